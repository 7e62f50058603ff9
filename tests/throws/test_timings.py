"""Records of a stopwatch and a tape, as people write them."""

from __future__ import annotations

import csv
import math
import sys
from functools import partial

import numpy as np
import pytest
from conftest import invoke, parts_in
from sample_files import CELL, PLAIN, TIMINGS, ods

import curlfit
from curlfit import load_joint
from curlfit.errors import DataError, InputError, Option
from curlfit.settings.choices import Reading
from curlfit.sheet import LINES
from curlfit.throws.load import detect_format, load_throw, usual_law
from curlfit.throws.odd_row import OddRow, odd_row_findings, odd_rows_in_words
from curlfit.throws.readers.text import TextFile

FOOT = 0.3048
INCH = FOOT / 12
THREE = "hog_to_hog = 14.2\nrest = 0.6\n"


@pytest.fixture
def read(write):
    return lambda text: load_throw(write(text))


def values(throw):
    return {event.name: event.value for event in throw.events}


def test_a_record(read):
    throw = read(TIMINGS)
    assert throw.labels == {}
    assert not throw.has_path
    assert throw.defaults["law"] == "front-back"  # curl and turns were measured
    events = {event.name: event for event in throw.events}
    # back line, hog lines and far tee, m from the hack (World Curling, rule R1)
    lines = {name: (event.since, event.at) for name, event in events.items()}
    assert lines == {
        "back_to_hog": (1.829, 10.059),
        "hog_to_hog": (10.059, pytest.approx(32.004)),
        "hog_to_rest": (pytest.approx(32.004), None),
        "rest": (None, None),
        "curl": (10.059, None),
        "turns": (10.059, None),
    }
    expected = {
        "back_to_hog": 3.4,
        "hog_to_hog": 14.2,
        "hog_to_rest": 10.3,
        "rest": 38.405 + 0.6,
        "curl": -4 * FOOT,
        "turns": 5 * math.pi,
    }
    assert values(throw) == pytest.approx(expected)
    sigmas = {name: event.sigma for name, event in events.items()}
    assert sigmas == pytest.approx(
        dict.fromkeys(("back_to_hog", "hog_to_hog", "hog_to_rest"), 0.1)
        | {"rest": 0.05, "curl": 0.05, "turns": 0.2 * math.pi}
    )


@pytest.mark.parametrize(
    "text",
    [
        "hog_to_hog;14,2\nhog_to_rest;10,3\n",
        'name,value\n"hog_to_hog","14.2 s"\nhog_to_rest,10.3\n',
        "hog_to_rest = 0.1716667 min\nHOG_TO_HOG: 14200 ms\n",
        "hog-to-hog: 14.2\nHog to rest = 10,3 s\n",
        "# sheet 3\n\nhog-to-hog = 14.2 sec # by hand\nhog-to-rest: 10.3;\n",
        "hog_to_hog, hog_to_rest\n14.2, 10.3\n",
        "h2h (s)\thog_to_rest\n14.2\t10.3\n",
        "hog2hog;Hog2rest\n14,2;10,3\n",
        "H-H;far hog to stop\n14,2;10,3\n",
        "hog-to-hog;hog to rest;who\n14,2;10,3;me\n",
        "hog_to_hog_ms,hog_to_rest\n14200,10.3\n",
    ],
)
def test_times_in_any_form(read, text):
    assert values(read(text)) == pytest.approx(
        {"hog_to_hog": 14.2, "hog_to_rest": 10.3}, rel=1e-6
    )


@pytest.mark.parametrize(
    ("line", "x"),
    [
        ("curl = 4 ft left", -4 * FOOT),
        ("Curl: 1.2 m right", 1.2),
        ("curl = 4 ft 6 in left", -4.5 * FOOT),
        ("curl = 4,5 ft right", 4.5 * FOOT),
        ("curl = -4 ft", -4 * FOOT),
        ("curl = +1.2", 1.2),
        ("curl = 0", 0.0),
        ("curl_ft = 4 L", -4 * FOOT),
        ("curl = 3'3\" left", -39 * INCH),
        ("curl = 3' 3\" right", 39 * INCH),
        ("curl = 3' left", -3 * FOOT),
        ('curl = 39" left', -39 * INCH),
        ("curl = 39'' left", -39 * INCH),
        ("curl = 3 ft 3 in left", -39 * INCH),
        ("curl = 3\u2032 3\u2033 left", -39 * INCH),
        ("curl = 3'3 left", -39 * INCH),
        ('curl = "3\'3" left"', -39 * INCH),
        ('curl = "3\'3""\nhandle = cw', 39 * INCH),
        ("curl = '1.2 m left'", -1.2),
        ("curl = 1.2 m left\nhandle = in", -1.2),
        ("curl = 1.2\nhandle = clockwise", 1.2),
        ("curl = 1.2\nhandle: ccw", -1.2),
        ("curl = 1.2\nhandle = in-turn right-handed", 1.2),
        ("curl = 1.2\nhandle = inturn, left-handed", -1.2),
        ("curl = 1.2\nspin = out turn right-handed", -1.2),
        ("curl = 1.2\nturns = 2.5 clockwise", 1.2),
        ("curl = 1.2\nturns = -2.5", 1.2),
        ("curl = 1.2\nrotation = counter clockwise", -1.2),
    ],
)
def test_the_side_of_the_curl(read, line, x):
    # a stone that turns clockwise curls to the right
    throw = read(THREE + line)
    assert values(throw)["curl"] == pytest.approx(x)
    if x and "turns" not in line:
        assert throw.assumed["omega0"] * x < 0


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("rest = 0.6", 0.6),
        ("rest: 2 ft past the tee", 2 * FOOT),
        ("rest = -0.6", -0.6),
        ("rest = 60 cm short of the tee line", -0.6),
        ("rest = 3 ft in front of the tee", -3 * FOOT),
        ("rest = 3 ft behind", 3 * FOOT),
        ("rest = 3 ft long", 3 * FOOT),
        ("rest = 1'2\" in front of the tee", -14 * INCH),
        ("rest = 0'11\" short", -11 * INCH),
        ("rest = -1'2\"", -14 * INCH),
        ("turns = 2.5 ccw", 2.5),
        ("turns = 2.5 counter-clockwise", 2.5),
        ("turns = 2.5 Anti clockwise", 2.5),
        ("turns = 900 deg counter-clockwise", 2.5),
        ("turns = -2.5", -2.5),
        ("turns = 2.5\ncurl = 1 m right", -2.5),
        ("turns = 900 deg clockwise", -2.5),
        ("turns = 2.5\nhandle = ccw", 2.5),
    ],
)
def test_the_place_of_rest_and_turns(read, text, found):
    """From the far tee line, and in revolutions."""
    name = text[:5].strip(" :")
    expected = {"rest": 38.405 + found, "turns": 2 * math.pi * found}[name]
    assert values(read(f"hog_to_hog = 14.2\nhog_to_rest = 10.3\n{text}\n"))[
        name
    ] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("text", "speed", "spin"),
    [
        ("speed = 7.2 km/h\nrest = 0.6\nspin = 12 rpm cw", 2.0, -0.4 * math.pi),
        ("speed: 2.0\nspin: -90 deg/s\nrest: 0.6", 2.0, -math.pi / 2),
        ("speed = 6,5 ft/s\nspin = 1.4 rad/s\nhandle = ccw\nrest = 1", 6.5 * FOOT, 1.4),
        ("rest = 1\nvelocity = 2 m/s\nomega = 1.4\ncurl = 1 m right", 2.0, -1.4),
        ("speed,spin,curl,rest\n2.0,+1.4,1.1 left,0.6", 2.0, 1.4),
        ("v_km_h;spin_rate_rpm;curl;rest\n7,2;12;1,1 left;0,6", 2.0, 0.4 * math.pi),
        ("speed (ft/s),spin (rad/s),turns,rest\n6.5,1.4,3 cw,0.6", 6.5 * FOOT, -1.4),
        ("speed,spin,rest\n2.0,90 \N{DEGREE SIGN}/s ccw,0.6", 2.0, math.pi / 2),
    ],
)
def test_speed_and_spin_at_the_near_hog_line(read, text, speed, spin):
    events = {event.name: event for event in read(text).events}
    speed_and_spin = events["speed"], events["spin"]
    assert [event.value for event in speed_and_spin] == pytest.approx([speed, spin])
    assert {(event.at, event.since) for event in speed_and_spin} == {(10.059, None)}
    assert [event.sigma for event in speed_and_spin] == [0.02, 0.05]


def test_a_column_of_words_about_the_spin_is_the_handle(read):
    throw = read("speed,spin,curl,rest,sigma_speed_km_h\n2.0,cw,1.1,0.6,0.36")
    assert throw.labels == {"handle": "cw"}
    assert values(throw)["curl"] == pytest.approx(1.1)
    assert {event.name for event in throw.events} == {"speed", "curl", "rest"}
    assert throw.events[-1].sigma == pytest.approx(0.1)


def test_a_path_with_its_speed_and_spin_is_a_path(read):
    rows = "\n".join(
        f"{k / 10},{0.01 * k},{0.2 * k},0,{2.0 - k / 50},1.0" for k in range(20)
    )
    throw = read(f"t,x,y,rest,speed,spin\n{rows}")
    assert throw.seen == ("x", "y", "speed", "omega")


def test_sigmas_are_set(read):
    throw = read(
        THREE
        + "curl = 1 m left\nsigma_time = 0.2\nsigma_rest = 3 cm\nsigma-curl = 0.1\n"
    )
    assert [event.sigma for event in throw.events] == pytest.approx([0.2, 0.03, 0.1])


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (
            "hog_to_hog = 14\n",
            None,
            "hog_to_hog alone gives the mean speed and no friction",
        ),
        ("rest = 0.6\ncurl = 1 m left\n", None, "no time; expected lines such as"),
        ("hog_to_hog = -14\nhog_to_rest = 3\n", 1, "expected a number above 0"),
        (
            "hog_to_hog = 142\nhog_to_rest = 3\n",
            1,
            "142 found, expected a number up to 60",
        ),
        ("hog_to_hog = 14 m\nhog_to_rest = 3\n", 1, "unknown unit"),
        ("hog_to_hog = 14\nhog_to_hog = 14\n", 2, "given twice"),
        ("hog_to_hog = 14\nhouse = 14\n", 2, "is not known"),
        ("hog_to_hog = 14\nhog_to_rest = 10\nrest = 400\n", 3, "up to 40"),
        (THREE + "curl = 4 ft\n", 3, "to which side. Expected curl = 4 ft left"),
        (THREE + "curl = 4 ft\nhandle = in-turn\n", 4, "of which hand"),
        (
            THREE + "curl = 4 ft\nhandle = left\n",
            4,
            "expected clockwise or counter-clockwise",
        ),
        (THREE + "curl = -4 ft left\n", 3, "a sign and a word"),
        (THREE + "curl = 4 ft past\n", 3, "expected a number and left or right"),
        (
            THREE + "curl = 1 m 20 left\n",
            3,
            "'1 m 20 left' found, expected a unit of 20",
        ),
        (THREE + "turns = 2.5\n", 3, "in which sense"),
        (
            "hog_to_hog = 14.2\nrest = -7\n",
            2,
            "-7 m past the far tee lies before a line",
        ),
        (
            "hog_to_hog = 14.2\nhog_to_tee = 14.1\n",
            2,
            "expected more than hog_to_hog = 14.2 s",
        ),
        ("speed = 2\nspin = 1 cw\n", None, "speed alone gives speed and no friction"),
        (
            "speed = 2\nrest = 1\nspin = 1.2\n",
            3,
            "in which sense. Expected spin = 1.4 rad/s",
        ),
        ("speed = 2 m\nrest = 1\n", 1, "speed in 'm': unknown unit"),
        ("speed = 0\nrest = 1\n", 1, "expected a number above 0"),
        ("speed = 22\nrest = 1\n", 1, "expected a number up to 10"),
        ("hog_to_hog,rest\n", 1, "no rows"),
        ("hog_to_hog,rest\n14.2\n", 2, "1 cell where the header has 2 columns"),
    ],
)
def test_records_that_cannot_be(read, text, line, words):
    with pytest.raises(DataError, match=words) as caught:
        read(text)
    assert caught.value.line == line


def test_a_table_has_a_throw_in_each_row(tmp_path):
    file = tmp_path / "evening.csv"
    file.write_text(
        "# law = 'power'\nthrow,hog_to_hog,curl,rest (ft),side\n"
        "1,14.2,4 ft left,2,x\n\n2,13.8,1.1 m right,-1,\n3,14.0,,1.5,\n4,14.0,1,1,\n"
    )
    parts = parts_in(file)
    assert [part.shot for part in parts] == [1, 2, 3, 4]
    first, second, third, fourth = (part.throw for part in parts)
    assert values(second) == pytest.approx(
        {"hog_to_hog": 13.8, "rest": 38.405 - FOOT, "curl": 1.1}
    )
    assert values(third).keys() == {"hog_to_hog", "rest"}
    assert first.name == f"{file} row 1"
    assert first.defaults["law"] == "power"
    assert isinstance(fourth, DataError)
    assert fourth.line == 7
    chosen = load_throw(file, shot=2)
    assert values(chosen) == values(second)
    assert str(chosen.notes[0]) == (
        "4 throws, one in each row; taken: 2; `--shot N` selects another"
    )
    (third,) = parts_in(file, shot=3)
    assert (third.shot, third.throw.read_with) == (3, ("--shot=3",))
    with pytest.raises(
        InputError, match="there is no such row; expected one of 1 line 3; 2"
    ):
        load_throw(file, shot=9)


@pytest.mark.parametrize(
    ("rows", "law"),
    [
        ("14.2,11,1,4 ft left,2.5 ccw", "front-back"),
        ("14.2,11,1,4 ft left,", "coulomb"),
        ("14.2,11,1,4 ft left,2.5 ccw\n14.0,11,1,,", "front-back"),
        ("14.2,11,1,4 ft left,2.5 ccw\n14.0,11,1,,\n14.1,11,1,,", "coulomb"),
    ],
)
def test_the_law_is_that_of_what_was_measured(tmp_path, rows, law):
    file = tmp_path / "evening.csv"
    file.write_text("hog_to_hog,hog_to_rest,rest,curl,turns\n" + rows + "\n")
    assert {part.throw.defaults["law"] for part in parts_in(file)} == {law}
    assert (
        usual_law(file, Reading()) == usual_law(file, Reading(format="timings")) == law
    )


def test_a_table_says_of_which_throw_each_row_is(tmp_path):
    file = tmp_path / "evening.csv"
    file.write_text(
        "Draw,Start, sheet ,Who threw,hog_to_hog,rest,remark,humidity\n"
        "1,19:05,A,Anna,14.2,0.3,,40\n2,19:12,,Bea,13.9,0.2,early,41\n"
        "3,19:20,B,Bea,14,0,n/a,40\n"
    )
    first, second, _ = (part.throw for part in parts_in(file))
    assert first.labels == {
        "draw": "1",
        "start": "19:05",
        "sheet": "A",
        "who_threw": "Anna",
    }
    assert second.labels == {"draw": "2", "start": "19:12", "who_threw": "Bea"}
    (ignored,) = (note for note in first.notes if note.code == "columns-ignored")
    assert ignored.numbers == {"columns": ["remark", "humidity"]}
    assert (
        second.with_defaults(law="power").with_sigma({"time": 0.2}).labels
        == second.labels
    )


@pytest.mark.parametrize("separator", [",", "\t"])
def test_feet_and_inches_and_gaps_in_a_table(tmp_path, separator):
    file = tmp_path / "evening.csv"
    rows = (
        ["hog to hog", "hog to rest", "curl", "rest", "handle"],
        ["14.2", "11", "3'3\" left", "1'2\" past", "out"],
        ["14.2", "n/a", '"3\'3"" left"', '39" short', "in"],
        ["14.2", "--", "nan", "-", "in"],
        ["-", "", "", "n/a", "out"],
        ["14.2", "11", '"3\'3" left"', '"0.3 m"', "out"],
    )
    file.write_text("\n".join(map(separator.join, rows)) + "\n")
    first, second, third, fourth, fifth = parts_in(file)
    assert values(first.throw) == pytest.approx(
        {
            "hog_to_hog": 14.2,
            "hog_to_rest": 11,
            "curl": -39 * INCH,
            "rest": 38.405 + 14 * INCH,
        }
    )
    assert values(second.throw) == pytest.approx(
        {"hog_to_hog": 14.2, "curl": -39 * INCH, "rest": 38.405 - 39 * INCH}
    )
    assert values(fifth.throw)["curl"] == pytest.approx(-39 * INCH)
    assert second.throw.labels == {"handle": "in"}
    assert values(third.throw) == {"hog_to_hog": 14.2}
    assert (second.alone, third.alone.line) == (None, 4)
    assert isinstance(fourth.throw, DataError)
    assert [part.left_out for part in parts_in(file)] == [
        False,
        False,
        False,
        True,
        False,
    ]
    with pytest.raises(
        DataError, match=r"line 4.*hog_to_hog alone gives the mean speed"
    ):
        load_throw(file, shot=3)


def evening(folder, *changed, rows=12, curl=True):
    """A table of nearly equal throws on lines 2 ... with some rows in other words."""
    lines = []
    for k in range(rows):
        times = f"{13.5 + k % 4 / 10},{12 - k % 3}"
        lines.append(f"{times},{3.1 + k % 5 / 10} ft left" if curl else times)
    for k, text in changed:
        lines[k] = text
    header = "hog_to_hog,hog_to_rest,curl" if curl else "hog_to_hog,hog_to_rest"
    file = folder / "evening.csv"
    file.write_text("\n".join([header, *lines]) + "\n")
    return file


@pytest.mark.parametrize(
    "row", ["31.65,11,3.2 ft left", "13.6,11,33 ft left", "13.6,11,9.9 m left"]
)
def test_an_odd_row_is_left_out_of_a_joint_fit_unless_it_is_kept(tmp_path, row):
    file = evening(tmp_path, (4, row))
    parts = parts_in(file)
    assert [k for k, part in enumerate(parts) if part.left_out] == [4]
    assert [odd.line for odd in parts[0].throw.odd_rows] == [6]
    (finding,) = odd_row_findings(parts[0].throw.odd_rows)
    assert finding.code == "odd-rows-left-out"
    assert [remedy.option for remedy in finding.remedies] == [Option("keep", "6")]
    (sentence,) = odd_rows_in_words(parts[0].throw.odd_rows)
    assert sentence.startswith("Left out as odd: line 6 (row 5, ")
    assert sentence.endswith("; `--keep 6` keeps it.")
    assert parts[4].odd_row.fault in sentence
    kept = parts_in(file, keep=[6])
    assert not any(part.left_out for part in kept)
    assert kept[4].throw.read_with == ("--keep=6",)
    file.write_text("# keep = [6]\n" + file.read_text())
    # now line 7
    assert [k for k, part in enumerate(parts_in(file)) if part.left_out] == [4]


def test_odd_rows_of_a_table_are_told_in_one_sentence():
    exchanged = OddRow("a.csv", 5, 6, "hog to hog", 16.93, "s", 3.934)
    impossible = OddRow("a.csv", 7, 8, "curl", 10.0, "m", None)
    of_another = OddRow("b.csv", 1, 2, "turns", 9.0, "turns", -6.0, left_out=False)
    assert odd_rows_in_words([exchanged, impossible]) == [
        "Left out as odd: line 6 (row 5, hog to hog 16.93 s: 3.93 s more than the "
        "other rows say); line 8 (row 7, curl 10 m, beyond any stone); "
        "`--keep 6,8` keeps them."
    ]
    first, second = odd_rows_in_words([exchanged, of_another])
    assert first.startswith("a.csv: left out as odd: line 6 (row 5, ")
    assert second == (
        "b.csv: odd rows, used since they are more than a fifth: line 2 (row 1, "
        "turns 9 turns: 6 turns less than the other rows say)."
    )


def test_an_odd_row_is_in_the_first_lines_of_check_and_batch(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    evening(tmp_path, (4, "31.65,11"), curl=False)
    odd = "line 6 (row 5, hog to hog 31.65 s: 18"
    run = invoke(["check", "evening.csv"])
    assert run.exit_code == 0, run.exception
    first_lines = " ".join(" ".join(run.stdout.splitlines()[:3]).split())
    assert f"Left out as odd: {odd}" in first_lines
    assert "`--keep 6` keeps it." in first_lines
    run = invoke(["batch", "evening.csv", "--workers", "1", "--out", "season.csv"])
    assert run.exit_code == 0, run.exception
    first_line = run.stdout.splitlines()[0]
    assert first_line.startswith(f"evening.csv: left out as odd: {odd}")
    assert "0 not usable, 0 failed, 1 odd. Written" in run.stdout
    with open("season.csv", newline="") as stream:
        rows = [*csv.DictReader(stream)]
    assert [row["status"] for row in rows[3:6]] == ["ok", "odd", "ok"]
    assert rows[4]["reason"].startswith(f"left out as odd: {odd}")
    run = invoke(
        ["batch", "evening.csv", "--workers", "1", "--keep", "6", "--out", "kept.csv"]
    )
    assert "12 ok" in run.stdout


def test_guards_and_takeouts_are_not_odd_and_few_rows_are_left_out(tmp_path):
    varied = ((1, "9.1,-,-"), (2, "15.4,6.5,0.4 m left"), (3, "13,12.5,6 ft right"))
    assert not any(part.left_out for part in parts_in(evening(tmp_path, *varied)))
    absurd = tuple((row, f"{30 + row},11,1 m left") for row in (1, 2, 3))
    first, *later_parts = parts_in(evening(tmp_path, *absurd))
    assert not any(part.left_out for part in (first, *later_parts))
    assert [odd.left_out for odd in first.throw.odd_rows] == [False] * 3
    (finding,) = odd_row_findings(first.throw.odd_rows)
    assert finding.code == "odd-rows-used"
    (sentence,) = odd_rows_in_words(first.throw.odd_rows)
    assert sentence.startswith(
        "Odd rows, used since they are more than a fifth: line 3"
    )
    first, *_ = parts_in(evening(tmp_path, absurd[0], rows=4))
    assert not first.throw.odd_rows


def test_rows_of_weight_alone_need_one_that_determines_friction(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    a = 0.0085 * 9.81
    v = 2.25
    d = np.array([21.945, 28.346])
    hog, tee = (v - np.sqrt(v**2 - 2 * a * d)) / a  # from the near hog line
    header = "hog_to_hog,hog_to_tee,curl,turns,hog spilt,humidity\n"
    alone = "13.5,,,,,40\n,,,,,41\n"
    file = tmp_path / "evening.csv"
    file.write_text(header + 2 * alone)
    run = invoke(["fit", "evening.csv"])
    assert run.exit_code == 2
    assert "line 2: hog_to_hog alone gives the mean speed" in str(run.exception)
    file.write_text(header + alone + 8 * f"{hog},{tee},0,0,,40\n")
    words = "fit evening.csv --law front-back --no-figures --no-sample --out joint"
    run = invoke(words.split())
    assert run.exit_code == 0, run.exception
    text = " ".join(run.stdout.split())
    for words in (
        "Note: left out of a joint fit, since no time was measured: line 3.",
        "Note: column hog spilt is not understood; expected one of "
        "back_to_hog, hog_to_hog",
        "Note: columns ignored: hog spilt, humidity.",
    ):
        assert text.count(words) == 1, words
    joint = load_joint(tmp_path / "joint")
    (total,) = joint.combinations  # without spin
    assert total.value == pytest.approx(2 * 0.0085, rel=1e-5)


def test_labels_of_tracks(tmp_path):
    for name in ("a.csv", "b.csv", "c.csv"):
        (tmp_path / name).write_text(PLAIN)
    notes = tmp_path / "notes.csv"
    folder = tmp_path.name
    notes.write_text(
        f"file,sheet,hog_to_hog,humidity\na.csv,2,14.2,40\n{folder}/b,3,,41\n"
    )
    a, b, c = (load_throw(tmp_path / f"{name}.csv", throws=notes) for name in "abc")
    assert (a.labels, b.labels, c.labels) == ({"sheet": "2"}, {"sheet": "3"}, {})
    assert [str(note) for note in a.notes] == [
        f"labels and measurements from {notes}, line 2",
        "columns ignored: humidity",
        "its measurements are not used, as they are at lines of the sheet; "
        "`--axes from-hack` says that y begins there",
    ]
    assert not a.events
    assert [note.code for note in c.notes] == ["not-in-the-table"]
    assert a == c
    for text, words in (
        (
            "sheet,stone\n1,2\n",
            "no names of throws; expected a column `file` or `track`",
        ),
        ("track,sheet\na,1\na.csv,2\n", "line 3: 'a.csv' is named again"),
        ("# empty\n", "comments only"),
    ):
        notes.write_text(text)
        with pytest.raises(DataError, match=words):
            load_throw(tmp_path / "a.csv", throws=notes)


def test_measurements_beside_a_track_are_used(tmp_path):
    law = curlfit.law_with("front-back", {"mu1_xi": 0.004, "mu2_xi": 0.05})
    times = np.append(np.arange(0, 4, 0.1), [20.0, 60.0])
    hog = LINES["hog"]
    start = curlfit.InitialState(y=hog, v=2.25, omega=1.4)
    path = curlfit.simulate(law, curlfit.Stone(), start, times).to_numpy()
    noise = np.random.default_rng(4).standard_normal((3, len(times) - 2))
    rows = np.array([times, path.x, path.y, path.phi])[:, :-2].T
    rows[:, 1:] += (0.005 * noise * np.array([[1], [1], [2]])).T
    clip = tmp_path / "clip.csv"
    notes = tmp_path / "notes.csv"
    np.savetxt(clip, rows, delimiter=",", header="t,x,y,phi", comments="")
    past = path.y[-1] - LINES["far-tee"]
    turns = path.phi[-1] / (2 * np.pi)
    notes.write_text(
        "file,sheet,rest (m),curl (m),turns\n"
        f"clip,2,{past:.3f},{path.x[-1]:.3f},{turns:.2f} ccw\n"
    )
    options = {"axes": "from-hack", "throws": str(notes)}
    alone = load_throw(clip, axes="from-hack")
    with_measurements = load_throw(clip, **options)
    assert [event.name for event in with_measurements.events] == [
        "rest",
        "curl",
        "turns",
    ]
    assert with_measurements.notes[-1].code == "measurements-of-a-table"
    fits = [curlfit.fit(throw, details=False) for throw in (alone, with_measurements)]
    errors = [fit.combinations[0].stderr for fit in fits]
    assert errors[1] < errors[0] / 3
    assert fits[1].combinations[0].value == pytest.approx(0.018, abs=3 * errors[1])
    assert fits[1]["mu2_xi"].value == pytest.approx(
        0.05, abs=3 * fits[1]["mu2_xi"].stderr
    )


def test_a_spreadsheet_is_read_as_its_text(tmp_path):
    pytest.importorskip("python_calamine")
    text = partial(CELL.format, "string", "")
    clock = CELL.format("time", 'office:time-value="PT19H05M00S"', "19:05")
    number = CELL.format("float", 'office:value="13.5"', "13.5")
    rows = (
        text('# law = "power"'),
        "",
        text("start") + text("hog to hog") + text("curl"),
        clock + number + text("3'3\" left; or so"),
        clock + number + text("3'3\" left"),
    )
    file = ods(tmp_path / "evening.ods", rows)
    assert detect_format(TextFile.read(file).lines) == "timings"
    bad, good = parts_in(file)
    assert bad.throw.line == 4
    assert good.throw.labels == {"start": "19:05"}
    assert good.throw.defaults["law"] == "power"
    assert values(good.throw) == pytest.approx({"hog_to_hog": 13.5, "curl": -39 * INCH})


def test_a_spreadsheet_without_its_reader_is_refused_with_what_to_install(
    tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    file = tmp_path / "evening.xlsx"
    file.write_bytes(b"PK\x03\x04" + bytes(40))
    with pytest.raises(
        DataError, match=r"save the sheet as CSV, or .* 'curlfit\[spreadsheet\]'"
    ):
        load_throw(file)


def test_a_column_that_is_not_understood_is_never_left_out_in_silence(write):
    """Neither a measurement with its unit, which would be a label, nor where one
    time is left."""
    rows = "1,13.4,12.9,1 m past,3A\n2,13.6,12.5,0.5 m past,4B\n"
    throw = load_throw(write("draw,hog to hog,hog to rest,Abstand,mark\n" + rows))
    (note,) = (note for note in throw.notes if note.code == "columns-not-understood")
    assert str(note).startswith("column Abstand is not understood; expected one of ")
    assert throw.labels["abstand"] == "1 m past"
    with pytest.raises(DataError) as caught:
        load_throw(
            write(
                "draw,hog to hog,hog-house,Curl (cm) L+,weight\n"
                "1,13.4,22.9,1,12\n2,13,22,1,12\n"
            )
        )
    assert str(caught.value).endswith(
        "line 2: hog_to_hog alone gives the mean speed and no friction; expected one "
        "more of rest, hog_to_rest, or another time; columns hog-house, Curl (cm) L+ "
        "are not understood; columns ignored: hog-house, Curl (cm) L+, weight"
    )


def test_turns_without_a_sense_are_left_out_where_other_rows_have_one(tmp_path):
    file = tmp_path / "evening.csv"
    file.write_text(
        "hog to hog,rest,curl,turns\n"
        "13.1,0.3 m past,1.1 m right,3\n"
        "13.3,0.2 m short,,2.5\n"
        "13.2,0.4 m past,,2.75 clockwise\n"
        "13.0,0.9 m past,1.0 m left,\n"
    )

    throws = curlfit.load_throws(file)

    names = [[event.name for event in throw.events] for throw in throws]
    assert [("turns" in of_throw) for of_throw in names] == [True, False, True, False]
    (note,) = (note for note in throws[0].notes if note.code == "turns-without-a-sense")
    assert str(note).endswith("turns and spin of line 3")


def test_a_table_of_turns_that_never_says_a_sense_is_refused(tmp_path):
    file = tmp_path / "evening.csv"
    file.write_text("hog to hog,rest,turns\n13.1,0.3,3\n13.3,-0.2,2.5\n")
    with pytest.raises(curlfit.DataError, match="line 2, column turns: in which sense"):
        curlfit.load_throws(file)
