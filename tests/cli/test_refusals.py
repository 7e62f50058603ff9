"""What cannot be carried out is refused in one sentence, and everything
stays as it was.

Refusals of what a file holds are with the readers, those of a table of `batch`
with that verb.
"""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest
from conftest import DATA, command, process

REFUSED = [
    line.split("  |  ")
    for line in Path(__file__).with_name("refusals.txt").read_text().splitlines()
    if line and not line.startswith("#")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, eq12_fit):
    """A throw with its fit, a joint fit, and a spreadsheet."""
    folder = tmp_path_factory.mktemp("refused")
    for name in "ab":
        shutil.copy(DATA, folder / f"{name}.csv")
    (folder / "a-fit").mkdir()
    eq12_fit.save(folder / "a-fit" / "fit.json")
    (folder / "book.xlsx").write_bytes(b"PK\x03\x04" + bytes(40))
    (folder / "joint").mkdir()
    (folder / "joint" / "joint.json").write_text("{}")
    return folder


@pytest.mark.parametrize(("words", "said"), REFUSED)
def test_a_refusal_is_one_sentence_and_nothing_is_written(folder, words, said):
    before = sorted(folder.rglob("*"))
    ran = command(*shlex.split(words), cwd=folder)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert said in " ".join(ran.stderr.replace("│", " ").split())
    assert ran.stderr.startswith(("curlfit: ", "╭"))
    assert ran.stderr.count("\n") == 1 or ran.stderr.startswith("╭")
    assert sorted(folder.rglob("*")) == before


def sentence(ran) -> str:
    """The one of a refusal, which shows foreign text within bounds."""
    assert (ran.returncode, ran.stdout) == (2, ""), ran
    assert ran.stderr.startswith("curlfit: ")
    assert ran.stderr.count("\n") == 1
    assert ran.stderr[:-1].isprintable()
    assert len(ran.stderr) < 1100
    return ran.stderr


ROWS = "t,x,y\n0,0,0\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"# stone.{'a.' * 25000}a = 1\n{ROWS}", "line 1: a line of 50013 characters"),
        (
            f"# {'x' * 1000}\n{ROWS}",
            "line 1: a line of 1002 characters; expected at most 1000",
        ),
        ("t,x,y" + ",a" * 500 + "\n", "line 1: a line of 1005 characters"),
        (f"{ROWS}1,2,{'3' * 20_000}\n", "line 3: a line of 20004 characters"),
        (
            "".join(f"# reference.values.a{k} = 1\n" for k in range(501)) + ROWS,
            "line 501: more than 500 settings",
        ),
        (ROWS + "\n" * 2_000_000, "more than 2000000 lines"),
        (ROWS + "1,2,3\n" * 8_400_000, "larger than 50000 kB"),
        (f"# law = '{'x' * 900}'\n{ROWS}", "unknown law 'xxxxxx"),
        ("# filmed\n# seed = -1\n" + ROWS, "line 2: seed = -1"),
        # a line of JSON may be long
        ('{"trajectory": [' + "[]," * 10_000 + "[]]}", "no trajectory found"),
    ],
)
def test_data_beyond_any_throw_are_refused(text, said, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    message = sentence(command("check", "a.csv", cwd=tmp_path))
    assert message.startswith("curlfit: a.csv")
    assert said in message
    assert "x" * 100 not in message


WHOLE = "expected a whole number from 0 to 4294967295"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('fix = "x"', "fix = 'x'; expected fix.NAME = a number"),
        ("stone = 1", "stone = 1; expected stone.NAME = a number"),
        ("stone.R = [1]", "stone.R = [1]; expected a number"),
        (
            "stone.R = 2026-01-05",
            "stone.R = datetime.date(2026, 1, 5); expected a number",
        ),
        ("start.v0 = 1" + "0" * 400, "expected a number, 0, or 1e-30 to 1e12"),
        ("until = nan", "until = nan; expected a time in s"),
        ("bound.v0 = ['a', 1]", "bound.v0 = ['a', 1]; expected [low, high]"),
        ("prior = 1", "prior = 1; expected prior.NAME"),
        ("prior.rho = 0.1", "prior.rho = 0.1; expected a string such as"),
        ('free = "rho"', "free = 'rho'; expected a list of names"),
        ('systematic.rho = "much"', "systematic.rho = 'much'; expected a number"),
        ("unbounded = 1", "unbounded = 1; expected true or false"),
        ("shot = 1.5", "expected a whole number from 1"),
        *(
            (f"seed = {seed}", WHOLE)
            for seed in ("-1", "1.5", "true", "'a'", str(2**32))
        ),
        ("free = [\n" + "[\n" * 25_000, "nested too deeply"),
        (f"stone.{'a.' * 300}a = 1", "stone.a = {'a': "),
        ("#" * 1001, "line 1: a line of 1001 characters"),
        ("# comment\n" * 6_401, "larger than 64 kB"),
        ('"\\u001b[31m" = 1', r"unknown setting '\x1b[31m'"),
    ],
)
def test_settings_of_wrong_types_are_refused(text, said, tmp_path):
    (tmp_path / "c.toml").write_text(text)
    message = sentence(command("check", DATA, "--config", "c.toml", cwd=tmp_path))
    assert message.startswith("curlfit: c.toml")
    assert said in message


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("fit", "nothing.csv"), "curlfit: nothing.csv: no such file"),
        (("fit", DATA, "--nonsense"), "Unknown option"),
    ],
)
def test_a_refusal_ends_the_process_with_status_2(words, said, tmp_path):
    run = process(*words, cwd=tmp_path)
    assert (run.returncode, run.stdout) == (2, "")
    assert said in run.stderr
    assert "Traceback" not in run.stderr


def test_a_refused_fit_leaves_earlier_results_alone(folder, tmp_path):
    before = (folder / "a-fit" / "fit.json").read_bytes()
    (tmp_path / "bad.csv").write_text(DATA.read_text().replace("0.205793511", "hello"))
    run = command("fit", tmp_path / "bad.csv", "--out", "a-fit", cwd=folder)
    message = f"curlfit: {tmp_path / 'bad.csv'}, line 17, column y: 'hello' found"
    assert (run.returncode, run.stderr[: len(message)]) == (2, message)
    assert [file.name for file in (folder / "a-fit").iterdir()] == ["fit.json"]
    assert (folder / "a-fit" / "fit.json").read_bytes() == before
