"""Words of the command line that its parser would not read as they are meant: values
that begin with a minus, `~` for the home, `-` for standard input."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import DATA, command, invoke
from sample_files import xlsx, xlsx_rows

from curlfit import InputError, load_fit
from curlfit.app.form import Written, values_of
from curlfit.cli import app
from curlfit.reports.fit import command_of
from curlfit.settings.choices import FILE, LAW, LAWS
from curlfit.settings.command_words import READ_STANDARD_INPUT, parser_words
from curlfit.settings.forms import PATH, Form

VERBS = [name for name in app if not name.startswith("-")]
WITH_VALUE = [
    (verb, argument.name)
    for verb in VERBS
    for argument in app[verb].assemble_argument_collection()
    if isinstance(argument.parameter.converter, Form)
]


# Values that begin with a minus


def test_every_option_takes_a_value_that_begins_with_a_minus():
    assert {"--range", "--target", "--derive", "--omega0"} <= {n for _, n in WITH_VALUE}
    for verb, option in WITH_VALUE:
        words = [verb, option, "-a+b", option, "-0.1,0.1", "-.5"]
        joined = [verb, f"{option}=-a+b", f"{option}=-0.1,0.1", "-.5"]
        assert parser_words(app, words) == joined


@pytest.mark.parametrize(
    "words",
    [
        ["fit", "a.csv", "--out", "-q"],
        ["fit", "a.csv", "--out", "-h"],
        ["fit", "a.csv", "--out", "--quiet"],
        ["fit", "a.csv", "--derive=v0", "-a"],
        ["fit", "a.csv", "--quiet", "-a"],
        ["fit", "-q", "--out", "there"],
        ["fit", "--", "--derive", "-a", "-"],
        ["fit"],
        ["nothing", "--derive", "-a"],
        ["--version"],
        [],
    ],
)
def test_other_words_stay(words):
    assert parser_words(app, words) == words


@pytest.mark.parametrize(
    "words",
    [
        ("profile", DATA, "--param", "mu1_xi", "--range", "-0.002,-0.001"),
        ("fit", DATA, "--derive", "-nothing + v0"),
        ("fit", DATA, "--until", "-1"),
        ("design", "--omega0", "-1.5,none"),
        ("predict", "no-fit", "--target", "-0.5,1"),
        ("simulate", "--sweep", "-1:-2=1"),
    ],
)
def test_a_value_with_a_minus_is_read_as_after_an_equals_sign(words, tmp_path):
    *arguments, option, value = words
    typed = command(*words, cwd=tmp_path)
    assert typed == command(*arguments, f"{option}={value}", cwd=tmp_path)
    assert typed.returncode == 2
    assert "requires an argument" not in typed.stderr


def test_the_page_reads_such_values_too():
    written = Written(line="--derive -mu1_eta+mu2_eta --since -1").words()
    assert values_of(app, written) == {"derive": ("-mu1_eta+mu2_eta",), "since": -1.0}


# The home


@pytest.fixture
def home(tmp_path, monkeypatch):
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("USERPROFILE", str(home))
    return home


@pytest.mark.parametrize(
    "words",
    [
        ("check", "~/no"),
        ("fit", "~/no"),
        ("fit", DATA, "--reference", "~/no"),
        ("fit", DATA, "--reference=~/no"),
        ("fit", DATA, "--throws", "~/no"),
        ("fit", DATA, "--config=~/no"),
        ("fit", DATA, "--law", "~/no.py:Mine"),
        ("simulate", "--law=~/no.py"),
        ("compare", DATA, "--laws=coulomb,~/no.py"),
        ("compare", "~/no"),
        ("batch", "~/no"),
        ("batch", "~/no/*.csv"),
        ("profile", "~/no", "--param", "mu"),
        ("predict", "~/no"),
        ("design", "--fit=~/no"),
        ("show", "~/no"),
        ("plot", "~/no"),
        ("report", "~/no"),
        ("export", "~/no", "--to", "csv"),
    ],
)
def test_a_tilde_is_the_home_wherever_a_path_is_taken(words, home, tmp_path):
    ran = command(*words, cwd=tmp_path)
    assert ran.returncode == 2
    assert f"{home / 'no'}" in ran.stderr
    assert "~" not in ran.stderr


def test_a_tilde_in_settings_is_the_home_too(home, tmp_path):
    for line in ('reference = "~/no"', 'throws = "~/no"', 'law = "~/no.py:Mine"'):
        (home / "c.toml").write_text(line)
        ran = command("fit", DATA, "--config", "~/c.toml", cwd=tmp_path)
        assert (ran.returncode, str(home / "no") in ran.stderr) == (2, True), ran
    ran = command("simulate", "--until=0.2", "--out", "~/a.csv", cwd=tmp_path)
    assert (ran.returncode, (home / "a.csv").is_file()) == (0, True)
    ran = command("check", "~/a.csv", "--out=~/a.png", cwd=tmp_path)
    assert (home / "a.png").is_file()


def test_a_name_may_begin_with_a_tilde(home):
    for name in ("~.csv", "~$book.xlsx", "a~/b"):
        assert parser_words(app, ["fit", name]) == ["fit", name]
        assert FILE.read_word("", name) == LAW.read_word("", name) == name
        assert PATH.read_word("", name) == Path(name)
    assert LAWS.checked("laws", "a.py,~/b.py") == ("a.py", f"{home / 'b.py'}")


# Standard input


def piped(*words: object, content: bytes, cwd: Path):
    """`curlfit` as a process of its own, with a content of its standard input."""
    return subprocess.run(
        [sys.executable, "-m", "curlfit", *map(str, words)],
        input=content,
        cwd=cwd,
        capture_output=True,
        timeout=600,
        check=False,
    )


def test_a_hyphen_is_standard_input(tmp_path):
    by_name = command("check", DATA, cwd=tmp_path).stdout
    ran = piped("check", "-", content=DATA.read_bytes(), cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, b"")
    assert ran.stdout.decode() == by_name.replace(str(DATA), "standard input")


def test_a_worksheet_is_read_from_standard_input(tmp_path):
    pytest.importorskip("python_calamine")
    lines = "\n".join(f"{t / 2},0,{t - 0.01 * t**2}" for t in range(20))
    book = xlsx(tmp_path / "throw.xlsx", xlsx_rows(f"t,x,y\n{lines}\n"))
    ran = piped("check", "-", content=book.read_bytes(), cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, b"")
    assert ran.stdout.startswith(b"standard input: table, 20 rows, t = 0 .. 9.5 s")


def test_a_fit_of_standard_input_has_a_name_and_its_command(tmp_path):
    words = ("fit", "-", "--law", "coulomb", "--no-sample", "--no-figures")
    ran = piped(*words, content=DATA.read_bytes(), cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert b"fitted to standard input\n" in ran.stdout
    assert [file.name for file in tmp_path.iterdir()] == ["standard-input-fit"]
    fit = load_fit(tmp_path / "standard-input-fit")
    assert fit.data.file == "standard input"
    assert command_of(fit).startswith("curlfit fit - --until=20")


def test_throws_of_a_table_have_folders(tmp_path):
    rows = "\n".join(f"13.{k},12.{k}" for k in range(3))
    table_of_throws = f"hog_to_hog,hog_to_rest\n{rows}\n".encode()
    words = ("fit", "-", "--law=coulomb", "--no-sample", "--no-figures")
    ran = piped(*words, content=table_of_throws, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    folders = sorted(file.name for file in (tmp_path / "standard-input-fit").iterdir())
    assert folders == ["joint.json", *(f"standard-input-{k}" for k in (1, 2, 3))]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fit", "-", "-"], "fit - -: standard input is read once; expected one `-`"),
        *(
            ([verb, "-"], f"{verb} -: only check, fit, compare and profile read stan")
            for verb in VERBS
            if verb not in READ_STANDARD_INPUT
        ),
        (["check", DATA, "--out", "-"], "--out -: expected a name; only data are"),
        (["fit", DATA, "--reference", "-"], "--reference -: expected a name; only"),
        (["fit", DATA, "--config=-"], "--config -: expected a name; only data are"),
    ],
)
def test_standard_input_is_read_once_and_as_data_alone(words, said):
    refused = invoke(words)
    assert isinstance(refused.exception, InputError)
    assert str(refused.exception).startswith(said)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "curlfit: standard input: the file is empty; expected"),
        (b"t,x,y\n0,0,a\n", "curlfit: standard input, line 2, column y: 'a' found"),
        (b"PK\x03\x04" + bytes(40), "curlfit: standard input: this is a spreadsheet"),
    ],
)
def test_a_fault_in_standard_input_is_one_sentence(content, said, tmp_path):
    ran = piped("fit", "-", content=content, cwd=tmp_path)
    assert (ran.returncode, ran.stdout, list(tmp_path.iterdir())) == (2, b"", [])
    assert ran.stderr.decode().startswith(said)
    assert ran.stderr.count(b"\n") == 1


# What is said of options


def test_the_command_line_says_options_as_they_are_typed_there(tmp_path):
    (tmp_path / "a.csv").write_text("hog_to_hog,rest\n1.2,39\n")
    ran = command("fit", "a.csv", "--no-sample", "--no-figures", cwd=tmp_path)
    assert "`--units t=ms` or `--units length=cm`" in " ".join(ran.stdout.split())
    assert "from_arrays" not in ran.stdout + ran.stderr
