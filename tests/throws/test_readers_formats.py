"""Each format, convention and refusal, on small files written here."""

from __future__ import annotations

import json
import sys
from itertools import product

import numpy as np
import pytest
from sample_files import (
    CLOCKS,
    KNOWN,
    OMEGA,
    PHI,
    PIXELS,
    PLAIN,
    SAMPLES,
    N,
    T,
    X,
    Y,
    known_points,
    log,
    project,
    shot,
    table,
    tracker,
    two_masses,
)

from curlfit import DataError, InputError, Throw, load_throw
from curlfit.sheet import LINES
from curlfit.throws.load import detect_format
from curlfit.throws.readers.angles import AmbiguousTurnError, unwrap
from curlfit.throws.readers.camera import homography


def said(throw: Throw, words: str) -> bool:
    return any(words in note for note in throw.notes)


@pytest.mark.parametrize(
    ("sample", "kind"),
    [("table", "table"), ("settings", "table"), ("tracker", "tracker"), ("two", "tracker"),
     ("shot", "digitalcurling"), ("log", "digitalcurling"), ("timings", "timings"),
     ("clocks", "table"), ("pixels", "table")],
)  # fmt: skip
def test_the_format_is_seen(sample, kind):
    assert detect_format(SAMPLES[sample].split("\n")) == kind


POINTS = known_points()
METRES = PLAIN.replace("x,y", "x_m,y_m")


@pytest.mark.parametrize(
    ("text", "points", "choices", "words"),
    [
        ("frame,1\n" + PLAIN.replace("t,x,y", "t,q,r"), "", "format=tracker", "expected a header"),
        (PLAIN, "", "format=digitalcurling", "not a line of JSON"),
        (PLAIN, "", "format=timings", "is not known"),
        (PLAIN, "", "format=video", "expected one of table, tracker"),
        (PLAIN, "", "units=mass=kg", "expected QUANTITY=UNIT"),
        (PLAIN, "", "units=x=kg", "x in 'kg': unknown unit"),
        (PLAIN, "", "axes=x-up", "unknown word"),
        (two_masses(), "", "stone_index=3", "no such object; expected one of 1 mass A; 2 mass B"),
        (log(2), "", "", "2 shots; choose one with `--shot N`: 1 end 0 shot 0; 2"),
        (log(2), "", "shot=3", "--shot 3: there is no such shot"),
        ('{"tag": "gam", "log": {"cmd": "update"}}\n', "", "", "no trajectory found"),
        ('{"tag": "gam"}\n{"tag"\n', "", "", "line 2: not a line of JSON"),
        ("t,x,y,t_phi,phi\n0,0,0,0,1\n1,0,2,0,2\n", "", "",
         "line 3, column t_phi: time 0 s is not later than"),
        ("t,x,y,t_phi,phi\n0,0,0,0,1\n1,0,2,,2\n", "", "",
         "line 3, column t_phi: the time is missing"),
        *((f'# axes = "{words}"\n' + PLAIN, "", "", f"line 1: axes '{told}") for words, told in (
            ("x-up", "x-up': unknown word"),
            ("x-left,x-right", "x-left,x-right': x points in two directions"),
            ("x-left,y-right", "x-left,y-right': x and y lie on one line"),
            ("cw,ccw", "cw,ccw': angles are both clockwise and counter-clockwise"),
            ("from-hog,from-tee", "from-hog,from-tee': two zeros are given"),
        )),
        (PIXELS, "", "", "positions are in pixels; give four or more known points"),
        (METRES, POINTS, "", "has no positions in pixels"),
        ("t,u,v\n0,320,-140\n1,320,-150\n", POINTS, "", "horizon"),
        *((PIXELS, points, "", words) for points, words in (
            (known_points(3), "3 points; a homography needs four"),
            ("u,v,x,y\n0,0,0,0\n1,1,1,1\n2,2,2,2\n3,3,3,3\n", "collinear in the image"),
            ("u,v,x,y\n0,0,0,0\n1,0,1,0\n2,0,2,0\n3,3,3,3\n", "three of the points are collinear"),
            ("u,v,x,y\n0,0,0,0\n9,0,1,0\n9,9,0,1\n0,9,1,1\n", "in this order"),
            ("u,v,x\n0,0,0\n", "no column for y"),
            ("u,v,x,y\n0,0,0,\n", "each point needs four finite numbers"),
            ("1,2,3,4\n", "begins with numbers"),
            ("\n", "the file is empty; expected a header u,v"),
        )),
    ],
)  # fmt: skip
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
    ("separator", "comma"),
    [*product("\t,; ", [False]), *product("\t; ", [True])],  # not both a comma
)
def test_tracker(write, separator, comma):
    text = tracker(separator, comma)
    text = text.replace(" (", "(") if separator == " " else text
    throw = load_throw(write(text))
    np.testing.assert_allclose(throw.x, X + 0.5)
    np.testing.assert_allclose(throw.y, Y + 1)
    assert throw.seen == ("x", "y")
    assert said(throw, "mass_A")
    assert said(throw, "left out: θ_{r}")
    assert said(throw, "Tracker computes them from the positions")


def test_what_tracker_computes_is_told_by_its_name(write):
    columns = {"t": T, "x": X, "y": Y + 1, "v": OMEGA, "θ_{r}": PHI, "ω": OMEGA, "θ": PHI}
    throw = load_throw(write("stone\n" + table(columns | {"phi": PHI, "spin": OMEGA}, "\t")))
    assert said(throw, "left out: v, θ_{r}, ω, θ: Tracker computes them")
    assert throw.seen == ("x", "y", "phi", "omega")


def test_two_objects_side_by_side(write):
    file = write(two_masses())
    throw = load_throw(file)
    assert said(throw, "2 objects: 1 mass A, 2 mass B; taken: 1 mass A")
    assert said(throw, "--handle N, one that marks the handle")
    np.testing.assert_allclose(throw.x, X, atol=1e-8)
    other = load_throw(file, stone_index=2)
    np.testing.assert_allclose(other.x, X[T > 1] + 0.1, atol=1e-8)
    assert said(other, "5 rows without mass B left out")


# DigitalCurling


def test_a_shot(write):
    throw = load_throw(write(json.dumps(shot(hit=40), indent=2), "shot_e000s00.json"))
    np.testing.assert_allclose(throw.t, T)
    np.testing.assert_allclose(throw.y, Y)
    np.testing.assert_allclose(throw.phi - throw.phi[0], PHI - PHI[0], atol=1e-9)
    assert throw.defaults["until"] == pytest.approx(39 * 0.25)
    assert said(throw, "another stone moves after t = 9.75 s")
    assert said(throw, "team1 stone 1, the one thrown")


def test_the_stone_that_was_hit(write):
    throw = load_throw(write(json.dumps(shot(hit=40))), stone_index=1)
    assert len(throw) == N - 39
    assert throw.y[-1] == 38.2


def test_a_log_of_several_shots(write):
    file = write(log(2), "server.log")
    assert said(load_throw(file, shot=2), "end 0 shot 1")


def test_a_client_sees_the_shot_in_its_last_move(write):
    update = {"cmd": "update", "state": {"end": 0, "shot": 1},
              "last_move": {"trajectory": shot()["log"]["trajectory"]}}  # fmt: skip
    np.testing.assert_allclose(load_throw(write(json.dumps(update))).y, Y)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.update(seconds_per_frame=0), "seconds_per_frame = 0"),
        (lambda t: t.update(frames=3), "needs a start and frames"),
        (
            lambda t: t["frames"][3][0].update(team="team7"),
            "frame 4: expected changes of stones of the start",
        ),
        (lambda t: t["frames"][3][0].update(value={"position": {"x": 1}}), "all finite numbers"),
        (lambda t: t["frames"].clear(), "no stone moves"),
    ],
)
def test_a_shot_that_cannot_be_read(write, change, words):
    entry = shot()
    change(entry["log"]["trajectory"])
    with pytest.raises(DataError, match=words):
        load_throw(write(json.dumps(entry)))


# Tables in memory


def test_a_data_frame():
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"y_ft": Y / 0.3048, "x": X, "angle_deg": np.degrees(PHI), "who": "a"})
    frame.index = pd.Index(1000 * T, name="time_ms")
    throw = Throw.from_frame(frame)
    np.testing.assert_allclose(throw.observed[:3], [X, Y, PHI], atol=1e-12)
    assert said(throw, "columns ignored: who")
    frame.index = pd.to_timedelta(T, unit="s")
    np.testing.assert_allclose(Throw.from_frame(frame).t, T)
    frame.index = pd.Timestamp("2024-01-01") + pd.to_timedelta(T, unit="s")
    np.testing.assert_allclose(Throw.from_frame(frame).t, T, atol=1e-9)
    with pytest.raises(DataError, match="no column for t"):
        Throw.from_frame(frame.reset_index(drop=True))
    frame["x"] = pd.array([None, *X[1:]], dtype="Float64")
    frame["t"] = T
    assert np.isnan(Throw.from_frame(frame).x).tolist() == [True, *[False] * (N - 1)]
    frame["x"] = "left"
    with pytest.raises(DataError, match="table, column x: expected numbers"):
        Throw.from_frame(frame)


def test_a_dataset():
    xr = pytest.importorskip("xarray")
    data = xr.Dataset(
        {"x": ("time", 100 * X, {"units": "cm"}), "y": ("time", Y, {"units": "m"}),
         "theta": ("time", np.degrees(PHI), {"units": "degrees"}), "ice": ((), 1.0)},
        coords={"time": T},
    )  # fmt: skip
    throw = Throw.from_frame(data, name="sheet 3")
    np.testing.assert_allclose(throw.observed[:3], [X, Y, PHI], atol=1e-12)
    assert throw.name == "sheet 3"
    data["x"].attrs["units"] = "kg"
    with pytest.raises(DataError, match="x in 'kg': unknown unit"):
        Throw.from_frame(data)


def test_a_mapping_and_what_is_no_table():
    np.testing.assert_allclose(Throw.from_frame({"t": T, "x": X, "y": Y}).y, Y)
    masked = np.ma.masked_array(X, mask=T > 10)
    assert np.isfinite(Throw.from_frame({"t": T, "x": masked, "y": Y}).x).sum() == (T <= 10).sum()
    with pytest.raises(InputError, match="expected a DataFrame"):
        Throw.from_frame(3)
    with pytest.raises(DataError, match="different lengths"):
        Throw.from_frame({"t": T, "x": X[:-1], "y": Y})
    with pytest.raises(InputError, match="--shot: table is a table file and holds no shots"):
        Throw.from_frame({"t": T, "x": X, "y": Y}, shot=2)
    with pytest.raises(InputError, match="reference = 3; expected a name of a file"):
        Throw.from_frame({"t": T, "x": X, "y": Y}, reference=3)


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
    assert load_throw(write(f'# axes = "{words}"\n' + file.read_text())).y == pytest.approx(Y)


def test_sigma_goes_with_its_axis(write):
    columns = {"t": T, "x": Y, "y": -X, "sigma_x": np.full(N, 0.3), "sigma_y": np.full(N, 0.1)}
    throw = load_throw(write(table(columns)), axes="x-along")
    assert throw.sigma["y"][0] == 0.3
    assert throw.sigma["x"][0] == 0.1


def test_the_lines_of_the_sheet():
    # 114 ft from tee to tee, 12 ft to the hack, 21 ft to the hog line, 6 ft to the back line
    feet = {"hack": 0, "back": 6, "tee": 12, "hog": 33, "centre": 69, "far-hog": 105,
            "far-tee": 126}  # fmt: skip
    assert {k: v / 0.3048 for k, v in LINES.items()} == pytest.approx(feet, abs=0.003)


# Pixels


def test_pixels(write):
    points = write(known_points(), "points.csv")
    throw = load_throw(write(PIXELS), reference=points)
    np.testing.assert_allclose(throw.observed[:3], [X, Y, PHI], atol=1e-9)
    assert said(throw, "pixels to metres by 6 points")
    assert said(throw, "one pixel is")
    renamed = PIXELS.replace("u,v,", "x,y,", 1)
    np.testing.assert_allclose(load_throw(write(renamed), reference=points).y, Y, atol=1e-9)


def test_the_noise_of_pixels_is_carried_over(write):
    u, v = project(X, Y)
    noise = np.full(N, 0.5)
    text = table({"t": T, "u": u, "v": v, "sigma_u": noise, "sigma_v": noise})
    throw = load_throw(write(text), reference=write(known_points(), "points.csv"))
    chance = np.random.default_rng(5)
    plane = homography(project(*KNOWN), KNOWN)
    seen = np.stack([u, v])
    shifted = [plane(*seen + chance.normal(0, 0.5, seen.shape))[1] for _ in range(200)]
    np.testing.assert_allclose(np.std(shifted, axis=0), throw.sigma["y"], rtol=0.3)
    assert throw.sigma["y"][-1] > 1.5 * throw.sigma["y"][0]


def test_the_homography_is_exact_in_any_units():
    plane = homography(1e4 * project(*KNOWN) + 1e6, 0.01 * KNOWN)
    assert plane.rms_px < 1e-6


@pytest.mark.parametrize("header", ["u_px,v_px", "u [px],v [px]", "u (pixels),v (pixels)", "u,v"])
def test_pixels_by_their_unit(write, header):
    points = write(known_points(), "points.csv")
    throw = load_throw(write(PIXELS.replace("u,v", header, 1)), reference=points)
    np.testing.assert_allclose(throw.observed[:3], [X, Y, PHI], atol=1e-9)
    assert not said(throw, "ignored")
    marked = write(known_points().replace("u,v", header, 1), "points.csv")
    np.testing.assert_allclose(load_throw(write(PIXELS), reference=marked).y, Y, atol=1e-9)
    frame = dict(zip(header.split(","), project(X, Y), strict=True)) | {"t": T}
    np.testing.assert_allclose(Throw.from_frame(frame, reference=points).y, Y, atol=1e-9)
    with pytest.raises(DataError, match="positions are in pixels"):
        load_throw(write(PIXELS.replace("u,v", header, 1)))


# Angles


@pytest.mark.parametrize("header", ["theta", "θ", "phi", "phi_rad"])
@pytest.mark.parametrize("low", [0.0, -180.0])
def test_degrees_without_a_unit_are_told_by_their_jumps(write, header, low):
    degrees = np.remainder(np.degrees(0.1 * PHI) + 340, 360) + low  # as slow as radians
    columns = {"t": T, "x": X, "y": Y, header: degrees}
    row = int(np.argmax(np.abs(np.diff(degrees)) > 180)) + 1
    told = "the numbers jump by 360 as degrees do; give `?--units angle=deg"
    with pytest.raises(DataError, match=told) as caught:
        load_throw(write(table(columns)))
    assert caught.value.line == row + 2
    with pytest.raises(DataError, match=told):
        Throw.from_frame(columns)
    throw = load_throw(write(table(columns)), units="angle=deg")
    np.testing.assert_allclose(throw.phi - throw.phi[0], 0.1 * (PHI - PHI[0]), atol=1e-9)
    if header != "phi_rad":  # whose unit is said already
        load_throw(write(table(columns)), units="angle=rad")


@pytest.mark.parametrize(
    ("header", "values", "flag"),
    [("theta", PHI, "angle=deg"), ("spin", OMEGA, "spin=deg/s"), ("gyro_z", OMEGA, "spin=deg/s")],
)
def test_turning_too_fast_for_radians_is_refused(write, header, values, flag):
    columns = {"t": T, "x": X, "y": Y, header: np.degrees(values)}
    with pytest.raises(DataError, match="more than two turns a second") as caught:
        load_throw(write(table(columns)))
    assert caught.value.column == header
    assert f"--units {flag}" in str(caught.value)
    throw = load_throw(write(table(columns)), units=flag)
    np.testing.assert_allclose(throw.phi if header == "theta" else throw.omega, values)
    assert not said(load_throw(write(table(columns | {header: values}))), "two turns")


def test_the_columns_of_curlfit_itself_are_radians_and_said_where_doubtful(write):
    hard = load_throw(write(table({"t": T, "x": X, "y": Y, "phi": 30 * T})))
    np.testing.assert_allclose(hard.phi, 30 * T)
    assert said(hard, "phi: no unit is given, and 30 rad/s would be more than two turns a second")
    calm = load_throw(write(table({"t": T, "x": X, "y": Y, "phi_rad": 30 * T})))
    assert not said(calm, "two turns")


@pytest.mark.parametrize("low", [0.0, -np.pi, -1.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_one_turn_is_undone(low, sign):
    wrapped = np.remainder(sign * PHI - low, 2 * np.pi) + low
    phi, jumps, _ = unwrap(T, wrapped)
    assert jumps in (2, 3)
    np.testing.assert_allclose(phi - phi[0], sign * (PHI - PHI[0]), atol=1e-12)


def test_the_direction_of_a_line_is_undone():
    phi, jumps, period = unwrap(T, np.remainder(PHI, np.pi))
    assert (jumps, period) == (4, np.pi)
    np.testing.assert_allclose(phi - phi[0], PHI - PHI[0], atol=1e-12)


def test_gaps_are_bridged_at_the_pace():
    t = np.concatenate([np.arange(0, 4, 0.2), np.arange(7.5, 14, 0.2)])
    phi = 1.5 * t
    got, _, _ = unwrap(t, np.remainder(phi, 2 * np.pi))
    np.testing.assert_allclose(got, phi, atol=1e-12)


def test_an_angle_that_counts_on_is_left_alone():
    for phi in (PHI, -PHI, np.array([0.0, 4, 5, 9, 9.5, 20, 21]), np.zeros(5)):
        got, jumps, _ = unwrap(np.arange(len(phi)) * 0.5, phi)
        assert jumps == 0
        np.testing.assert_array_equal(got, phi)


def test_single_jumps_are_taken_out():
    phi = PHI.copy()
    phi[30:] -= 2 * np.pi
    phi[45:] += 4 * np.pi
    got, jumps, _ = unwrap(T, phi)
    assert jumps == 2
    np.testing.assert_allclose(got, PHI, atol=1e-12)


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
    faster = np.remainder(5.5 * t, 2 * np.pi)
    throw = load_throw(write(table(columns | {"phi": faster, "omega": np.full(30, 5.5)})))
    np.testing.assert_allclose(throw.phi, 5.5 * t, atol=1e-9)
    assert said(throw, "of 360 degrees removed")


# Clocks


def test_clocks_are_merged(write):
    throw = load_throw(write(CLOCKS))
    assert np.isfinite(throw.x).sum() == np.isfinite(throw.phi).sum() == 12
    assert said(throw, "clocks t (12 rows), t_phi (12 rows) merged")
    np.testing.assert_allclose(throw.phi[throw.t == 0.1], 0)


def test_a_clock_that_runs_on_alone(write):
    throw = load_throw(write("t,x,y,time_gyro,gyro_dps\n0,0,0,0,90\n1,0,2,0.5,90\n,,,1,90\n"))
    np.testing.assert_allclose(throw.t, [0, 0.5, 1])
    np.testing.assert_allclose(throw.omega, np.pi / 2)
    assert np.isnan(throw.x[1])


def test_empty_rows_are_left_out(write):
    throw = load_throw(write(PLAIN + ",,,\n,,,\n"))
    assert len(throw) == N
    assert said(throw, "2 empty rows left out")


# Large files


def test_a_long_file_is_read_with_few_calls_for_each_row(tmp_path):
    """So that a million rows take seconds: their numbers are parsed together."""
    n = 5000
    t = np.arange(n) * 1e-3
    s = 1 - (1 - t / 51) ** 2
    file = tmp_path / "long.csv"
    np.savetxt(
        file, np.c_[t, -s, 25 * s, np.remainder(40 * s, 2 * np.pi)],
        fmt="%.6f", delimiter=",", header="t,x,y,phi", comments="",
    )  # fmt: skip
    calls = []
    sys.setprofile(lambda _, event, __: calls.append(event) if "call" in event else None)
    try:
        throw = load_throw(file)
    finally:
        sys.setprofile(None)
    assert len(calls) < 10 * n
    np.testing.assert_allclose(throw.phi, 40 * s, atol=1e-5)
    text = file.read_text().split("\n")
    text[4000] = "3.999,0,hello,1"
    file.write_text("\n".join(text))
    with pytest.raises(DataError, match="line 4001, column y: 'hello' found"):
        load_throw(file)
