"""What is printed: no blanks at the ends of lines, and nothing cut in a
narrow terminal."""

import os
import pty
import re
import shlex
import subprocess
import sys
from contextlib import suppress
from io import StringIO

import pytest
from conftest import invoke
from rich.console import Console
from rich.text import Text

import curlfit
from curlfit.output.console import terminal
from curlfit.output.text import sided
from curlfit.paper.claim import Claim, printed_claims
from curlfit.throws.synthetic import law_with, synthetic_throw, write_table
from curlfit.wording import compact, format_estimate, p_text


@pytest.fixture(scope="module")
def folder(tmp_path_factory, eq12_posterior):
    """Throws, and a fit with a posterior."""
    root = tmp_path_factory.mktemp("printed")
    for name, v0 in (("a", 2.0), ("b", 2.1)):
        throw = synthetic_throw(
            law_with("front-back", {}),
            curlfit.Stone(),
            v0=v0,
            until=15,
            noise_xy=0.005,
            noise_phi=0.01,
        )
        (root / f"{name}.csv").write_text(write_table(throw))
    (root / "saved").mkdir()
    eq12_posterior[0].save(root / "saved" / "fit.json")
    return root


VERBS = {
    "fit": ("fit", "a.csv", "--no-sample", "--out", "fit"),
    "joint fit": ("fit", "a.csv", "b.csv", "--out", "joint"),
    "show": ("show", "saved"),
    "check": ("check", "a.csv"),
    "laws": ("laws",),
    "compare": ("compare", "a.csv", "--laws", "front-back", "--out", "compare"),
    "profile": (
        "profile",
        "a.csv",
        "--param",
        "mu1_xi",
        "--points",
        "5",
        "--out",
        "profile",
    ),
    "profile of two": (
        "profile",
        "a.csv",
        "--param",
        "mu1_xi",
        "--param",
        "mu2_xi",
        "--points",
        "5",
        "--out",
        "pair",
    ),
    "predict": ("predict", "saved", "--draws", "100", "--out", "predict"),
    "design": ("design", "--v0", "1.6,2.2", "--omega0", "1,10", "--out", "design"),
    "batch": ("batch", "a.csv", "b.csv", "--workers", "1"),
    "simulate": ("simulate", "--until", "1"),
    "plot": ("plot", "saved", "--out", "drawn"),
}
DRAWING = ("fit", "compare", "profile", "predict", "design")


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_prints_whole_lines(verb, folder, monkeypatch):
    monkeypatch.chdir(folder)
    words = VERBS[verb]
    if words[0] in DRAWING:
        words += ("--no-figures",)
    for width in (60,) if verb == "plot" else (110, 80, 60):
        if width == 110:  # what a pipe gets
            monkeypatch.delenv("COLUMNS", raising=False)
        else:
            monkeypatch.setenv("COLUMNS", str(width))
        run = invoke(words)
        assert run.exit_code == 0, run.exception
        lines = run.stdout.splitlines()
        assert not [line for line in lines if line != line.rstrip()]
        assert "\N{HORIZONTAL ELLIPSIS}" not in run.stdout
        assert "..." not in run.stdout
        if verb == "simulate":  # a table for a file
            return
        # A list of files stays whole, to be copied.
        assert not [
            line for line in lines if len(line) > width and "Written:" not in line
        ]
        if "--out" in words and verb != "plot":  # at other widths from what was saved
            words = ("show", words[words.index("--out") + 1])


def test_a_terminal_gets_no_blanks_either(folder):
    leader, follower = pty.openpty()
    run = subprocess.Popen(
        [sys.executable, "-m", "curlfit", "show", "saved"],
        cwd=folder,
        stdout=follower,
        env={**os.environ, "COLUMNS": "80", "TERM": "xterm-256color"},
    )
    os.close(follower)
    written = b""
    with suppress(OSError):  # what Linux says at the end of a terminal
        while part := os.read(leader, 65536):
            written += part
    os.close(leader)
    assert run.wait() == 0
    assert b"\x1b[" in written
    shown = re.sub(r"\x1b\[[0-9;]*m", "", written.decode())
    assert "mu1_xi" in shown
    assert not [line for line in shown.splitlines() if line != line.rstrip()]


@pytest.mark.parametrize(
    ("words", "closed"),
    [
        (("show", "saved"), "unread"),
        (("show", "saved"), ">&-"),
        (("show", "nothing"), "2>&-"),
        (("show", "nothing"), "<&- >&- 2>&-"),
    ],
)
def test_who_does_not_want_to_read_changes_nothing(folder, words, closed):
    command = [sys.executable, "-m", "curlfit", *words]
    how = {}
    if closed == "unread":
        unread, how["stdout"] = os.pipe()
        os.close(unread)
    else:
        command = ["sh", "-c", f"{shlex.join(command)} {closed}"]
    run = subprocess.run(
        command,
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        **{"stdout": subprocess.DEVNULL, **how},
    )
    failed = "nothing" in words
    message = (
        "curlfit: nothing: no such file\n" if failed and "2>&-" not in closed else ""
    )
    assert (run.returncode, run.stderr) == (2 if failed else 0, message)


def test_a_plain_terminal_is_given_what_it_can_show(folder):
    text = (
        (folder / "a.csv").read_text().replace("phi", "\N{GREEK SMALL LETTER PHI}_rad")
    )
    (folder / "greek.csv").write_text(text, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "curlfit", "check", "greek.csv"],
        cwd=folder,
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "cp1252"},
        check=False,
    )
    assert (run.returncode, run.stderr) == (0, b"")
    shown = run.stdout.decode("cp1252")
    assert "?_rad" in shown


def test_styles_and_blanks_within_a_line_stay():
    console = terminal()
    console.file = StringIO()
    console.print(Text("a  b   "), Text("  c ", style="bold"), "")
    console.print(Text(" \n d  "))
    assert console.file.getvalue() == "a  b      c\n\n d\n"


@pytest.mark.parametrize(
    ("value", "stderr", "texts", "together"),
    [
        (0.0556, 0.0012, ("0.0556", "0.0012"), "0.0556(12)"),
        (123456.7, 12.0, ("123457", "12"), "123457(12)"),
        (1e300, 3e298, ("1.00e+300", "3.0e+298"), "1.00e+300 +- 3.0e+298"),
        (-2.5e12, 1.0e9, ("-2.5000e+12", "1.0e+09"), "-2.5000e+12 +- 1.0e+09"),
        (1000.0, 1e20, ("1.0e+03", "1.0e+20"), "1.0e+03 +- 1.0e+20"),
    ],
)
def test_numbers_of_extreme_size(value, stderr, texts, together):
    assert format_estimate(value, stderr) == texts
    assert compact(value, stderr) == together
    assert max(map(len, format_estimate(float("inf"), 1.0))) < 12


def test_the_claims_keep_their_formulas_at_80_columns():
    claim = Claim(
        "eq14y",
        "d2y/dt2 from eq. 12",
        "-0.08 (1-t/23)^-0.013 m/s^2",
        "-0.0804 (1-t/23)^-0.897, then",
        "holds with a correction",
        "Two digits change places.",
    )
    console = Console(width=80, file=StringIO())
    console.print(printed_claims((claim,)))
    text = console.file.getvalue()
    for word in (*claim.printed.split(), *claim.computed.split()):
        assert word in text
    assert "\N{HORIZONTAL ELLIPSIS}" not in text


@pytest.mark.parametrize(
    ("meaning", "value", "expected"),
    [
        ("curl to the right, at rest", -1.15, ("curl to the left, at rest", -1.0)),
        ("curl to the right, at rest", 1.15, ("curl to the right, at rest", 1.0)),
        ("turns counter-clockwise", -2.0, ("turns clockwise", -1.0)),
        ("rests right of centre line", -0.1, ("rests left of centre line", -1.0)),
        ("rests beyond tee line", -0.1, ("rests before tee line", -1.0)),
        ("mean deceleration / g", -0.1, ("mean deceleration / g", 1.0)),
    ],
)
def test_a_signed_quantity_is_told_with_its_side(meaning, value, expected):
    assert sided(meaning, value) == expected


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "p < 0.001"),
        (1e-30, "p < 0.001"),
        (0.00099, "p < 0.001"),
        (0.0012, "p = 0.0012"),
        (0.31, "p = 0.31"),
    ],
)
def test_a_p_value_is_never_zero(value, text):
    assert p_text(value) == text
