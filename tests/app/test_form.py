"""What is written on the page: its line of options as the command reads it, and what
findings propose."""

from __future__ import annotations

import math
import re
import shlex
import sys
from contextlib import suppress

import pytest
from conftest import DATA, command, invoke
from hypothesis import given, settings, strategies as st

from curlfit import load_throw
from curlfit.app.form import (
    Written,
    flags_of,
    help_of,
    proposals,
    values_of,
    words_for,
)
from curlfit.app.reading import look
from curlfit.cli import app
from curlfit.errors import InputError, Option

SUM = ("--law", "power+sideways")
FIT = flags_of(app, "fit")
COMPARE = flags_of(app, "compare")
LINE = (
    "--units t=ms,x=cm --until 18 --sweep=6:11 --fix phi0=0,x0=1 --bound mu1_xi=0:0.05 "
    "--bound mu2_xi=:1 --unbounded --free slope_x,drag --derive 'mu2_xi - mu1_xi' "
    "--noise ar1 --keep 3,5"
)


def test_the_page_knows_the_flags_that_the_command_lists():
    text = command("fit", "--help", cwd=DATA.parent).stdout
    # of another command
    listed = set(re.findall(r"--(?!empty)[a-z-]+", text)) - {"--conditions"}
    beside = {"--out", "--figures", "--no-figures", "--report", "--quiet", "--resume"}
    assert beside <= listed
    assert set(FIT) == listed - beside
    shown = help_of(app, "fit")
    assert set(re.findall(r"--(?!empty)[a-z-]+", shown)) - {"--conditions"} == listed
    assert "\x1b" not in shown


def test_a_line_reads_as_the_command_reads_it():
    words = Written(law="coulomb", stone="rho=0.1", line=LINE).words()
    assert words == ["--law=coulomb", "--stone=rho=0.1", *shlex.split(LINE)]
    _, bound, _ = app.parse_args(["fit", "a.csv", *words])
    flags = bound.arguments["flags"]
    reading = bound.arguments["reading"]
    assert values_of(app, words) == {**flags.given(), **reading.given()}
    assert flags.derive == ("mu2_xi - mu1_xi",)
    assert flags.bounds == {"mu1_xi": (0.0, 0.05), "mu2_xi": (-math.inf, 1.0)}


def test_a_comparison_takes_the_flags_that_it_has():
    words = ["--law=coulomb", "--until", "18", "--derive", "a b", "--no-sample"]
    assert words_for(COMPARE, words) == ["--until", "18"]
    assert words_for(FIT, words) == words


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("--bound 'mu1_xi=0", "mark or a backslash has no end; expected options as on"),
        ("--until 18\\", "mark or a backslash has no end; expected options as on"),
        ("--until soon", "--until soon: expected a time in s"),
        ("--until", "--until requires an argument"),
        ("--unti 18", "Unknown option: --unti. Did you mean --until"),
        ("18", "18: expected an option, as --until 18; files are dropped above"),
        ("--derive mu2_xi + mu1_xi", "+: expected an option, as"),
        ("--until 18 /etc/passwd", "/etc/passwd: expected an option"),
        ("-- --x", "--x: expected an option"),
        ("--out=/tmp/x", "--out: the page itself writes and saves results"),
        ("--report", "--report: the page itself writes and saves results"),
        ("-q", "--quiet: the page itself writes and saves results"),
        ("--resume", "--resume: the page itself writes and saves results"),
        ("--help", "--help: expected options of the fit; all are listed below"),
        ("-h", "--help: expected options of the fit; all are listed below"),
    ],
)
def test_what_the_command_would_refuse_is_refused_in_a_sentence(line, said):
    with pytest.raises(InputError, match=re.escape(said)):
        values_of(app, Written(line=line).words())


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (
            [Option("units", "length=ft"), Option("as-given")],
            [("--units", "length=ft"), ("--as-given", "yes")],
        ),
        (
            [Option("noise", "ar1"), Option("noise", "ar1"), Option("law", "power")],
            [("--noise", "ar1"), ("--law", "power")],
        ),
        ([Option("reference", "FILE")], [("--reference", "")]),
        ([Option("columns", '"x=wide"'), Option("by", "sheet")], []),
        (
            [
                Option("law", "evil.py:L"),
                Option("law", "power+evil.py:L"),
                Option("law", "power+sideways"),
            ],
            [SUM],
        ),
        ([Option("bound", '"0:1"'), Option("units", "'x")], []),
        ([Option("stone-index", "N"), Option("rm", "/")], []),
        ([Option("units", "phi=UNIT")], []),
        ([Option("since", "3", in_python=True), Option("axes", left_out=True)], []),
    ],
)
def test_proposals(options, found):
    assert proposals(FIT, options) == found


def test_a_proposal_is_added_to_what_is_written():
    line = Written().with_option(FIT["--free"], "drag")
    assert line == Written(line="--free drag")
    assert line.with_option(FIT["--free"], "drag") == line
    longer_line = line.with_option(FIT["--free"], "slope_x")
    assert values_of(app, longer_line.words()) == {"free": ("drag", "slope_x")}
    milli = Written(line="--units t=s").with_option(FIT["--units"], "t=ms")
    assert values_of(app, milli.words()) == {"units": "t=ms"}  # the last one counts
    quoted = Written().with_option(FIT["--reference"], "my points.csv")
    assert quoted.line == "--reference 'my points.csv'"
    assert Written().with_option(FIT["--as-given"], "yes").line == "--as-given"
    law = Written(law="coulomb").with_option(FIT["--law"], "power")
    assert law == Written(law="power")
    stone = Written(stone="R=0.05").with_option(FIT["--stone"], "rho=0.1")
    assert stone == Written(stone="R=0.05,rho=0.1")


def test_what_is_seen_of_a_throw_is_what_the_command_says(write):
    reading = look([DATA], {})
    assert (reading.fault, reading.oddities) == ("", [])
    throw = load_throw(DATA)
    assert "230 rows in 22.9 s" in reading.finding
    assert (
        f"turns {throw.phi[-1] / (2 * 3.14159265):.2g} times counter-clockwise"
        in reading.finding
    )
    curl = re.search(r"curls ([\d.]+) m to the left", reading.finding)[1]
    assert float(curl) == pytest.approx(-throw.x[-1], abs=0.1)  # thrown along y
    assert reading.shown.count("<svg") == 3
    for line in invoke(["check", DATA]).stdout.splitlines()[:5]:
        assert line in reading.text

    lines = DATA.read_text().splitlines()
    head = lines.index("t,x,y,phi")
    rows = [line.split(",") for line in lines[head + 1 :]]
    text = "\n".join(
        [lines[head]]
        + [
            f"{t},{float(x) / 0.3048},{float(y) / 0.3048},{phi}"
            for t, x, y, phi in rows
        ]
    )
    file = write(text, "feet.csv")
    reading = look([file], {})
    assert reading.fault == str(invoke(["fit", file, "--no-sample"]).exception)
    assert proposals(FIT, reading.options)[0] == ("--units", "length=ft")
    assert look([file], {"units": "length=ft"}).fault == ""


def test_a_folder_of_draws_and_a_table_of_friction():
    reading = look([DATA.parent / "evening.csv"], {})
    assert "throws, which are fitted together" in reading.finding
    assert "hog to hog (s)" in reading.shown
    reading = look([DATA.parent / "sutor_1988_friction.csv"], {})
    assert reading.finding == "13 values of friction against speed, 0.6 to 3.98 m/s"


def test_without_nicegui_the_command_says_how_to_install_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    monkeypatch.chdir(tmp_path)
    done = invoke(["app"])
    assert done.exit_code == 2
    assert "pip install 'curlfit[app]'" in str(done.exception)
    assert "--port 99999: expected a whole number" in str(
        invoke(["app", "--port", "99999"]).exception
    )


EVIL = "`--law evil.py:L` `--as-given` `--reference FILE`"
ESCAPED = EVIL.replace("`", "\\u0060")
HOSTILE = {
    "heading.csv": f"t,x,y,phi,{EVIL}\n0,0,0,0,1\n1,1,1,1,1\n",
    "headings.csv": f"{EVIL},{EVIL} 2\n1,2\n2,3\n",
    "cell.csv": f"t,x,y\n0,0,0\n1,{EVIL},2\n",
    "setting.csv": f'# {EVIL} = 1\n# law = "{EVIL}"\nt,x,y\n0,0,0\n1,1,2\n',
    "escaped.csv": f'# stone = "{ESCAPED}"\nt,x,y\n0,0,0\n1,1,2\n',
    "key.csv": f'# "{ESCAPED}" = 1\nt,x,y\n0,0,0\n1,1,2\n',
    "units.csv": f"t [{EVIL}],x,y\n0,0,0\n1,1,2\n",
    "label.csv": f'hog to hog (s),{EVIL}\n12,a\n13,"{EVIL}"\n14,"{EVIL} 2"\n',
    "keys.json": f'{{"{ESCAPED}": [0, 1], "t": [0, 1], "x": ["{ESCAPED}", 1]}}',
    "record.json": f'{{"cmd": "{ESCAPED}", "version": "{ESCAPED}"}}\n{{"cmd": 1}}\n',
    "rows.json": f'[{{"t": 0, "x": "{ESCAPED}", "y": 1}}, {{"t": 1, "{ESCAPED}": 2}}]',
    "columns.txt": f"t {EVIL} y\n0 0 0\n1 1 1\n",
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("chosen", [{}, {"columns": {"x": EVIL}}, {"worksheet": "a"}])
def test_words_of_a_file_make_no_button(name, chosen, write):
    reading = look([write(HOSTILE[name], name)], chosen)
    findings = [*reading.oddities, *reading.notes]
    assert reading.fault or findings or reading.finding
    options = [
        *reading.options,
        *(option for finding in findings for option in finding.options),
    ]
    buttons = proposals(FIT, options)
    assert ("--as-given", "yes") not in buttons
    assert not {flag for flag, _ in buttons} & {"--law", "--reference"}


MARKS = st.sampled_from(["`", '"', "'", "\\", "=", ",", ":", "--law ", "1e999", "\0"])
TYPED = st.lists(MARKS | st.text(max_size=6), max_size=8).map("".join)


@settings(max_examples=100, deadline=None)
@given(flag=st.sampled_from(sorted(FIT)), text=TYPED)
def test_any_line_is_taken_or_refused(flag, text):
    for written in (
        Written(line=text),
        Written(line=f"{flag} {text}"),
        Written(law=text, stone=text),
    ):
        with suppress(InputError):
            values_of(app, written.words())
    for proposed, value in proposals(FIT, [Option(flag[2:], text)]):
        written = Written(line=text).with_option(FIT[proposed], value)
        with suppress(InputError):
            assert written.words()
