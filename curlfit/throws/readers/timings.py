"""Stop-watch records: times between the lines, and the position at rest."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError
from curlfit.sheet import HOG_TO_HOG, LINES
from curlfit.throws.readers.columns import Column, in_unit
from curlfit.throws.readers.parsed_file import Format, ParsedFile, ReadOptions, Series
from curlfit.throws.readers.table import defaults_of
from curlfit.throws.readers.text import parse_number

TIMES = ("back_to_hog", "hog_to_hog", "hog_to_rest")
_TIMED = re.compile(rf"^[^\S\n]*[\"']?({'|'.join(TIMES)})\b", re.I | re.M)
_KEYS = {
    **dict.fromkeys(TIMES, "t"),
    "curl": "x",
    "rest": "y",
    "turns": "phi",
    "sigma_t": "t",
    "sigma_rest": "y",
    "sigma_turns": "phi",
}
_EXPECTED = (
    "expected lines such as hog_to_hog = 14.2 and hog_to_rest = 10.3 (s), curl = 1.2 (m), "
    "rest = 0.5 (m beyond the far tee), turns = 2.5, sigma_t = 0.1, sigma_rest = 0.05, "
    "sigma_turns = 0.1"
)
_LINE = re.compile(r"""["']?(?P<key>[a-z_]+)["']?\s*[=:;,\t ]\s*(?P<value>\S.*?)\s*[;,]?$""", re.I)
_VALUE = re.compile(r"""["']?(?P<number>[-+]?[\d.,]+(?:e[-+]?\d+)?)[\s;,]*(?P<unit>[^"']*)["']?$""",
                    re.I)  # fmt: skip


class _Entry(NamedTuple):
    line: int
    value: float
    unit: str


def read_timings(path: Path, lines: list[str], _: ReadOptions) -> ParsedFile:
    """Rows at the lines and at rest: y there, x on the line of delivery and at rest.

    The stone crosses the back line (if timed), both hog lines, and rests; y is counted from the
    hack. The noise of y at a line is the timing error times the speed there under constant
    deceleration. The last row's speed of 0 gives the time of rest (see `Throw.stops`); its noise
    is the timing error times the deceleration.

    Raises
    ------
    DataError : an unknown line, a missing hog_to_hog, or an impossible value.
    """
    found, notes = _entries(path, lines)
    comments = [(k, line) for k, line in enumerate(lines, 1) if line.lstrip().startswith("#")]
    settings, reference, more = defaults_of(path, comments)

    def get(key: str) -> float | None:
        return found[key].value if key in found else None

    if "hog_to_hog" not in found or len(found.keys() & set(TIMES)) < 2:
        missing = "hog_to_hog" if "hog_to_hog" not in found else "back_to_hog or hog_to_rest"
        raise DataError(f"no {missing}; {_EXPECTED}", file=path)
    hogs, back, slide = found["hog_to_hog"].value, get("back_to_hog"), get("hog_to_rest")
    sigma_t, sigma_rest = get("sigma_t") or 0.1, get("sigma_rest") or 0.05
    sigma_turns = get("sigma_turns") or 0.1 * 2 * math.pi
    for key in ("curl", "rest", "turns"):
        if key in found and slide is None:
            raise DataError(
                f"{key} is measured at rest, and hog_to_rest is missing",
                file=path,
                line=found[key].line,
            )
    slowing = HOG_TO_HOG / (hogs * (hogs / 2 + (slide or math.inf)))
    speeds = {
        "back": HOG_TO_HOG / hogs + slowing * (hogs / 2 + (back or 0) / 2),
        "hog": HOG_TO_HOG / hogs + slowing * hogs / 2,
        "far-hog": HOG_TO_HOG / hogs - slowing * hogs / 2,
    }
    rows = [] if back is None else [("back", -back)]
    rows += [("hog", 0.0), ("far-hog", hogs)]
    nan = math.nan
    columns = {
        "t": [time for _, time in rows],
        "x": [0.0 if name != "far-hog" else nan for name, _ in rows],
        "y": [LINES[name] for name, _ in rows],
        "sigma_x": [sigma_rest] * len(rows),
        "sigma_y": [sigma_t * speeds[name] for name, _ in rows],
    }
    where = [found[key].line for key in TIMES if key in found]
    numbers = [where[0]] * (len(rows) - 1) + [found["hog_to_hog"].line]
    if slide is not None:
        rest, curl, turns = get("rest"), get("curl"), get("turns")
        columns["t"].append(hogs + slide)
        columns["x"].append(nan if curl is None else curl)
        columns["y"].append(nan if rest is None else LINES["far-tee"] + rest)
        columns["sigma_x"].append(sigma_rest)
        columns["sigma_y"].append(sigma_rest)
        columns["speed"] = [nan] * len(rows) + [0.0]
        columns["sigma_speed"] = [sigma_t * slowing] * (len(rows) + 1)
        if turns is not None:
            columns["phi"] = [0.0 if name == "hog" else nan for name, _ in rows] + [turns]
            columns["sigma_phi"] = [sigma_turns] * (len(rows) + 1)
        numbers.append(found["hog_to_rest"].line)
    notes += [
        f"y from the hack: back line {LINES['back']:.3f}, hog lines {LINES['hog']:.3f} and "
        f"{LINES['far-hog']:.3f}, far tee {LINES['far-tee']:.3f} m (hog to hog "
        f"{HOG_TO_HOG:.3f} m); t = 0 at the near hog line",
        f"sigma of times {sigma_t:g} s, of positions at rest {sigma_rest:g} m"
        + (f", of turns {sigma_turns / (2 * math.pi):g}" if "turns" in found else ""),
        "x = 0 up to the near hog line: curl is measured from the line of delivery, whose "
        "direction was not measured (--fix heading=0)",
    ]
    parsed = ParsedFile(path, "timings", [], [], settings, reference, notes=[*more, *notes])
    parsed.lines = np.asarray(numbers, np.int64)
    units = {"t": "s", "speed": "m/s", "phi": "rad"}
    parsed.series = [
        Series(name, Column(name, units.get(name.removeprefix("sigma_"), "m"), 1.0),
               np.asarray(values, float))
        for name, values in columns.items()
        if not name.startswith("sigma_") or np.isfinite(columns[name[6:]]).any()
    ]  # fmt: skip
    parsed.series = [s for s in parsed.series if np.isfinite(s.values).any()]
    return parsed


def _recognizes(head: list[str]) -> bool:
    return bool(_TIMED.search("\n".join(head)))


TIMINGS = Format("timings", _recognizes, read_timings)


def _entries(path: Path, lines: list[str]) -> tuple[dict[str, _Entry], list[str]]:
    """Values in SI by key."""
    found: dict[str, _Entry] = {}
    notes = []
    for count, line in enumerate(lines, 1):
        body = line.split("#", 1)[0].strip()
        if not body or body.startswith("["):
            continue
        match = _LINE.match(body)
        key = match["key"].lower() if match else ""
        if match is None or key not in _KEYS:
            if not found and re.fullmatch(r"(?i)(name|key|quantity|what)\W.*", body):
                continue  # a header
            raise DataError(f"{body[:40]!r} is not known; {_EXPECTED}", file=path, line=count)
        if key in found:
            raise DataError(f"{key} is given twice", file=path, line=count)
        entry = _value(path, count, key, match["value"])
        if entry.unit not in ("", "s", "m"):
            notes.append(f"{key} in {entry.unit}")
        found[key] = entry
    return found, notes


def _value(path: Path, line: int, key: str, text: str) -> _Entry:
    match = _VALUE.match(text)
    value = None if match is None else parse_number(match["number"], decimal_comma=True)
    if match is None or value is None or not abs(value) < 1e6:
        raise DataError(f"{text[:40]!r} found, expected a number", file=path, line=line, column=key)
    unit, quantity = match["unit"].strip().strip(";,").strip(), _KEYS[key]
    try:
        factor = (
            in_unit(quantity, unit).factor
            if unit
            else 2 * math.pi
            if key.endswith("turns")
            else 1.0
        )
    except ValueError as error:
        raise DataError(str(error), file=path, line=line, column=key) from None
    value *= factor
    limit = {"rest": 40.0, "curl": 10.0, "turns": 1000.0}.get(key, 600.0)
    if (
        abs(value) > limit
        or (quantity == "t" and value <= 0)
        or (key in ("sigma_rest", "sigma_turns") and value <= 0)
    ):
        raise DataError(
            f"{value:g} found, expected a number {'above 0' if value <= 0 else f'up to {limit:g}'}",
            file=path,
            line=line,
            column=key,
        )
    return _Entry(line, value, unit)
