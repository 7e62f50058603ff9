"""Tables as people write them, and the sentence for each that cannot be read."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import DATA
from sample_files import note_on

from curlfit import DataError, InputError, Throw, load_throw
from curlfit.throws.readers.columns import parse_header

PLAIN = "t,x,y,phi\n0,0.1,0,0\n1,0.2,2,1\n2,0.4,3,1.5\n"


@pytest.mark.parametrize(
    ("header", "quantity", "factor"),
    [
        ("t", "t", 1),
        ("time", "t", 1),
        ("t_s", "t", 1),
        ("Time [ms]", "t", 1e-3),
        ("x_m", "x", 1),
        ("y_ft", "y", 0.3048),
        ("pos_x (in)", "x", 0.0254),
        ("theta_rad", "phi", 1),
        ("angle_deg", "phi", math.pi / 180),
        ("phi_rev", "phi", 2 * math.pi),
        ("sigma_x", "sigma_x", 1),
        ("sigma_phi_deg", "sigma_phi", math.pi / 180),
        ("y_err_cm", "sigma_y", 0.01),
        ("t_phi", "t_phi", 1),
        ("time_gyro", "t_omega", 1),
        ("gyro time [ms]", "t_omega", 1e-3),
        ("t_xy", "t_xy", 1),
        ("x_px", "u", 1),
        ("v (m/s)", "speed", 1),
        ("v [m s^-1]", "speed", 1),
        ("ω (°/s)", "omega", math.pi / 180),
    ],
)
def test_column_names(header, quantity, factor):
    column = parse_header(header)
    assert column.quantity == quantity
    assert column.factor == pytest.approx(factor)


@pytest.mark.parametrize(
    "header", ["vx", "x_velocity", "frame", "x_deg", "phi_m", "sigma", ""]
)
def test_columns_that_mean_nothing_here(header):
    assert parse_header(header) is None


def test_gaps_and_missing_angle(write):
    throw = load_throw(write("t,x,y\n0,0.1,\n1,NaN,2\n2,0.4,3\n"))
    assert np.isnan(throw.phi).all()
    assert np.isnan(throw.x[1])
    assert np.isnan(throw.y[0])
    assert throw.n_observations == 4


@pytest.mark.parametrize("header", ["v", "phi", "spin", "sigma_x", "speed_kmh"])
def test_an_empty_column_was_not_measured(write, header):
    file = write(f"t,x,y,{header}\n0,0.1,0,\n1,0.2,2,\n2,0.4,3,nan\n")
    throw = load_throw(file)
    assert throw.seen == ("x", "y")
    assert not throw.sigma
    assert note_on(throw, "empty-column").numbers["column"] == header


@pytest.mark.parametrize(
    "comment",
    ["law: see below", "reference: Penner 2001", "columns: t, x, y", "sheet: 3"],
)
def test_a_colon_in_a_comment_is_no_setting(write, comment):
    throw = load_throw(write(f"# {comment}\n{PLAIN}"))
    assert (throw.defaults, throw.notes) == ({}, ())


def test_settings_and_other_comments(write):
    throw = load_throw(
        write(
            '# seen from the gallery\n# until = 1.5\n# stone.R = 0.06\n# ice = "new"\n'
            + PLAIN
        )
    )
    assert throw.defaults == {"until": 1.5, "stone": {"R": 0.06}}
    note = note_on(throw, "unknown-settings")
    assert str(note) == "settings not known and ignored: 'ice' (line 4)"


@pytest.mark.parametrize(
    ("content", "line", "column", "words"),
    [
        ("", None, None, "empty"),
        ("# until = 3\n", None, None, "comments only"),
        ("t,x,y,phi\n", 1, None, "no rows"),
        ("0,0,0,0\n1,1,1,1\n", 1, None, "expected a header"),
        (PLAIN.replace("x", "z"), 1, None, "no column for x among t, z, y, phi"),
        (
            "lap,end\n13.2,0.5\n",
            1,
            None,
            "or of a stopwatch such as hog_to_hog,rest; or say which they are",
        ),
        (PLAIN.replace("phi", "x_cm"), 1, None, "both mean x"),
        (
            PLAIN.replace("0.2", "hello"),
            3,
            "x",
            "'hello' found, expected a finite number",
        ),
        (PLAIN.replace("0.2", "1e999"), 3, "x", "'1e999' found"),
        (PLAIN.replace("\n1,", "\n,"), 3, "t", "the time is missing"),
        (
            PLAIN.replace("\n2,", "\n1,").replace("0.4,3", "9,3"),
            4,
            "t",
            "places 8.8 m apart",
        ),
        ("t,x,y,phi\n0,nan,0,0\n1,nan,2,1\n", None, "x", "no value of x"),
        (PLAIN.replace("0.2,2,1", "0.2,2"), 3, None, "3 cells where the header has 4"),
        (PLAIN.replace(".", ","), 2, None, "separate the columns by semicolons"),
        ("# stone.R = -1\n" + PLAIN, 1, None, "stone.R = -1"),
        ("# stone.R = wide\n" + PLAIN, 1, None, "cannot read the setting"),
        ("# stone.Q = 1\n" + PLAIN, 1, None, "no property 'Q'"),
        ('# law = "ice"\n' + PLAIN, 1, None, "unknown law 'ice'"),
        ("# stone.R: 0.02\n" + PLAIN, 1, None, "expected stone.R = 0.02"),
        ("# stone.R: 6 cm\n" + PLAIN, 1, None, "'stone.R: 6 cm' is no setting"),
        ("# until: 12\n" + PLAIN, 1, None, "expected until = 12"),
        ("# law: coulomb\n" + PLAIN, 1, None, "expected law = 'coulomb'"),
        (b"\x00\x01\x02\x00", None, None, "not a text file"),
        (
            "t,x,y,phi,sigma_x\n0,1,0,0,0.1\n1,2,2,1,0\n",
            3,
            "sigma_x",
            "positive standard",
        ),
    ],
)
def test_each_fault_has_its_place_and_its_sentence(write, content, line, column, words):
    file = write(content)
    with pytest.raises(DataError) as caught:
        load_throw(file)
    error = caught.value
    assert str(error).startswith(str(file))
    assert str(error).isprintable()
    assert words in str(error)
    assert error.line == line
    assert error.column == column
    assert error.exit_status == 2


def test_files_that_are_none(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        load_throw(tmp_path / "nothing.csv")
    with pytest.raises(DataError, match="this is a folder"):
        load_throw(tmp_path)


def test_arrays():
    throw = Throw.from_arrays([0, 1, 2], [0, 0, 0], [0, 2, 3], sigma={"x": 0.01})
    np.testing.assert_array_equal(throw.sigma["x"], 0.01)
    with pytest.raises(DataError, match="row 2: 1 found; times must increase"):
        Throw.from_arrays([0, 1, 1], [0, 0, 0], [0, 2, 3])


def test_rows_are_chosen_by_their_times():
    throw = load_throw(DATA)
    with pytest.raises(
        ValueError, match=r"no row .* until = -1 s; its times are 0 \.\. 22.9 s"
    ):
        throw.select_rows(until=-1)
    some = throw.select_rows(since=1.0, until=5.0, exclude=[(2.0, 3.0), (4.55, 4.95)])
    expected = [
        t for t in throw.t if 1 <= t <= 5 and not 2 <= t <= 3 and not 4.55 < t < 4.95
    ]
    np.testing.assert_array_equal(some.t, expected)
    np.testing.assert_array_equal(some.y, np.interp(some.t, throw.t, throw.y))
    for exclude, fault in (
        ([(3, 2)], "A before B"),
        ([(-1, 50)], "excluded intervals leave no row"),
    ):
        with pytest.raises(InputError, match=fault):
            throw.select_rows(exclude=exclude)
    with pytest.raises(InputError, match="since = 40 s"):
        throw.select_rows(since=40)


def test_rows_are_chosen_in_the_file(write):
    throw = load_throw(write("# since = 0.5\n# exclude = [[1.0, 1.2]]\n" + PLAIN))
    assert throw.defaults == {"since": 0.5, "exclude": [[1.0, 1.2]]}
    for bad in (
        "exclude = [1, 2]",
        "exclude = '1:2'",
        "since = 'now'",
        "exclude = [[1]]",
    ):
        with pytest.raises(DataError, match=bad.split(" ")[0]):
            load_throw(write(f"# {bad}\n" + PLAIN))
