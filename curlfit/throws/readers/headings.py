"""Which columns of a table are those of a throw, by their headings or as the
user names them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from curlfit.errors import DataError, InputError, Option
from curlfit.findings import Finding, Remedy
from curlfit.foreign import cut, quoted
from curlfit.settings.choices import Reading
from curlfit.throws.channels import CHANNELS
from curlfit.throws.readers import columns as c
from curlfit.throws.readers.columns import Column
from curlfit.throws.readers.parsed_file import ParsedFile, clock_of
from curlfit.throws.readers.text import EXPECTED

_MOST_NAMES = 400  # characters
_FRAME_NUMBERS = re.compile(r"frames?|frame[ _](number|no)")
_UNIT = re.compile(r"\s*[(\[].*$")
_QUANTITIES = "t, x, y, angle, speed, spin, u, v (pixels), sigma_x, t_phi ..."


class Headings(NamedTuple):
    """The headings of a table.

    Attributes
    ----------
    names : the headings, in order.
    error : makes an error about them, from a message and, if any, options to type
        instead.
    numeric : whether the column of an index holds numbers.
    """

    names: Sequence[str]
    error: Callable[..., DataError]
    numeric: Callable[[int], bool] = lambda _: True

    def of_throw(
        self, parsed: ParsedFile, reading: Reading, *, python: bool = False
    ) -> dict[int, Column]:
        """The columns of a throw, by index; the parsed file is told of the others.

        Parameters
        ----------
        python : whether an option is written as in Python.

        Raises
        ------
        DataError : as `columns`.
        """
        columns = self.columns(reading, parsed.settings.pop("columns", {}))
        parsed.ignored = [
            name for k, name in enumerate(self.names) if name and k not in columns
        ]
        like = self._unused(columns)
        if like:
            option = _columns_option(like)
            if python:
                option = Option("columns", str(like), in_python=True)
            not_used = Finding.note(
                "columns-not-used",
                Remedy("reads-them-so", option),
                quantities=list(like),
                columns=list(like.values()),
            )
            parsed.notes.insert(0, not_used)
        return columns

    def columns(
        self, reading: Reading, named_in_file: Mapping[str, str]
    ) -> dict[int, Column]:
        """Columns to read, by index.

        With a reference, positions are in pixels: x and y without a unit are then in
        pixels, and v is not a speed; of positions in metres beside pixels, it decides
        which are read. With a unit of t such as 25fps, a column of frame
        numbers is the time if there is no other. What is missing is sought among
        headings in other words.

        Parameters
        ----------
        named_in_file : headings that the file itself names, by quantity.

        Raises
        ------
        DataError : two columns have the same meaning, or a required one is missing.
        """
        units = c.parse_units(reading.units)
        words = [name.strip().lower() for name in self.names]
        quantities = set(c.quantities_of(self.names))
        has_reference = reading.reference is not None
        # Beside x and y, a column u is a velocity, and v with it.
        u_is_velocity = not has_reference and {"x", "y"} <= quantities and "u" in words
        in_pixels = has_reference or ({"u", "v"} <= set(words) and not u_is_velocity)
        in_both = {"x", "y", "u", "v"} <= quantities and not u_is_velocity
        frames: list[int] = []
        if "t" not in quantities:
            frames = [
                index
                for index, word in enumerate(words)
                if _FRAME_NUMBERS.fullmatch(word)
            ]

        def in_unit(column: Column) -> Column:
            """A column in the unit that the user gives, or in pixels."""
            column = c.with_unit(column, units.get(column.base))
            is_place = column.quantity in ("x", "y", "sigma_x", "sigma_y")
            if is_place and in_pixels and not in_both and not column.stated:
                axis = "u" if column.base == "x" else "v"
                return Column(column.quantity[:-1] + axis, "px", 1.0)
            return column

        def by_heading(index: int) -> Column | None:
            """The column that a heading means in one of the usual words, if it does."""
            word = words[index]
            if u_is_velocity and word in ("u", "v"):
                return None
            if in_pixels and word in ("v", "sigma_v"):
                return in_unit(Column(word, "px", 1.0))
            if index in frames and units.get("t", "").endswith("fps"):
                return in_unit(Column("t", "s", 1.0, stated=False))
            column = c.parse_header(self.names[index])
            return None if column is None else in_unit(column)

        of_user = self._named({**named_in_file, **reading.columns}, units)
        columns = {index: in_unit(column) for index, column in of_user.items()}
        quantities_of_user = {column.quantity for column in columns.values()}
        index_of: dict[str, int] = {}
        for index, name in enumerate(self.names):
            column = None if index in columns else by_heading(index)
            if column is None or column.quantity in quantities_of_user:
                continue
            other = index_of.setdefault(column.quantity, index)
            if other != index:
                raise self.error(
                    f"columns {quoted(self.names[other])} and {quoted(name)} both mean "
                    f"{column.quantity}; rename or remove one"
                )
            columns[index] = column
        columns |= self._in_other_words(columns, in_unit)
        if in_both:
            left_out = ("u", "v")
            if has_reference or quantities_of_user & {"u", "v"}:
                left_out = ("x", "y")
            columns = {
                index: column
                for index, column in columns.items()
                if column.base not in left_out
            }
        missing = missing_columns(column.quantity for column in columns.values())
        if missing:
            raise self._missing(missing, has_frames=bool(frames))
        return dict(sorted(columns.items()))

    def _named(
        self, wanted: Mapping[str, str], units: Mapping[str, str]
    ) -> dict[int, Column]:
        """The columns that the user names, by index."""
        quantities = named_columns(
            wanted, self.names, self.error, c.quantity_of, _QUANTITIES
        )
        columns: dict[int, Column] = {}
        for index, quantity in quantities.items():
            name = self.names[index].strip().lower()
            heading = without_unit(name) if quantity in units else name
            try:
                columns[index] = c.named_column(heading, quantity)
            except InputError as fault:
                option = Option("units", f"{quantity}=UNIT")
                raise self.error(f"{fault}, or {option}", options=(option,)) from None
        return columns

    def _in_other_words(
        self, columns: Mapping[int, Column], in_unit: Callable[[Column], Column]
    ) -> dict[int, Column]:
        """Further columns by words that are less certain: of quantities that no other
        column has, each of one column alone, positions only in pairs."""
        present = {column.quantity for column in columns.values()}
        candidates: dict[str, dict[int, Column]] = {}
        for index, name in enumerate(self.names):
            column = c.parse_header(name, other_words=True)
            if index in columns or column is None or c.parse_header(name) is not None:
                continue
            column = in_unit(column)
            if column.quantity in ("t", "x", "y", "u", "v") or self.numeric(index):
                candidates.setdefault(column.quantity, {})[index] = column
        sole = {
            quantity
            for quantity, column_by_index in candidates.items()
            if len(column_by_index) == 1 and quantity not in present
        }
        with_sole = present | sole
        has_metres = {"x", "y"} <= with_sole and not present & {"u", "v"}
        has_pixels = {"u", "v"} <= with_sole and not with_sole & {"x", "y"}
        if not has_metres:
            sole -= {"x", "y"}
        if not has_pixels:
            sole -= {"u", "v"}
        further: dict[int, Column] = {}
        for quantity, column_by_index in candidates.items():
            if quantity in sole and not quantity.startswith("sigma"):
                further |= column_by_index
        return further

    def _missing(self, missing: Sequence[str], *, has_frames: bool) -> DataError:
        """The error of columns that are missing, with what would make other columns
        these; numbers of frames become times."""
        expected = EXPECTED
        if has_frames and "t" in missing:
            option = Option("units", "t=30fps")
            remedy = f"{option}, with the camera's rate, makes frames times"
        else:
            if {"t", "x", "y"} <= {*missing}:
                expected += ", or of a stopwatch such as hog_to_hog,rest"
            guesses: dict[str, str] = {}
            for name in reversed(self.names):
                quantity = c.resembled(name)
                if quantity is not None and quantity in missing:
                    guesses[quantity] = name
            example = {key: guesses.get(key, "HEADING") for key in missing}
            option = _columns_option(example)
            remedy = f"or say which they are, as in {option}"
        return self.error(
            f"no column for {' and '.join(missing)} among {_listed(self.names)}; "
            f"{expected}; {remedy}",
            options=(option,),
        )

    def _unused(self, columns: Mapping[int, Column]) -> dict[str, str]:
        """Columns of numbers that are not used although they resemble what is not
        measured otherwise, by quantity."""
        present = {column.quantity for column in columns.values()}
        like: dict[str, str] = {}
        for index, name in enumerate(self.names):
            quantity = None if index in columns else c.resembled(name)
            if quantity not in CHANNELS or quantity in present or quantity in like:
                continue
            if set(name) & set(',"$`'):
                continue  # cannot be typed in an option
            with suppress(InputError):  # of a unit or a row that cannot be read
                c.named_column(name, quantity)
                if self.numeric(index):
                    like[quantity] = name
        has_place = {"x", "y"} <= present | like.keys()
        if present & {"u", "v"} or not has_place:
            like.pop("x", None)
            like.pop("y", None)
        return like


def has_clock(headings: Iterable[str]) -> bool:
    """Whether a heading means times, in any language, or numbers of frames."""
    for heading in headings:
        column = c.parse_header(heading, other_words=True)
        is_time = column is not None and column.base == "t"
        if is_time or _FRAME_NUMBERS.fullmatch(heading.strip().lower()):
            return True
    return False


def named_columns(
    wanted: Mapping[str, str],
    headings: Sequence[str],
    error: Callable[..., DataError],
    quantity_of: Callable[[str], str | None],
    expected: str,
) -> dict[int, str]:
    """The quantities of the columns that the user names, by index; a heading may be
    named without its unit.

    Parameters
    ----------
    wanted : headings by what the user calls the quantity.
    error : makes an error about the headings.
    quantity_of : the quantity that a word stands for, if any. expected : all of them,
        for a message.

    Raises
    ------
    DataError : an unknown quantity; no column of this heading, or more than one.
    """
    quantities: dict[int, str] = {}
    names = [heading.strip().lower() for heading in headings]
    for key, header in wanted.items():
        quantity = quantity_of(key)
        if not quantity:
            raise error(
                f"columns {quoted(key)}={quoted(header)}: expected one of {expected}"
            )
        sought = header.strip().lower()
        candidates = names
        if sought not in names:
            candidates = [without_unit(name) for name in names]
        matching = [index for index, name in enumerate(candidates) if name == sought]
        if len(matching) != 1 or matching[0] in quantities:
            how_many = "no column"
            if matching:
                how_many = "more than one column, or one named twice,"
            raise error(
                f"columns {key}={quoted(header)}: {how_many} of this name among "
                f"{_listed(headings)}"
            )
        quantities[matching[0]] = quantity
    return quantities


def _listed(headings: Sequence[str]) -> str:
    """Headings for a message, cut if they are many."""
    return cut(", ".join(headings), _MOST_NAMES)


def without_unit(heading: str) -> str:
    """A heading without the unit in brackets at its end."""
    return _UNIT.sub("", heading)


def _columns_option(headings: Mapping[str, str]) -> Option:
    """The option that reads columns of these headings, by quantity."""
    pairs = ", ".join(f"{quantity}={name}" for quantity, name in headings.items())
    return Option("columns", f'"{pairs}"')


def missing_columns(quantities: Iterable[str]) -> list[str]:
    """Quantities required for a throw that the columns lack."""
    present = set(quantities)
    axes = ("u", "v") if {"u", "v"} & present else ("x", "y")
    without_axes = {"phi", "speed", "omega"}
    missing = [axis for axis in axes if axis not in present]
    if missing == ["x", "y"] and present & without_axes:
        missing = []  # a gyroscope or a radar alone
    if "t" in present:
        return missing
    timed = {*axes, *without_axes} & present
    have_own_clocks = all(clock_of(quantity, present) != "t" for quantity in timed)
    if not timed or not have_own_clocks:
        missing.insert(0, "t")
    return missing
