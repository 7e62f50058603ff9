"""Columns by their headings: other languages, headings that the user names, and
those unused."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from conftest import command
from sample_files import PHI, T, X, Y, is_throw, note_on, table

from curlfit import DataError, Throw, load_throw
from curlfit.errors import Option

TURNS = PHI / (2 * np.pi)
DEGREES = np.degrees(PHI)


def written(headings: str, *columns: np.ndarray) -> str:
    return table(
        dict(zip(headings.split(";"), columns or (T, X, Y, DEGREES), strict=True)), ";"
    )


@pytest.mark.parametrize(
    "headings",
    [
        "Zeit [s];x-Position [m];y-Position [m];Winkel [°]",
        "Zeit in s;X-Koordinate in m;Y-Koordinate in m;Drehwinkel in Grad",
        "Temps (s);Position X (m);Position Y (m);Angle (degrés)",
        "Tid (s);x-läge (m);y-läge (m);Vinkel (grader)",
        "時間 (s);x位置 (m);y位置 (m);角度 (度)",
        "時刻(秒);X座標(m);Y座標(m);回転角(度)".translate({40: 0xFF08, 41: 0xFF09}),
        "t;x;y;Handle angle (deg)",
        "time;x;y;yaw_deg",
        "t;x;y;Angle (Grad)",
        "t;Stone x;Stone y;angle_deg",
        "Time (s);Trajectory 1/0/X;Trajectory 1/0/Y;angle_deg",
    ],
)
def test_headings_in_other_words(write, headings):
    text = written(headings)
    is_throw(load_throw(write(text)))
    is_throw(load_throw(write(text.encode("cp932" if "x位置" in text else "utf-16"))))
    with suppress(UnicodeEncodeError):
        is_throw(load_throw(write(text.encode("cp1252"))))


def test_inches_are_no_filling_word(write):
    file = write(written("t;Stone x (in);y-läge in m;yaw (rad)", T, X / 0.0254, Y, PHI))
    is_throw(load_throw(file))
    file = write(
        written("t;Off (in);Far in ft;yaw (rad)", T, X / 0.0254, Y / 0.3048, PHI)
    )
    is_throw(load_throw(file, columns={"x": "Off (in)", "y": "Far in ft"}))


@pytest.mark.parametrize(
    "heading", ["turns", "Umdrehungen", "tours", "Winkel (Umdrehungen)"]
)
def test_turns_are_angles(write, heading):
    is_throw(load_throw(write(written(f"t;x;y;{heading}", T, X, Y, TURNS))))


def test_words_in_other_languages_yield_to_those_of_curlfit(write):
    """What was read before is read as before, whatever else is there."""
    for heading in ("Winkel", "Zeit", "px", "x-läge", "Tempo"):
        throw = load_throw(write(written(f"t;x;y;phi;{heading}", T, X, Y, PHI, 0 * T)))
        is_throw(throw)
        assert throw.seen == (
            "x",
            "y",
            "phi",
            *(["speed"] if heading == "Tempo" else []),
        )
    words = "\n".join(f"{t},{x},{y},out" for t, x, y in zip(T, X, Y, strict=True))
    throw = load_throw(write("t,x,y,Drehung\n" + words))
    is_throw(throw, phi=False)
    assert note_on(throw, "columns-ignored").numbers == {"columns": ["Drehung"]}
    two = load_throw(write(written("t;x;y;Winkel;yaw", T, X, Y, PHI, 2 * PHI)))
    assert two.seen == ("x", "y")
    assert (
        str(two.notes[0])
        == 'not used, and perhaps phi: Winkel; `--columns "phi=Winkel"` reads them so'
    )


def test_the_user_names_columns(write):
    file = write(
        written("When;Off;Far (m);Turned (deg);x;phi", T, X, Y, DEGREES, 0 * T, 0 * T)
    )
    names = {"t": "when", "x": "Off", "y": "far", "angle": "Turned (deg)"}
    is_throw(load_throw(file, columns=names))
    lines = "".join(
        f'# columns.{key} = "{heading}"\n' for key, heading in names.items()
    )
    annotated_file = write(lines + file.read_text(), "own.csv")
    throw = load_throw(annotated_file)
    is_throw(throw)
    assert "columns" not in throw.defaults
    words = [
        "--columns",
        ", ".join(f"{key}={heading}" for key, heading in names.items()),
    ]
    ran = command("check", file, *words, cwd=file.parent)
    assert ran.returncode == 0, ran.stderr
    assert "Turned (deg)  phi       deg" in ran.stdout
    again = load_throw(file, columns=names, units="t=ms")
    np.testing.assert_allclose(again.t, T / 1000)
    frame = {"when": T, "off": X, "far": Y, "phi": PHI}
    is_throw(Throw.from_frame(frame, columns={"t": "when", "x": "off", "y": "far"}))


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"t": "Uhr"}, "columns t='Uhr': no column of this name among t, x, y, Drall"),
        ({"mass": "x"}, "columns 'mass'='x': expected one of t, x, y, angle"),
        (
            {"x": "y", "y": "y"},
            "columns y='y': more than one column, or one named twice",
        ),
        ({"phi": "x"}, "no column for x among t, x, y, Drall"),
    ],
)
def test_columns_that_cannot_be_named_so(write, columns, words):
    with pytest.raises(DataError, match="line 1: ") as caught:
        load_throw(write(written("t;x;y;Drall")), columns=columns)
    assert words in str(caught.value)


def test_columns_are_named_in_tables_alone(write):
    with pytest.raises(
        DataError, match="columns 't'='x': expected one of back_to_hog, hog_to_hog"
    ):
        load_throw(write("hog_to_hog = 14.2\nhog_to_rest = 10\n"), columns={"t": "x"})


def test_what_is_not_used_is_named_first_with_the_option_that_reads_it(write):
    file = write(written("Time (s);Lateral (m);Distance (m);Degrees"))
    with pytest.raises(DataError) as caught:
        load_throw(file)
    assert str(caught.value).endswith(
        'or say which they are, as in `--columns "x=Lateral (m), y=Distance (m)"`'
    )
    throw = load_throw(file, columns={"x": "Lateral", "y": "Distance"})
    is_throw(throw, phi=False)
    assert caught.value.options == (
        Option("columns", '"x=Lateral (m), y=Distance (m)"'),
    )
    assert throw.notes[0].code == "columns-not-used"
    assert str(throw.notes[0]) == (
        'not used, and perhaps phi: Degrees; `--columns "phi=Degrees"` reads them so'
    )
    is_throw(
        load_throw(file, columns={"x": "Lateral", "y": "Distance", "phi": "Degrees"})
    )


def test_a_unit_that_is_not_known_is_never_taken_for_another(write):
    file = write(written("t;x;y;Twist (gon)", T, X, Y, PHI * 200 / np.pi))
    throw = load_throw(file)
    (note,) = throw.notes
    assert str(note) == "columns ignored: Twist (gon)"
    with pytest.raises(
        DataError, match=r"line 1: phi in 'gon': unknown unit; .*--units phi=UNIT"
    ):
        load_throw(file, columns={"phi": "Twist"})
    angle = load_throw(file, columns={"phi": "Twist"}, units="angle=mrad").phi
    np.testing.assert_allclose(angle, 0.2 / np.pi * PHI)


def test_what_cannot_be_one_of_ours_is_not_proposed(write):
    """A component of the velocity, an acceleration, text, or one axis of two."""
    unused_headings = "velocity x;acceleration (m/s^2);twist;weight"
    rows = "".join(f"{k / 10};2;{k};1;out;5\n" for k in range(20))
    throw = load_throw(write(f"t;speed;{unused_headings}\n{rows}"))
    (note,) = throw.notes
    assert (note.code, note.numbers["columns"]) == (
        "columns-ignored",
        unused_headings.split(";"),
    )
    rows = "".join(f"{k / 10};{k / 9};1\n" for k in range(20))
    (note,) = load_throw(write(f"t;phi;distance\n{rows}")).notes
    assert str(note) == "columns ignored: distance"


def test_pixels_ask_for_known_points(write):
    file = write(written("time;px;py;angle_deg"))
    ran = command("check", file, cwd=file.parent)
    assert ran.returncode == 2
    assert (
        "positions are in pixels; give four or more known points with `--reference"
        in ran.stderr
    )
