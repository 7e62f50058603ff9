"""The form of the page: the flags of the commands, and what sentences propose."""

from __future__ import annotations

import re
import sys
from contextlib import suppress

import pytest
from conftest import DATA, command, invoke
from hypothesis import given, settings, strategies as st

from curlfit import load_throw
from curlfit.app.form import fields_of, merged, proposals, values_of, words_of
from curlfit.app.reading import look
from curlfit.cli import app
from curlfit.errors import InputError

SUM = ("--law", "power+sideways")
FIT, COMPARE = fields_of(app, "fit"), fields_of(app, "compare")
WRITTEN = {
    "--units": "t=ms,x=cm",
    "--until": "18",
    "--sweep": "6:11",
    "--fix": "phi0=0,x0=1",
    "--bound": "mu1_xi=0:0.05 mu2_xi=:1",
    "--unbounded": "yes",
    "--free": "slope_x,drag",
    "--derive": "mu2_xi - mu1_xi",
    "--noise": "ar1",
    "--keep": "3,5",
}


def test_the_form_has_the_flags_that_the_command_lists():
    text = command("fit", "--help", cwd=DATA.parent).stdout
    # of another command
    listed = set(re.findall(r"--(?!empty)[a-z-]+", text)) - {"--conditions"}
    beside = {"--out", "--figures", "--no-figures", "--report", "--quiet", "--resume"}
    assert beside <= listed
    assert set(FIT) == listed - beside
    assert all(field.help and field.group for field in FIT.values())


def test_what_is_written_reads_as_the_command_reads_it():
    words = words_of(FIT, WRITTEN)
    _, bound, _ = app.parse_args(["fit", "a.csv", *words])
    flags, reading = bound.arguments["flags"], bound.arguments["reading"]
    assert values_of(FIT, WRITTEN) == {**flags.given(), **reading.given()}
    assert "--noise=ar1" in words
    with pytest.raises(InputError, match="--until soon: expected a time in s"):
        values_of(FIT, {"--until": "soon"})


def test_a_comparison_takes_the_flags_that_it_has():
    assert words_of(COMPARE, {"--law": "coulomb", "--until": "18"}) == ["--until=18"]


@pytest.mark.parametrize(
    ("sentence", "found"),
    [
        (
            "in feet: `--units length=ft`. As they are: `--as-given`",
            [("--units", "length=ft"), ("--as-given", "yes")],
        ),
        ("`--noise ar1` or `--law power`", [("--noise", "ar1"), ("--law", "power")]),
        (
            "give points with `--reference FILE` (columns u,v,x,y)",
            [("--reference", "")],
        ),
        (
            "to be tried: `--sweep 5.0:9.2` (friction that differs meanwhile), "
            "`--until 4.5` (without the rows after it)",
            [("--sweep", "5.0:9.2"), ("--until", "4.5")],
        ),
        ("a heading with --reference FILE in it", []),
        ('as in `--columns "x=wide"`, or `--by sheet`', []),
        ("`--law evil.py:L`, `--law power+evil.py:L`, `--law power+sideways`", [SUM]),
        ("`--units 'x`, `--bound a=\"0:1`", []),
        (
            "`--systematic` sets, `--stone-index N` selects, "
            "`curlfit design --separate a,b`",
            [],
        ),
        ("`--rm /`", []),
    ],
)
def test_proposals(sentence, found):
    assert proposals(FIT, sentence) == found


def test_a_proposal_is_added_to_what_is_written():
    assert merged(FIT["--free"], "drag", "slope_x") == "drag,slope_x"
    assert merged(FIT["--bound"], "a=0:1", "b=0:1") == "a=0:1 b=0:1"
    assert merged(FIT["--free"], "drag", "drag") == "drag"
    assert merged(FIT["--units"], "t=s", "t=ms") == "t=ms"


def test_what_is_seen_of_a_throw_is_what_the_command_says(write):
    seen = look([DATA], {})
    assert (seen.fault, seen.oddities) == ("", [])
    throw = load_throw(DATA)
    assert "230 rows in 22.9 s" in seen.finding
    assert (
        f"turns {throw.phi[-1] / (2 * 3.14159265):.2g} times counter-clockwise"
        in seen.finding
    )
    curl = re.search(r"curls ([\d.]+) m to the left", seen.finding)[1]
    assert float(curl) == pytest.approx(-throw.x[-1], abs=0.1)  # thrown along y
    assert seen.shown.count("<svg") == 3
    for line in invoke(["check", DATA]).stdout.splitlines()[:5]:
        assert line in seen.text

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
    said = str(invoke(["fit", file, "--no-sample"]).exception)
    assert look([file], {}).fault == said
    assert proposals(FIT, said)[0] == ("--units", "length=ft")
    assert look([file], {"units": "length=ft"}).fault == ""


def test_a_folder_of_draws_and_a_table_of_friction():
    seen = look([DATA.parent / "evening.csv"], {})
    assert "throws, which are fitted together" in seen.finding
    assert "hog to hog (s)" in seen.shown
    seen = look([DATA.parent / "sutor_1988_friction.csv"], {})
    assert seen.finding == "13 values of friction against speed, 0.6 to 3.98 m/s"


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
    seen = look([write(HOSTILE[name], name)], chosen)
    sentences = [seen.fault, *seen.oddities, *seen.notes]
    assert any(sentences) or seen.finding
    found = [one for text in sentences for one in proposals(FIT, text)]
    assert ("--as-given", "yes") not in found
    assert not {flag for flag, _ in found} & {"--law", "--reference"}


MARKS = st.sampled_from(["`", '"', "'", "\\", "=", ",", ":", "--law ", "1e999", "\0"])
TYPED = st.lists(MARKS | st.text(max_size=6), max_size=8).map("".join)


@settings(max_examples=300, deadline=None)
@given(flag=st.sampled_from(sorted(FIT)), text=TYPED)
def test_any_text_of_a_field_is_taken_or_refused(flag, text):
    words = words_of(FIT, {flag: text})
    assert all(word.startswith(flag) for word in words)
    with suppress(InputError):
        values_of(FIT, {flag: text})
    for proposed, value in proposals(FIT, f"give `{flag} {text}`"):
        words_of(FIT, {proposed: merged(FIT[proposed], text, value)})
