"""Several throws in one table, clock times, and rows out of order or repeated."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import parts_in
from sample_files import COLUMNS, HEADER, ROWS, N, T, X, Y, is_throw, note_on, table

from curlfit import DataError, InputError, Throw, load_throw
from curlfit.errors import Option

OTHERS = table(COLUMNS | {"x": X + 0.5}).splitlines()[1:]


def two(interleaved=False):
    """A red stone, and a yellow one 0.5 m to the right, with a column
    that names them."""
    red = [f"{row},red" for row in ROWS]
    yellow = [f"{row},yellow" for row in OTHERS]
    rows = (
        [r for pair in zip(red, yellow, strict=True) for r in pair]
        if interleaved
        else red + yellow
    )
    return "\n".join([f"{HEADER},stone", *rows]) + "\n"


@pytest.mark.parametrize("interleaved", [False, True])
def test_a_column_names_the_throws(write, interleaved):
    file = write(two(interleaved))
    with pytest.raises(DataError) as caught:
        load_throw(file)
    assert str(caught.value) == (
        f"{file}: 2 throws; choose one with `--stone-index N`: 1 stone red (60 rows); "
        "2 stone yellow (60 rows)"
    )
    assert caught.value.options == (Option("stone-index", "N"),)
    is_throw(load_throw(file, stone_index=1))
    second = load_throw(file, stone_index=2)
    is_throw(second, 0.5)
    assert str(note_on(second, "one-of-throws")) == "2 throws; taken: 2 stone yellow"
    assert second.lines[0] == (3 if interleaved else N + 2)
    with pytest.raises(
        InputError, match="--stone-index 3: there is no such throw; expected"
    ):
        load_throw(file, stone_index=3)


def test_times_that_start_again_begin_a_throw(write):
    file = write("\n".join([HEADER, *ROWS, *OTHERS]))
    with pytest.raises(
        DataError, match=rf"1 from line 2 \(60 rows\); 2 from line {N + 2} \(60"
    ):
        load_throw(file)
    is_throw(load_throw(file, stone_index=2), 0.5)
    first, second = parts_in(file)  # of a batch
    assert (first.stone_index, second.stone_index) == (1, 2)
    is_throw(first.throw)
    is_throw(second.throw, 0.5)
    (only,) = parts_in(file, stone_index=2)
    is_throw(only.throw, 0.5)


@pytest.mark.parametrize("column", ["stone,red", "id,{k}", "frame_id,{k}", "heat,{k}"])
def test_a_column_that_names_one_throw_or_each_row_is_ignored(write, column):
    name, cell = column.split(",")
    body = [f"{row},{cell.format(k=k)}" for k, row in enumerate(ROWS)]
    throw = load_throw(write("\n".join([f"{HEADER},{name}", *body])))
    is_throw(throw)
    assert note_on(throw, "columns-ignored").numbers == {"columns": [name]}


def test_two_stones_without_names_are_refused(write):
    bare = [row.rsplit(",", 1)[0] for row in two(interleaved=True).splitlines()]
    with pytest.raises(DataError) as caught:
        load_throw(write("\n".join(bare)))
    assert "line 3, column t: time 0 s is repeated with places 0.5 m apart" in str(
        caught.value
    )
    assert "in a column `stone`, and choose one with `--stone-index N`" in str(
        caught.value
    )
    assert caught.value.options == (Option("stone-index", "N"),)


def test_rows_are_sorted_and_repeated_ones_left_out(write):
    rows = ROWS.copy()
    rows[10], rows[11] = rows[11], rows[10]
    throw = load_throw(write("\n".join([HEADER, *rows])))
    is_throw(throw)
    note = note_on(throw, "rows-sorted")
    assert str(note) == "1 row out of the order of time, now sorted"
    assert throw.lines[10:12].tolist() == [13, 12]
    throw = load_throw(write("\n".join([HEADER, *rows[:20], *rows[15:]])))
    is_throw(throw)
    assert note_on(throw, "repeated-rows").numbers == {"count": 5}
    backwards = load_throw(write("\n".join([HEADER, *rows[::-1]])))
    is_throw(backwards)


def test_rows_of_one_time_are_averaged(write):
    coarse = COLUMNS | {"t": np.repeat(T[::2], 2), "x": X, "y": 0.01 * Y}
    throw = load_throw(write(table(coarse)))
    np.testing.assert_allclose(throw.t, T[::2])
    np.testing.assert_allclose(throw.x, X.reshape(-1, 2).mean(1), atol=1e-12)
    assert note_on(throw, "equal-times").numbers == {"count": 60}


CLOCKS = {
    "t": lambda s: f"14:{3 + int(s // 60):02d}:{s % 60:06.3f}",
    "timestamp": lambda s: f"{3 + int(s // 60)}:{s % 60:05.2f}",
    "time_ms": lambda s: f"2026-01-05T14:{3 + int(s // 60):02d}:{s % 60:06.3f}Z",
    "time": lambda s: f"2026-01-05 14:{3 + int(s // 60):02d}:{s % 60:06.3f}+01:00",
}


@pytest.mark.parametrize(("name", "clock"), CLOCKS.items())
def test_clock_times_are_read_as_seconds(write, name, clock):
    times = [clock(22.15 + t) for t in T]
    body = [
        ",".join([time, *row.split(",")[1:]])
        for time, row in zip(times, ROWS, strict=True)
    ]
    throw = load_throw(write("\n".join([HEADER.replace("t", name, 1), *body])))
    is_throw(throw)
    numbers = note_on(throw, "clock-times").numbers
    assert numbers == {"column": name, "since": times[0]}
    is_throw(Throw.from_frame(COLUMNS | {"t": np.array(times)}))


def test_clock_times_pass_midnight_and_have_decimal_commas(write):
    text = "t;x;y\n" + "".join(
        f"{clock};0,1;{k}\n"
        for k, clock in enumerate(["23:59:59,5", "00:00:00,25", "", "0:00:01"])
        if clock
    )
    np.testing.assert_allclose(load_throw(write(text)).t, [0, 0.75, 1.5])


def test_a_cell_that_is_no_clock_time_is_refused_by_name(write):
    with pytest.raises(
        DataError, match="line 3, column t: '14:61' found, expected a clock time"
    ):
        load_throw(write("t,x,y\n14:03:22,0,0\n14:61,1,1\n"))


def test_frames_of_a_camera_are_a_unit_of_time(write):
    file = write(table(COLUMNS | {"t": 29.97 * T}))
    is_throw(load_throw(file, units="t=29.97fps"))
    with pytest.raises(InputError, match="unknown unit"):
        load_throw(file, units="x=30fps")
    numbered = {"frame": 29.97 * T} | {
        name: COLUMNS[name] for name in COLUMNS if name != "t"
    }
    file = write(table(numbered))
    is_throw(load_throw(file, units="t=29.97fps"))
    with pytest.raises(DataError, match=r"no column for t .*`--units t=30fps`"):
        load_throw(file)
