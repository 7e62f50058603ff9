"""Diagnostics of a prediction: extrapolation, null directions, discrepancy, held-out rows."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import cast

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import InputError
from curlfit.inference.fit.result import FitResult
from curlfit.prediction.ensemble import TrajectoryEnsemble
from curlfit.prediction.request import ThrowStart
from curlfit.prediction.result import COMPONENT_LABELS, DETECTION, PREDICTED, Discrepancy, HeldOut
from curlfit.sheet import STONE_RADIUS, TEE, WIDTH
from curlfit.throws.throw import Throw

_MAX_CHECKED = 2000  # measured rows that a prediction is compared with
_EXTRAPOLATION = 1.02  # of the fitted range of speed or spin, beyond which a warning is given
_RELEVANT = 1e-3  # m and rad; smaller effects of null directions at rest are negligible


def extrapolation(fit: FitResult, best: TrajectoryEnsemble, new: bool) -> list[str]:
    """Warnings where the throw leaves the fitted range of speed or spin."""
    seen_speed, seen_spin = fit.fitted["speed"], fit.fitted["omega"]
    speed = np.hypot(*best.state[0, 3:5])
    omega, y = best.state[0, 5], best.state[0, 1]
    found = []
    fastest, slowest = float(seen_speed.max()), float(seen_speed.min())
    if speed[0] > _EXTRAPOLATION * fastest:
        found.append(
            f"the initial speed of {speed[0]:.3g} m/s is above the fitted range, up to "
            f"{fastest:.3g} m/s: an extrapolation"
        )
    slow = np.flatnonzero(speed < slowest / _EXTRAPOLATION)
    distance = float(y[-1] - y[slow[0]]) if len(slow) else 0.0
    if distance > 0.01:
        found.append(
            f"the last {distance:.2g} m, below {slowest:.2g} m/s, are slower than the fitted "
            "range: an extrapolation"
        )
    spins = np.abs(seen_spin)
    if new and abs(omega[0]) > _EXTRAPOLATION * spins.max():
        found.append(
            f"the initial spin of {abs(omega[0]):.3g} rad/s is above the fitted range, up to "
            f"{spins.max():.3g} rad/s: an extrapolation"
        )
    if new and 0 < abs(omega[0]) < spins.min() / _EXTRAPOLATION:
        found.append(
            f"the initial spin of {abs(omega[0]):.3g} rad/s is below the fitted range, from "
            f"{spins.min():.3g} rad/s: an extrapolation"
        )
    if new and omega[0] * seen_spin[0] < 0:
        found.append(
            "it turns the opposite way to the fitted throw: mirror symmetry of the ice is assumed"
        )
    return found


def null_direction_effects(
    fit: FitResult, probed: dict[str, TrajectoryEnsemble], best: TrajectoryEnsemble
) -> tuple[list[str], list[str]]:
    """Warnings about null directions of the fit that affect the throw, and notes on the others."""
    warnings: list[str] = []
    notes: list[str] = []
    for index, direction in enumerate(fit.null_directions):
        ends = probed[f"null {index}"]
        names = " and ".join(direction) if len(direction) < 3 else ", ".join(direction)
        what = f"{names} {'is' if len(direction) == 1 else 'are'} not determined"
        what += " individually" if len(direction) > 1 else ""
        if not ends.good.all():
            warnings.append(
                f"{what}; at the ends of the allowed range the stone does not come to rest"
            )
            continue
        moved = float(np.hypot(*(ends.state[:, :2, -1] - best.state[0, :2, -1]).T).max())
        turned = float(np.abs(ends.state[:, 2, -1] - best.state[0, 2, -1]).max())
        if max(moved, turned) < _RELEVANT:
            size = "less than 0.01 mm" if moved < 1e-5 else f"{1000 * moved:.2g} mm"
            notes.append(
                f"{what}, which has no effect here: over the allowed range the resting "
                f"position moves by {size}"
            )
        else:
            warnings.append(
                f"{what}, which affects this throw: the resting position may change by {moved:.2g} "
                f"m and the final angle by {turned:.2g} rad; the bands include this, uniformly "
                "over the allowed range"
            )
    return warnings, notes


def discrepancy_remarks(discrepancy: Discrepancy) -> tuple[list[str], list[str]]:
    """Warnings and notes on the model discrepancy."""

    def listing(sizes: Mapping[str, float], shown: Collection[str]) -> str:
        return ", ".join(
            f"{size:.2g} {'rad' if name == 'turning' else 'm'}/s^2 {COMPONENT_LABELS[name]}"
            for name, size in sizes.items()
            if name in shown
        )

    limit = (
        "the prior is truncated at what friction does to this throw, "
        f"{listing(discrepancy.ceilings, COMPONENT_LABELS)} (mu = {discrepancy.friction:.2g}; "
        "untruncated, 5 % of it would lie above, and its mean would be a third of that)"
    )
    if not discrepancy.estimated:
        return [
            "too few rows were fitted to estimate the model discrepancy; the bands use its prior "
            f"alone: {listing(discrepancy.sizes, COMPONENT_LABELS)}"
        ], [f"the size of a missing acceleration is limited: {limit}"]
    found = [name for name, excess in discrepancy.excess.items() if excess > DETECTION]
    rest = [name for name in COMPONENT_LABELS if name not in found]
    warnings = [
        "the law does not describe the fitted rows: the residuals show a missing acceleration of "
        f"about {listing(discrepancy.sizes, found)}. The bands include it, to the side of the path "
        "of the law that the residuals indicate; beyond the fitted speeds and spins the error of "
        "the law may be larger"
    ] if found else []  # fmt: skip
    undetected = (
        "the bands include accelerations too small to be detected in the fitted rows, about "
        f"{listing(discrepancy.sizes, rest)}; "
    )
    return warnings, [
        (undetected if rest else "the size of a missing acceleration is limited: ") + limit
    ]


def off_the_sheet(best: TrajectoryEnsemble) -> list[str]:
    """A warning where the stone leaves the sheet."""
    x, y = best.state[0, :2]
    outside = np.flatnonzero(np.abs(x) + STONE_RADIUS > WIDTH / 2)
    if len(outside):
        return [
            f"it touches the side of a {WIDTH:g} m wide sheet {abs(y[outside[0]] - TEE):.3g} m "
            f"{'before' if y[outside[0]] < TEE else 'beyond'} the tee, and would be removed"
        ]
    return []


def compare_held_out(
    throw: Throw,
    fit: FitResult,
    throw_start: ThrowStart,
    discrepancy: Discrepancy,
    best: TrajectoryEnsemble,
    full: TrajectoryEnsemble,
    random: np.random.Generator,
) -> HeldOut:
    """Comparison of the prediction with measured rows after the fitted ones."""
    first, last = fit.data["from"], fit.data["to"]
    _require_same_throw(throw, fit)
    later = np.flatnonzero(throw.t > last)
    if not len(later):
        raise InputError(
            f"{throw.name}: no rows after t = {last:g} s, the last one fitted; fit with a smaller "
            "--until"
        )
    later = thin(later)
    t = throw.t[later] - first
    at, middle = full.positions_at(t), best.positions_at(t)[0]
    shift = (*throw_start.shift, 0.0)
    channels, observed = {}, {"t": t}
    for row, name in enumerate(PREDICTED):
        values = getattr(throw, name)[later] + shift[row]
        observed[name] = values
        finite = np.isfinite(values)
        if not finite.any():
            continue
        sigma = discrepancy.noise.get(name, fit.sigma.get(name, 0.0))
        given, course = throw.sigma.get(name), throw.relative_sigma.get(name)
        if given is None and course is not None and f"sigma_{name}" in fit.observed:
            fitted = np.interp(fit.observed["t"], throw.t, course)
            given = course * np.nanmedian(fit.observed[f"sigma_{name}"] / fitted)
        noise = np.full(len(later), sigma) if given is None else given[later]
        noisy = at[:, row] + noise * random.standard_normal(at[:, row].shape)
        low95, low68, high68, high95 = np.quantile(noisy, [0.025, 0.16, 0.84, 0.975], axis=0)
        off = (values - middle[row])[finite]
        end = int(np.flatnonzero(finite)[-1])
        channels[name] = {
            "rows": float(finite.sum()),
            "rms": float(np.sqrt(np.mean(off**2))),
            "inside_68": float(((values >= low68) & (values <= high68))[finite].mean()),
            "inside_95": float(((values >= low95) & (values <= high95))[finite].mean()),
            "end": float(off[-1]),
            "end_sd": float(noisy[:, end].std()),
        }
    if not channels:
        raise InputError(f"{throw.name}: no x, y or phi after t = {last:g} s")
    return HeldOut(
        throw.name, float(throw.t[later[0]]), float(throw.t[later[-1]]), channels, observed
    )


def _require_same_throw(throw: Throw, fit: FitResult) -> None:
    """Raise `InputError` if a throw does not contain the fitted rows."""
    for name in PREDICTED:
        if name not in fit.rms:
            continue
        own = np.interp(fit.observed["t"], throw.t, getattr(throw, name))
        off = np.abs(own - fit.observed[name])
        size = 10 * fit.rms[name] + 0.05 * float(np.nanmax(np.abs(np.ptp(fit.fitted[name]))))
        overlap = np.isfinite(off)
        if not overlap.any() or float(np.nanmedian(off)) > size:
            raise InputError(
                f"{throw.name}: not the throw that was fitted ({fit.data['file']}): "
                f"{name} differs before t = {fit.data['to']:g} s"
            )


def thin(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """At most `_MAX_CHECKED` of the given rows, evenly spaced."""
    indices = np.linspace(0, len(rows) - 1, min(len(rows), _MAX_CHECKED)).astype(int)
    return cast(NDArray[np.int64], rows[np.unique(indices)])
