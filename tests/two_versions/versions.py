"""Two versions of curlfit beside each other: this checkout and an earlier commit."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import time
import venv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
ANSWERS = Path(__file__).with_name("answers.py")
CANNOT_RUN = 3
"""Exit status of `ANSWERS` where curlfit cannot be imported."""
LIMIT = 300.0
"""Time for the commands of a case, in s."""
EXTRAS = "spreadsheet"
"""What a version is installed with, beside what it requires."""


@dataclass(frozen=True)
class Version:
    """A version of curlfit, with the Python that runs it."""

    name: str
    python: str
    sources: Path | None = None
    """folder with the package, if it is not the one that the Python has installed"""

    def environment(self, cache: Path) -> dict[str, str]:
        """Variables of a process that runs it, with a cache of compiled programs."""
        variables = os.environ | {"CURLFIT_CACHE": str(cache)}
        variables.pop("PYTHONPATH", None)
        if self.sources is not None:
            variables["PYTHONPATH"] = str(self.sources)
        return variables


def checkout(folder: Path) -> Version:
    """A copy of the sources of this checkout, run by this Python."""
    shutil.copytree(ROOT / "curlfit", folder / "curlfit", dirs_exist_ok=True)
    return Version("this checkout", sys.executable, folder)


def installed(python: str) -> Version:
    """What another Python has installed."""
    return Version(python, python)


def sources_of(commit: str, folder: Path) -> Version:
    """The sources of a commit, run by this Python with the libraries that it has.

    Raises
    ------
    subprocess.CalledProcessError : if there is no such commit.
    """
    archive = git("archive", "--format=tar", commit, "curlfit")
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
    return Version(commit, sys.executable, folder)


def commit_in_environment(commit: str, folder: Path) -> Version:
    """A commit, installed in an environment of its own, made where there is none."""
    python = folder / "bin" / "python"
    if not python.exists():
        sources = folder / "sources"
        subprocess.run(["git", "clone", "--quiet", ROOT, sources], check=True)
        checked_out = ["git", "-C", sources, "checkout", "--quiet", commit]
        subprocess.run(checked_out, check=True)
        venv.create(folder, with_pip=True)
        install = [python, "-m", "pip", "install", "--quiet", f"{sources}[{EXTRAS}]"]
        subprocess.run(install, check=True)
    return Version(commit, str(python))


def git(*words: str) -> bytes:
    """What git says of this checkout."""
    command = ["git", "-C", str(ROOT), *words]
    return subprocess.run(command, check=True, capture_output=True).stdout


def is_ancestor(commit: str, of: str) -> bool:
    """Whether a commit is another one or came before it."""
    words = ["git", "-C", str(ROOT), "merge-base", "--is-ancestor", commit, of]
    return subprocess.run(words, check=False, capture_output=True).returncode == 0


def ask(
    versions: Mapping[str, Version],
    cases: Mapping[str, Sequence[Sequence[str]]],
    folder: Path,
    say: Callable[[str], None] = lambda words: None,
) -> dict[str, Path]:
    """Have versions answer the same cases side by side.

    A process ends when a command ends it, when it has taken much memory, or when a case
    has taken longer than `LIMIT`; another one answers the cases that are left.

    Parameters
    ----------
    versions : by their part in the comparison.
    cases : the words of the commands of each case, by its name.
    folder : for the answers; cases that were answered there are not asked again.
    say : called with a sentence of how far it is.

    Returns
    -------
    The folders with the answers, by the part of the version.

    Raises
    ------
    RuntimeError : if a version cannot be run.
    """
    file = folder / "cases.json"
    file.write_text(json.dumps(cases))
    folders = {part: folder / f"answers {part}" for part in versions}
    running: dict[str, subprocess.Popen[bytes]] = {}
    started: dict[str, float] = {}
    try:
        for part, version in versions.items():
            folders[part].mkdir(exist_ok=True)
            forget_interrupted(folders[part])
            running[part] = start(version, file, folders[part])
            started[part] = time.time()
        while running:
            for part, version in versions.items():
                if part in running and stalled(folders[part], started[part]):
                    running[part].kill()
                if part in running and ended(running[part]):
                    if running.pop(part).returncode == CANNOT_RUN:
                        raise RuntimeError(f"{version.name} cannot be run")
                    if answered(folders[part]) < len(cases):
                        running[part] = start(version, file, folders[part])
                        started[part] = time.time()
            counts = (f"{answered(folders[part])} {part}" for part in versions)
            say(f"answered of {len(cases)} cases: {', '.join(counts)}")
    finally:
        for process in running.values():
            process.kill()
    return folders


def stalled(folder: Path, started: float) -> bool:
    """Whether a case has taken too long in a process that started at some time."""
    begun = [file.stat().st_mtime for file in folder.glob("*/answers.json")]
    return time.time() - max([started, *begun]) > LIMIT


def ended(process: subprocess.Popen[bytes]) -> bool:
    """Whether a process has ended, within half a second."""
    try:
        process.wait(timeout=0.5)
    except subprocess.TimeoutExpired:
        return False
    return True


def start(version: Version, cases: Path, folder: Path) -> subprocess.Popen[bytes]:
    """Start a process that answers the cases that are left."""
    cache = folder.with_name(folder.name.replace("answers", "programs"))
    return subprocess.Popen(
        [version.python, "-P", ANSWERS, cases, folder],
        env=version.environment(cache),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def answered(folder: Path) -> int:
    """How many cases have been answered."""
    return sum(1 for _ in folder.glob("*/answers.json"))


def forget_interrupted(folder: Path) -> None:
    """Have cases that were interrupted answered again."""
    for file in folder.glob("*/answers.json"):
        if not json.loads(file.read_text()):
            shutil.rmtree(file.parent)
