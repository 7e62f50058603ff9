"""Stopwatch records: times between lines, and where the stone came to rest."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from curlfit.errors import DataError, InputError
from curlfit.foreign import quoted
from curlfit.settings.choices import Reading
from curlfit.sheet import LINES
from curlfit.throws.events import SIGMA_TIME, Event
from curlfit.throws.readers.defaults import begun
from curlfit.throws.readers.notation import Quantity, parse_quantity
from curlfit.throws.readers.parsed_file import Contents, Format, ParsedFile
from curlfit.throws.readers.text import TextFile, cells, header_cells, lines_of, separator_of

TIMES: dict[str, tuple[str, str | None]] = {
    "back_to_hog": ("back", "hog"),
    "hog_to_hog": ("hog", "far-hog"),
    "hog_to_tee": ("hog", "far-tee"),
    "hog_to_rest": ("far-hog", None),
}
"""Lines between which each time is measured; None is rest."""
SIGMA_REST = 0.05
"""Standard deviation in m of a position measured with a tape: a judgement."""
SIGMA_TURNS = 0.1
"""Standard deviation of the number of turns, counted by eye: a judgement."""
USUAL_SPIN = 1.2
"""Spin in rad/s at the near hog line where it was not measured: that of two and a half turns in
25 s if it decreases linearly, 2 * 2.5 * 2 pi/25; a judgement."""
_KINDS = {
    **dict.fromkeys(TIMES, "t"), "curl": "x", "rest": "y", "turns": "phi", "handle": "word",
    "hand": "word", "sigma_time": "t", "sigma_rest": "y", "sigma_curl": "x", "sigma_turns": "phi",
}  # fmt: skip
_ALLOWED = {
    "curl": {"left", "right"}, "rest": {"past", "short"},
    "turns": {"clockwise", "counter-clockwise"},
}  # fmt: skip
_ALIASES = {
    "sigma_t": "sigma_time", "spin": "handle", "rotation": "handle", "split": "back_to_hog",
    "h2h": "hog_to_hog", "hog_hog": "hog_to_hog",
}  # fmt: skip
# Friction of 0.002, the lowest on any ice, stops a stone from hog line to tee within 54 s.
_LIMITS = dict.fromkeys(TIMES, 60.0) | {"rest": 40.0, "curl": 10.0, "turns": 1000.0 * 2 * math.pi}
_EXPECTED = (
    "expected lines such as hog_to_hog = 14.2, back_to_hog = 3.4, hog_to_tee = 18.1, "
    "hog_to_rest = 10.3 (s), curl = 4 ft left, rest = 0.6 (m past the far tee), turns = 2.5 cw, "
    "handle = clockwise, sigma_time = 0.1, sigma_rest = 0.05, sigma_curl = 0.05, sigma_turns = 0.1"
)
_SIDE = (
    "curl = 4 ft left, or curl = 4 ft right, or a line handle = clockwise, handle = "
    "counter-clockwise, or handle = in-turn right-handed"
)
_SPLIT = re.compile(r"[\s_\-./()\[\]]+")
_LINE = re.compile(r"""\s*["']?([^=:;,\t"']*?)["']?\s*[=:;,\t]\s*(\S.*?)\s*[;,]?\s*$""")
_MOST_ROWS = 100_000


class _Entry(NamedTuple):
    line: int
    text: str
    unit: str


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The only record, or the rows of a table with one throw per row.

    Raises
    ------
    DataError : an unknown line, an impossible value, a curl without its side, or times that do not
        determine friction.
    """
    rows = _rows(file)
    return Contents(
        [f"line {_first_line(row)}" for row in rows],
        lambda index: _record(file, rows, index),
        note="{} throws, one in each row; taken: {} (--shot selects another)",
    )


def _first_line(entries: dict[str, _Entry]) -> int:
    return min((entry.line for entry in entries.values()), default=0)


def is_table(head: list[str]) -> bool:
    """Whether lines, comments removed, begin with a header of several known quantities."""
    if not head:
        return False
    names = header_cells(head[0], separator_of(head[0]))
    return sum(_key(name) is not None for name in names) > 1


def _recognizes(head: list[str]) -> bool:
    if is_table(head):
        return any(key in TIMES for name in _header(head[0]) if (key := name[0]) is not None)
    found = [_pair(line) for line in head]
    keys = [pair[0] for pair in found if pair is not None]
    if any(key in TIMES for key in keys):
        return True
    # the header of a table may begin with such a name too, but has no digits
    first = found[0] if found else None
    return first is not None and any(char.isdigit() for char in first[2])


TIMINGS = Format("timings", _recognizes, _contents, "row", "shot", 0, ("shot",))


def _key(text: str) -> tuple[str, str] | None:
    """A known quantity and the unit that follows it, if any, as in `curl_ft`."""
    words = [word for word in _SPLIT.split(text.strip().strip("\"'").lower()) if word]
    for count in range(len(words), 0, -1):
        name = "_".join(words[:count])
        name = _ALIASES.get(name, name)
        if name in _KINDS and len(words) - count < 2:
            return name, "".join(words[count:])
    return None


def _header(line: str) -> list[tuple[str | None, str]]:
    return [_key(name) or (None, "") for name in header_cells(line, separator_of(line))]


def _pair(line: str) -> tuple[str, str, str] | None:
    """Quantity, unit and text of a line; None if it names no known quantity."""
    match = _LINE.match(line)
    if match is not None and (found := _key(match[1])) is not None:
        return *found, match[2]
    # `hog to hog 14.2`: the name ends where the value begins
    words = line.split()
    for count in range(min(4, len(words) - 1), 0, -1):
        found = _key(" ".join(words[:count]))
        if found is not None and not found[1]:
            return *found, " ".join(words[count:])
    return None


def _rows(file: TextFile) -> list[dict[str, _Entry]]:
    """Entries by quantity of each record in the file."""
    body = [
        (index, text)
        for index, line in enumerate(file.lines)
        if (text := line.split("#", 1)[0].strip()) and not text.startswith("[")
    ]
    if not is_table([text for _, text in body]):
        return [_entries(file, body)]
    if len(body) > _MOST_ROWS:
        raise file.error(f"more than {_MOST_ROWS} throws", body[_MOST_ROWS][0])
    first, head = body[0]
    header, separator = _header(head), separator_of(head)
    rows = []
    for index, text in body[1:]:
        values = cells(text, separator)
        if len(values) != len(header):
            fault = f"{len(values)} cells, expected {len(header)} as in the header"
            raise file.error(fault, index)
        rows.append(
            {
                key: _Entry(index + 1, value, unit)
                for (key, unit), value in zip(header, values, strict=True)
                if key is not None and value.strip() not in ("", "-", "--")
            }
        )
    if not rows:
        raise file.error("a header but no rows", first)
    return rows


def _entries(file: TextFile, body: Sequence[tuple[int, str]]) -> dict[str, _Entry]:
    found: dict[str, _Entry] = {}
    for index, text in body:
        pair = _pair(text)
        if pair is None:
            if not found and re.fullmatch(r"(?i)(name|key|quantity|what)\W.*", text):
                continue  # a header
            raise file.error(f"{quoted(text)} is not known; {_EXPECTED}", index)
        key, unit, value = pair
        if key in found:
            raise file.error(f"{key} is given twice", index)
        found[key] = _Entry(index + 1, value, unit)
    return found


def _record(file: TextFile, rows: list[dict[str, _Entry]], index: int) -> ParsedFile:
    several = len(rows) > 1
    parsed = begun(file, "timings", source=f"{file.path} row {index + 1}" if several else None)
    parsed.settings.setdefault("law", _usual_law(rows))
    record = _Record(file, rows[index], _first_line(rows[index]) if several else None)
    parsed.events = record.events()
    record.require_friction(parsed.events)
    spin, said = record.spin(parsed.events)
    parsed.assumed = {"omega0": spin}
    used = sorted({y for event in parsed.events for y in (event.at, event.since) if y is not None})
    named = {y: line.replace("far-", "far ") for line, y in LINES.items()}
    parsed.notes += [
        "y from the hack, x from the line of delivery: the stone's centre crosses the "
        + ", ".join(f"{named[y]} line at {y:.3f} m" for y in used)
        + f" (far tee {LINES['far-tee']:.3f} m)",
        said,
    ]
    return parsed


def usual_law(path: Path) -> str:
    """The law that a file is fitted with if none is named. Raises `DataError` as the reader."""
    return _usual_law(_rows(TextFile(path, lines_of(path))))


def _usual_law(rows: list[dict[str, _Entry]]) -> str:
    """The law that the measurements determine: curl and turns need one that curls and slows the
    spin as stones do, times and positions along the sheet a mean friction."""
    both = sum({"curl", "turns"} <= row.keys() for row in rows)
    return "front-back" if 2 * both >= len(rows) > 0 else "coulomb"


class _Record:
    """One record with its parsed quantities."""

    def __init__(self, file: TextFile, entries: dict[str, _Entry], line: int | None) -> None:
        self.file, self.entries, self.line = file, entries, line
        self.values = {key: self._read(key) for key in entries}

    def _error(self, key: str, message: str) -> DataError:
        return self.file.error(message, self.entries[key].line - 1, key)

    def _read(self, key: str) -> Quantity:
        _, text, unit = self.entries[key]
        kind = _KINDS[key]
        per = 2 * math.pi if kind == "phi" else 1.0
        try:
            found = parse_quantity(text, "x" if kind == "word" else kind, unit, per=per)
        except InputError as error:
            raise self._error(key, str(error)) from None
        if kind == "word":
            return found
        value, allowed, fault = found.value, _ALLOWED.get(key, set()), ""
        limit = _LIMITS.get(key, 600.0)
        positive = kind == "t" or key.startswith("sigma")
        if math.isnan(value) or found.words - allowed or len(found.words) > 1:
            what = f"a number and {' or '.join(sorted(allowed))}" if allowed else "a number"
            fault = f"{quoted(text)} found, expected {what}"
        elif abs(value) > limit or (positive and value <= 0):
            range_of = "above 0" if value <= 0 else f"up to {limit:g}"
            fault = f"{value:g} found, expected a number {range_of}"
        elif found.signed and found.words:
            fault = f"{quoted(text)} has a sign and a word; expected one of them"
        if fault:
            raise self._error(key, fault)
        return found

    def _sigma(self, key: str, usual: float) -> float:
        return self.values[key].value if key in self.values else usual

    def events(self) -> list[Event]:
        """The measured events."""
        values, hog = self.values, LINES["hog"]
        rest = self._sigma("sigma_rest", SIGMA_REST)
        found = [
            Event(
                key, "time", values[key].value, self._sigma("sigma_time", SIGMA_TIME),
                None if to is None else LINES[to], LINES[since],
            )
            for key, (since, to) in TIMES.items()
            if key in values
        ]  # fmt: skip
        if "rest" in values:
            value, _, words = values["rest"]
            y = LINES["far-tee"] + (-value if "short" in words else value)
            found.append(Event("rest", "y", y, rest))
        if "curl" in values:
            sigma = self._sigma("sigma_curl", rest)
            found.append(Event("curl", "x", self._curl(), sigma, since=hog))
        if "turns" in values:
            sigma = self._sigma("sigma_turns", SIGMA_TURNS * 2 * math.pi)
            found.append(Event("turns", "phi", self._turns(), sigma, since=hog))
        return found

    def _handle(self) -> int:
        """Sense of the spin from `handle`: 1 counter-clockwise, -1 clockwise, 0 if not given.

        The in-turn of a right-hander turns clockwise, as does the out-turn of a left-hander.
        """
        if "handle" not in self.values:
            return 0
        found = self.values["handle"]
        words = found.words | (self.values["hand"].words if "hand" in self.values else frozenset())
        if not math.isnan(found.value) and found.signed:
            return int(math.copysign(1, found.value))
        if "clockwise" in words or "counter-clockwise" in words:
            return -1 if "clockwise" in words else 1
        turn, hand = words & {"in-turn", "out-turn"}, words & {"left", "right"}
        if len(turn) == 1 and len(hand) == 1:
            return -1 if ("in-turn" in turn) == ("right" in hand) else 1
        if len(turn) == 1:
            raise self._error(
                "handle",
                f"{next(iter(turn))} of which hand? Expected handle = in-turn right-handed, or "
                "handle = clockwise",
            )
        raise self._error(
            "handle",
            f"{quoted(self.entries['handle'].text)} found, expected clockwise, counter-clockwise, "
            "or in-turn or out-turn with right-handed or left-handed",
        )

    def _sense(self) -> int:
        """Sense of the spin from the handle or the turns; 0 if neither gives it."""
        if handle := self._handle():
            return handle
        if "turns" not in self.values:
            return 0
        value, signed, words = self.values["turns"]
        if words:
            return 1 if "counter-clockwise" in words else -1
        return int(math.copysign(1, value)) if signed else 0

    def _curl(self) -> float:
        """Curl to the right, m. A stone curls to the side to which its front turns: to the left if
        counter-clockwise."""
        value, signed, words = self.values["curl"]
        if words:
            return -value if "left" in words else value
        if signed or value == 0:
            return value
        if not (sense := self._sense()):
            raise self._error("curl", f"to which side? Expected {_SIDE}")
        return -sense * value

    def _turns(self) -> float:
        """Angle turned in rad, counter-clockwise."""
        value = abs(self.values["turns"].value)
        sense = self._sense()
        if not sense and "curl" in self.values and (curl := self._curl()):
            sense = -1 if curl > 0 else 1
        if not sense and value:
            raise self._error(
                "turns", "in which sense? Expected turns = 2.5 clockwise or 2.5 counter-clockwise"
            )
        return sense * value

    def spin(self, events: list[Event]) -> tuple[float, str]:
        """Spin in rad/s at which a fit fixes it if it is not determined, and a note on it."""
        if "turns" in self.values:
            return 0.0, "turns are counted from the near hog line"
        sense, why = self._sense(), "by the handle"
        curl = next((event.value for event in events if event.name == "curl"), 0.0)
        if not sense and curl:
            sense, why = (-1 if curl > 0 else 1), "by the side of the curl"
        if not sense:
            return 0.0, "the spin was not measured and is taken to be zero"
        word = "counter-clockwise" if sense > 0 else "clockwise"
        return sense * USUAL_SPIN, (
            f"the spin was not measured: it is held at {USUAL_SPIN} rad/s, {word} {why}, as for "
            "two and a half turns; a value of `turns` gives the measured number"
        )

    def require_friction(self, events: list[Event]) -> None:
        """Raise `DataError` if the record does not determine friction or is impossible."""
        times = [event for event in events if event.quantity == "time"]
        fault = "" if times else f"no time; {_EXPECTED}"
        if len(times) == 1 and "rest" not in self.values:
            keys = [key for key in ("hog_to_hog", "rest", "hog_to_rest") if key not in self.values]
            others = ", ".join([*keys[:2], "or another time"])
            fault = f"{times[0].name} alone gives the mean speed and no friction; expected one more"
            fault += f" of {others}"
        if fault:
            raise self.file.error(fault, None if self.line is None else self.line - 1)
        value = {event.name: event.value for event in times}
        if value.get("hog_to_tee", math.inf) <= value.get("hog_to_hog", 0.0):
            raise self._error(
                "hog_to_tee",
                f"{value['hog_to_tee']:g} s found, expected more than hog_to_hog = "
                f"{value['hog_to_hog']:g} s: the tee line lies behind the far hog line",
            )
        rest = next((event.value for event in events if event.name == "rest"), math.inf)
        crossed = {y: e.name for e in times for y in (e.at, e.since) if y is not None}
        farthest = max(crossed)
        if rest <= farthest:
            raise self._error(
                "rest",
                f"{rest - LINES['far-tee']:.3g} m past the far tee lies before a line that the "
                f"stone has crossed by {crossed[farthest]} ({farthest - LINES['far-tee']:.3f} m)",
            )
