"""Angles of a stone: their unit, their jumps, and their measurement by a
second mark."""

from __future__ import annotations

import math

import numpy as np

from curlfit.foreign import counted
from curlfit.numerics.arrays import Floats
from curlfit.throws.channels import scatter
from curlfit.throws.readers.columns import parse_header
from curlfit.throws.readers.parsed_file import ParsedFile

_TURN = 2 * math.pi
MAX_SPIN = 2 * _TURN
"""rad/s; a thrown stone makes two to four turns, at about 1 rad/s or 60 degrees/s."""
_FARTHEST = 0.3  # m, of a mark; the stone's diameter is 0.29 m


def require_radians(parsed: ParsedFile, columns: dict[str, Floats]) -> None:
    """Refuse an angle or a spin whose numbers cannot be radians.

    They cannot be if they jump by 360 or 180, and are unlikely to be if the stone would
    turn more than twice a second; columns named `phi` and `omega` then are rad and
    rad/s, with a note.
    """
    for header, (quantity, unit, factor, stated), _ in parsed.series:
        if quantity not in ("phi", "omega"):
            continue
        values = columns[quantity]
        flag, other = ("angle", "deg") if quantity == "phi" else ("spin", "deg/s")
        remedy = f"--units {flag}={other} if so, {flag}=rad{other[3:]} if not"
        jump = jump_in_degrees(values) if quantity == "phi" else None
        if stated:
            named = parse_header(header)
            if jump is not None and factor == 1 and named is not None and named.stated:
                fault = (
                    f"the header says {unit}, and the numbers jump by "
                    f"{jump[1]} as degrees do; "
                )
                raise parsed.error(
                    f"{fault}give `--units angle=deg`", jump[0], quantity
                )
            continue
        if jump is not None:
            fault = (
                f"no unit is given, and the numbers jump by {jump[1]} as "
                "degrees do; give "
            )
            raise parsed.error(fault + remedy, jump[0], quantity)
        rate = (
            turning_rate(columns["t"], values)
            if flag == "angle"
            else float(np.nanquantile(np.abs(values), 0.9))
        )
        if rate <= MAX_SPIN:
            continue
        fault = (
            f"no unit is given, and {rate:.3g} rad/s would be more than two turns a "
            f"second; these may be degrees: give {remedy}"
        )
        if header.strip().lower() != quantity:
            raise parsed.error(fault, quantity=quantity)
        parsed.notes.append(f"{quantity}: {fault}")


def unwrap_angle(parsed: ParsedFile, columns: dict[str, Floats]) -> str:
    """Undo the jumps of the angle; says how many. Raises `DataError` where their
    sense is unclear."""
    try:
        columns["phi"], jumps, period = unwrap(
            columns["t"], columns["phi"], columns.get("omega")
        )
    except AmbiguousTurnError as error:
        raise parsed.error(
            "the angle is wrapped and the stone turns so far from row to row that the "
            "sense is ambiguous; expected rows closer in time, an unwrapped angle, "
            "or a column of the spin",
            error.args[0],
            "phi",
        ) from None
    size = "360" if period > 4 else "180"
    return f"phi: {counted(jumps, 'jump')} of {size} degrees removed" if jumps else ""


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
    dx, dy = mark[0] - columns["x"], mark[1] - columns["y"]
    length = np.hypot(dx, dy)
    seen = np.isfinite(length)
    if seen.sum() < 2:
        raise parsed.error(
            "stone and mark are never seen together; expected both in many rows"
        )
    typical = float(np.median(length[seen]))
    if not 0 < typical < _FARTHEST:
        raise parsed.error(
            f"the mark is {typical:.3g} m from the stone, and a stone's diameter is "
            "0.29 m; expected a point of the same stone (--handle N)"
        )
    columns["phi"] = phi = np.arctan2(dy, dx)
    unwrap_angle(parsed, columns)
    note = (
        f"phi is the direction of the mark, {1000 * typical:.3g} mm from the "
        "stone's position"
    )
    if {"sigma_x", "sigma_y"} <= columns.keys():
        across = columns["sigma_x"] ** 2 * np.sin(phi) ** 2
        across += columns["sigma_y"] ** 2 * np.cos(phi) ** 2
        columns["sigma_phi"] = np.sqrt(2 * across) / typical
        how = "from sigma_x and sigma_y"
    elif (noise := float(scatter(length[seen]))) > 0:
        columns["sigma_phi"] = np.full(len(phi), noise / typical)
        how = f"from the scatter of that length, {1000 * noise:.2g} mm"
    if "sigma_phi" in columns:
        note += (
            f"; its sigma, {float(np.nanmedian(columns['sigma_phi'])):.2g} rad, {how}"
        )
    parsed.notes.append(note)


class AmbiguousTurnError(Exception):
    """About half a period between two rows, of ambiguous sense; its argument is
    the later row."""


def unwrap(
    t: Floats, phi: Floats, omega: Floats | None = None
) -> tuple[Floats, int, float]:
    """The angle without its jumps, and their number and size.

    An angle that stays within one turn (or half a turn, the direction of a line) and
    jumps against its trend was reduced modulo that period. A measured spin determines
    the rotation between two rows; without one, the rotation from row to row must be
    well below half a period, and gaps are bridged at the neighbouring rate. In an angle
    that exceeds one turn, single jumps by whole turns are removed.

    Parameters
    ----------
    t : times in s, increasing. phi : angle in rad, NaN where not measured.
    omega : spin in rad/s with the same sign convention, NaN where not measured.

    Raises
    ------
    AmbiguousTurnError : the stone turns too fast for the rows.
    """
    finite = np.flatnonzero(np.isfinite(phi))
    if len(finite) < 3:
        return phi, 0, _TURN
    time, angle = t[finite], phi[finite]
    step, dt = np.diff(angle), np.diff(time)
    expected = None if omega is None else _integrated_spin(t, omega, time)
    period, wrapped = _period(angle, step)
    if expected is not None:
        true = step - period * np.round((step - expected) / period)
        if np.median(np.abs(true - expected)) > 0.25 * period:
            expected = None  # the spin has another sign or clock
    if expected is None:
        if wrapped:
            true = _unwrap_by_rate(time, step, dt, period, finite)
        else:
            period, true = _TURN, _remove_jumps(step, dt)
    jumps = int((np.abs(true - step) > period / 2).sum())
    if not jumps:
        return phi, 0, period
    result = phi.copy()
    result[finite] = angle[0] + np.concatenate([[0.0], np.cumsum(true)])
    return result, jumps, period


def jump_in_degrees(angle: Floats) -> tuple[int, int] | None:
    """Row and size (360 or 180) of the first jump of an apparently wrapped
    angle in degrees.

    None if the values do not look like one.
    """
    if not np.fmax.reduce(angle) - np.fmin.reduce(angle) > 90:
        return None
    finite = np.flatnonzero(np.isfinite(angle))
    degrees = np.radians(angle[finite])
    step = np.diff(degrees)
    period, reduced = _period(degrees, step)
    if not reduced:
        return None
    row = int(finite[np.argmax(np.abs(step) > 0.5 * period) + 1])
    return row, round(math.degrees(period))


def turning_rate(t: Floats, phi: Floats) -> float:
    """Largest turning rate in rad/s over a tenth of the rows, which averages
    out the noise."""
    finite = np.flatnonzero(np.isfinite(phi))
    some = finite[:: max(1, len(finite) // 10)]
    return float(np.abs(np.diff(phi[some]) / np.diff(t[some])).max(initial=0.0))


def _period(angle: Floats, step: Floats) -> tuple[float, bool]:
    """The period of an angle, and whether it is wrapped."""
    span = float(np.ptp(angle))
    for period in (_TURN / 2, _TURN):
        large = np.abs(step) > 0.5 * period
        if not large.any() or not 0.7 * period < span <= 1.02 * period:
            continue
        if not ((step > 0).any() and (step < 0).any()):
            continue  # monotonic
        if period < _TURN:
            typical = float(np.median(np.abs(step)))
            if (np.abs(np.abs(step[large]) - period) > 0.15 * period + typical).any():
                continue
        return period, True
    return _TURN, False


def _integrated_spin(t: Floats, omega: Floats, time: Floats) -> Floats | None:
    """Rotation between the times, from the spin; None if it is not known throughout."""
    known = np.isfinite(omega)
    if (
        known.sum() < 2
        or t[known][0] > time[0] + 1e-9
        or t[known][-1] < time[-1] - 1e-9
    ):
        return None
    at, rate = t[known], omega[known]
    turned = np.concatenate(
        [[0.0], np.cumsum(np.diff(at) * (rate[1:] + rate[:-1]) / 2)]
    )
    return np.diff(np.interp(time, at, turned))


def _unwrap_by_rate(
    time: Floats, step: Floats, dt: Floats, period: float, finite: np.ndarray
) -> Floats:
    near = step - period * np.round(step / period)
    usual = dt <= 1.5 * np.median(dt)
    fast = usual & (np.abs(near) > 0.4 * period)
    if fast.any():
        raise AmbiguousTurnError(int(finite[np.argmax(fast) + 1]))
    if usual.all():
        return near
    from scipy.ndimage import uniform_filter1d

    rates = uniform_filter1d(near[usual] / dt[usual], 9, mode="nearest")
    middle = (time[1:] + time[:-1]) / 2
    expected = np.interp(middle, middle[usual], rates) * dt
    far = ~usual & (np.abs(expected) * 0.25 > 0.4 * period)
    if far.any():
        raise AmbiguousTurnError(int(finite[np.argmax(far) + 1]))
    bridged = step - period * np.round((step - expected) / period)
    return np.where(usual, near, bridged)


def _remove_jumps(step: Floats, dt: Floats) -> Floats:
    """Steps of an unwrapped angle, with single ones corrected that are off by
    whole turns."""
    if len(step) < 5:
        return step
    rate = step / dt
    if np.ptp(rate) * dt.max() < _TURN / 2:
        return step
    padded = np.pad(rate, 2, "edge")
    pace = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    off = step - pace * dt
    turns = np.round(off / _TURN)
    odd = np.abs(off) > 0.1 * _TURN
    clear = (turns != 0) & (np.abs(off - turns * _TURN) < 0.15 * _TURN)
    if odd.sum() > 0.2 * len(step) or not clear.any():
        return step
    return np.where(clear, step - turns * _TURN, step)
