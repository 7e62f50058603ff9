"""Angles of a stone: their unit, what is said of their jumps, and their measurement by
a second mark."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from curlfit.errors import Option
from curlfit.findings import Finding, Remedy
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.sheet import LENGTH
from curlfit.throws.channels import scatter
from curlfit.throws.readers.columns import in_unit, parse_header
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.unwrapping import (
    TURN,
    AmbiguousTurnError,
    ContradictoryAnglesError,
    period_of,
    unwrap,
)

MAX_SPIN = 2 * TURN
"""rad/s; a thrown stone makes two to four turns, at about 1 rad/s or 60 degrees/s."""
_MOST_NAMED = 3  # stretches of rows whose angle contradicts the others
_HANDLE = Option("handle", "N")
_FARTHEST = 0.3  # m, of a mark; the stone's diameter is 0.29 m
_HANDLE_ARM = 0.1  # m, from the centre of a stone to the end of its handle
_LENGTHS = ("m", "cm", "mm", "ft", "in")


def require_radians(parsed: ParsedFile, columns: dict[str, Floats]) -> None:
    """Refuse an angle or a spin whose numbers cannot be radians.

    They cannot be if they jump by 360 or 180, and are unlikely to be if the stone would
    turn more than twice a second; columns named `phi` and `omega` then are rad and
    rad/s, with a note.
    """
    t = columns["t"]
    for header, column, _ in parsed.series:
        quantity = column.quantity
        if quantity == "phi":
            degrees = Option("units", "angle=deg")
            radians = Option("units", "angle=rad")
            jump = _jump_in_degrees(t, columns["phi"])
        elif quantity == "omega":
            degrees = Option("units", "spin=deg/s")
            radians = Option("units", "spin=rad/s")
            jump = None
        else:
            continue
        if column.stated:
            of_header = parse_header(header)  # a user may have stated another unit
            header_states_it = of_header is not None and of_header.stated
            if jump is not None and column.factor == 1 and header_states_it:
                fault = (
                    f"the header says {column.unit}, and the numbers jump by "
                    f"{jump.degrees} as degrees do; give {degrees}"
                )
                raise parsed.error(fault, jump.row, quantity, options=(degrees,))
            continue
        remedy = Remedy("unit-of-angles", degrees, {"other": str(radians)})
        if jump is not None:
            fault = (
                f"no unit is given, and the numbers jump by {jump.degrees} as "
                f"degrees do; {remedy}"
            )
            raise parsed.error(fault, jump.row, quantity, options=(degrees, radians))
        if quantity == "phi":
            rate = _turning_rate(t, columns["phi"])
        else:
            rate = float(np.nanquantile(np.abs(columns["omega"]), 0.9))
        if rate <= MAX_SPIN or math.radians(rate) > MAX_SPIN:
            continue  # the times are wrong if degrees turn too fast too
        if header.strip().lower() != quantity:
            fault = (
                f"no unit is given, and {rate:.3g} rad/s would be more than two turns "
                f"a second; these may be degrees: {remedy}"
            )
            raise parsed.error(fault, quantity=quantity, options=(degrees, radians))
        parsed.notes.append(
            Finding.note("unit-of-angles-unknown", remedy, quantity=quantity, rate=rate)
        )


def unwrap_angle(parsed: ParsedFile, columns: dict[str, Floats]) -> list[Finding]:
    """Undo the jumps of the angle; says how many, and which rows contradict the
    others. Raises `DataError` where the sense of a jump is unclear."""
    try:
        unwrapped = unwrap(columns["t"], columns["phi"], columns.get("omega"))
    except AmbiguousTurnError as error:
        raise parsed.error(
            "the angle is wrapped and the stone turns so far from row to row that the "
            "sense is ambiguous; expected rows closer in time, an unwrapped angle, "
            "or a column of the spin",
            error.row,
            "phi",
        ) from None
    except ContradictoryAnglesError as error:
        raise parsed.error(
            f"the angle stays within one turn, and {error.rows} of {error.measured} "
            "values contradict the others, the first one here; expected an unwrapped "
            "angle, or empty cells where it was not measured",
            error.row,
            "phi",
        ) from None
    columns["phi"] = unwrapped.angle
    notes = []
    if unwrapped.jumps:
        removed = Finding.note(
            "jumps-removed",
            count=unwrapped.jumps,
            degrees=round(math.degrees(unwrapped.period)),
        )
        notes.append(removed)
    if unwrapped.off_course.any():
        notes.append(_off_course(parsed, columns["t"], unwrapped.off_course))
    return notes


def _off_course(parsed: ParsedFile, t: Floats, rows: Booleans) -> Finding:
    """Which rows have an angle that contradicts those before and after them."""
    change = np.diff(np.concatenate([[False], rows, [False]]).astype(int))
    begins = np.flatnonzero(change == 1)
    ends = np.flatnonzero(change == -1) - 1
    stretches = []
    options = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        stretch = _row_in_words(parsed, begin)
        if end > begin:
            stretch += f" to {_row_in_words(parsed, end)}"
        stretches.append(stretch)
        low = (t[begin] + t[max(begin - 1, 0)]) / 2
        high = (t[end] + t[min(end + 1, len(t) - 1)]) / 2
        options.append(Option("exclude", f"{low:.6g}:{high:.6g}"))
    more = len(stretches) - _MOST_NAMED
    if more > 0:
        remedies = [Remedy("leaves-the-rows-out", Option("exclude", "A:B"))]
    elif len(stretches) == 1:
        remedies = [Remedy("leaves-the-rows-out", options[0])]
    else:
        remedies = [
            Remedy("leaves-out", option, {"rows": stretch})
            for stretch, option in zip(stretches, options, strict=True)
        ]
    return Finding.note(
        "angles-off-course",
        *remedies,
        count=int(rows.sum()),
        places=stretches[:_MOST_NAMED],
        more=more if more > 0 else None,
    )


def _row_in_words(parsed: ParsedFile, row: int) -> str:
    """The line of a row in the file, or its number where it has none."""
    place = parsed.place(row)
    if place["line"] is not None:
        return f"line {place['line']}"
    return f"row {place['row']}"


def add_angle_of_quaternion(parsed: ParsedFile, columns: dict[str, Floats]) -> None:
    """Put phi, in (-pi, pi], in place of the parts of a rotation quaternion.

    A turn by phi about the vertical axis multiplies the quaternion by cos(phi/2) +
    k sin(phi/2), which turns its scalar and vertical parts by phi/2 in their plane,
    whatever the attitude of the body's own axes: with s and v these, phi is twice
    atan2(v, s), up to a constant, and q and -q give the same.
    """
    scalar = columns.pop("quaternion_scalar")
    vertical = columns.pop("quaternion_vertical")
    columns["phi"] = np.arctan2(2 * scalar * vertical, scalar**2 - vertical**2)
    parsed.notes.append(Finding.note("angle-of-quaternion"))


def add_angle_of_mark(
    parsed: ParsedFile, columns: dict[str, Floats], mark: tuple[Floats, Floats]
) -> None:
    """Add phi and sigma_phi from the direction from the stone's position to the mark.

    With d = (x_mark - x, y_mark - y), phi = atan2(d_y, d_x), unwrapped. To first order
    the error of phi is the noise of d across its direction, divided by |d|. With given
    sigmas, the same for mark and stone, var(phi) = 2 (sigma_x^2 sin^2 phi + sigma_y^2
    cos^2 phi) / |d|^2. Without them, the noise across d is taken to equal that along d,
    where the true length is constant: sigma_phi is the scatter of |d| from row to row,
    divided by its median.

    Parameters
    ----------
    columns : with x and y in m and curlfit's axes, shape (n,); phi and
        sigma_phi are added.
    mark : x and y of the mark, likewise.

    Raises
    ------
    DataError : there is an angle already, the mark is not on the stone, or it turns too
        fast for the rows.
    """
    if "phi" in columns:
        raise parsed.error(
            "an angle and a second mark are both given; leave one of them out",
            quantity="phi",
        )
    x_mark, y_mark = mark
    dx = x_mark - columns["x"]
    dy = y_mark - columns["y"]
    length = np.hypot(dx, dy)
    measured = length[np.isfinite(length)]
    if len(measured) < 2:
        raise parsed.error(
            "stone and mark are never seen together; expected both in many rows"
        )
    typical = float(np.median(measured))
    if not 0 < typical < _FARTHEST:
        other_unit = _unit_of_mark(parsed, columns, typical)
        if other_unit is not None:
            raise parsed.error(
                f"the path is {_length(columns):.3g} m long and the mark {typical:.3g} "
                f"m from the stone, and a sheet has {LENGTH:.3g} m; give the unit of "
                f"lengths, as in {other_unit}",
                options=(other_unit,),
            )
        raise parsed.error(
            f"the mark is {typical:.3g} m from the stone, and a stone's diameter is "
            f"0.29 m; expected a point of the same stone ({_HANDLE})",
            options=(_HANDLE,),
        )
    phi = np.arctan2(dy, dx)
    columns["phi"] = phi
    unwrap_angle(parsed, columns)
    noise = float(scatter(measured))
    if {"sigma_x", "sigma_y"} <= columns.keys():
        across = columns["sigma_x"] ** 2 * np.sin(phi) ** 2
        across += columns["sigma_y"] ** 2 * np.cos(phi) ** 2
        columns["sigma_phi"] = np.sqrt(2 * across) / typical
        note = Finding.note(
            "angle-of-mark-with-sigma",
            millimetres=1000 * typical,
            sigma=float(np.nanmedian(columns["sigma_phi"])),
        )
    elif noise > 0:
        columns["sigma_phi"] = np.full(len(phi), noise / typical)
        note = Finding.note(
            "angle-of-mark-and-scatter",
            millimetres=1000 * typical,
            sigma=noise / typical,
            scatter=1000 * noise,
        )
    else:
        note = Finding.note("angle-of-mark", millimetres=1000 * typical)
    parsed.notes.append(note)


def _length(columns: dict[str, Floats]) -> float:
    """Extent of the positions in m."""
    complete = np.isfinite(columns["x"]) & np.isfinite(columns["y"])
    x = columns["x"][complete]
    y = columns["y"][complete]
    return float(np.hypot(np.ptp(x), np.ptp(y)))


def _unit_of_mark(
    parsed: ParsedFile, columns: dict[str, Floats], typical: float
) -> Option | None:
    """The unit of lengths in which a path too long for a sheet fits on it, and the mark
    is about as far from the stone as a handle's end; None if there is none, or if the
    path is short enough.

    Parameters
    ----------
    typical : distance of the mark from the stone in m.
    """
    length = _length(columns)
    factor_as_read = next(
        (
            series.column.factor
            for series in parsed.series
            if series.column.quantity in ("x", "y")
        ),
        None,
    )
    if not typical or length <= LENGTH or factor_as_read is None:
        return None
    nearest = math.inf
    best_unit = None
    for unit in _LENGTHS:
        factor = in_unit("x", unit).factor / factor_as_read
        off = abs(math.log(typical * factor / _HANDLE_ARM))
        if factor * length <= LENGTH and off < nearest:
            nearest = off
            best_unit = unit
    return None if best_unit is None else Option("units", f"length={best_unit}")


class _Jump(NamedTuple):
    """A jump of an angle by 360 or 180 degrees: the row after it, and its size."""

    row: int
    degrees: int


def _jump_in_degrees(t: Floats, angle: Floats) -> _Jump | None:
    """The first jump of an angle, if its numbers look like degrees within one turn, or
    within half a turn; None if they do not."""
    if not np.fmax.reduce(angle) - np.fmin.reduce(angle) > 90:
        return None
    measured = np.flatnonzero(np.isfinite(angle))
    radians = np.radians(angle[measured])
    period, wrapped = period_of(t[measured], radians)
    if not wrapped:
        return None
    large = np.abs(np.diff(radians)) > 0.5 * period
    row = int(measured[np.argmax(large) + 1])
    return _Jump(row, round(math.degrees(period)))


def _turning_rate(t: Floats, phi: Floats) -> float:
    """Turning rate in rad/s that one in four tenths of the rows exceeds: a tenth
    averages out the noise, and single bad values do not count."""
    finite = np.flatnonzero(np.isfinite(phi))
    tenths = finite[:: max(1, len(finite) // 10)]
    if len(tenths) < 2:
        return 0.0
    rates = np.sort(np.abs(np.diff(phi[tenths]) / np.diff(t[tenths])))
    return float(np.interp(0.75, np.linspace(0, 1, len(rates)), rates))
