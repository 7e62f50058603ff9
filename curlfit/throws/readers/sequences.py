"""Sequences in memory as numbers: arrays, lists and columns of tables, of numbers,
dates, durations or clock times, with gaps."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, date, timedelta
from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.throws.readers.cells import is_gap
from curlfit.throws.readers.clocks import AmbiguousTimesError, clock_times

Fault = Callable[[str], InputError]
"""Makes an error of what was found and expected; it adds the name of the sequence."""
_NUMBERS = "numbers"
_TIMES = "numbers, dates, durations or clock times"
_NAMES_OF_KINDS = {
    "b": "truth values",
    "c": "complex numbers",
    "m": "durations",
    "M": "dates",
    "V": "records of several values",
}
"""What an array holds where that is no number, by the kind of its dtype."""


def numbers(values: Any, fault: Fault) -> Floats:
    """The numbers of a sequence, shape (n,); NaN for masked entries, None, NA, NaT and
    words for gaps.

    Raises
    ------
    InputError : made by `fault`, for anything but numbers in one dimension.
    """
    return _as_floats(_in_one_dimension(values, fault, _NUMBERS), fault, _NUMBERS)


def times(values: Any, fault: Fault, unit: float = 1.0) -> Floats:
    """The times of a sequence, shape (n,); NaN for gaps, as of `numbers`.

    Parameters
    ----------
    unit : that of numbers, in s. Durations are converted to it; so are dates and clock
        times, which count from the first one.

    Raises
    ------
    InputError : made by `fault`, for anything but times in one dimension.
    """
    array = _in_one_dimension(values, fault, _TIMES)
    if array.dtype.kind in "mM":
        return _seconds(array, fault) / unit
    if array.dtype.kind in "OU":
        present = [value for value in array.tolist() if not _is_gap(value)]
        if any(isinstance(value, date | timedelta) for value in present):
            kinds = " and ".join(dict.fromkeys(map(_kind_of, present)))
            raise fault(f"{kinds} found together, expected times of one kind")
        words = [None if _is_gap(value) else str(value) for value in array.tolist()]
        try:
            clock = clock_times(words)
        except AmbiguousTimesError as error:
            raise fault(f"{error}, expected datetime objects or seconds") from None
        if clock.first and not clock.bad:
            return clock.seconds / unit
    return _as_floats(array, fault, _TIMES)


def one_or_many(values: Any, count: int, fault: Fault) -> Floats:
    """The numbers of a sequence, as `numbers`, or a single one `count` times."""
    array = as_array(values)
    single = array.ndim == 0
    return numbers(np.full(count, array) if single else array, fault)


def as_array(values: Any) -> NDArray[Any]:
    """An array of anything; its dtype is that of floats, dates or durations where it
    has nothing else but gaps."""
    if np.ma.isMaskedArray(values):
        values = _without_mask(values)
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):  # of lists of unlike lengths
        array = np.empty((), object)
        array[()] = values
    return _of_objects(array) if array.dtype == object and array.ndim else array


def _is_gap(value: Any) -> bool:
    """Whether a value stands for none: None, NaN, or the NA and NaT of pandas."""
    if value is None or type(value).__name__ in ("NAType", "NaTType"):
        return True
    if isinstance(value, np.datetime64 | np.timedelta64):
        return bool(np.isnat(value))
    return isinstance(value, float) and value != value


def _without_mask(values: Any) -> NDArray[Any]:
    """The entries of a masked array, with gaps for those that are masked."""
    entries = np.ma.getdata(values)
    mask = np.ma.getmaskarray(values)
    if entries.dtype.kind in "mM":
        return np.where(mask, np.array("NaT", entries.dtype), entries)
    entries = entries.astype(float if entries.dtype.kind in "fiu" else object)
    entries[mask] = None  # NaN in an array of floats
    return entries


def _of_objects(array: NDArray[Any]) -> NDArray[Any]:
    """Objects as an array of numbers, dates or durations if all of them are such, apart
    from gaps; otherwise as they are."""
    gaps = np.reshape([_is_gap(value) for value in array.flat], array.shape)
    present = array[~gaps]
    if not len(present):
        return array
    if all(map(_is_number, present)):
        return _with_gaps(array, gaps, np.nan, "f8")
    if all(isinstance(value, timedelta | np.timedelta64) for value in present):
        return _with_gaps(array, gaps, None, "m8[us]")
    if not all(isinstance(value, date | np.datetime64) for value in present):
        return array
    zoned = [getattr(value, "tzinfo", None) is not None for value in present]
    if all(zoned):
        array = array.copy()
        array[~gaps] = [value.astimezone(UTC).replace(tzinfo=None) for value in present]
    elif any(zoned):
        return array  # of two dates, it is not known which is the earlier
    return _with_gaps(array, gaps, None, "M8[us]")


def _is_number(value: Any) -> bool:
    return isinstance(value, Real | Decimal) and not isinstance(value, bool)


def _with_gaps(
    array: NDArray[Any], gaps: Booleans, gap: float | None, dtype: str
) -> NDArray[Any]:
    """An array of objects in a dtype, with `gap` for its gaps; unchanged if the dtype
    cannot hold them, as a large number or a duration of months."""
    filled = array.copy()
    filled[gaps] = gap
    try:
        return filled.astype(dtype)
    except (OverflowError, TypeError):
        return array


def _in_one_dimension(values: Any, fault: Fault, expected: str) -> NDArray[Any]:
    """The values as an array of shape (n,)."""
    array = as_array(values)
    if array.ndim == 1:
        return array
    if array.ndim > 1:
        raise fault(f"shape {array.shape} found, expected {expected} in one dimension")
    if isinstance(values, list | tuple):
        raise fault(f"lists of unlike lengths found, expected {expected}")
    raise fault(f"{_shown(values)} found, expected a list or an array of {expected}")


def _shown(value: Any) -> str:
    """A value for a message; of what holds many, its kind alone."""
    if value is None:
        return "None"
    short = isinstance(value, str | Real)
    return f"{_kind_of(value)} {quoted(value)}" if short else _kind_of(value)


def _kind_of(value: Any) -> str:
    kind = type(value).__name__
    zone = getattr(value, "tzinfo", None)
    return kind if zone is None else f"{kind} with a time zone"


def _seconds(array: NDArray[Any], fault: Fault) -> Floats:
    """Durations, or the times since the first date, in s; NaN for gaps."""
    gaps = np.isnat(array)
    if gaps.all():
        raise fault("every time is missing")
    if array.dtype.kind == "M":
        array = array - array[~gaps][0]
    try:
        return np.where(gaps, np.nan, array / np.timedelta64(1, "s"))
    except TypeError:
        raise fault("months or years found, expected days or seconds") from None


def _as_floats(array: NDArray[Any], fault: Fault, expected: str) -> Floats:
    """The numbers of an array, also where they are written as words."""
    kind = array.dtype.kind
    if kind in "fiu":
        return np.asarray(array, float)
    if kind in _NAMES_OF_KINDS:
        raise fault(f"{_NAMES_OF_KINDS[kind]} found, expected {expected}")
    values = array.tolist()
    floats = [math.nan if _is_gap(value) else _number(value) for value in values]
    if None in floats:
        row = floats.index(None)
        raise fault(f"row {row}: {_shown(values[row])} found, expected {expected}")
    return np.array(floats, float)


def _number(value: Any) -> float | None:
    """A number, or a word for one as a file would have it, or NaN of a word for a gap;
    None of anything else."""
    if isinstance(value, str):
        if is_gap(value.strip()):
            return math.nan
        if "_" in value:  # which Python takes for a separator of digits
            return None
    elif not _is_number(value):
        return None
    try:
        return float(value)
    except (ValueError, OverflowError):
        return None
