"""Carry out commands of curlfit in this process and keep what each of them answers.

    PYTHON -P tests/two_versions/answers.py CASES.json FOLDER

runs in the environment of either version, and needs nothing of curlfit but its command.
`CASES.json` has the commands by the name of their case. Each case is carried out in a
folder of its name, in which the results of its commands lie beside `answers.json`, the
exit status and the time of each, and their printed pages `1.out`, `1.err`, `2.out` ...
A case that has been answered is not repeated. The process ends early when it has taken
much memory; it is then to be started again. Exit status 3 if there is no curlfit.
"""

import contextlib
import json
import os
import resource
import sys
import time
from pathlib import Path

try:
    from curlfit.cli import main as curlfit_main
except ImportError:
    sys.exit(3)

MOST_MEMORY = 4e9
"""In bytes: programs that were compiled stay in memory."""

os.environ["COLUMNS"] = "110"  # pages are as wide for both versions


def answer(words: list[str]) -> int:
    """Carry out a command; returns its exit status, -1 if it raises an exception."""
    sys.argv = ["curlfit", *words]
    try:
        curlfit_main()
    except SystemExit as end:
        return int(end.code or 0)
    except Exception as error:
        print(f"traceback: {type(error).__name__}: {error}", file=sys.stderr)
        return -1
    return 0


def carry_out(commands: list[list[str]]) -> list[dict]:
    """Carry out the commands of a case in the working folder."""
    answers = []
    for number, words in enumerate(commands, start=1):
        begin = time.perf_counter()
        with (
            open(f"{number}.out", "w", encoding="utf-8") as out,
            open(f"{number}.err", "w", encoding="utf-8") as err,
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            status = answer(words)
        seconds = time.perf_counter() - begin
        answers.append({"words": words, "status": status, "seconds": seconds})
    return answers


def main() -> None:
    """Carry out the cases that have no answer yet."""
    cases = json.loads(Path(sys.argv[1]).read_text())
    results = Path(sys.argv[2]).resolve()
    for name, commands in cases.items():
        folder = results / name
        if (folder / "answers.json").exists():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        os.chdir(folder)
        (folder / "answers.json").write_text("[]")  # should a command end this process
        answers = carry_out(commands)
        (folder / "answers.json").write_text(json.dumps(answers, indent=1))
        kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if 1000 * kilobytes > MOST_MEMORY:
            return


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)
