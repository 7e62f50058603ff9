"""Each format, convention and refusal, on small files written here."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sample_files import (
    CLOCKS,
    OMEGA,
    PHI,
    PIXELS,
    PLAIN,
    SAMPLES,
    N,
    T,
    X,
    Y,
    has_note,
    known_points,
    log,
    note_on,
    shot,
    table,
    tracker,
    two_masses,
)

from curlfit import DataError, InputError, Throw, load_throw
from curlfit.errors import Option
from curlfit.sheet import LINES
from curlfit.throws.load import detect_format
from curlfit.throws.readers import json_values
from curlfit.throws.readers.unwrapping import AmbiguousTurnError, unwrap


@pytest.mark.parametrize(
    ("sample", "kind"),
    [
        ("table", "table"),
        ("settings", "table"),
        ("tracker", "tracker"),
        ("two", "tracker"),
        ("shot", "digitalcurling"),
        ("log", "digitalcurling"),
        ("video", "curling-stone-tracker"),
        ("timings", "timings"),
        ("clocks", "table"),
        ("pixels", "table"),
    ],
)
def test_the_format_is_seen(sample, kind):
    assert detect_format(SAMPLES[sample].split("\n")) == kind


POINTS = known_points()
METRES = PLAIN.replace("x,y", "x_m,y_m")


@pytest.mark.parametrize(
    ("text", "points", "choices", "words"),
    [
        (
            "frame,1\n" + PLAIN.replace("t,x,y", "t,q,r"),
            "",
            "format=tracker",
            "expected a header",
        ),
        (PLAIN, "", "format=digitalcurling", "not a line of JSON"),
        (PLAIN, "", "format=timings", "is not known"),
        (PLAIN, "", "format=video", "expected one of table, tracker"),
        (PLAIN, "", "units=mass=kg", "expected QUANTITY=UNIT"),
        (PLAIN, "", "units=x=kg", "x in 'kg': unknown unit"),
        (PLAIN, "", "axes=x-up", "unknown word"),
        (
            two_masses(),
            "",
            "stone_index=3",
            "no such object; expected one of 1 mass A; 2 mass B",
        ),
        (log(2), "", "", "2 shots; choose one with `--shot N`: 1 end 0 shot 0; 2"),
        (log(2), "", "shot=3", "--shot 3: there is no such shot"),
        ('{"tag": "gam", "log": {"cmd": "update"}}\n', "", "", "no trajectory found"),
        ('{"tag": "gam"}\n{"tag"\n', "", "", "line 2: not a line of JSON"),
        (
            "t,x,y,t_phi,phi\n0,0,0,0,1\n1,0,2,0,2\n",
            "",
            "",
            "line 3, column t_phi: time 0 s is not later than",
        ),
        (
            "t,x,y,t_phi,phi\n0,0,0,0,1\n1,0,2,,2\n",
            "",
            "",
            "line 3, column t_phi: the time is missing",
        ),
        *(
            (f'# axes = "{words}"\n' + PLAIN, "", "", f"line 1: axes '{message}")
            for words, message in (
                ("x-up", "x-up': unknown word"),
                ("x-left,x-right", "x-left,x-right': x points in two directions"),
                ("x-left,y-right", "x-left,y-right': x and y lie on one line"),
                ("cw,ccw", "cw,ccw': angles are both clockwise and counter-clockwise"),
                ("from-hog,from-tee", "from-hog,from-tee': two zeros are given"),
            )
        ),
        (PIXELS, "", "", "positions are in pixels; give four or more known points"),
        (METRES, POINTS, "", "has no positions in pixels"),
        ("t,u,v\n0,320,-140\n1,320,-150\n", POINTS, "", "horizon"),
        (
            "t,u,v\n" + "".join(f"{k},320,{240 + k}\n" for k in range(12)),
            POINTS,
            "",
            "no values of u that change",
        ),
        *(
            (PIXELS, points, "", words)
            for points, words in (
                (known_points(3), "3 points; a homography needs four"),
                (
                    "u,v,x,y\n0,0,0,0\n1,1,1,1\n2,2,2,2\n3,3,3,3\n",
                    "collinear in the image",
                ),
                (
                    "u,v,x,y\n0,0,0,0\n1,0,1,0\n2,0,2,0\n3,3,3,3\n",
                    "three of the points are collinear",
                ),
                ("u,v,x,y\n0,0,0,0\n9,0,1,0\n9,9,0,1\n0,9,1,1\n", "in this order"),
                ("u,v,x\n0,0,0\n", "no column for y"),
                ("u,v,x,y\n0,0,0,\n", "each point needs four finite numbers"),
                ("1,2,3,4\n", "begins with numbers"),
                ("\n", "the file is empty; expected a header u,v"),
            )
        ),
    ],
)
def test_refusals(write, text, points, choices, words):
    name, _, value = choices.partition("=")
    chosen = {name: int(value) if value.isdigit() else value} if name else {}
    if points:
        chosen["reference"] = write(points, "points.csv")
    with pytest.raises(InputError) as caught:
        load_throw(write(text), **chosen)
    assert words in str(caught.value)


# Tracker


@pytest.mark.parametrize(
    ("separator", "comma"), [("\t", False), (",", False), (" ", False), (";", True)]
)
def test_tracker(write, separator, comma):
    text = tracker(separator, comma)
    text = text.replace(" (", "(") if separator == " " else text
    throw = load_throw(write(text))
    np.testing.assert_allclose(throw.x, X + 0.5)
    np.testing.assert_allclose(throw.y, Y + 1)
    assert throw.seen == ("x", "y")
    assert note_on(throw, "object").numbers == {"name": "mass_A"}
    computed = str(note_on(throw, "computed-by-tracker"))
    assert computed.startswith("left out: θ_{r}")
    assert "Tracker computes them from the positions" in computed


def test_what_tracker_computes_is_told_by_its_name(write):
    columns = {
        "t": T,
        "x": X,
        "y": Y + 1,
        "v": OMEGA,
        "θ_{r}": PHI,
        "ω": OMEGA,
        "θ": PHI,
    }
    throw = load_throw(
        write("stone\n" + table(columns | {"phi": PHI, "spin": OMEGA}, "\t"))
    )
    computed = note_on(throw, "computed-by-tracker").numbers
    assert computed == {"columns": ["v", "θ_{r}", "ω", "θ"]}
    assert throw.seen == ("x", "y", "phi", "omega")


def test_two_objects_side_by_side(write):
    file = write(two_masses())
    throw = load_throw(file)
    note = note_on(throw, "one-of-objects")
    assert str(note) == (
        "2 objects: 1 mass A, 2 mass B; taken: 1 mass A; `--stone-index N` selects "
        "another; `--handle N`, one that marks the handle of this stone"
    )
    np.testing.assert_allclose(throw.x, X, atol=1e-8)
    other = load_throw(file, stone_index=2)
    np.testing.assert_allclose(other.x, X[T > 1] + 0.1, atol=1e-8)
    note = note_on(other, "rows-without-the-object")
    assert str(note) == "5 rows without mass B left out"


# DigitalCurling


def test_a_shot(write):
    throw = load_throw(write(json.dumps(shot(hit=40), indent=2), "shot_e000s00.json"))
    np.testing.assert_allclose(throw.t, T)
    np.testing.assert_allclose(throw.y, Y)
    np.testing.assert_allclose(throw.phi - throw.phi[0], PHI - PHI[0], atol=1e-9)
    assert throw.defaults["until"] == pytest.approx(39 * 0.25)
    assert note_on(throw, "another-stone-moves").numbers == {"t": 9.75}
    logged = note_on(throw, "logged-stone")
    assert "(team1 stone 1, the one thrown), " in str(logged)
    assert logged.numbers["count"] == N
    assert has_note(throw, "simulated")


def test_the_stone_that_was_hit(write):
    throw = load_throw(write(json.dumps(shot(hit=40))), stone_index=1)
    assert len(throw) == N - 39
    assert throw.y[-1] == 38.2


def test_a_log_of_several_shots(write):
    file = write(log(2), "server.log")
    second = load_throw(file, shot=2)
    assert note_on(second, "logged-stone").numbers["shot"] == "end 0 shot 1"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.update(seconds_per_frame=0), "seconds_per_frame = 0"),
        (lambda t: t.update(frames=3), "needs a start and frames"),
        (
            lambda t: t["frames"][3][0].update(team="team7"),
            "frame 4: expected changes of stones of the start",
        ),
        (
            lambda t: t["frames"][3][0].update(value={"position": {"x": 1}}),
            "all finite numbers",
        ),
        (lambda t: t["frames"].clear(), "no stone moves"),
    ],
)
def test_a_shot_that_cannot_be_read(write, change, words):
    entry = shot()
    change(entry["log"]["trajectory"])
    with pytest.raises(DataError, match=words):
        load_throw(write(json.dumps(entry)))


def test_a_log_that_would_take_too_much_memory_is_refused_unread(write, monkeypatch):
    monkeypatch.setattr(json_values, "_MOST_PARTS", 1000)
    text = json.dumps({"trajectory": [{}] * 1000})
    monkeypatch.setattr(json_values.json, "loads", pytest.fail)
    with pytest.raises(DataError, match="line 1: more than 1,000 lists and objects"):
        load_throw(write(text))


# Tables in memory


def test_a_data_frame():
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame(
        {"y_ft": Y / 0.3048, "x": X, "angle_deg": np.degrees(PHI), "who": "a"}
    )
    frame.index = pd.Index(1000 * T, name="time_ms")
    throw = Throw.from_frame(frame)
    np.testing.assert_allclose(throw.observed[:3], [X, Y, PHI], atol=1e-12)
    assert note_on(throw, "columns-ignored").numbers == {"columns": ["who"]}
    for origin in (pd.Timedelta(0), pd.Timestamp("2024-01-01")):
        frame.index = origin + pd.to_timedelta(T, unit="s")
        np.testing.assert_allclose(Throw.from_frame(frame).t, T, atol=1e-9)
    with pytest.raises(DataError, match="no column for t"):
        Throw.from_frame(frame.reset_index(drop=True))
    frame["x"] = pd.array([None, *X[1:]], dtype="Float64")
    assert np.isnan(Throw.from_frame(frame).x).tolist() == [True, *[False] * (N - 1)]
    frame["x"] = "left"
    with pytest.raises(DataError, match="column x: row 0: str 'left' found, expected"):
        Throw.from_frame(frame)


def test_a_dataset():
    xr = pytest.importorskip("xarray")
    data = xr.Dataset(
        {
            "x": ("time", 100 * X, {"units": "cm"}),
            "y": ("time", Y, {"units": "m"}),
            "theta": ("time", np.degrees(PHI), {"units": "degrees"}),
            "ice": ((), 1.0),
        },
        coords={"time": T},
    )
    throw = Throw.from_frame(data, name="sheet 3")
    np.testing.assert_allclose(throw.observed[:3], [X, Y, PHI], atol=1e-12)
    assert throw.name == "sheet 3"
    data["x"].attrs["units"] = "kg"
    with pytest.raises(DataError, match="x in 'kg': unknown unit"):
        Throw.from_frame(data)


def test_a_mapping_and_what_is_no_table():
    np.testing.assert_allclose(Throw.from_frame({"t": T, "x": X, "y": Y}).y, Y)
    masked = np.ma.masked_array(X, mask=T > 10)
    assert (
        np.isfinite(Throw.from_frame({"t": T, "x": masked, "y": Y}).x).sum()
        == (T <= 10).sum()
    )
    with pytest.raises(InputError, match="expected a DataFrame"):
        Throw.from_frame(3)
    with pytest.raises(DataError, match="unlike lengths"):
        Throw.from_frame({"t": T, "x": X[:-1], "y": Y})
    with pytest.raises(
        InputError, match="--shot: table is a table file and holds no shots"
    ):
        Throw.from_frame({"t": T, "x": X, "y": Y}, shot=2)


# Axes


@pytest.mark.parametrize(
    ("words", "columns"),
    [
        ("", (X, Y, PHI)),
        ("x-left", (-X, Y, -PHI)),
        ("x-left, counter-clockwise", (-X, Y, PHI)),
        ("clockwise", (X, Y, -PHI)),
        ("x-along", (Y, -X, PHI)),
        ("x-along y-right", (Y, X, -PHI)),
        ("x-back", (-Y, X, PHI)),
        ("y-left", (Y, -X, PHI)),
        ("y-back", (X, -Y, -PHI)),
        ("x-left,y-back", (-X, -Y, PHI)),
        ("from-hog", (X, Y - LINES["hog"], PHI)),
        ("y-back,x-left,from-far-tee", (-X, LINES["far-tee"] - Y, PHI)),
        ("x-along,from-center,cw", (Y - LINES["centre"], -X, -PHI)),
    ],
)
def test_axes(write, words, columns):
    x, y, phi = columns
    omega = np.gradient(phi, T)
    file = write(table({"t": T, "x": x, "y": y, "phi": phi, "omega": omega}))
    throw = load_throw(file, axes=words)
    np.testing.assert_allclose(throw.observed[:3], [X, Y, PHI], atol=1e-9)
    np.testing.assert_allclose(throw.omega, OMEGA, atol=1e-9)


def test_the_lines_of_the_sheet():
    # 114 ft from tee to tee, 12 ft to the hack, 21 ft to the hog line, 6 ft to
    # the back line
    feet = {
        "hack": 0,
        "back": 6,
        "tee": 12,
        "hog": 33,
        "centre": 69,
        "far-hog": 105,
        "far-tee": 126,
    }
    assert {k: v / 0.3048 for k, v in LINES.items()} == pytest.approx(feet, abs=0.003)


# Pixels


def test_pixels(write):
    points = write(known_points(), "points.csv")
    throw = load_throw(write(PIXELS), reference=points)
    np.testing.assert_allclose(throw.observed[:3], [X, Y, PHI], atol=1e-9)
    assert note_on(throw, "pixels-to-metres").numbers["points"] == 6
    assert has_note(throw, "one-pixel")
    renamed = PIXELS.replace("u,v,", "x,y,", 1)
    np.testing.assert_allclose(
        load_throw(write(renamed), reference=points).y, Y, atol=1e-9
    )


# Angles

GAP = np.concatenate([np.arange(0, 4, 0.2), np.arange(7.5, 14, 0.2)])


@pytest.mark.parametrize(
    ("header", "low"), [("θ", 0.0), ("phi", -180.0), ("phi_rad", 0.0)]
)
def test_degrees_without_a_unit_are_told_by_their_jumps(write, header, low):
    degrees = np.remainder(np.degrees(0.1 * PHI) + 340, 360) + low  # as slow as radians
    columns = {"t": T, "x": X, "y": Y, header: degrees}
    row = int(np.argmax(np.abs(np.diff(degrees)) > 180)) + 1
    message = "the numbers jump by 360 as degrees do; give `?--units angle=deg"
    with pytest.raises(DataError, match=message) as caught:
        load_throw(write(table(columns)))
    assert caught.value.line == row + 2
    throw = load_throw(write(table(columns)), units="angle=deg")
    np.testing.assert_allclose(
        throw.phi - throw.phi[0], 0.1 * (PHI - PHI[0]), atol=1e-9
    )


@pytest.mark.parametrize(
    ("header", "values", "flag"),
    [
        ("theta", PHI, "angle=deg"),
        ("spin", OMEGA, "spin=deg/s"),
        ("gyro_z", OMEGA, "spin=deg/s"),
    ],
)
def test_turning_too_fast_for_radians_is_refused(write, header, values, flag):
    columns = {"t": T, "x": X, "y": Y, header: np.degrees(values)}
    with pytest.raises(DataError, match="more than two turns a second") as caught:
        load_throw(write(table(columns)))
    assert caught.value.column == header
    assert caught.value.options[0] == Option("units", flag)
    assert f"give `--units {flag}` if so, " in str(caught.value)
    throw = load_throw(write(table(columns)), units=flag)
    np.testing.assert_allclose(throw.phi if header == "theta" else throw.omega, values)
    slow = load_throw(write(table(columns | {header: values})))
    assert not has_note(slow, "unit-of-angles-unknown")


def test_the_columns_of_curlfit_itself_are_radians_and_said_where_doubtful(write):
    hard = load_throw(write(table({"t": T, "x": X, "y": Y, "phi": 30 * T})))
    np.testing.assert_allclose(hard.phi, 30 * T)
    assert str(note_on(hard, "unit-of-angles-unknown")) == (
        "phi: no unit is given, and 30 rad/s would be more than two turns a second; "
        "these may be degrees; give `--units angle=deg` if so, `--units angle=rad` if "
        "not"
    )


@pytest.mark.parametrize("low", [0.0, -np.pi, -1.0])
@pytest.mark.parametrize(
    ("t", "turned", "period", "jumps"),
    [
        (T, PHI, 2 * np.pi, (2, 3)),
        (T, -PHI, 2 * np.pi, (2, 3)),
        (T, PHI, np.pi, (4, 5)),  # the direction of a line
        (GAP, 1.5 * GAP, 2 * np.pi, (3, 4)),  # bridged at the pace
    ],
)
def test_turns_are_undone(t, turned, period, jumps, low):
    unwrapped = unwrap(t, np.remainder(turned - low, period) + low)
    assert unwrapped.jumps in jumps
    assert unwrapped.period == period
    assert not unwrapped.off_course.any()
    phi = unwrapped.angle
    np.testing.assert_allclose(phi - phi[0], turned - turned[0], atol=1e-12)


def test_an_angle_that_counts_on_is_left_alone():
    for phi in (PHI, -PHI, np.array([0.0, 4, 5, 9, 9.5, 20, 21]), np.zeros(5)):
        unwrapped = unwrap(np.arange(len(phi)) * 0.5, phi)
        assert unwrapped.jumps == 0
        np.testing.assert_array_equal(unwrapped.angle, phi)


def test_single_jumps_are_taken_out():
    phi = PHI.copy()
    phi[30:] -= 2 * np.pi
    phi[45:] += 4 * np.pi
    unwrapped = unwrap(T, phi)
    assert unwrapped.jumps == 2
    np.testing.assert_allclose(unwrapped.angle, PHI, atol=1e-12)


def test_a_fast_spin_needs_the_spin(write):
    t = np.arange(30) * 1.0
    phi = 2.9 * t
    columns = {"t": t, "x": 0 * t, "y": t, "phi": np.remainder(phi, 2 * np.pi)}
    with pytest.raises(AmbiguousTurnError):
        unwrap(t, columns["phi"])
    with pytest.raises(DataError, match="the sense is ambiguous") as caught:
        load_throw(write(table(columns)))
    assert caught.value.line == 3
    assert caught.value.column == "phi"
    throw = load_throw(write(table(columns | {"omega": np.full(30, 2.9)})))
    np.testing.assert_allclose(throw.phi, phi, atol=1e-12)
    assert note_on(throw, "jumps-removed").numbers["degrees"] == 360


# Clocks


def test_clocks_are_merged(write):
    throw = load_throw(write(CLOCKS))
    assert np.isfinite(throw.x).sum() == np.isfinite(throw.phi).sum() == 12
    merged = note_on(throw, "clocks-merged")
    assert str(merged) == "clocks t (12 rows), t_phi (12 rows) merged"
    np.testing.assert_allclose(throw.phi[throw.t == 0.1], 0)
