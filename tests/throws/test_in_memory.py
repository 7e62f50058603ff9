"""Arrays, lists and tables in memory: dates, durations and gaps, and what is none of
these."""

import datetime as dt
from decimal import Decimal

import numpy as np
import pytest

from curlfit import DataError, InputError, Throw

T = np.arange(6) * 0.5
X = 0.01 * T
Y = 2 * T - 0.05 * T**2
DAY = dt.datetime(2026, 1, 5, 23, 59, 59)
DURATIONS = [dt.timedelta(seconds=float(t)) for t in T]
DATES = [DAY + duration for duration in DURATIONS]
NANOSECONDS = (T * 1e9).astype("m8[ns]")
TOKYO = dt.timezone(dt.timedelta(hours=9))


def pandas():
    return pytest.importorskip("pandas")


def masked_dates():
    dates = np.datetime64("2026-01-05") + NANOSECONDS
    return np.ma.masked_array(dates, mask=[0, 0, 0, 0, 0, 0])


TIMES = {
    "numbers": lambda: T,
    "timedelta64": lambda: NANOSECONDS,
    "timedelta64 in ms": lambda: (T * 1000).astype("m8[ms]"),
    "datetime64": lambda: np.datetime64("2026-01-05T23:59:59") + NANOSECONDS,
    "list of datetime64": lambda: list(np.datetime64("2026-01-05") + NANOSECONDS),
    "masked datetime64": masked_dates,
    "timedelta": lambda: DURATIONS,
    "datetime": lambda: DATES,
    "datetime with a zone": lambda: [date.replace(tzinfo=TOKYO) for date in DATES],
    "datetime of two zones": lambda: [
        date.replace(tzinfo=dt.UTC).astimezone(TOKYO if k % 2 else dt.UTC)
        for k, date in enumerate(DATES)
    ],
    "time past midnight": lambda: [date.time() for date in DATES],
    "clock times": lambda: [str(date.time()) for date in DATES],
    "dates as text": lambda: [date.isoformat() for date in DATES],
    "words for numbers": lambda: [str(t) for t in T],
    "Timestamps": lambda: [pandas().Timestamp(date) for date in DATES],
    "Timedeltas": lambda: [pandas().Timedelta(duration) for duration in DURATIONS],
    "a Series of dates": lambda: pandas().Series(DATES),
    "a Series with a zone": lambda: pandas().Series(DATES).dt.tz_localize("Asia/Tokyo"),
    "a DatetimeIndex with a zone": lambda: pandas().date_range(
        "2026-01-05", periods=6, freq="500ms", tz="Europe/Stockholm"
    ),
    "a TimedeltaIndex": lambda: pandas().to_timedelta(T, unit="s"),
}


@pytest.mark.parametrize("make", TIMES.values(), ids=list(TIMES))
def test_times_of_every_kind_are_seconds(make):
    times = make()
    for throw in (
        Throw.from_arrays(times, X, Y),
        Throw.from_frame({"time": times, "x": X, "y": Y}),
    ):
        np.testing.assert_allclose(throw.t, T, atol=1e-12)
        np.testing.assert_array_equal(throw.y, Y)


def test_durations_keep_their_origin_and_units_are_those_of_numbers():
    later = [dt.timedelta(seconds=3) + duration for duration in DURATIONS]
    np.testing.assert_allclose(Throw.from_arrays(later, X, Y).t, T + 3, atol=1e-12)
    for times in (1000 * T, NANOSECONDS, DATES):
        throw = Throw.from_arrays(times, 100 * X, Y, units="t=ms,x=cm")
        np.testing.assert_allclose(throw.t, T, atol=1e-12)
        np.testing.assert_allclose(throw.x, X, atol=1e-12)


GAPS = {
    "NaN": lambda: [np.nan, *X[1:]],
    "None": lambda: [None, *X[1:]],
    "None among decimals": lambda: [None, *(Decimal(str(x)) for x in X[1:])],
    "a masked array": lambda: np.ma.masked_array(X, mask=T < 0.1),
    "a masked array of objects": lambda: np.ma.masked_array(
        X.astype(object), mask=T < 0.1
    ),
    "words": lambda: ["n/a", *(str(x) for x in X[1:])],
    "NA": lambda: [pandas().NA, *X[1:]],
    "NaT": lambda: [pandas().NaT, *X[1:]],
    "a nullable array": lambda: pandas().array([None, *X[1:]], dtype="Float64"),
    "a nullable Series": lambda: pandas().Series([None, *X[1:]], dtype="Float64"),
}


@pytest.mark.parametrize("make", GAPS.values(), ids=list(GAPS))
def test_gaps_of_every_kind_are_nan(make):
    gapped = make()
    for throw in (
        Throw.from_arrays(T, gapped, Y),
        Throw.from_frame({"t": T, "x": gapped, "y": Y}),
    ):
        np.testing.assert_array_equal(throw.x, [np.nan, *X[1:]])


@pytest.mark.parametrize(
    "times",
    [
        np.where(T == 1, np.timedelta64("NaT", "ns"), NANOSECONDS),
        [None if t == 1 else date for t, date in zip(T, DATES, strict=True)],
    ],
)
def test_a_missing_time_is_refused(times):
    with pytest.raises(DataError, match="throw, column t: row 2: nan found; expected"):
        Throw.from_arrays(times, X, Y)
    with pytest.raises(DataError, match="table, column t: row 2: the time is missing"):
        Throw.from_frame({"t": times, "x": X, "y": Y})


NO_NUMBERS = {
    "a text": ("left", "str 'left' found, expected a list or an array of numbers"),
    "a number": (0.5, "float 0.5 found, expected a list or an array of numbers"),
    "a table": ({"x": X}, "dict found, expected a list or an array of numbers"),
    "a function": (len, "builtin_function_or_method found, expected a list"),
    "words": (list("abcdef"), "row 0: str 'a' found, expected numbers"),
    "a word among numbers": (
        [0.0, None, "left", 1, 2, 3],
        "row 2: str 'left' found, expected numbers",
    ),
    "digits in groups": (["1_000", *"12345"], "row 0: str '1_000' found"),
    "a large number": ([10**400, *X[1:]], "row 0: int 1000000.*0000 found, expected"),
    "lists in a list": ([*X[:5], [1]], "lists of unlike lengths found, expected"),
    "a column": (X[:, None], r"shape \(6, 1\) found, expected numbers in one dim"),
    "complex numbers": (X + 1j, "complex numbers found, expected numbers"),
    "truth values": (X > 0, "truth values found, expected numbers"),
    "records": (np.zeros(6, [("x", float)]), "records of several values found"),
    "dates": (DATES, "dates found, expected numbers"),
    "durations": (NANOSECONDS, "durations found, expected numbers"),
}


@pytest.mark.parametrize(("x", "words"), NO_NUMBERS.values(), ids=list(NO_NUMBERS))
def test_what_is_no_sequence_of_numbers_is_named(x, words):
    with pytest.raises(InputError, match=f"^x: {words}"):
        Throw.from_arrays(T, x, Y)
    with pytest.raises(DataError, match=f"^table, column x: {words}"):
        Throw.from_frame({"t": T, "x": x, "y": Y})


NO_TIMES = {
    "None": (None, "None found, expected a list or an array of numbers, dates, dur"),
    "words": (list("abcdef"), "row 0: str 'a' found, expected numbers, dates, dur"),
    "dates with and without a zone": (
        [*DATES[:5], DATES[5].replace(tzinfo=TOKYO)],
        "datetime and datetime with a time zone found together, expected times of one",
    ),
    "dates and numbers": ([DAY, *T[1:]], r"datetime and float\w* found together"),
    "years": (
        np.array(["2020", "2021", "2022", "2023", "2024", "2025"], "M8[Y]"),
        "months or years found, expected days or seconds",
    ),
    "no time": (np.full(6, "NaT", "M8[s]"), "every time is missing"),
}


@pytest.mark.parametrize(("t", "words"), NO_TIMES.values(), ids=list(NO_TIMES))
def test_what_is_no_sequence_of_times_is_named(t, words):
    with pytest.raises(InputError, match=f"^t: {words}"):
        Throw.from_arrays(t, X, Y)
    with pytest.raises(DataError, match=f"^table, column t: {words}"):
        Throw.from_frame({"t": t, "x": X, "y": Y})


@pytest.mark.parametrize(
    ("sigma", "words"),
    [
        ({"x": "small"}, "^sigma of x: row 0: str 'small' found, expected numbers"),
        ({"x": [0.1, 0.2]}, r"sigma_x has shape \(2,\), t has \(6,\)"),
        ({"x": None}, "nan found; expected a positive standard deviation"),
        ({"z": 0.1}, "^sigma: 'z' found, expected channels, which are x, y, phi"),
        (0.1, "^sigma: float '0.1' found, expected a mapping"),
    ],
)
def test_a_sigma_that_is_none_is_named(sigma, words):
    with pytest.raises(InputError, match=words):
        Throw.from_arrays(T, X, Y, sigma=sigma)


def test_a_single_sigma_is_that_of_all_rows():
    sigma = {"x": 0.01, "y": np.array(0.02), "phi": [0.1] * 6}
    throw = Throw.from_arrays(T, X, Y, X, sigma=sigma)
    assert [throw.sigma[name][5] for name in ("x", "y", "phi")] == [0.01, 0.02, 0.1]


def test_columns_of_unlike_lengths_are_named():
    with pytest.raises(DataError, match=r"unlike lengths \(t 6, x 5, y 6\); expected"):
        Throw.from_frame({"t": T, "x": X[:-1], "y": Y})
    with pytest.raises(DataError, match=r"x has shape \(5,\), t has \(6,\)"):
        Throw.from_arrays(T, X[:-1], Y)
    with pytest.raises(DataError, match="no rows"):
        Throw.from_frame({"t": [], "x": [], "y": []})


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (None, "^table: NoneType found, expected a DataFrame, a Dataset, a table or"),
        (X, "^table: ndarray found, expected a DataFrame"),
        ("throw.csv", "'throw.csv' found, expected a DataFrame.*load_throw reads a fi"),
    ],
)
def test_what_is_no_table_is_named(table, words):
    with pytest.raises(InputError, match=words):
        Throw.from_frame(table)


def test_a_table_in_place_of_times_is_sent_to_from_frame():
    for table in ({"t": T, "x": X, "y": Y}, pandas().DataFrame({"t": T})):
        with pytest.raises(InputError, match=r"^t: .* `Throw.from_frame` reads a ta"):
            Throw.from_arrays(table)


def test_columns_that_are_not_read_may_hold_anything():
    unread_columns = {
        "stone": "red",
        "shape": [[1], [1, 2]],
        "picture": np.zeros((2, 3)),
    }
    throw = Throw.from_frame({"t": T, "x": X, "y": Y, **unread_columns})
    np.testing.assert_array_equal(throw.x, X)


# Tables of other libraries

STATES = {"t": DATES, "x": [None, *X[1:]], "y": Y, "who": list("abcdef")}


def numpy_records():
    records = np.empty(6, [("t", "M8[us]"), ("x", float), ("y", float)])
    records["t"] = DATES
    records["x"] = [np.nan, *X[1:]]
    records["y"] = Y
    return records


def pandas_with_dates_as_index():
    frame = pandas().DataFrame(STATES).convert_dtypes().set_index("t")
    frame.index = frame.index.tz_localize("Asia/Tokyo").rename(None)
    return frame


def pandas_of_arrow():
    pytest.importorskip("pyarrow")
    return pandas().DataFrame(STATES).convert_dtypes(dtype_backend="pyarrow")


TABLES = {
    "records of NumPy": numpy_records,
    "pandas": lambda: pandas().DataFrame(STATES),
    "pandas, nullable": lambda: pandas().DataFrame(STATES).convert_dtypes(),
    "pandas, dates with a zone as index": pandas_with_dates_as_index,
    "pandas, of PyArrow": pandas_of_arrow,
    "polars": lambda: pytest.importorskip("polars").DataFrame(STATES),
    "polars, lazy": lambda: pytest.importorskip("polars").LazyFrame(STATES),
    "PyArrow": lambda: pytest.importorskip("pyarrow").table(STATES),
    "a batch of PyArrow": lambda: pytest.importorskip(
        "pyarrow"
    ).RecordBatch.from_pydict(STATES),
}


@pytest.mark.parametrize("make", TABLES.values(), ids=list(TABLES))
def test_tables_of_every_library_are_read(make):
    throw = Throw.from_frame(make())
    np.testing.assert_allclose(throw.t, T, atol=1e-12)
    np.testing.assert_array_equal(throw.x, [np.nan, *X[1:]])
    np.testing.assert_array_equal(throw.y, Y)
