"""What a reader says of a file are findings: codes with numbers, as in JSON."""

from __future__ import annotations

import json

import pytest
from sample_files import PLAIN, SAMPLES, note_on

import curlfit
from curlfit import DataError, InputError, load_throw
from curlfit.errors import Option
from curlfit.findings import Finding
from curlfit.records import plain
from curlfit.throws.throw import counts_from_hack


@pytest.mark.parametrize("name", sorted(set(SAMPLES) - {"log", "pixels", "friction"}))
def test_numbers_of_notes_are_those_of_json(name, tmp_path):
    (tmp_path / "data").write_text(SAMPLES[name], encoding="utf-8")
    for note in load_throw(tmp_path / "data").notes:
        written = json.loads(json.dumps(plain(note.numbers), allow_nan=False))
        assert written == note.numbers
        assert str(Finding.note(note.code, *note.remedies, **written)) == str(note)


def test_y_is_from_the_hack_where_a_note_says_so(write):
    timed = load_throw(write("hog_to_hog = 14.2\nhog_to_rest = 10\n"))
    assert note_on(timed, "y-from-the-hack").numbers["far_tee"] == pytest.approx(38.405)
    assert counts_from_hack(timed.notes)
    for axes, from_hack in (("from_tee", True), ("x-left", False)):
        throw = load_throw(write(PLAIN), axes=axes)
        assert str(note_on(throw, "axes")) == f"axes: {axes}"
        assert counts_from_hack(throw.notes) == from_hack


@pytest.mark.parametrize(
    ("sentence", "from_hack"),
    [
        ("y from the hack, x from the line of delivery: the stone's centre", True),
        ("axes: x-left,from-tee", True),
        ("axes: x-left", False),
        ("columns ignored: from-tee", False),
    ],
)
def test_sentences_of_earlier_versions_say_whether_y_is_from_the_hack(
    sentence, from_hack
):
    assert counts_from_hack([Finding.note("text", text=sentence)]) == from_hack


def test_a_record_of_a_stopwatch_has_no_axes_and_no_pixels(write):
    timed = write("hog_to_hog = 14.2\nhog_to_rest = 10\n", "timed.csv")
    with pytest.raises(InputError, match=r"leave out `--axes`$") as caught:
        load_throw(timed, axes="x-left")
    assert caught.value.options == (Option("axes", left_out=True),)


@pytest.mark.parametrize(
    ("text", "choices", "option"),
    [
        ("t,x_px,y_px\n0,1,2\n1,1,3\n", {}, Option("reference", "FILE")),
        ("frame,x,y\n0,1,2\n1,1,3\n", {}, Option("units", "t=30fps")),
        (
            "t,x,y,Twist (gon)\n0,1,2,3\n1,1,3,4\n",
            {"columns": {"phi": "Twist"}},
            Option("units", "phi=UNIT"),
        ),
        (
            "t,x,y,phi (rad)\n"
            + "".join(f"{k},0,{k},{100 * k % 360}\n" for k in range(40)),
            {},
            Option("units", "angle=deg"),
        ),
    ],
)
def test_an_error_carries_the_option_that_its_sentence_proposes(
    write, text, choices, option
):
    with pytest.raises(DataError) as caught:
        load_throw(write(text), **choices)
    assert caught.value.options == (option,)
    assert str(option) in str(caught.value)


def test_a_saved_fit_still_says_that_y_is_from_the_hack(write):
    timed = load_throw(write("hog_to_hog = 14.2\nhog_to_rest = 10\n"))
    fit = curlfit.fit(timed, "coulomb", details=False)
    assert fit.counts_from_hack
    entries = json.loads(json.dumps(fit.to_json()))
    again = curlfit.FitResult.from_json(entries)
    assert tuple(again.data.notes) == timed.notes
    assert again.counts_from_hack
    del entries["data"]["findings"]  # as an earlier version wrote it
    earlier = curlfit.FitResult.from_json(entries)
    assert {note.code for note in earlier.data.notes} == {"text"}
    assert list(map(str, earlier.data.notes)) == list(map(str, timed.notes))
    assert earlier.counts_from_hack
