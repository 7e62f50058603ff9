"""Which columns of a table are those of a throw, by their headings or as the user names them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

from curlfit.errors import DataError, InputError
from curlfit.foreign import cut, quoted
from curlfit.settings.choices import Reading
from curlfit.throws.channels import CHANNELS
from curlfit.throws.readers.columns import (
    Column,
    named_column,
    parse_header,
    parse_units,
    quantity_of,
    resembled,
    with_unit,
)
from curlfit.throws.readers.parsed_file import ParsedFile, clock_of
from curlfit.throws.readers.text import EXPECTED

_MOST_NAMES = 400  # characters
_FRAME_NUMBERS = re.compile(r"frames?|frame[ _](number|no)")
_UNIT = re.compile(r"\s*[(\[].*$")
_QUANTITIES = "t, x, y, angle, speed, spin, u, v (pixels), sigma_x, t_phi ..."


def columns_of(
    names: Sequence[str],
    reading: Reading,
    error: Callable[[str], DataError],
    numeric: Callable[[int], bool],
) -> tuple[dict[int, Column], list[str]]:
    """Columns to read, by index, and the names of the others.

    With a reference, positions are in pixels: x and y without a unit are then in pixels, and v is
    not a speed. With a unit of t such as 25fps, a column of frame numbers is the time if there is
    no other. What is missing is sought among headings in other words.

    Parameters
    ----------
    numeric : whether the column of an index holds numbers.

    Raises
    ------
    DataError : two columns have the same meaning, or a required one is missing.
    """
    units, pixels = parse_units(reading.units), reading.reference is not None
    bare = [str(name).strip().lower() for name in names]
    meant = {column.quantity for name in names if (column := parse_header(name)) is not None}
    velocities = not pixels and {"x", "y"} <= meant and "u" in bare
    pixels = pixels or ("u" in bare and "v" in bare and not velocities)
    counted = "t" not in meant and any(map(_FRAME_NUMBERS.fullmatch, bare))
    as_set = partial(_as_set, units, pixels)
    named = _chosen(names, reading.columns, units, error)
    columns = {index: as_set(column) for index, column in named.items()}
    chosen = {column.quantity for column in columns.values()}
    taken: dict[str, str] = {}
    for index, (name, word) in enumerate(zip(names, bare, strict=True)):
        column = parse_header(name)
        if counted and _FRAME_NUMBERS.fullmatch(word) and units.get("t", "").endswith("fps"):
            column = Column("t", "s", 1.0, stated=False)
        if pixels and word in ("v", "sigma_v"):
            column = Column(word, "px", 1.0)
        if column is None or (velocities and word in ("u", "v")):
            continue
        column = as_set(column)
        if index in columns or column.quantity in chosen:
            continue
        if column.quantity in taken:
            raise error(
                f"columns {quoted(taken[column.quantity])} and {quoted(name)} both mean "
                f"{column.quantity}; rename or remove one"
            )
        taken[column.quantity] = name
        columns[index] = column
    columns |= _in_other_words(names, columns, as_set, numeric)
    if missing := missing_columns(column.quantity for column in columns.values()):
        raise error(_what_is_missing(missing, names, counted))
    columns = dict(sorted(columns.items()))
    return columns, [name for k, name in enumerate(names) if name and k not in columns]


def with_own_columns(reading: Reading, parsed: ParsedFile) -> Reading:
    """The choices with the columns that the file itself names."""
    own = parsed.settings.pop("columns", {})
    return replace(reading, columns={**own, **reading.columns})


def _as_set(units: Mapping[str, str], pixels: bool, column: Column) -> Column:
    """A column in the unit given by the user, if any; in pixels, if positions are."""
    column = with_unit(column, units.get(column.base))
    if pixels and not column.stated and column.quantity in ("x", "y", "sigma_x", "sigma_y"):
        axis = "u" if column.base == "x" else "v"
        return Column(column.quantity[:-1] + axis, "px", 1.0)
    return column


def _chosen(
    names: Sequence[str],
    wanted: Mapping[str, str],
    units: Mapping[str, str],
    error: Callable[[str], DataError],
) -> dict[int, Column]:
    """The columns that the user names, by index; a heading may be named without its unit."""
    found: dict[int, Column] = {}
    whole = [str(name).strip().lower() for name in names]
    bare = [_UNIT.sub("", name) for name in whole]
    for key, header in wanted.items():
        quantity, sought = quantity_of(key), header.strip().lower()
        if quantity is None:
            raise error(f"columns {quoted(key)}={quoted(header)}: expected one of {_QUANTITIES}")
        headings = whole if sought in whole else bare
        places = [k for k, name in enumerate(headings) if name == sought]
        if len(places) != 1 or places[0] in found:
            many = "no column" if not places else "more than one column, or one named twice,"
            said = f"{many} of this name among {_listed(names)}"
            raise error(f"columns {key}={quoted(header)}: {said}")
        heading = bare[places[0]] if quantity in units else whole[places[0]]
        try:
            found[places[0]] = named_column(heading, quantity)
        except InputError as fault:
            raise error(f"{fault}, or `--units {key}=UNIT`") from None
    return found


def _in_other_words(
    names: Sequence[str],
    columns: Mapping[int, Column],
    as_set: Callable[[Column], Column],
    numeric: Callable[[int], bool],
) -> dict[int, Column]:
    """Further columns by words that are less certain: of quantities that no other column has, each
    of one column alone, positions only in pairs."""
    taken = {column.quantity for column in columns.values()}
    found: dict[str, list[tuple[int, Column]]] = {}
    for index in set(range(len(names))) - columns.keys():
        column = parse_header(names[index], other_words=True)
        if column is None or parse_header(names[index]) is not None:
            continue
        column = as_set(column)
        if column.quantity in ("t", "x", "y", "u", "v") or numeric(index):
            found.setdefault(column.quantity, []).append((index, column))
    sole = {key: every[0] for key, every in found.items() if len(every) == 1 and key not in taken}
    for pair, others in (("xy", taken & {"u", "v"}), ("uv", (taken | sole.keys()) & {"x", "y"})):
        if others or not set(pair) <= taken | sole.keys():
            sole = {key: one for key, one in sole.items() if key not in pair}
    return {k: column for k, column in sole.values() if not column.quantity.startswith("sigma")}


def _what_is_missing(missing: Sequence[str], names: Sequence[str], counted: bool) -> str:
    guesses = {key: name for name in reversed(names) if (key := resembled(str(name))) in missing}
    example = ", ".join(f"{key}={guesses.get(key, 'HEADING')}" for key in missing)
    remedy = f'; or say which they are, as in `--columns "{example}"`'
    if counted and "t" in missing:
        remedy = "; `--units t=30fps`, with the camera's rate, makes frames times"
    return f"no column for {' and '.join(missing)} among {_listed(names)}; {EXPECTED}{remedy}"


def unused(
    names: Sequence[str],
    columns: Mapping[int, Column],
    numeric: Callable[[int], bool],
    *,
    python: bool = False,
) -> list[str]:
    """A note on columns of numbers that are not used although they resemble what is not measured
    otherwise, with the option that reads them."""
    taken = {column.quantity for column in columns.values()}
    like: dict[str, str] = {}
    for index, name in enumerate(names):
        quantity = None if index in columns else resembled(name)
        if quantity not in CHANNELS or quantity in {*taken, *like} or set(name) & set(',"$`'):
            continue
        with suppress(InputError):
            named_column(name, quantity)
            like |= {quantity: name} if numeric(index) else {}
    if taken & {"u", "v"} or not {"x", "y"} <= {*taken, *like}:
        like = {quantity: name for quantity, name in like.items() if quantity not in "xy"}
    if not like:
        return []
    headings, option = ", ".join(like.values()), ", ".join(f"{k}={v}" for k, v in like.items())
    said = f"`columns={like}`" if python else f'`--columns "{option}"`'
    return [f"not used, and perhaps {', '.join(like)}: {headings}; {said} reads them so"]


def _listed(names: Sequence[str]) -> str:
    return cut(", ".join(map(str, names)), _MOST_NAMES)


def missing_columns(quantities: Iterable[str]) -> list[str]:
    """Quantities required for a throw that the columns lack."""
    found = set(quantities)
    axes, others = ("u", "v") if {"u", "v"} & found else ("x", "y"), {"phi", "speed", "omega"}
    missing = [axis for axis in axes if axis not in found]
    if missing == ["x", "y"] and found & others:
        missing = []  # a gyroscope or a radar alone
    need = {*axes, *others} & found
    if "t" not in found and (
        not need or any(clock_of(quantity, found) == "t" for quantity in need)
    ):
        missing.insert(0, "t")
    return missing
