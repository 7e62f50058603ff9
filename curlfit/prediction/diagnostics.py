"""Diagnostics of a prediction: extrapolation, null directions, discrepancy,
held-out rows."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.fit.advice import curl_warnings
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Floats
from curlfit.prediction.request import PlannedThrow
from curlfit.prediction.result import (
    COMPONENT_LABELS,
    DETECTION,
    PREDICTED,
    Discrepancy,
    HeldOut,
)
from curlfit.prediction.simulation import Simulation
from curlfit.sheet import STONE_RADIUS, TEE, WIDTH
from curlfit.throws.throw import Throw

MOST_ROWS = 2000
"""Measured rows that a prediction contains, at most."""
# of the fitted range of speed or spin, beyond which a warning is given
_EXTRAPOLATION = 1.02
_RELEVANT = 1e-3  # m and rad; smaller effects of null directions at rest are negligible


def remarks(
    throw: PlannedThrow, found: Simulation, anywhere: bool
) -> tuple[list[str], list[str]]:
    """Warnings and notes; `anywhere` is where neither user nor data say where the
    throw starts."""
    fit, new = throw.fit, throw.new
    null_warnings, null_notes = _null_direction_effects(fit, found)
    law_warnings, law_notes = _discrepancy_remarks(found.discrepancy)
    notes = {
        "the data do not state where on the sheet y = 0 lies; the throw is "
        "assumed to start on the near hog line, which affects the resting position "
        "but not the motion": anywhere and throw.line == "hog" and not new,
        "the variation of the ice from throw to throw cannot be estimated "
        "from a single throw": new and found.discrepancy is not None,
    }
    return [
        *_extrapolation(fit, found, new),
        *null_warnings,
        *law_warnings,
        *curl_warnings([fit]),
        *_off_the_sheet(found),
    ], [*null_notes, *law_notes, *(note for note, holds in notes.items() if holds)]


def _extrapolation(fit: FitResult, found: Simulation, new: bool) -> list[str]:
    """Warnings where the throw leaves the fitted range of speed or spin."""
    seen, spins = fit.fitted["speed"], np.abs(fit.fitted["omega"])
    speed, omega, y = (
        found.best.speed[0],
        found.best.state[0, 5, 0],
        found.best.state[0, 1],
    )
    warnings = []
    for name, unit, first, lowest, highest in (
        ("speed", "m/s", speed[0], 0.0, seen.max()),
        ("spin", "rad/s", abs(omega) * new, spins.min(), spins.max()),
    ):
        above, below = (
            first > _EXTRAPOLATION * highest,
            0 < first < lowest / _EXTRAPOLATION,
        )
        if above or below:
            side = "above" if above else "below"
            end = f"up to {highest:.3g}" if above else f"from {lowest:.3g}"
            warnings.append(
                f"the initial {name} of {first:.3g} {unit} is {side} the fitted "
                f"range, {end} {unit}: an extrapolation"
            )
    slow = np.flatnonzero(speed < seen.min() / _EXTRAPOLATION)
    distance = float(y[-1] - y[slow[0]]) if len(slow) else 0.0
    if distance > 0.01:
        warnings.append(
            f"the last {distance:.2g} m, below {seen.min():.2g} m/s, "
            "are slower than the fitted range: an extrapolation"
        )
    if new and (omega * fit.fitted["omega"] < 0).all():
        warnings.append(
            "it turns the opposite way to what was fitted: mirror symmetry of "
            "the ice is assumed"
        )
    return warnings


def _null_direction_effects(
    fit: FitResult, found: Simulation
) -> tuple[list[str], list[str]]:
    """Warnings about null directions of the fit that affect the throw, and notes
    on the others; of a curve of values that fit, along which the bands are drawn, where
    they lead says nothing."""
    if fit.ridge:
        return [], [
            "the bands are drawn along the values that fit, which lie on a curve"
        ]
    warnings: list[str] = []
    notes: list[str] = []
    for index, direction in enumerate(fit.null_directions):
        ends = found.probed[f"null {index}"]
        names = " and ".join(direction) if len(direction) < 3 else ", ".join(direction)
        what = f"{names} {'is' if len(direction) == 1 else 'are'} not determined"
        what += " individually" if len(direction) > 1 else ""
        if not ends.good.all():
            warnings.append(
                f"{what}; at the ends of the allowed range the stone does "
                "not come to rest"
            )
            continue
        off = ends.end - found.best.end
        moved, turned = np.hypot(off[:, 0], off[:, 1]).max(), np.abs(off[:, 2]).max()
        if max(moved, turned) < _RELEVANT:
            size = "less than 0.01 mm" if moved < 1e-5 else f"{1000 * moved:.2g} mm"
            notes.append(
                f"{what}, which has no effect here: over the allowed range the resting "
                f"position moves by {size}"
            )
        else:
            warnings.append(
                f"{what}, which affects this throw: the resting position may "
                f"change by {moved:.2g} m and the final angle by {turned:.2g} rad; "
                "the bands include this, uniformly over the allowed range"
            )
    return warnings, notes


def _discrepancy_remarks(
    discrepancy: Discrepancy | None,
) -> tuple[list[str], list[str]]:
    """Warnings and notes on the model discrepancy, without one of a joint fit."""
    if discrepancy is None:
        return [], [
            "the bands contain the spread between the throws of the joint fit, "
            "and with it what the law lacks at the speeds and spins of these"
        ]
    found = {name for name, excess in discrepancy.excess.items() if excess > DETECTION}

    def listing(shown: Collection[str]) -> str:
        return ", ".join(
            f"{discrepancy.sizes[name]:.2g} {'rad' if name == 'turning' else 'm'}/s^2 "
            f"{label}"
            for name, label in COMPONENT_LABELS.items()
            if name in shown
        )

    if not discrepancy.estimated:
        return [
            "too few rows were fitted to estimate the model discrepancy; "
            f"the bands use its prior alone: {listing(COMPONENT_LABELS)}"
        ], []
    warnings = [
        "the law does not describe the fitted rows: the residuals show a "
        f"missing acceleration of about {listing(found)}. The bands include it, "
        "to the side of the path of the law that the residuals indicate; "
        "beyond the fitted speeds and spins the error of the law may be larger"
    ]
    notes = [
        "the bands include accelerations too small to be detected in the fitted rows, "
        f"about {listing(COMPONENT_LABELS.keys() - found)}; the prior is truncated at "
        f"what friction does to this throw (mu = {discrepancy.friction:.2g})"
    ]
    return warnings[: len(found)], notes[: len(COMPONENT_LABELS) - len(found)]


def _off_the_sheet(found: Simulation) -> list[str]:
    """A warning where the stone leaves the sheet."""
    x, y = found.best.state[0, :2]
    outside = np.flatnonzero(np.abs(x) + STONE_RADIUS > WIDTH / 2)
    return [
        f"it touches the side of a {WIDTH:g} m wide sheet {abs(y[first] - TEE):.3g} m "
        f"{'before' if y[first] < TEE else 'beyond'} the tee, and would be removed"
        for first in outside[:1]
    ]


def compare_held_out(
    throw: Throw, begun: PlannedThrow, found: Simulation, random: np.random.Generator
) -> HeldOut:
    """Comparison of the prediction with measured rows after the fitted ones."""
    fit, last = begun.fit, begun.fit.data["to"]
    _require_same_throw(throw, fit)
    later = np.flatnonzero(throw.t > last)
    if not len(later):
        raise InputError(
            f"{throw.name}: no rows after t = {last:g} s, the last one fitted; "
            "fit with a smaller --until"
        )
    later = later[:: len(later) // MOST_ROWS + 1]
    observed = {"t": throw.t[later] - fit.data["from"]}
    predicted = found.full.positions_at(observed["t"]).swapaxes(0, 1)
    best = found.best.positions_at(observed["t"])[0]
    channels = {}
    for row, (name, shift) in enumerate(
        zip(PREDICTED, (*begun.shift, 0.0), strict=True)
    ):
        values = observed[name] = getattr(throw, name)[later] + shift
        seen = np.isfinite(values)
        if not seen.any():
            continue
        noise = _noise(throw, fit, found.discrepancy, name)[later]
        noisy = predicted[row] + noise * random.standard_normal(predicted[row].shape)
        low95, low68, high68, high95 = np.quantile(
            noisy, [0.025, 0.16, 0.84, 0.975], axis=0
        )
        off = (values - best[row])[seen]
        numbers = {
            "rows": seen.sum(),
            "rms": np.sqrt(np.mean(off**2)),
            "inside_68": ((values >= low68) & (values <= high68))[seen].mean(),
            "inside_95": ((values >= low95) & (values <= high95))[seen].mean(),
            "end": off[-1],
            "end_sd": noisy[:, np.flatnonzero(seen)[-1]].std(),
        }
        channels[name] = {key: float(value) for key, value in numbers.items()}
    if not channels:
        raise InputError(f"{throw.name}: no x, y or phi after t = {last:g} s")
    first, last = map(float, throw.t[later[[0, -1]]])
    return HeldOut(throw.name, first, last, channels, observed)


def _noise(
    throw: Throw, fit: FitResult, discrepancy: Discrepancy | None, name: str
) -> Floats:
    """Standard deviation of the noise of a channel in each row."""
    if (given := throw.sigma.get(name)) is not None:
        return given
    course = throw.relative_sigma.get(name)
    if course is not None and f"sigma_{name}" in fit.observed:
        fitted = np.interp(fit.observed["t"], throw.t, course)
        return course * np.nanmedian(fit.observed[f"sigma_{name}"] / fitted)
    known = fit.sigma | ({} if discrepancy is None else discrepancy.noise)
    return np.full(len(throw.t), known.get(name, 0.0))


def _require_same_throw(throw: Throw, fit: FitResult) -> None:
    """Raise `InputError` if a throw does not contain the fitted rows."""
    for name in (one for one in PREDICTED if one in fit.rms):
        own = np.interp(fit.observed["t"], throw.t, getattr(throw, name))
        off = np.abs(own - fit.observed[name])
        size = 10 * fit.rms[name] + 0.05 * float(np.ptp(fit.fitted[name]))
        if not np.isfinite(off).any() or np.nanmedian(off) > size:
            raise InputError(
                f"{throw.name}: not the throw that was fitted ({fit.data['file']}): "
                f"{name} differs before t = {fit.data['to']:g} s"
            )
