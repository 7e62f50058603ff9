"""Clock times, dates and timecodes as people, cameras and spreadsheets write them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from curlfit.errors import Option
from curlfit.foreign import quoted
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.cells import is_gap
from curlfit.throws.readers.numbers import parse_number

MINUTE = 60.0
HOUR = 60 * MINUTE
DAY = 24 * HOUR
_OF_A_WATCH = re.compile(
    r"(?:(?P<hours>\d{1,2}):)?(?P<minutes>\d{1,2}):(?P<seconds>\d{1,2}(?:[.,]\d+)?)"
    r"(?:[:;](?P<parts>\d{1,3}))?"
)
"""14:03:22.150, 03:22.15, and with hundredths or frames of a film, 0:00:12:86."""
_OF_A_DAY = re.compile(
    r"(?P<hours>\d{1,2})(?:[:h](?P<minutes>\d{2}))?(?::(?P<seconds>\d{2}(?:[.,]\d+)?))?"
    r"(?:\s*(?P<half>[ap])\.?m\.?|\s*uhr)?",
    re.I,
)
"""19:05, 19h05, 7:05 pm, 7 pm, 19:05:10.5."""
_DATE = re.compile(
    r"(?P<first>\d{1,2})(?P<mark>[./-])(?P<second>\d{1,2})(?P=mark)(?P<year>\d{4}|\d{2})"
    r"(?:[ T,]+(?P<clock>.*))?"
)
"""12.01.2026 19:05, 1/12/2026 7:05 PM."""
_HUNDREDTHS = 100
_LONGEST_BY_WATCH = 60.0
"""s; no time between lines is longer, so that 00:12:86 and 00:12:45 of a watch are
hundredths and 00:00:13 of a spreadsheet is not."""


class AmbiguousTimesError(ValueError):
    """Clock times or dates of two meanings; `options` say which is meant."""

    def __init__(self, message: str, *options: Option) -> None:
        super().__init__(message)
        self.options = options


class ClockTimes(NamedTuple):
    """The cells of a column of clock times.

    Attributes
    ----------
    seconds : since the first one, shape (n,); NaN for gaps and in `bad`.
    first : the first clock time as written; empty if there is none.
    bad : rows with something else.
    in_hundredths : whether the last part of each counts hundredths of a second.
    """

    seconds: Floats
    first: str
    bad: list[int]
    in_hundredths: bool = False


def clock_times(
    cells: Sequence[str | None],
    *,
    frame_rate: float | None = None,
    day_first: bool | None = None,
) -> ClockTimes:
    """Clock times such as 14:03:22.150, 03:22.15 or 2026-01-05T14:03:22.150Z, as s
    since the first.

    Without dates, midnight may pass from one row to the next, and without hours an
    hour. Where some rows have minutes, a number below 60 is that of a row without.

    Parameters
    ----------
    frame_rate : of a film, frames a second, which the last of four parts counts.
    day_first : whether 1/12/2026 is the first of December; None if the file must say.

    Raises
    ------
    AmbiguousTimesError : the last of four parts may count frames or hundredths, or
        dates have two meanings.
    """
    texts = ["" if cell is None else cell.strip() for cell in cells]
    dates = [match for text in texts if (match := _DATE.fullmatch(text))]
    if day_first is None:
        day_first = _day_is_first(dates)
    watches = [match for text in texts if (match := _OF_A_WATCH.fullmatch(text))]
    parts = [int(match["parts"]) for match in watches if match["parts"]]
    in_hundredths = bool(parts) and frame_rate is None
    if in_hundredths and max(parts) < MINUTE and max(parts) > 0:
        raise AmbiguousTimesError(
            f"the last part of {quoted(watches[-1][0])} may count frames or hundredths",
            Option("units", "t=30fps"),
            Option("units", "t=100fps"),
        )
    parts_a_second = frame_rate or _HUNDREDTHS
    has_hours = any(match["hours"] for match in watches)
    seconds_alone = bool(watches) and not has_hours and not dates
    seconds = np.array(
        [_seconds(text, day_first, parts_a_second, seconds_alone) for text in texts]
    )
    bad = [
        row
        for row, text in enumerate(texts)
        if math.isnan(seconds[row]) and not is_gap(text)
    ]
    timed = np.flatnonzero(np.isfinite(seconds))  # rows
    if not len(timed):
        return ClockTimes(seconds, "", bad)
    seconds -= seconds[timed[0]]
    if not dates and not any(text[4:5] == "-" for text in texts):
        round_of_the_clock = DAY if has_hours or not watches else HOUR
        back = np.diff(seconds[timed]) < -round_of_the_clock / 2
        for row in timed[1:][back]:
            seconds[row:] += round_of_the_clock
    return ClockTimes(np.round(seconds, 9), texts[timed[0]], bad, in_hundredths)


def _day_is_first(dates: Sequence[re.Match[str]]) -> bool:
    """Whether dates begin with the day, as those with points do. Raises
    `AmbiguousTimesError` where the file does not say it."""
    slashed = [match for match in dates if match["mark"] != "."]
    first = {int(match["first"]) for match in slashed}
    second = {int(match["second"]) for match in slashed}
    if not slashed or max(first) > 12:
        return True
    if max(second) > 12:
        return False
    if len({match.group("first", "second", "year") for match in slashed}) == 1:
        return True  # one day, whichever it is
    raise AmbiguousTimesError(
        f"in {quoted(slashed[0][0])} the day or the month may be first",
        Option("units", "date=day-first"),
        Option("units", "date=month-first"),
    )


def _seconds(
    text: str, day_first: bool, parts_a_second: float, seconds_alone: bool
) -> float:
    """A clock time in s, since 1970 if it has a date; NaN if it is not one.

    Parameters
    ----------
    seconds_alone : whether a number below 60 is a time too.
    """
    watch = _OF_A_WATCH.fullmatch(text)
    if watch:
        hours = int(watch["hours"] or 0)
        minutes = int(watch["minutes"])
        seconds = float(watch["seconds"].replace(",", "."))
        parts = int(watch["parts"] or 0)
        valid = hours < 24 and seconds < 60 and (minutes < 60 or not watch["hours"])
        if not valid or parts >= parts_a_second:
            return math.nan
        return hours * HOUR + minutes * MINUTE + seconds + parts / parts_a_second
    number = parse_number(text) if seconds_alone else None
    if number is not None:
        return number if 0 <= number < MINUTE else math.nan
    if ":" not in text:
        return math.nan
    date = _moment(text, day_first)
    if date is not None:
        return date.timestamp()
    return _time_of_day(text)


def _moment(text: str, day_first: bool) -> datetime | None:
    """A date with a time of the day, if any; None for another text."""
    match = _DATE.fullmatch(text)
    try:
        if match is None:
            moment = datetime.fromisoformat(text) if text[4:5] == "-" else None
        else:
            day = int(match["first"])
            month = int(match["second"])
            if not day_first:
                day, month = month, day
            year = int(match["year"])
            year += 2000 if year < 100 else 0
            moment = datetime(year, month, day)
            seconds = _time_of_day(match["clock"]) if match["clock"] else 0.0
            moment = datetime.fromtimestamp(
                moment.replace(tzinfo=UTC).timestamp() + seconds, UTC
            )
    except (ValueError, OverflowError):
        return None
    if moment is None or moment.tzinfo is not None:
        return moment
    return moment.replace(tzinfo=UTC)


def _time_of_day(text: str) -> float:
    """A time of the day in s; NaN for another text."""
    match = _OF_A_DAY.fullmatch(text.strip())
    if match is None or not (match["minutes"] or match["half"]):
        return math.nan
    hours = int(match["hours"])
    minutes = int(match["minutes"] or 0)
    seconds = float((match["seconds"] or "0").replace(",", "."))
    if match["half"]:
        if not 1 <= hours <= 12:
            return math.nan
        hours = hours % 12 + (12 if match["half"].lower() == "p" else 0)
    if hours >= 24 or minutes >= 60 or seconds >= 60:
        return math.nan
    return hours * HOUR + minutes * MINUTE + seconds


def times_of_day(texts: Sequence[str]) -> Floats | None:
    """Times of the day, which may pass midnight from one to the next, or dates with
    such times, in s; None where one is something else. Raises `AmbiguousTimesError`
    for dates of two meanings."""
    texts = [text.strip() for text in texts]
    dates = [match for text in texts if (match := _DATE.fullmatch(text))]
    day_first = _day_is_first(dates)
    seconds = np.empty(len(texts))
    dated = 0
    for row, text in enumerate(texts):
        moment = _moment(text, day_first)
        dated += moment is not None
        seconds[row] = _time_of_day(text) if moment is None else moment.timestamp()
    if np.isnan(seconds).any() or 0 < dated < len(texts):
        return None
    if not dated:
        midnights = np.flatnonzero(np.diff(seconds) < -DAY / 2) + 1
        for row in midnights.tolist():
            seconds[row:] += DAY
    return seconds


def time_by_watch(text: str) -> float | None:
    """A time of at most a minute or so as a watch shows it, `0:12.86`, `00:12:86`, or
    a spreadsheet, `00:00:12.860`, in s; None for another text."""
    match = _OF_A_WATCH.fullmatch(text.strip())
    if match is None:
        return None
    seconds = _seconds(match[0], True, _HUNDREDTHS, seconds_alone=False)
    is_clock = seconds <= _LONGEST_BY_WATCH  # not of NaN
    if not is_clock and match["hours"] and match["seconds"].isdigit():
        minutes_seconds = MINUTE * int(match["hours"]) + int(match["minutes"])
        return minutes_seconds + int(match["seconds"]) / _HUNDREDTHS
    return None if math.isnan(seconds) else seconds
