"""Tables of a path that other programs export, against the throw that they hold."""

from __future__ import annotations

import re

import numpy as np
import pytest
from conftest import STRICT, parts_in, python
from sample_files import (
    CASES,
    EXPORTS,
    PHI,
    PLAIN,
    N,
    T,
    X,
    Y,
    has_note,
    is_throw,
    known_points,
    marked_stone,
    note_on,
    optitrack,
    project,
    rows_of,
    vernier,
    vicon,
)
from scipy.spatial.transform import Rotation

from curlfit import DataError, InputError, load_throw, load_throws
from curlfit.throws.load import detect_format

TRUTH = load_throw(CASES / "00_truth.csv")


def agrees(throw, truth=TRUTH, first=0, *, phi=False, atol=6e-5):
    """Assert that a throw is the truth from a row on, as rounded as in the file."""
    np.testing.assert_allclose(throw.t, truth.t[first:], atol=1e-9)
    np.testing.assert_allclose(throw.x, truth.x[first:], atol=atol)
    np.testing.assert_allclose(throw.y, truth.y[first:], atol=atol)
    if phi:
        turns = np.round((throw.phi[0] - truth.phi[first]) / (2 * np.pi))
        # noise of the mark, which is placed with the true angle
        np.testing.assert_allclose(
            throw.phi - 2 * np.pi * turns, truth.phi[first:], atol=2e-3
        )


@pytest.mark.parametrize("name", EXPORTS)
def test_the_layout_is_seen(name):
    assert detect_format(EXPORTS[name].split("\n")) == name


LAST_LINES_OF_HEADERS = {
    "deeplabcut": "coords",
    "optitrack": "Frame",
    "qualisys": "Frame",
    "trackmate": ",,,",
    "vernier": "VideoAnalysis",
    "vicon": ",,mm",
}


@pytest.mark.parametrize("name", EXPORTS)
def test_a_file_that_ends_in_its_header_is_refused(write, name):
    lines = EXPORTS[name].split("\n")
    last = LAST_LINES_OF_HEADERS[name]
    count = next(k for k, line in enumerate(lines, 1) if line.startswith(last))
    for end in range(1, count + 1):
        with pytest.raises(DataError):
            load_throw(write("\n".join(lines[:end])), format=name)


@pytest.mark.parametrize("name", EXPORTS)
def test_another_table_is_refused(write, name):
    with pytest.raises(DataError, match=r"expect|no section|no line"):
        load_throw(write("a,b,c\n1,2,3\n"), format=name)


# TrackMate


def test_a_table_of_spots():
    throw = load_throw(CASES / "16_trackmate.csv")
    agrees(throw)
    assert throw.lines[0] == 5


def trackmate(tracks, order=None):
    """A table of spots of several tracks, each farther to the right; a track without a
    name is none."""
    header = EXPORTS["trackmate"].split("\n")[:4]
    rows = [
        f"ID{k},{k},{name},5,{x + 0.5 * number:.9g},{y:.9g},0,{t:.9g},{frame},0.1,1"
        for number, name in enumerate(tracks)
        for k, (frame, t, x, y) in enumerate(
            zip(range(N), T, X, Y, strict=True), 100 * number
        )
    ]
    if order is not None:
        order.shuffle(rows)
    return "\n".join([*header, *rows]) + "\n"


def test_each_track_of_spots_is_a_throw(write):
    file = write(trackmate(["3", "8"], np.random.default_rng(0)))
    with pytest.raises(DataError) as caught:
        load_throw(file)
    listed = "1 Track ID {} (60 rows); 2 Track ID {} (60 rows)"
    names = re.findall(r"Track ID (\d)", str(caught.value))
    assert set(names) == {"3", "8"}
    assert listed.format(*names) in str(caught.value)
    shift = {"3": 0.0, "8": 0.5}
    for number, name in enumerate(names, 1):
        throw = load_throw(file, stone_index=number)
        is_throw(throw, shift[name], phi=False, atol=1e-7)
    assert len(parts_in(file)) == 2
    assert len(load_throws(file)) == 2


def test_spots_of_no_track_are_left_out(write):
    throw = load_throw(write(trackmate(["0", ""])))
    is_throw(throw, phi=False, atol=1e-7)
    assert note_on(throw, "rows-of-no-throw").numbers["count"] == N
    with pytest.raises(DataError, match="no row names its throw"):
        load_throw(write(trackmate([""])))


def test_spots_with_keys_alone(write):
    keys, _, _, _, *rows = trackmate(["0"]).split("\n")
    is_throw(load_throw(write("\n".join([keys, *rows]))), phi=False, atol=1e-7)


def test_spots_in_pixels_and_frames(write):
    text = trackmate(["0"]).replace("(m)", "(pixel)").replace("(sec)", "(frame)")
    file = write(text)
    with pytest.raises(DataError, match="`--units t=30fps`, with the camera's rate"):
        load_throw(file)
    with pytest.raises(DataError, match="pixels; give four or more known points with"):
        load_throw(file, units="t=4fps")


# DeepLabCut


def test_points_of_a_network():
    file = CASES / "16_deeplabcut.csv"
    with pytest.raises(DataError) as caught:
        load_throw(file)
    assert [str(option) for option in caught.value.options] == ["`--units t=30fps`"]
    with pytest.raises(DataError, match="`--reference FILE`"):
        load_throw(file, units="t=10fps")
    throw = load_throw(file, units="t=10fps,length=m")
    agrees(throw, first=2)
    objects = note_on(throw, "one-of-objects").numbers["objects"]
    assert [point["name"] for point in objects] == ["stone", "handle"]
    agrees(load_throw(file, units="t=10fps,length=m", handle=2), first=2, phi=True)
    other = load_throw(file, units="t=10fps,length=m", stone_index=2)
    assert np.hypot(other.x - throw.x, other.y - throw.y) == pytest.approx(
        0.1, abs=1e-3
    )


def deeplabcut(*points, individuals=()):
    """Points of a network, each of a name, pixels u and v, and likelihoods."""
    names = [name for name, *_ in points for _ in range(3)]
    header = [["scorer", *["net"] * len(names)], ["bodyparts", *names]]
    if individuals:
        owners = [name for name in individuals for _ in range(3)]
        header.insert(1, ["individuals", *owners])
    header.append(["coords", *["x", "y", "likelihood"] * len(points)])
    columns = [column for _, *columns in points for column in columns]
    return "".join(",".join(line) + "\n" for line in header) + rows_of(*columns)


def test_unlikely_points_are_gaps(write):
    u, v = project(X, Y)
    likelihood = np.full(N, 0.99)
    likelihood[[7, 20]] = 0.59
    likelihood[9] = 0.6
    u[7] += 200  # the handle of another stone
    text = deeplabcut(("stone", u, v, likelihood))
    choices = {"units": "t=4fps", "reference": write(known_points(), "points.csv")}
    file = write(text)
    throw = load_throw(file, **choices)
    assert len(throw) == N - 2
    assert np.isin(T[[7, 20]], throw.t).sum() == 0
    np.testing.assert_allclose(throw.x, np.delete(X, [7, 20]), atol=1e-5)
    np.testing.assert_allclose(throw.y, np.delete(Y, [7, 20]), atol=1e-5)
    note = note_on(throw, "unlikely-positions")
    assert str(note) == (
        "2 positions with a likelihood below 0.6 (column 4) taken as gaps; "
        "`--as-given` keeps them"
    )
    as_given = load_throw(file, **choices, as_given=True)
    assert len(as_given) == N
    assert not has_note(as_given, "unlikely-positions")
    assert abs(as_given.x[7] - X[7]) > 0.5
    assert len(load_throw(write("# as_given = true\n" + text), **choices)) == N


def test_a_point_on_the_handle_gives_the_angle(write):
    """An unlikely one leaves a gap of the angle alone."""
    positions = marked_stone()
    likely = np.ones(N)
    of_handle = np.where(np.arange(N) == 30, 0.1, 1.0)
    text = deeplabcut(
        ("stone", *project(positions["x"], positions["y"]), likely),
        ("handle", *project(positions["x_mark"], positions["y_mark"]), of_handle),
    )
    points = write(known_points(), "points.csv")
    throw = load_throw(write(text), units="t=4fps", reference=points, handle=2)
    is_throw(throw, phi=False, atol=1e-5)
    assert np.flatnonzero(np.isnan(throw.phi)).tolist() == [30]
    has_angle = np.isfinite(throw.phi)
    difference = (throw.phi - throw.phi[0] - PHI + PHI[0])[has_angle]
    np.testing.assert_allclose(difference, 0.0, atol=1e-3)
    assert note_on(throw, "unlikely-positions").numbers["column"] == 7


def test_points_of_several_individuals(write):
    likely = np.ones(N)
    text = deeplabcut(
        ("centre", X, Y, likely),
        ("centre", X + 0.5, Y, likely),
        ("tee", X, Y + 1, likely),
        individuals=("red", "yellow", "single"),
    )
    throw = load_throw(write(text), units="t=4fps,length=m", stone_index=2)
    is_throw(throw, 0.5, phi=False, atol=1e-7)
    note = note_on(throw, "one-of-objects").numbers
    names = [point["name"] for point in note["objects"]]
    assert names == ["red centre", "yellow centre", "single tee"]


# OptiTrack


def test_a_rigid_body_and_a_marker(write):
    file = write(optitrack())
    throw = load_throw(file)
    is_throw(throw, phi=False, atol=1e-8)
    is_angle(throw)
    assert has_note(throw, "y-points-up")
    objects = note_on(throw, "one-of-objects").numbers["objects"]
    assert [tracked["name"] for tracked in objects] == [
        "Stone (rigid body)",
        "Stone:Handle (marker)",
    ]
    marked = load_throw(file, handle=2)
    is_angle(marked)
    assert has_note(marked, "angle-of-mark-and-scatter")


def is_angle(throw):
    """Assert that the angle of the throw is the true one, up to a constant."""
    np.testing.assert_allclose(throw.phi - throw.phi[0], PHI - PHI[0], atol=1e-6)


ATTITUDE = Rotation.from_euler("XYZ", [50.0, -20.0, 110.0], degrees=True)


@pytest.mark.parametrize(
    ("axes_of_file", "vertical", "choices"),
    [
        ((1, None, 0), 1, {}),  # X along, Z to the right
        ((None, 0, 1), 0, {"columns": {"x": "Y", "y": "Z"}}),
        ((0, 1, None), 2, {"columns": {"x": "X", "y": "Y"}}),
        (
            (1, None, 0),
            1,
            {"columns": {"x": "X", "y": "Z"}, "axes": "x-along,y-right"},
        ),
    ],
)
def test_a_rotation_about_the_vertical_axis_is_the_angle(
    write, axes_of_file, vertical, choices
):
    """Whatever the attitude of the axes of the body, and the axes of the export."""
    height = np.full(N, 0.11)
    coordinates = [(X, Y)[k] if k is not None else height for k in axes_of_file]
    axis = np.eye(3)[vertical]
    turned = Rotation.from_rotvec(PHI[:, None] * axis) * ATTITUDE
    names = ["X", "Y", "Z", "X handle", "Y handle", "Z handle"]
    columns = {
        name: 1000 * coordinate
        for name, coordinate in zip(names, coordinates * 2, strict=True)
    }
    throw = load_throw(write(optitrack(columns, turned.as_quat())), **choices)
    is_throw(throw, phi=False, atol=1e-8)
    is_angle(throw)


def test_the_other_axis_may_be_along_the_sheet(write):
    height = np.full(N, 0.11)
    names = ["X", "Y", "Z", "X handle", "Y handle", "Z handle"]
    coordinates = [-X, height, Y] * 2  # Z along, X to the left
    columns = {
        name: 1000 * coordinate
        for name, coordinate in zip(names, coordinates, strict=True)
    }
    throw = load_throw(write(optitrack(columns)), axes="x-along")
    is_throw(throw, phi=False, atol=1e-8)
    is_angle(throw)


def test_euler_angles_are_not_used(write):
    lines = optitrack().split("\n")
    lines[6] = lines[6].replace("X,Y,Z,W", "X,Y,Z,")
    throw = load_throw(write("\n".join(lines)))
    assert "phi" not in throw.seen
    assert has_note(throw, "rotation-not-used")


@pytest.mark.parametrize(
    ("unit", "factor"), [("Meters", 1000.0), ("Centimeters", 100.0), ("Feet", 304.8)]
)
def test_lengths_in_other_units(write, unit, factor):
    throw = load_throw(write(optitrack(unit=unit)))
    metres = {"Meters": 1.0, "Centimeters": 0.01, "Feet": 0.3048}[unit]
    np.testing.assert_allclose(throw.y, 1000 * metres * Y, atol=1e-6 * factor)
    with pytest.raises(DataError, match="Length Units 'Cubits': unknown unit"):
        load_throw(write(optitrack(unit="Cubits")))


# Vicon


def test_trajectories_of_markers(write):
    file = write(vicon())
    throw = load_throw(file)
    is_throw(throw, later=0.25, phi=False, atol=1e-8)
    objects = note_on(throw, "one-of-objects").numbers["objects"]
    assert [marker["name"] for marker in objects] == ["stone:centre", "stone:handle"]
    is_angle(load_throw(file, handle=2))


def test_a_rate_that_is_missing_is_asked_for(write):
    file = write(vicon(rate=""))
    with pytest.raises(DataError) as caught:
        load_throw(file)
    assert [str(option) for option in caught.value.options] == ["`--units t=30fps`"]
    is_throw(load_throw(file, units="t=4fps"), later=0.25, phi=False, atol=1e-8)
    with pytest.raises(DataError, match="no section Trajectories"):
        load_throw(write(vicon().partition("Trajectories")[0]))


@pytest.mark.parametrize("rate", ["0", "-4", "inf", "1e999", "nan"])
def test_a_rate_that_is_none_is_asked_for_too(write, rate):
    with pytest.raises(DataError, match="`--units t=30fps`"):
        load_throw(write(vicon(rate)))


def test_a_rate_with_a_decimal_comma(write):
    semicolons = vicon("4.0").replace(",", ";").replace(".", ",")
    is_throw(load_throw(write(semicolons)), later=0.25, phi=False, atol=1e-8)


def test_sections_of_a_spreadsheet_are_as_wide_as_the_widest(write):
    lines = vicon().split("\n")
    padded = "\n".join(line + "," * (12 - line.count(",")) for line in lines)
    is_throw(load_throw(write(padded)), later=0.25, phi=False, atol=1e-8)


# Qualisys


def test_markers_are_in_millimetres():
    file = CASES / "22_qualisys.tsv"
    throw = load_throw(file)
    agrees(throw)
    assert note_on(throw, "unit-of-the-program").numbers["unit"] == "mm"
    agrees(load_throw(file, handle=2), phi=True)
    np.testing.assert_allclose(load_throw(file, units="length=cm").y, 10 * throw.y)


def test_markers_without_headings_or_times(write):
    lines = EXPORTS["qualisys"].split("\n")
    with pytest.raises(DataError, match="export with times and headings of columns"):
        load_throw(write("\n".join(lines[:9] + lines[10:])))
    without_time = [
        "\t".join(line.split("\t")[:1] + line.split("\t")[2:]) for line in lines[9:]
    ]
    throw = load_throw(write("\n".join(lines[:9] + without_time)))
    np.testing.assert_allclose(throw.t, TRUTH.t + 0.1, atol=1e-9)


def test_a_unit_of_a_table_with_a_mark_is_proposed(write):
    """By the length of the path, where the mark would be 100 m from the stone."""
    series = marked_stone() | {"t": T}
    header = "x,y,x_mark,y_mark,t"
    for unit, factor in (("mm", 1000.0), ("cm", 100.0), ("in", 1 / 0.0254)):
        scaled = [factor * series[name] for name in header.split(",")[:4]]
        rows = "\n".join(
            ",".join(f"{value:.9g}" for value in row)
            for row in zip(*scaled, T, strict=True)
        )
        file = write(f"{header}\n{rows}\n")
        with pytest.raises(DataError) as caught:
            load_throw(file)
        (option,) = caught.value.options
        assert str(option) == f"`--units length={unit}`"
        is_angle(load_throw(file, units=f"length={unit}"))


# Vernier


@pytest.mark.parametrize("space", [" ", ""])
def test_a_data_set(write, space):
    throw = load_throw(write(vernier(space=space)))
    is_throw(throw, phi=False, atol=1e-8)
    assert note_on(throw, "object").numbers["name"] == "VideoAnalysis"


def test_runs_are_side_by_side(write):
    file = write(vernier(["Data Set 1", "Latest"]))
    is_throw(load_throw(file, stone_index=2), 0.5, phi=False, atol=1e-8)
    semicolons = vernier(["Latest"]).replace(",", ";").replace(".", ",")
    is_throw(load_throw(write(semicolons)), phi=False, atol=1e-8)


def test_headings_of_other_tables_are_no_data_sets():
    assert detect_format(PLAIN.split("\n")) == "table"
    assert detect_format(["t,10:x,y", "0,0,0"]) == "table"
    assert detect_format(["t: s,note", "0,0"]) == "table"


# the command


@pytest.mark.parametrize(
    ("file", "layout", "words"),
    [
        ("16_trackmate.csv", "trackmate", []),
        (
            "16_deeplabcut.csv",
            "deeplabcut",
            ["--units=t=10fps,length=m", "--handle=2"],
        ),
        ("22_qualisys.tsv", "qualisys", ["--handle=2"]),
    ],
)
def test_check_shows_how_an_export_is_read(file, layout, words):
    run = python(*STRICT, "-m", "curlfit", "check", CASES / file, *words)
    assert run.returncode == 0, run.stderr
    assert f": {layout}, " in run.stdout
    with pytest.raises(InputError):
        load_throw(CASES / file, shot=1)
