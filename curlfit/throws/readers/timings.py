"""Stopwatch records: times between lines, and where the stone came to rest."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.foreign import quoted
from curlfit.settings.choices import Reading
from curlfit.sheet import LINES
from curlfit.throws.events import SIGMA_TIME, Event
from curlfit.throws.readers.defaults import begun
from curlfit.throws.readers.notation import Quantity, parse_quantity
from curlfit.throws.readers.parsed_file import Contents, Format, ParsedFile
from curlfit.throws.readers.text import (
    GAPS,
    TextFile,
    cells,
    header_cells,
    is_number,
    lines_of,
    separator_of,
)

TIMES: dict[str, tuple[str, str | None]] = {
    "back_to_hog": ("back", "hog"),
    "hog_to_hog": ("hog", "far-hog"),
    "hog_to_tee": ("hog", "far-tee"),
    "hog_to_rest": ("far-hog", None),
}
"""Lines between which each time is measured; None is rest."""
LABELS = {
    "sheet", "stone", "thrower", "start", "draw", "end", "team", "handle", "file", "track",
}  # fmt: skip
"""Columns that say of which throw a row is; any other that has words in most rows is kept too."""
SIGMA_REST = 0.05
"""Standard deviation in m of a position measured with a tape: a judgement."""
SIGMA_TURNS = 0.1
"""Standard deviation of the number of turns, counted by eye: a judgement."""
USUAL_SPIN = 1.2
"""Spin in rad/s at the near hog line where it was not measured: that of two and a half turns in
25 s if it decreases linearly, 2 * 2.5 * 2 pi/25; a judgement."""


class _Kind(NamedTuple):
    """What may be written of a quantity: units, largest size (SI), words; only words if no unit.
    Sizes that differ by `usual` are not odd."""

    unit: str
    limit: float = 600.0
    words: frozenset[str] = frozenset()
    usual: float = 0.0


# Friction of 0.002, the lowest on any ice, stops a stone from hog line to tee within 54 s.
_KINDS = dict.fromkeys(TIMES, _Kind("t", 60.0)) | {
    "curl": _Kind("x", 10.0, frozenset({"left", "right"}), 1.5),
    "rest": _Kind("y", 40.0, frozenset({"past", "short"}), 6.0),
    "turns": _Kind("phi", 2000 * math.pi, frozenset({"clockwise", "counter-clockwise"}), 19.0),
    "handle": _Kind(""), "hand": _Kind(""), "sigma_time": _Kind("t"), "sigma_rest": _Kind("y"),
    "sigma_curl": _Kind("x"), "sigma_turns": _Kind("phi"),
}  # fmt: skip
_NEGATIVE = {"left", "short", "clockwise"}
_ALIASES = {
    "sigma_t": "sigma_time", "spin": "handle", "rotation": "handle", "split": "back_to_hog",
    "h2h": "hog_to_hog", "hog_hog": "hog_to_hog",
}  # fmt: skip
_COMPARED = {*TIMES, "curl", "rest", "turns"}
_SI = {"t": "s", "x": "m", "y": "m"}
_FEWEST = 5  # values of a column among which one may be odd
# A value is odd if it is farther from the median of its column than 9 median absolute deviations
# (6 standard deviations of normal values) and 0.7 of this median, as no two weights in play are.
_MOST_OFF, _MOST_SHARE = 9.0, 0.7
_EXPECTED = (
    "expected lines such as hog_to_hog = 14.2, back_to_hog = 3.4, hog_to_tee = 18.1, "
    "hog_to_rest = 10.3 (s), curl = 4 ft left, rest = 0.6 (m past the far tee), turns = 2.5 cw, "
    "handle = clockwise, sigma_time = 0.1, sigma_rest = 0.05, sigma_curl = 0.05, sigma_turns = 0.1"
)
_COLUMNS = f"one of {', '.join(TIMES)}, curl, rest, turns, with a unit as in curl_ft"
_SPLIT = re.compile(r"[\s_\-./()\[\]]+")
_LINE = re.compile(r"""\s*["']?([^=:;,\t"']*?)["']?\s*[=:;,\t]\s*(\S.*?)\s*[;,]?\s*$""")
_MOST_ROWS = 100_000
_MANY = 4  # throws of a table whose curls determine an asymmetry of the friction


class _Entry(NamedTuple):
    line: int
    text: str
    unit: str


class _Row(NamedTuple):
    """One record: the line where it begins, its measurements, and what else is said of it."""

    line: int
    entries: dict[str, _Entry]
    labels: dict[str, str]
    notes: list[str]


def _contents(file: TextFile, reading: Reading) -> Contents:
    """The only record, or the rows of a table with one throw per row.

    Raises
    ------
    DataError : an unknown line, an impossible value, a curl without its side, or times that do not
        determine friction.
    """
    rows = _rows(file)
    keep = {*reading.keep, *begun(file, "timings").settings.get("keep", ())}
    law, several = _usual_law(rows), len(rows) > 1
    left_out, said = _left_out(file, rows, keep) if several else (set(), [])

    def parse(index: int) -> ParsedFile:
        source = f"{file.path} row {index + 1}" if several else None
        parsed = begun(file, "timings", source=source)
        parsed.settings.setdefault("law", law)
        parsed.settings.pop("keep", None)
        _read_record(parsed, _Record(file, rows[index], several, keep))
        parsed.notes += said
        return parsed

    return Contents(
        [f"line {row.line}" for row in rows], parse, left_out=left_out,
        note="{} throws, one in each row; taken: {} (--shot selects another)",
    )  # fmt: skip


def _left_out(
    file: TextFile, rows: list[_Row], keep: Collection[int]
) -> tuple[set[int], list[str]]:
    """Rows that a joint fit leaves out: those without a time, and odd ones, of which a value is
    beyond its limit or far from the median of its column, unless more than a tenth are odd."""
    found: dict[str, dict[int, float]] = {}
    for index, row in enumerate(rows):
        with suppress(DataError):  # the row itself is refused where it is read
            record = _Record(file, row, True, {row.line})
            for key in record.found.keys() & _COMPARED:
                found.setdefault(key, {})[index] = record.size(key)
    odd: dict[int, list[str]] = {}
    for key, sizes in found.items():
        values, kind = np.array([*sizes.values()]), _KINDS[key]
        middle = float(np.median(values))
        off = np.abs(values - middle)
        allowed = max(_MOST_OFF * float(np.median(off)), _MOST_SHARE * abs(middle), kind.usual)
        for index, value, far in zip(sizes, values, off, strict=True):
            if len(values) >= _FEWEST and (far > allowed or abs(value) > kind.limit):
                factor, unit = (2 * math.pi, "turns") if key == "turns" else (1, _SI[kind.unit])
                what = f"{key} {value / factor:.4g} {unit} where others have {middle / factor:.3g}"
                if rows[index].line not in keep:
                    odd.setdefault(index, []).append(what)
    lines = {
        index: f"line {rows[index].line} ({' and '.join(odd[index])})" for index in sorted(odd)
    }
    listed, said = "; ".join(lines.values()), []
    if len(odd) > len(rows) / 10:
        said = [f"odd rows, kept since they are more than a tenth: {listed}"]
        odd = {}
    elif odd:
        flag = ",".join(str(rows[index].line) for index in lines)
        said = [f"left out of a joint fit as odd: {listed}; --keep {flag} uses them"]
    empty = [index for index, row in enumerate(rows) if not row.entries.keys() & TIMES]
    if empty:
        listed = ", ".join(str(rows[index].line) for index in empty)
        said.append(f"left out of a joint fit, since no time was measured: line {listed}")
    return {*odd, *empty}, said


def is_table(head: list[str]) -> bool:
    """Whether lines, comments removed, begin with a header of several known quantities."""
    return bool(head) and sum(key is not None for key, _ in _header(head[0])) > 1


def _recognizes(head: list[str]) -> bool:
    if is_table(head):
        return any(key in TIMES for key, _ in _header(head[0]))
    found = [_pair(line) for line in head]
    # The header of a table may begin with such a name too, but has no digits.
    return any(pair is not None and pair[0] in TIMES for pair in found) or (
        found[0] is not None and any(char.isdigit() for char in found[0][2])
    )


TIMINGS = Format("timings", _recognizes, _contents, "row", "shot", 0, ("shot", "keep"))


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


def _rows(file: TextFile, *, table: bool = False) -> list[_Row]:
    """Each record in the file, which is a `table` even if it has one column of times or none."""
    body = [
        (index, text)
        for index, line in enumerate(file.lines)
        if (text := line.split("#", 1)[0].strip(" ")).strip() and not text.startswith("[")
    ]
    if not table and not is_table([text for _, text in body]):
        body = [(index, text.strip()) for index, text in body]
        return [_Row(body[0][0] + 1 if body else 0, _entries(file, body), {}, [])]
    if len(body) > _MOST_ROWS:
        raise file.error(f"more than {_MOST_ROWS} throws", body[_MOST_ROWS][0])
    first, head = body[0]
    separator = separator_of(head)
    names = header_cells(head, separator)
    while len(names) > 1 and not names[-1]:
        names.pop()
    header = [_key(name) or (None, "") for name in names]
    found = []
    for index, text in body[1:]:
        values = _cells(text, separator, len(names))
        while len(values) > len(header) and not values[-1]:
            values.pop()
        if len(values) != len(header):
            fault = f"{len(values)} cells, expected {len(header)} as in the header"
            raise file.error(fault, index)
        found.append((index + 1, [None if one.lower() in GAPS else one for one in values]))
    if not found:
        raise file.error("a header but no rows", first)
    kept = {k: "handle" for k, (key, _) in enumerate(header) if key == "handle"}
    unused = []
    notes = []
    for place, name in enumerate(names):
        label = "_".join(name.lower().split())
        if header[place][0] is not None or not name:
            continue
        if label not in LABELS and _is_like_a_measurement(name):
            notes.append(f"column {name} is not understood; expected {_COLUMNS}")
        words = sum(not is_number(values[place] or "0") for _, values in found)
        if label in LABELS or 2 * words > len(found):
            kept[place] = label
        else:
            unused.append(name)
    if unused:
        notes.append(f"columns not used: {', '.join(unused)}")
    return [
        _Row(
            line,
            {
                key: _Entry(line, value, unit)
                for (key, unit), value in zip(header, values, strict=True)
                if key is not None and value is not None
            },
            {label: cell for place, label in kept.items() if (cell := values[place])},
            notes,
        )
        for line, values in found
    ]


def _cells(line: str, separator: str | None, width: int) -> list[str]:
    """Cells of a row, in which a quotation mark may be that of inches."""
    found = [] if separator is None else [cell.strip() for cell in line.split(separator)]
    if len(found) == width and all(cell[:1] != '"' or cell[-1:] == '"' for cell in found):
        return [cell[1:-1].replace('""', '"') if cell[:1] == '"' else cell for cell in found]
    return cells(line, separator)


def _is_like_a_measurement(name: str) -> bool:
    """Whether a header has a unit in brackets or a word as in those of measurements."""
    words = filter(None, _SPLIT.split(name.lower()))
    return bool(re.search(r"[(\[]", name)) or any(
        get_close_matches(word, ("hog", "tee", "rest", "curl", "turns", "split"), 1, 0.75)
        for word in words
    )


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


def _read_record(parsed: ParsedFile, record: _Record) -> None:
    """Add the measurements and labels of a record, with notes."""
    parsed.events = record.events()
    parsed.alone = record.fault_alone(parsed.events)
    spin, said = record.spin()
    parsed.assumed, parsed.labels = {"omega0": spin}, record.row.labels
    crossed = {y for event in parsed.events for y in (event.at, event.since)}
    places = ", ".join(
        f"{name.replace('far-', 'far ')} line at {y:.3f} m"
        for name, y in LINES.items()
        if y in crossed
    )
    parsed.notes += [
        f"y from the hack, x from the line of delivery: the stone's centre crosses the {places} "
        f"(far tee {LINES['far-tee']:.3f} m)",
        said,
        *record.row.notes,
    ]


def usual_law(path: Path) -> str:
    """The law that a file is fitted with if none is named. Raises `DataError` as the reader."""
    return _usual_law(_rows(TextFile(path, lines_of(path))))


def labels_in(table: Path, source: str) -> tuple[dict[str, str], str]:
    """What a table with a column `file` or `track` says of a throw, and a note on it.

    Parameters
    ----------
    source : its file, which is named there with or without its folder and suffix.

    Raises
    ------
    DataError : as the reader; no such column, or the throw is named twice.
    """
    file = TextFile(table, lines_of(table))
    head, path, found = file.head(), Path(source.partition(" row ")[0]).resolve(), []
    rows = [
        (row, row.labels.pop("file", None) or row.labels.pop("track", None))
        for row in _rows(file, table=True)
    ]
    for row, name in rows:
        parts = Path((name or "").replace("\\", "/")).parts
        if parts and parts in (
            path.parts[-len(parts) :],
            path.with_suffix("").parts[-len(parts) :],
        ):
            found.append(row)
    if not any(name for _, name in rows):
        raise file.error("no names of throws; expected a column `file` or `track`", head)
    if len(found) > 1:
        raise file.error(f"{quoted(path.name)} is named again", found[1].line - 1)
    if not found:
        return {}, f"{table} says nothing of it"
    unused = ["its measurements are not used"] if found[0].entries else []
    said = [f"labels from {table}, line {found[0].line}", *unused, *found[0].notes]
    return found[0].labels, "; ".join(said)


def _usual_law(rows: list[_Row]) -> str:
    """The law that the measurements determine: the curl needs one that curls and slows the spin as
    stones do, and of a single throw the turns too; times and positions along the sheet determine a
    mean friction."""
    needed = {"curl"} if len(rows) >= _MANY else {"curl", "turns"}
    told = sum(needed <= row.entries.keys() for row in rows)
    return "front-back" if 2 * told >= len(rows) > 0 else "coulomb"


class _Record:
    """One record with its parsed quantities; those of lines to `keep` have no limits."""

    def __init__(self, file: TextFile, row: _Row, several: bool, keep: Collection[int]) -> None:
        self.file, self.row, self.entries = file, row, row.entries
        self.line = row.line if several else None
        self.limited = row.line not in keep
        self.found = {key: self._read(key) for key in row.entries}

    def _error(self, key: str, message: str) -> DataError:
        return self.file.error(message, self.entries[key].line - 1, key)

    def _read(self, key: str) -> Quantity:
        _, text, unit = self.entries[key]
        of, limit, words, _ = _KINDS[key]
        try:
            found = parse_quantity(text, of or "x", unit, per=2 * math.pi if of == "phi" else 1.0)
        except InputError as error:
            raise self._error(key, str(error)) from None
        if not of:
            return found
        value, fault = found.value, ""
        if math.isnan(value) or found.words - words or len(found.words) > 1:
            what = f"a number and {' or '.join(sorted(words))}" if words else "a number"
            fault = f"{quoted(text)} found, expected {what}"
        elif (self.limited and abs(value) > limit) or (
            value <= 0 and (of == "t" or key.startswith("sigma"))
        ):
            range_of = "above 0" if value <= 0 else f"up to {limit:g}"
            fault = f"{value:g} found, expected a number {range_of}"
        elif found.signed and found.words:
            fault = f"{quoted(text)} has a sign and a word; expected one of them"
        if fault:
            raise self._error(key, fault)
        return found

    def _value(self, key: str) -> float:
        """A value with the sign of its word."""
        value, _, words = self.found[key]
        return -value if words & _NEGATIVE else value

    def size(self, key: str) -> float:
        """A value to compare with those of other rows; of a curl and of turns the size."""
        return self._value(key) if key == "rest" else abs(self.found[key].value)

    def _has_side(self, key: str) -> bool:
        """Whether a sign or a word says to which side a quantity is counted."""
        return key in self.found and bool(self.found[key].signed or self.found[key].words)

    def _sigma(self, name: str) -> float:
        usual = {"time": SIGMA_TIME, "rest": SIGMA_REST, "turns": 2 * math.pi * SIGMA_TURNS}
        if f"sigma_{name}" in self.found:
            return self.found[f"sigma_{name}"].value
        return self._sigma("rest") if name == "curl" else usual[name]

    def events(self) -> list[Event]:
        """The measured events."""
        found = [
            Event(
                key, "time", self.found[key].value, self._sigma("time"),
                None if to is None else LINES[to], LINES[since],
            )
            for key, (since, to) in TIMES.items()
            if key in self.found
        ]  # fmt: skip
        if "rest" in self.found:
            y = LINES["far-tee"] + self._value("rest")
            found.append(Event("rest", "y", y, self._sigma("rest")))
        for key, quantity, value in (("curl", "x", self._curl), ("turns", "phi", self._turns)):
            if key in self.found:
                found.append(Event(key, quantity, value(), self._sigma(key), since=LINES["hog"]))
        return found

    def _handle(self) -> int:
        """Sense of the spin from `handle`: 1 counter-clockwise, -1 clockwise, 0 if not given.

        The in-turn of a right-hander turns clockwise, as does the out-turn of a left-hander.
        """
        if "handle" not in self.found:
            return 0
        value, signed, words = self.found["handle"]
        if "hand" in self.found:
            words |= self.found["hand"].words
        if signed and not math.isnan(value):
            return int(math.copysign(1, value))
        if words & {"clockwise", "counter-clockwise"}:
            return -1 if "clockwise" in words else 1
        turn, hand = words & {"in-turn", "out-turn"}, words & {"left", "right"}
        if len(turn) == 1 and len(hand) == 1:
            return -1 if ("in-turn" in turn) == ("right" in hand) else 1
        sides = [self._has_side(key) for key in ("curl", "turns") if key in self.found]
        if len(turn) == 1 and not hand and (any(sides) or not sides):
            return 0  # a label: the sense is given otherwise, or nothing needs it
        raise self._error(
            "handle",
            f"{next(iter(turn))} of which hand? Expected handle = in-turn right-handed, or "
            "handle = clockwise"
            if len(turn) == 1
            else f"{quoted(self.entries['handle'].text)} found, expected clockwise, "
            "counter-clockwise, or in-turn or out-turn with right-handed or left-handed",
        )

    def _sense(self) -> int:
        """Sense of the spin from the handle or the turns; 0 if neither gives it."""
        sense = self._handle()
        if not sense and self._has_side("turns"):
            sense = int(math.copysign(1, self._value("turns")))
        return sense

    def _curl(self) -> float:
        """Curl to the right, m. A stone curls to the side to which its front turns: to the left if
        counter-clockwise."""
        value = self._value("curl")
        if self._has_side("curl") or value == 0:
            return value
        if not (sense := self._sense()):
            raise self._error(
                "curl",
                "to which side? Expected curl = 4 ft left, or curl = 4 ft right, or a line handle "
                "= clockwise, handle = counter-clockwise, or handle = in-turn right-handed",
            )
        return -sense * value

    def _turns(self) -> float:
        """Angle turned in rad, counter-clockwise."""
        value = abs(self.found["turns"].value)
        sense = self._sense() or self._sense_of_curl()
        if not sense and value:
            raise self._error(
                "turns", "in which sense? Expected turns = 2.5 clockwise or 2.5 counter-clockwise"
            )
        return sense * value

    def _sense_of_curl(self) -> int:
        curl = self._curl() if "curl" in self.found else 0.0
        return (curl < 0) - (curl > 0)

    def spin(self) -> tuple[float, str]:
        """Spin in rad/s at which a fit fixes it if it is not determined, and a note on it."""
        if "turns" in self.found:
            return 0.0, "turns are counted from the near hog line"
        sense, why = self._sense(), "by the handle"
        if not sense:
            sense, why = self._sense_of_curl(), "by the side of the curl"
        if not sense:
            return 0.0, "the spin was not measured and is taken to be zero"
        word = "counter-clockwise" if sense > 0 else "clockwise"
        return sense * USUAL_SPIN, (
            f"the spin was not measured: it is held at {USUAL_SPIN} rad/s, {word} {why}, as for "
            "two and a half turns; a value of `turns` gives the measured number"
        )

    def fault_alone(self, events: list[Event]) -> DataError | None:
        """Why a row of a table of several determines no friction by itself.

        Raises
        ------
        DataError : the record is impossible or, as the only one, does not determine friction.
        """
        times = [event for event in events if event.quantity == "time"]
        fault = "" if times else f"no time; {_EXPECTED}"
        if len(times) == 1 and "rest" not in self.found:
            keys = [key for key in ("hog_to_hog", "rest", "hog_to_rest") if key not in self.found]
            fault = (
                f"{times[0].name} alone gives the mean speed and no friction; expected one more of "
                + ", ".join([*keys[:2], "or another time"])
            )
        if fault:
            error = self.file.error(fault, None if self.line is None else self.line - 1)
            if self.line is not None and times:
                return error
            raise error
        value = {event.name: event.value for event in events}
        if value.get("hog_to_tee", math.inf) <= value.get("hog_to_hog", 0.0):
            raise self._error(
                "hog_to_tee",
                f"{value['hog_to_tee']:g} s found, expected more than hog_to_hog = "
                f"{value['hog_to_hog']:g} s: the tee line lies behind the far hog line",
            )
        tee, rest = LINES["far-tee"], value.get("rest", math.inf)
        farthest, by = max((y, e.name) for e in times for y in (e.at, e.since) if y is not None)
        if rest <= farthest:
            raise self._error(
                "rest",
                f"{rest - tee:.3g} m past the far tee lies before a line that the stone has "
                f"crossed by {by} ({farthest - tee:.3f} m)",
            )
        return None
