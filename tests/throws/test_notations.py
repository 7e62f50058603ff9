"""How people, cameras and spreadsheets write times, dates and numbers."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
import pytest
from sample_files import COLUMNS, PHI, N, T, X, Y, is_throw, note_on, table

from curlfit import DataError, InputError, load_throw, load_throws
from curlfit.throws.readers.clocks import clock_times, time_by_watch, times_of_day
from curlfit.throws.readers.numbers import numbers_in, thousands_of_whole_numbers

BEGIN = datetime(2026, 1, 13, 19, 59, 58, 250000)
MOMENTS = [BEGIN + timedelta(seconds=float(t)) for t in T]


@pytest.mark.parametrize(
    "form",
    [
        "%H:%M:%S.%f",
        "%M:%S.%f",
        "%Y-%m-%d %H:%M:%S.%f",
        "%Y-%m-%dT%H:%M:%S.%f",
        "%d.%m.%Y %H:%M:%S.%f",
        "%d/%m/%Y %H:%M:%S.%f",
        "%m/%d/%Y %H:%M:%S.%f",
        "%m/%d/%Y %I:%M:%S.%f %p",
        "%d.%m.%y %H:%M:%S.%f",
        "%I:%M:%S.%f %p",
    ],
)
def test_clock_times_and_dates(form: str) -> None:
    """Whole minutes, an hour, and where it is written, p.m., pass."""
    times = clock_times([moment.strftime(form) for moment in MOMENTS])
    assert times.bad == []
    assert np.allclose(times.seconds, T, atol=1e-6)


def test_midnight_and_the_turn_of_an_hour_pass() -> None:
    late = ["23:59:58.5", "23:59:59.5", "00:00:00.5"]
    assert clock_times(late).seconds.tolist() == [0, 1, 2]
    assert clock_times(["59:58.5", "59:59.5", "0:00.5"]).seconds.tolist() == [0, 1, 2]
    assert clock_times(["11:59:59 pm", "12:00:01 am"]).seconds.tolist() == [0, 2]


def test_seconds_alone_before_the_first_minute() -> None:
    assert clock_times(["59.5", "1:00.5", "1:01.5"]).seconds.tolist() == [0, 1, 2]
    times = clock_times(["59.5", "0:01:00.5", "61"])
    assert times.bad == [0, 2]  # beside hours they are no times


def test_the_last_of_four_parts_counts_hundredths_or_frames(write) -> None:
    seconds = 0.25 * np.arange(N)

    def timecodes(parts: int) -> list[str]:
        return [
            f"0:00:{int(second):02d}:{round((second % 1) * parts):02d}"
            for second in seconds
        ]

    def written(parts: int) -> str:
        rows = zip(timecodes(parts), X, Y, PHI, strict=True)
        lines = [f"{t},{x:.17g},{y:.17g},{phi:.17g}" for t, x, y, phi in rows]
        return "\n".join(["t,x,y,phi", *lines])

    kinovea = load_throw(write(written(100)))
    is_throw(kinovea)
    assert note_on(kinovea, "clock-times-in-hundredths").numbers["since"]
    with pytest.raises(DataError) as caught:
        load_throw(write(written(40)))
    sentence = str(caught.value)
    assert "may count frames or hundredths" in sentence
    assert "`--units t=30fps` or `--units t=100fps`" in sentence
    is_throw(load_throw(write(written(40)), units="t=40fps"))


def test_a_date_of_two_meanings_is_refused_with_the_option_that_says_it(write) -> None:
    days = [datetime(2026, 2, 11) + timedelta(days=day) for day in range(2)]
    rows = [
        f"{day:%d/%m/%Y} {12 + second // 60}:{second % 60:02d}:00,{y}"
        for day in days
        for second, y in ((0, 1.0), (1, 2.0))
    ]
    with pytest.raises(DataError) as caught:
        load_throw(write("\n".join(["t,speed", *rows])))
    assert "the day or the month may be first" in str(caught.value)
    assert "`--units date=day-first` or `--units date=month-first`" in str(caught.value)
    text = "\n".join(["t,speed", *rows])
    by_day = load_throw(write(text), units="date=day-first", as_given=True)
    assert by_day.t.tolist() == [0, 60, 86400, 86460]
    by_month = load_throw(write(text), units="date=month-first", as_given=True)
    assert by_month.t[2] == (datetime(2026, 12, 2) - datetime(2026, 11, 2)).days * 86400
    with pytest.raises(InputError, match="expected date=day-first or date=month-first"):
        load_throw(write(text), units="date=german")


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [
        ("0:12.86", 12.86),
        ("00:12,86", 12.86),
        ("00:12:86", 12.86),
        ("00:12:45", 12.45),
        ("0:00:12.860000", 12.86),
        ("00:00:13", 13.0),
        ("1:02.5", 62.5),
        ("12.86", None),
        ("noon", None),
    ],
)
def test_a_time_by_watch(cell: str, seconds: float | None) -> None:
    assert time_by_watch(cell) == (None if seconds is None else pytest.approx(seconds))


@pytest.mark.parametrize(
    ("labels", "hours"),
    [
        (["19:05", "19:35"], [19 + 5 / 60, 19 + 35 / 60]),
        (["7:05 pm", "7:35 p.m."], [19 + 5 / 60, 19 + 35 / 60]),
        (["11 pm", "1 am"], [23, 25]),
        (["19h30", "20 Uhr"], None),
        (["19:05 Uhr", "20:05 Uhr"], [19 + 5 / 60, 20 + 5 / 60]),
        (["19:05", "late"], None),
    ],
)
def test_times_of_the_day(labels: list[str], hours: list[float] | None) -> None:
    times = times_of_day(labels)
    if hours is None:
        assert times is None
    else:
        assert times is not None
        assert (times / 3600).tolist() == pytest.approx(hours)


def test_dates_with_times_of_the_day_are_hours_apart() -> None:
    times = times_of_day(["2026-01-12 23:30", "2026-01-13 01:00"])
    assert times is not None
    assert np.diff(times) == pytest.approx(1.5 * 3600)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("ns", 1e9), ("us", 1e6), ("ms", 1e3), ("min", 1 / 60), ("h", 1 / 3600)],
)
def test_times_in_any_unit(write, unit: str, factor: float) -> None:
    columns = COLUMNS | {"t": T * factor}
    is_throw(load_throw(write(table(columns)), units=f"t={unit}"))
    headed = {f"t ({unit})": T * factor, **COLUMNS}
    del headed["t"]
    is_throw(load_throw(write(table(headed))))


@pytest.mark.parametrize(
    ("cells", "mark"),
    [
        (["985", "1,085"], ","),
        (["985", "1.085", "12.345"], "."),
        (["985", "1 085"], " "),
        (["1,085", "1,17"], None),
        (["0,985", "1,085"], None),
        (["85", "1,085"], None),
        (["1085", "1,085"], None),
        (["985", "0,085"], None),
    ],
)
def test_thousands_of_whole_numbers(cells: list[str], mark: str | None) -> None:
    thousands = thousands_of_whole_numbers(cells)
    assert (thousands and thousands.mark) == mark


def test_thousands_with_points_are_seen_among_plain_numbers(write) -> None:
    """NumPy reads 1.085 as a number like the others."""

    def grouped(value: float) -> str:
        return f"{value:,.0f}".replace(",", ".")

    rows = [
        f"{grouped(1000 * t)};{1000 * x:.0f};{grouped(1000 * y)};{1000 * phi:.0f}"
        for t, x, y, phi in zip(T, X, Y, PHI, strict=True)
    ]
    throw = load_throw(write("\n".join(["t (ms);x (mm);y (mm);phi (mrad)", *rows])))
    is_throw(throw, atol=1e-3)
    assert note_on(throw, "thousands")


def test_huge_numbers_are_refused_and_do_not_overflow(write) -> None:
    with pytest.raises(DataError, match="line 3, column x: 1e\\+308 m found"):
        load_throw(write("t,x,y\n0,1,2\n1,1e308,3\n2,1,4\n"))


@pytest.mark.parametrize("cell", ["inf", "DNF", "NT", "x", ".", "?", "#N/A", "NA", ""])
def test_gaps(write, cell: str) -> None:
    assert np.isnan(numbers_in([cell])[0])
    rows = [f"{k},{12.5 + 0.1 * k:.2f},0.5" for k in range(6)]
    rows[2] = f"3,{cell},0.5"
    throws = load_throws(write("\n".join(["draw,hog to hog,rest", *rows])))
    assert len(throws) == 5


def test_words_that_are_no_gaps_are_refused(write) -> None:
    with pytest.raises(DataError, match="line 2, column x: 'maybe' found, expected a"):
        load_throw(write("t,x,y\n0,maybe,1\n1,2,3\n"))


def test_rows_below_a_table(write) -> None:
    """Max is a person where others have names too."""
    rows = "Sue,12.8,0.5\nMax,12.7,0.4\n"
    throws = load_throws(write(f"thrower,hog to hog,rest\n{rows}"))
    assert throws[-1].labels["thrower"] == "Max"
    numbered = "1,12.8,0.5\n2,12.7,0.4\n3,12.9,0.3\n"
    below = "mean,12.8,0.4\nmax,12.9,0.5\n,=SUM(B2:B4),\n"
    throws = load_throws(write(f"draw,hog to hog,rest\n{numbered}{below}"))
    assert len(throws) == 3
    note = note_on(throws[0], "rows-below-the-table")
    assert note.numbers["lines"] == [5, 6, 7]


def test_units_and_columns_of_stopwatch_tables(write) -> None:
    text = "draw,Interval,End\n1,12800,50\n2,12700,40\n"
    throws = load_throws(
        write(text),
        columns={"hog_to_hog": "Interval", "rest": "End"},
        units="t=ms,length=cm",
    )
    values = {event.name: event.value for event in throws[0].events}
    assert values == pytest.approx({"hog_to_hog": 12.8, "rest": 38.905})
    with pytest.raises(DataError, match=r"columns hog_to_hog='Lap': no column of this"):
        load_throws(write(text), columns={"hog_to_hog": "Lap"}, format="timings")


def test_what_stands_between_rows_is_said(write) -> None:
    text = "draw,hog to hog,rest\n1,12.8,0.5\nafter the break,,\n"
    text += "draw,hog to hog,rest\n2,12.7,0.4\n"
    throws = load_throws(write(text))
    assert len(throws) == 2
    note = note_on(throws[0], "lines-between-rows")
    assert note.numbers["lines"] == [3, 4]


def test_a_comma_within_the_words_of_the_last_column(write) -> None:
    text = "hog to hog,rest,remark\n12.8,0.5,wide, a bit\n12.7,0.4,good\n"
    throws = load_throws(write(text))
    assert throws[0].labels["remark"] == "wide, a bit"
    with pytest.raises(DataError, match="line 2: 4 cells where the header has 3"):
        load_throws(write("hog to hog,rest,remark\n12,8,0.5,good\n12.7,0.4,good\n"))


def test_each_row_is_a_frame_where_there_are_no_times(write) -> None:
    states = zip(X, Y, PHI, strict=True)
    rows = [f"{x:.17g},{y:.17g},{phi:.17g}" for x, y, phi in states]

    def text(head: str) -> str:
        return "\n".join([head, *rows])

    for head in ("x,y,phi", "my throw\nx,y,phi", "my throw\nof today\n,,\nx,y,phi"):
        throw = load_throw(write(text(head)), units="t=4fps")
        is_throw(throw)
        assert note_on(throw, "rows-are-frames")
    with pytest.raises(DataError, match="no column for t among x, y, phi"):
        load_throw(write(text("x,y,phi")))
    rows[5] = ",,"
    throw = load_throw(write(text("x,y,phi")), units="t=4fps")
    assert throw.t.tolist() == T.tolist()
    assert np.flatnonzero(np.isnan(throw.x)).tolist() == [5]
    rows[5] = "1,2"
    with pytest.raises(DataError, match="line 7: 2 cells where the header has 3"):
        load_throw(write(text("x,y,phi")), units="t=4fps")
