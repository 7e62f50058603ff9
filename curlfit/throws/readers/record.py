"""A record of one throw by stopwatch and tape: what may be measured, and the
events it makes."""

from __future__ import annotations

import math
from typing import NamedTuple

from curlfit.errors import DataError, InputError
from curlfit.findings import Finding
from curlfit.foreign import quoted
from curlfit.sheet import LINES
from curlfit.throws.events import SIGMA_TIME, Event
from curlfit.throws.readers.notation import Quantity, parse_quantity
from curlfit.throws.readers.text import TextFile

SIGMA_REST = 0.05
"""Standard deviation in m of a position measured with a tape: a judgement."""
SIGMA_TURNS = 0.1
"""Standard deviation of the number of turns, counted by eye: a judgement."""
SIGMA_SPEED = 0.02
"""Standard deviation in m/s of a speed by light barriers 2 m apart or a radar, 1 %: a
judgement."""
SIGMA_SPIN = 0.05
"""Standard deviation in rad/s of a spin from two pictures of the handle, 0.5 s apart
and each within 1 degree: a judgement."""
USUAL_SPIN = 1.2
"""Spin in rad/s at the near hog line where it was not measured: that of two and a half
turns in 25 s if it decreases linearly, 2 * 2.5 * 2 pi/25; a judgement."""
EXPECTED = (
    "expected lines such as hog_to_hog = 14.2, back_to_hog = 3.4, hog_to_tee = 18.1, "
    "hog_to_rest = 10.3 (s), curl = 4 ft left, rest = 0.6 (m past the far tee), "
    "turns = 2.5 cw, speed = 2.1 (m/s at the near hog line), spin = 1.4 cw "
    "(rad/s there), handle = clockwise, sigma_time = 0.1, sigma_rest = 0.05, "
    "sigma_curl = 0.05, sigma_turns = 0.1"
)


class Kind(NamedTuple):
    """What may be written of a quantity.

    Attributes
    ----------
    unit : the quantity whose units it has; empty if it is in words only.
    limit : largest size, SI.
    words : that may follow the number.
    usual : by how much throws may differ, SI.
    at : the line at which it is measured; None at rest.
    since : the line since which it is measured; None for the throw's own axes.
    """

    unit: str
    limit: float = 600.0
    words: frozenset[str] = frozenset()
    usual: float = 0.0
    at: str | None = None
    since: str | None = None


# Friction of 0.002, the lowest on any ice, stops a stone from hog line to tee
# within 54 s.
_TIME = Kind("t", 60.0)
TIMES = {
    "back_to_hog": _TIME._replace(since="back", at="hog"),
    "hog_to_hog": _TIME._replace(since="hog", at="far-hog"),
    "hog_to_tee": _TIME._replace(since="hog", at="far-tee"),
    "hog_to_rest": _TIME._replace(since="far-hog"),
}
"""Times between lines."""
_SENSES = frozenset({"clockwise", "counter-clockwise"})
MEASURED = TIMES | {
    "rest": Kind("y", 40.0, frozenset({"past", "short"}), 6.0),
    "curl": Kind("x", 10.0, frozenset({"left", "right"}), 1.5, since="hog"),
    "turns": Kind("phi", 2000 * math.pi, _SENSES, 19.0, since="hog"),
    "speed": Kind("speed", 10.0, usual=1.5, at="hog"),
    "spin": Kind("omega", 50.0, _SENSES, 6.0, at="hog"),
}
ALONG = {*TIMES, "speed"}
"""Measurements of the motion along the sheet; a throw without one determines
no friction."""
KINDS = MEASURED | {
    "handle": Kind(""),
    "sigma_time": Kind("t"),
    "sigma_rest": Kind("y"),
    "sigma_curl": Kind("x"),
    "sigma_turns": Kind("phi"),
    "sigma_speed": Kind("speed"),
    "sigma_spin": Kind("omega"),
}
_NEGATIVE = {"left", "short", "clockwise"}
_SIGMAS = {
    "time": SIGMA_TIME,
    "rest": SIGMA_REST,
    "curl": SIGMA_REST,
    "turns": 2 * math.pi * SIGMA_TURNS,
    "speed": SIGMA_SPEED,
    "spin": SIGMA_SPIN,
}


def usual_sigma(key: str) -> float:
    """Standard deviation of a measurement, where a file does not say it."""
    return _SIGMAS["time" if key in TIMES else key]


_SENSE_BY = {
    "curl": ("handle", "turns", "spin"),
    "turns": ("handle", "turns", "spin", "curl"),
    "spin": ("handle", "spin", "turns", "curl"),
}
"""Quantities that say to which side a stone curls or in which sense it turns: of those
that were measured the first."""
_WITHOUT_SENSE = {
    "curl": "to which side? Expected curl = 4 ft left, or curl = 4 ft right, "
    "or a line handle = clockwise, handle = counter-clockwise, "
    "or handle = in-turn right-handed",
    "turns": "in which sense? Expected turns = 2.5 clockwise or 2.5 counter-clockwise",
    "spin": "in which sense? Expected spin = 1.4 rad/s clockwise or 1.4 rad/s "
    "counter-clockwise",
}
"""What is expected where none of these says it."""


class Entry(NamedTuple):
    """A quantity as written: its line, text and the unit in its header."""

    line: int
    text: str
    unit: str


class Row(NamedTuple):
    """One record: the line where it begins, its measurements, and what else
    is said of it."""

    line: int
    entries: dict[str, Entry]
    labels: dict[str, str]
    notes: list[Finding]


class Record:
    """The parsed measurements of a row; `limited` ones may not be too large
    for any throw."""

    def __init__(self, file: TextFile, row: Row, *, limited: bool = True) -> None:
        self.file = file
        self.row = row
        self.limited = limited
        self.measured = {key: self._read(key) for key in row.entries}

    def _error(self, key: str, message: str) -> DataError:
        return self.file.error(message, self.row.entries[key].line - 1, key)

    def _read(self, key: str) -> Quantity:
        """A quantity of the row. Raises `DataError` for what it cannot be."""
        _, text, unit = self.row.entries[key]
        kind = KINDS[key]
        per = 2 * math.pi if kind.unit == "phi" else 1.0
        try:
            quantity = parse_quantity(text, kind.unit or "x", unit, per=per)
        except InputError as error:
            raise self._error(key, str(error)) from None
        if not kind.unit:
            return quantity
        value = quantity.value
        words = quantity.words
        fault = ""
        if math.isnan(value) or words - kind.words or len(words) > 1:
            expected = "a number"
            if kind.words:
                expected += f" and {' or '.join(sorted(kind.words))}"
            fault = f"{quoted(text)} found, expected {expected}"
        elif value <= 0 and (kind.unit in ("t", "speed") or key.startswith("sigma")):
            fault = f"{value:g} found, expected a number above 0"
        elif self.limited and abs(value) > kind.limit:
            fault = f"{value:g} found, expected a number up to {kind.limit:g}"
        elif quantity.signed and words:
            fault = f"{quoted(text)} has a sign and a word; expected one of them"
        if fault:
            raise self._error(key, fault)
        return quantity

    def _value(self, key: str) -> float:
        """A value with the sign of its word."""
        value, _, words = self.measured[key]
        return -value if words & _NEGATIVE else value

    def sizes(self) -> dict[str, float]:
        """Values to compare with those of other rows; of a curl and of
        turns the size."""
        return {
            key: self._value(key) if key == "rest" else abs(self.measured[key].value)
            for key in self.measured.keys() & MEASURED.keys()
        }

    def _has_side(self, key: str) -> bool:
        """Whether a sign or a word says to which side a quantity is counted."""
        if key not in self.measured:
            return False
        quantity = self.measured[key]
        return quantity.signed or bool(quantity.words)

    def _sigma(self, name: str) -> float:
        """Standard deviation of a measurement; that of the rest is also that of a curl,
        since both are measured with one tape."""
        keys = [f"sigma_{name}"]
        if name == "curl":
            keys.append("sigma_rest")
        for key in keys:
            if key in self.measured:
                return self.measured[key].value
        return _SIGMAS[name]

    def events(self) -> list[Event]:
        """The measured events."""
        events = []
        for key, kind in MEASURED.items():
            if key not in self.measured:
                continue
            is_time = key in TIMES
            event = Event(
                name=key,
                quantity="time" if is_time else kind.unit,
                value=self._oriented(key),
                sigma=self._sigma("time" if is_time else key),
                at=LINES[kind.at] if kind.at else None,
                since=LINES[kind.since] if kind.since else None,
            )
            events.append(event)
        return events

    def _oriented(self, key: str) -> float:
        """A value in SI: y from the hack, x to the right, angles counter-clockwise."""
        value = self._value(key)
        if key == "rest":
            return LINES["far-tee"] + value
        if key not in _SENSE_BY:
            return value
        if key == "curl" and (self._has_side(key) or not value):
            return value
        sense = self._sense(*_SENSE_BY[key])
        if not sense and value:
            raise self._error(key, _WITHOUT_SENSE[key])
        if key == "curl":
            return -sense * abs(value)
        return sense * abs(value)

    def _handle(self) -> int:
        """Sense of the spin from `handle`: 1 counter-clockwise, -1 clockwise, 0
        if not given.

        The in-turn of a right-hander turns clockwise, as does the out-turn of
        a left-hander.
        """
        if "handle" not in self.measured:
            return 0
        words = self.measured["handle"].words
        if words & _SENSES:
            return -1 if "clockwise" in words else 1
        turn = words & {"in-turn", "out-turn"}
        hand = words & {"left", "right"}
        if len(turn) == 1 and len(hand) == 1:
            return -1 if ("in-turn" in turn) == ("right" in hand) else 1
        if len(turn) == 1 and not hand:
            # A label, where the sense is given otherwise or nothing needs it.
            needs_sense = {"curl", "turns", "spin"} & self.measured.keys()
            if not needs_sense or any(map(self._has_side, needs_sense)):
                return 0
        raise self._error(
            "handle",
            f"{quoted(self.row.entries['handle'].text)} found; expected clockwise or "
            "counter-clockwise, or in-turn or out-turn and of which hand, "
            "such as right-handed",
        )

    def _sense(self, *keys: str) -> int:
        """Sense of the spin by the first quantity that tells it; 0 if none
        does. A stone curls to the side to which its front turns: to the left
        if counter-clockwise."""
        for key in keys:
            if key == "handle":
                sense = self._handle()
            elif self._has_side(key):
                value = self._value(key)
                if key == "curl":
                    value = -value  # to the left
                sense = (value > 0) - (value < 0)
            else:
                continue
            if sense:
                return sense
        return 0

    def without_sense(self) -> set[str]:
        """Which of turns and spin have a size but no sense that anything tells."""
        return {
            key
            for key in ("turns", "spin")
            if key in self.measured
            and self._value(key)
            and not self._sense(*_SENSE_BY[key])
        }

    def spin(self) -> tuple[float, list[Finding]]:
        """Spin in rad/s at which a fit fixes it if it is not determined, and
        notes on it."""
        notes = []
        if "turns" in self.measured:
            notes.append(Finding.note("turns-from-the-hog-line"))
        if "spin" in self.measured:
            notes.append(Finding.note("spin-at-the-hog-line"))
        if notes:
            return 0.0, notes
        by_handle = self._sense("handle")
        sense = by_handle or self._sense("curl")
        if not sense:
            return 0.0, [Finding.note("spin-not-measured")]
        fixed = Finding.note(
            "spin-by-the-handle" if by_handle else "spin-by-the-curl",
            spin=USUAL_SPIN,
            sense="counter-clockwise" if sense > 0 else "clockwise",
        )
        return sense * USUAL_SPIN, [fixed]

    def fault_alone(self) -> str:
        """Why the record determines no friction by itself; empty if it does.

        Raises
        ------
        DataError : the record is impossible.
        """
        times = [key for key in MEASURED if key in ALONG and key in self.measured]
        if not times:
            return f"no time; {EXPECTED}"
        if len(times) == 1 and "rest" not in self.measured:
            lacking = [
                key
                for key in ("hog_to_hog", "rest", "hog_to_rest")
                if key not in self.measured
            ]
            speed = "the mean speed" if times[0] in TIMES else "speed"
            return (
                f"{times[0]} alone gives {speed} and no friction; expected one more of "
                f"{lacking[0]}, {lacking[1]}, or another time"
            )
        if {"hog_to_hog", "hog_to_tee"} <= self.measured.keys():
            to_hog = self.measured["hog_to_hog"].value
            to_tee = self.measured["hog_to_tee"].value
            if to_tee <= to_hog:
                raise self._error(
                    "hog_to_tee",
                    f"{to_tee:g} s found, expected more than hog_to_hog = {to_hog:g} "
                    "s: the tee line lies behind the far hog line",
                )
        crossed = []
        for key in times:
            for line in (KINDS[key].at, KINDS[key].since):
                if line is not None:
                    crossed.append((LINES[line], key))
        farthest, by = max(crossed)
        past = farthest - LINES["far-tee"]
        if "rest" in self.measured and self._value("rest") <= past:
            raise self._error(
                "rest",
                f"{self._value('rest'):.3g} m past the far tee lies before a line "
                f"that the stone has crossed by {by} ({past:.3f} m)",
            )
        return ""
