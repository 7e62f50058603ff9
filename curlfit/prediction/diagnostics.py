"""Diagnostics of a prediction: extrapolation, null directions, discrepancy,
held-out rows."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.findings import Finding
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
_EXTRAPOLATION = 1.02  # factor beyond the fitted speed or spin that gives a warning
_SHORTEST_END = 0.01  # m below the fitted speeds, up to which no warning is given
# Rows of the fitted throw differ from those fitted by less than a number of times the
# rms of its residuals plus a part of its range.
_SAME_BY_RMS = 10.0
_SAME_BY_RANGE = 0.05
_UNSEEN = 1e-5  # m; no camera sees smaller effects
_RELEVANT = 1e-3  # m and rad; smaller effects of null directions at rest are negligible


def findings_of(
    throw: PlannedThrow, simulation: Simulation, *, line_assumed: bool
) -> list[Finding]:
    """What a user should know of a prediction; `line_assumed` is where the user does
    not say on which line the throw starts."""
    findings = [
        *_extrapolation_findings(throw.fit, simulation, throw.new),
        *_null_direction_findings(throw.fit, simulation),
        *_discrepancy_findings(simulation.discrepancy),
        *curl_warnings([throw.fit]),
        *_side_findings(simulation),
    ]
    if line_assumed and throw.line == "hog" and not throw.new:
        findings.append(Finding.note("start-assumed"))
    if throw.new and simulation.discrepancy is not None:
        findings.append(Finding.note("ice-of-one-throw"))
    return findings


def _extrapolation_findings(
    fit: FitResult, simulation: Simulation, new: bool
) -> Iterator[Finding]:
    """Warnings where the throw leaves the fitted range of speed or, if it is a `new`
    one, of spin."""
    fitted_speed = fit.fitted["speed"]
    fitted_omega = fit.fitted["omega"]
    speed = simulation.best.speed[0]
    omega = simulation.best.state[0, 5, 0]
    y = simulation.best.state[0, 1]
    slowest = float(fitted_speed.min())
    yield from _beyond("speed", "m/s", speed[0], 0.0, fitted_speed.max())
    if new:
        spin = np.abs(fitted_omega)
        yield from _beyond("spin", "rad/s", abs(omega), spin.min(), spin.max())
    slow = np.flatnonzero(speed < slowest / _EXTRAPOLATION)
    distance = float(y[-1] - y[slow[0]]) if len(slow) else 0.0
    if distance > _SHORTEST_END:
        yield Finding.warning(
            "end-below-fitted-range", distance=distance, speed=slowest
        )
    if new and (omega * fitted_omega < 0).all():
        yield Finding.warning("opposite-turn")


def _beyond(
    quantity: str, unit: str, value: float, lowest: float, highest: float
) -> Iterator[Finding]:
    """A warning if an initial value is outside the fitted range."""
    if value > _EXTRAPOLATION * highest:
        code = "above-fitted-range"
        limit = highest
    elif 0 < value < lowest / _EXTRAPOLATION:
        code = "below-fitted-range"
        limit = lowest
    else:
        return
    yield Finding.warning(
        code, quantity=quantity, value=float(value), unit=unit, limit=float(limit)
    )


def _null_direction_findings(
    fit: FitResult, simulation: Simulation
) -> Iterator[Finding]:
    """Warnings about null directions of the fit that affect the throw, and notes
    on the others."""
    if fit.ridge:  # the values that fit lie on a curve, along which draws are made
        yield Finding.note("bands-along-curve")
        return
    directions = fit.identifiability.null_directions
    for direction, ends in zip(directions, simulation.null_ends, strict=True):
        numbers: dict[str, Any] = {"names": [*direction], "count": len(direction)}
        if not ends.comes_to_rest.all():
            yield Finding.warning("null-without-rest", **numbers)
            continue
        # x, y and phi at rest, of both ends
        change = ends.end - simulation.best.end
        moved = float(np.hypot(change[:, 0], change[:, 1]).max())
        turned = float(np.abs(change[:, 2]).max())
        numbers |= {"moved": moved, "turned": turned}
        if moved < _UNSEEN and turned < _RELEVANT:
            yield Finding.note("null-without-effect", **numbers)
        elif max(moved, turned) < _RELEVANT:
            millimetres = 1000 * moved
            yield Finding.note(
                "null-hardly-moves-rest", **numbers, millimetres=millimetres
            )
        else:
            yield Finding.warning("null-moves-rest", **numbers)


def _discrepancy_findings(discrepancy: Discrepancy | None) -> Iterator[Finding]:
    """Warnings and notes on the model discrepancy; None is that of a joint fit."""
    if discrepancy is None:
        yield Finding.note("bands-between-throws")
        return
    if not discrepancy.estimated:
        sizes = _sizes(discrepancy, COMPONENT_LABELS)
        yield Finding.warning("discrepancy-by-prior", sizes=sizes)
        return
    detected = {
        name for name, excess in discrepancy.excess.items() if excess > DETECTION
    }
    undetected = COMPONENT_LABELS.keys() - detected
    if detected:
        sizes = _sizes(discrepancy, detected)
        yield Finding.warning("missing-acceleration", sizes=sizes)
    if undetected:
        yield Finding.note(
            "undetected-acceleration",
            sizes=_sizes(discrepancy, undetected),
            friction=float(discrepancy.friction),
        )


def _sizes(
    discrepancy: Discrepancy, components: Collection[str]
) -> list[dict[str, Any]]:
    """Sizes of missing accelerations, of some of their components."""
    return [
        {
            "size": float(discrepancy.sizes[name]),
            "unit": "rad/s^2" if name == "turning" else "m/s^2",
            "component": label,
        }
        for name, label in COMPONENT_LABELS.items()
        if name in components
    ]


def _side_findings(simulation: Simulation) -> Iterator[Finding]:
    """A warning where the stone leaves the sheet."""
    x = simulation.best.state[0, 0]
    y = simulation.best.state[0, 1]
    outside = np.flatnonzero(np.abs(x) + STONE_RADIUS > WIDTH / 2)
    if not len(outside):
        return
    first = float(y[outside[0]])
    yield Finding.warning(
        "touches-side",
        width=WIDTH,
        distance=abs(first - TEE),
        where="before" if first < TEE else "beyond",
    )


def compare_held_out(
    throw: Throw,
    planned: PlannedThrow,
    simulation: Simulation,
    random: np.random.Generator,
) -> HeldOut:
    """Comparison of the prediction with measured rows after the fitted ones."""
    fit = planned.fit
    last = fit.data.end
    _require_same_throw(throw, fit)
    later = np.flatnonzero(throw.t > last)
    if not len(later):
        raise InputError(
            f"{throw.name}: no rows after t = {last:g} s, the last one fitted; "
            "fit with a smaller --until"
        )
    later = later[:: len(later) // MOST_ROWS + 1]
    t = throw.t[later] - fit.data.begin
    best = simulation.best.positions_at(t)[0]
    draws = simulation.full.positions_at(t)
    # from the coordinates of the data to those of the sheet
    shifts = (*planned.shift, 0.0)
    observed = {"t": t}
    channels = {}
    for row, name in enumerate(PREDICTED):
        values = getattr(throw, name)[later] + shifts[row]
        observed[name] = values
        measured = np.isfinite(values)
        if not measured.any():
            continue
        noise = _noise(throw, fit, simulation.discrepancy, name)[later]
        predicted = draws[:, row]
        noisy = predicted + noise * random.standard_normal(predicted.shape)
        low95, low68, high68, high95 = np.quantile(
            noisy, [0.025, 0.16, 0.84, 0.975], axis=0
        )
        error = (values - best[row])[measured]
        inside_68 = (values >= low68) & (values <= high68)
        inside_95 = (values >= low95) & (values <= high95)
        last_row = np.flatnonzero(measured)[-1]
        numbers = {
            "rows": measured.sum(),
            "rms": np.sqrt(np.mean(error**2)),
            "inside_68": inside_68[measured].mean(),
            "inside_95": inside_95[measured].mean(),
            "end": error[-1],
            "end_sd": noisy[:, last_row].std(),
        }
        channels[name] = {key: float(value) for key, value in numbers.items()}
    if not channels:
        raise InputError(f"{throw.name}: no x, y or phi after t = {last:g} s")
    begin = float(throw.t[later[0]])
    end = float(throw.t[later[-1]])
    return HeldOut(throw.name, begin, end, channels, observed)


def _noise(
    throw: Throw, fit: FitResult, discrepancy: Discrepancy | None, name: str
) -> Floats:
    """Standard deviation of the noise of a channel in each row."""
    if name in throw.sigma:
        return throw.sigma[name]
    course = throw.relative_sigma.get(name)
    if course is not None and f"sigma_{name}" in fit.observed:
        fitted = np.interp(fit.observed["t"], throw.t, course)
        return course * np.nanmedian(fit.observed[f"sigma_{name}"] / fitted)
    sigma = fit.sigma.get(name, 0.0)
    if discrepancy is not None:
        sigma = discrepancy.noise.get(name, sigma)
    return np.full(len(throw.t), sigma)


def _require_same_throw(throw: Throw, fit: FitResult) -> None:
    """Raise `InputError` if a throw does not contain the fitted rows."""
    for name in PREDICTED:
        if name not in fit.rms:
            continue
        measured = np.interp(fit.observed["t"], throw.t, getattr(throw, name))
        error = np.abs(measured - fit.observed[name])
        extent = float(np.ptp(fit.fitted[name]))
        largest = _SAME_BY_RMS * fit.rms[name] + _SAME_BY_RANGE * extent
        if not np.isfinite(error).any() or np.nanmedian(error) > largest:
            raise InputError(
                f"{throw.name}: not the throw that was fitted ({fit.data.file}): "
                f"{name} differs before t = {fit.data.end:g} s"
            )
