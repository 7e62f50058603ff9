"""Prediction of a throw: the fitted one extrapolated to rest, or another one on the same ice.

Two errors are propagated separately. The error of the parameters: each draw from the posterior (the
chain or, without one, the covariance of the fit: Gaussian along determined directions, uniform
within the bounds along the others) is simulated to rest. The error of the law, the model
discrepancy (see `curlfit.prediction.discrepancy`): each draw is simulated again with missing
accelerations. Neither contains measurement noise, which is added where a prediction is compared
with measured rows.

A given initial state is taken as exact. Without one the throw is the fitted one, whose initial
state has the errors of the fit.

Positions are on the sheet: x to the right of the centre line, y from the hack that the stone is
thrown from (`curlfit.sheet`). The origin of the data is arbitrary, so the initial position is
placed on a line of the sheet, by default the near hog line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np

from curlfit.errors import InputError, UnusableFitError
from curlfit.friction import Law, no_motion_because
from curlfit.inference.derived import LEVELS, quantiles_of
from curlfit.inference.fit.advice import curl_warnings
from curlfit.inference.fit.fit import refit
from curlfit.inference.fit.prepared import prepare_linearized
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.mcmc.chain import Chain
from curlfit.inference.mcmc.ridge import ridge_proposal
from curlfit.inference.parameters import START
from curlfit.numerics.arrays import Floats
from curlfit.prediction import diagnostics
from curlfit.prediction.discrepancy import discrepancy_posterior
from curlfit.prediction.ensemble import VARIED, ThrowFamily, TrajectoryEnsemble, prepare_ensemble
from curlfit.prediction.request import ThrowRequest, ThrowStart, start_of
from curlfit.prediction.result import PREDICTED, QUANTITIES, Discrepancy, Prediction, Quantity
from curlfit.sheet import END, HOUSE, LINES, STONE_RADIUS, TEE
from curlfit.throws.throw import CHANNELS, Throw

_BAND_POINTS = 121
_SAMPLED, _SAMPLE_TIMES = 60, 30  # draws kept, and times of each
_DIGITS = 4  # decimals of these: 0.1 mm
_HEADING_CHANGE = 0.001  # for the sensitivity of the resting position, rad


def predict(
    fit: FitResult,
    chain: Chain | None = None,
    *,
    start: Mapping[str, float] | None = None,
    line: str | None = None,
    target: tuple[float, float] | None = None,
    weight: str | None = None,
    tee_speed: float | None = None,
    draws: int = 1000,
    seed: int = 0,
    check: Throw | None = None,
) -> Prediction:
    """Predict a throw, from a fit of a throw on the same ice.

    Without `start`, `target` and `weight` it is the fitted throw, extrapolated to rest. Otherwise
    it is another one: along the centre line from `line`, with the speed and spin of the fitted one
    unless these are given.

    Parameters
    ----------
    fit, chain : a converged fit and, if there is one, its posterior sample.
    start : any of x0, y0 (m on the sheet), heading (rad), v0 (m/s), phi0 (rad), omega0 (rad/s);
        taken as exact.
    line : where the throw starts: "hack", "back", "tee", "hog", "centre" or "far-hog"; "data" is
        the start of the data, whose y must then be measured from the hack. By default "hog", or
        "data" for the fitted throw if its file states that y is measured from the hack.
    target : (x, y), m to the right of the tee and beyond it, where the stone is to rest; speed and
        heading are found.
    weight : "draw", "guard" or "takeout" (see `WEIGHTS`); the speed and, unless it is given, the
        heading to the centre line are found.
    tee_speed : speed in m/s at which a takeout passes the tee.
    draws : number of draws from the posterior. seed : of the draws.
    check : the fitted throw with later rows; not with `start`, `target` or `weight`.

    Returns
    -------
    Prediction.

    Raises
    ------
    InputError : an unknown name, contradictory arguments, a target that no throw reaches, a fit
        that does not determine the spin where none is given, a `check` that is another throw or has
        no later rows.
    UnusableFitError : the fit did not converge, or its law does not bring the stone to rest.

    Examples
    --------
    >>> prediction = curlfit.predict(sampled, chain, draws=200)
    >>> round(prediction.quantities["time"].value, 1)
    24.3
    """
    require_fit(fit)
    request = ThrowRequest(dict(start or {}), line or "hog", target, weight, tee_speed)
    if line is None and not request.new and fit.counts_from_hack:
        request = request._replace(line="data")
    request.require(fit, check)
    _require_predictable(fit, draws)
    notes = []
    if "discrepancy" in fit.noise.kind:
        fit, chain = refit(fit, "white"), None
        _require_predictable(fit, draws)
        notes.append(
            "the path is that of the least-squares coefficients; the discrepancy that the fit has "
            "as noise is here in the bands"
        )
    prepare_ensemble(fit)
    prepare_linearized(fit)
    random = np.random.default_rng(seed)
    throw_start = start_of(fit, request)
    values, source = _drawn_values(fit, chain, draws, random)
    simulated = _simulated(fit, ThrowFamily(fit, throw_start, request.new), values, random)
    best, plain, full, probed, discrepancy = simulated
    quantities = _quantities(best, plain, full)
    null_warnings, null_notes = diagnostics.null_direction_effects(fit, probed, best)
    law_warnings, law_notes = diagnostics.discrepancy_remarks(discrepancy)
    warnings = [
        *diagnostics.extrapolation(fit, best, request.new),
        *null_warnings,
        *law_warnings,
        *curl_warnings([fit]),
        *diagnostics.off_the_sheet(best),
    ]
    notes += [*null_notes, *law_notes]
    if line is None and throw_start.line == "hog" and not request.new:
        notes.append(
            "the data do not state where on the sheet y = 0 lies; the throw is assumed to start on "
            "the near hog line, which affects the resting position but not the motion"
        )
    if request.new:
        notes.append(
            "the variation of the ice from throw to throw cannot be estimated from a single throw"
        )
    used = len(plain.good)
    if used < draws:
        warnings.append(f"{1 - used / draws:.1%} of the draws do not come to rest and are left out")
    comparison = None
    if check is not None:
        comparison = diagnostics.compare_held_out(
            check, fit, throw_start, discrepancy, best, full, random
        )
    return Prediction(
        law=fit.law,
        load=fit.load,
        stone=fit.stone,
        fit={key: fit.data[key] for key in ("file", "rows", "from", "to")},
        start=throw_start.record(request),
        of="new" if request.new else "fitted",
        line="" if "y0" in request.start else throw_start.line,
        goal=request.goal(),
        draws={"number": draws, "used": used, "source": source, "seed": seed},
        misfit=discrepancy,
        series=_series(best, plain, full),
        band=_band(best, full),
        rest=_rest(plain, full),
        measured=_measured_rows(fit, throw_start),
        sample=_sample(full),
        quantities=quantities,
        chances=_chances(full),
        sensitivity=_sensitivity(probed, best),
        warnings=tuple(warnings),
        notes=tuple(notes),
        check=comparison,
    )


def _require_predictable(fit: FitResult, draws: int) -> None:
    """Raise `UnusableFitError` or `InputError` if no throw can be predicted from a fit."""
    if not fit.converged:
        raise UnusableFitError(f"nothing can be predicted from this fit: {fit.status}")
    for name in ("length_scale", "time_scale"):
        if name in fit.conditions and fit.parameters[name].value != 1.0:
            raise InputError(
                f"{name} of this fit is not 1: measured lengths or times differ from the true "
                "ones; use a fit of corrected data"
            )
    if draws < 100:
        raise InputError(f"{draws} draws: expected at least 100")


class _Simulated(NamedTuple):
    """Simulations of a throw."""

    best: TrajectoryEnsemble
    """at the best estimate"""
    plain: TrajectoryEnsemble
    """for the draws that come to rest"""
    full: TrajectoryEnsemble
    """for the same draws, each with a draw of the model discrepancy"""
    probed: dict[str, TrajectoryEnsemble]
    """at the best estimate with small changes"""
    discrepancy: Discrepancy


def _simulated(
    fit: FitResult, throws: ThrowFamily, values: Floats, random: np.random.Generator
) -> _Simulated:
    """Simulate a throw for drawn parameter vectors. Raises `UnusableFitError` if it, or most of
    them, do not come to rest."""
    probes = throws.probes()
    vectors = [throws.with_start(fit.values[None]), *probes.values(), throws.with_start(values)]
    ensembles = throws.simulate(np.concatenate(vectors))
    ends = np.cumsum([len(item) for item in vectors])
    best, plain = ensembles.select(slice(0, 1)), ensembles.select(slice(ends[-2], None))
    if not best.good[0]:
        raise UnusableFitError(
            f"the {fit.law} law as fitted does not bring this stone to rest"
            + no_motion_because(fit.load)
        )
    probed = {
        name: ensembles.select(slice(low, high))
        for name, low, high in zip(probes, ends, ends[1:], strict=False)
    }
    discrepancy = discrepancy_posterior(fit)
    missing = discrepancy.draw(len(values), random)
    shifted = throws.with_start(discrepancy.shift_parameters(values, missing))
    full = missing.applied_to(throws.simulate(shifted), throws.spin_ratio)
    use = plain.good & full.good
    if use.mean() < 0.5:
        raise UnusableFitError(
            f"only {use.mean():.0%} of the draws come to rest; the fit is too uncertain for this "
            "throw"
        )
    return _Simulated(best, plain.select(use), full.select(use), probed, discrepancy.summary)


def held_out(
    throw: Throw,
    law: str | type[Law] = "front-back",
    *,
    until: float,
    draws: int = 1000,
    seed: int = 0,
    **options: Any,
) -> Prediction:
    """Fit the first rows of a throw, predict the rest, and compare (`check` of the result).

    Parameters
    ----------
    throw : the data, with rows after `until` (s). law, options : as in `curlfit.fit`.
    draws, seed : as in `predict`.

    Raises
    ------
    InputError, UnusableFitError : as in `curlfit.fit` and `predict`.

    Examples
    --------
    >>> held_out = curlfit.held_out(throw, until=12, draws=200)
    >>> sorted(held_out.check.channels)
    ['phi', 'x', 'y']
    """
    from curlfit.inference.fit.fit import fit

    return predict(fit(throw, law, until=until, **options), draws=draws, seed=seed, check=throw)


def _drawn_values(
    fit: FitResult, chain: Chain | None, draws: int, random: np.random.Generator
) -> tuple[Floats, str]:
    """Parameter vectors from the posterior, and their source."""
    if chain is not None:
        if chain.names != tuple(fit.parameters):
            raise InputError("the chain is of another fit: its parameters differ")
        flat = chain.flat
        return flat[random.choice(len(flat), draws, replace=len(flat) < draws)], "chain"
    parameters = fit.parameter_set
    free = parameters.free
    proposal = ridge_proposal(fit)
    lower, upper = parameters.lower[free], parameters.upper[free]
    accepted: list[Floats] = []
    for _ in range(200):
        proposed = proposal.draw(draws, random, gaussian=True)
        accepted.extend(proposed[((proposed >= lower) & (proposed <= upper)).all(1)])
        if len(accepted) >= draws:
            break
    else:
        accepted += list(np.clip(proposal.draw(draws, random, gaussian=True), lower, upper))
    values = np.tile(fit.values, (draws, 1))
    values[:, free] = accepted[:draws]
    return values, "covariance"


def _measured_rows(fit: FitResult, throw_start: ThrowStart) -> dict[str, Floats]:
    """The fitted rows on the sheet, if x and y were measured, translated and rotated to the initial
    position and heading of the throw."""
    measured = fit.observed
    if not all(np.isfinite(measured.get(name, np.nan)).any() for name in ("x", "y")):
        return {}
    rows = diagnostics.thin(np.arange(len(measured["t"])))
    begin = throw_start.values
    fitted = {item.name: fit.parameters[item.name].value for item in START}
    right, along = (measured[name][rows] - fitted[f"{name}0"] for name in ("x", "y"))
    turn = begin["heading"] - fitted["heading"]  # from +y toward +x
    return {
        "t": measured["t"][rows] - measured["t"][0],
        "x": begin["x0"] + right * math.cos(turn) + along * math.sin(turn),
        "y": begin["y0"] + along * math.cos(turn) - right * math.sin(turn),
        **{name: measured[name][rows] for name in CHANNELS[2:] if name in measured},
    }


def _quantities(
    best: TrajectoryEnsemble, plain: TrajectoryEnsemble, full: TrajectoryEnsemble
) -> dict[str, Quantity]:
    each = [_throw_quantities(ensemble) for ensemble in (best, plain, full)]
    found = {}
    for name, (_, unit) in QUANTITIES.items():
        value, ours, both = (values[name] for values in each)
        there = np.isfinite(ours) & np.isfinite(both)
        if not there.any():
            continue
        found[name] = Quantity(
            value=float(value[0]),
            unit=unit,
            parameter_sd=float(ours[there].std()),
            model_sd=float(_rms((both - ours)[there])),
            quantiles=quantiles_of(both[there]),
            share=float(np.isfinite(both).mean()),
        )
    return found


def _throw_quantities(ensemble: TrajectoryEnsemble) -> dict[str, Floats]:
    """The quantities of each throw; NaN where it has none."""
    first, last = ensemble.state[:, :3, 0], ensemble.state[:, :3, -1]
    vx, vy = ensemble.state[:, 3, 0], ensemble.state[:, 4, 0]
    dx, dy = (last - first)[:, :2].T
    passed = {name: ensemble.crossing(LINES[name]) for name in ("hog", "far-hog", "far-tee")}
    hog, far_hog, tee = (passed[name][0] for name in ("hog", "far-hog", "far-tee"))
    return {
        "rest_x": last[:, 0],
        "rest_y": last[:, 1] - TEE,
        "rest_to_tee": np.hypot(last[:, 0], last[:, 1] - TEE),
        "curl": (dx * vy - dy * vx) / np.hypot(vx, vy),
        "turns": (last - first)[:, 2] / (2 * math.pi),
        "time": ensemble.rest,
        "hog_to_hog": far_hog - hog,
        "hog_to_tee": tee - hog,
        "hog_to_rest": ensemble.rest - far_hog,
        "speed_at_hog": passed["hog"][1],
        "speed_at_far_hog": passed["far-hog"][1],
        "speed_at_tee": passed["far-tee"][1],
    }


def _rms(values: Floats) -> Floats:
    """Root mean square over the draws."""
    return cast(Floats, np.sqrt(np.mean(values**2, axis=0)))


def _series(
    best: TrajectoryEnsemble, plain: TrajectoryEnsemble, full: TrajectoryEnsemble
) -> dict[str, Floats]:
    duration = max(float(best.rest[0]), float(np.quantile(full.rest, 0.975)))
    n = min(int(np.searchsorted(best.t, duration)) + 1, len(best.t))
    state = best.state[0, :, :n]
    found = {"t": best.t[:n], **dict(zip(PREDICTED, state[:3], strict=True))}
    found |= {"speed": np.hypot(state[3], state[4]), "omega": state[5]}
    for row, name in enumerate(PREDICTED):
        ours, both = plain.state[:, row, :n], full.state[:, row, :n]
        found[f"{name}_parameter_sd"] = ours.std(0)
        found[f"{name}_model_sd"] = _rms(both - ours)
        found |= _around(name, both)
    return found


def _around(name: str, values: Floats) -> dict[str, Floats]:
    """Quantiles over the draws, except the median, by name and level."""
    quantile = np.nanquantile if np.isnan(values).any() else np.quantile  # the faster one
    levels = quantile(values, [float(level) / 100 for level in LEVELS], axis=0)
    rows = zip(LEVELS, levels, strict=True)
    return {f"{name}_{level}": row for level, row in rows if level != "50"}


def _sample(full: TrajectoryEnsemble) -> dict[str, Floats]:
    """The first draws: a random sample, since the draws are in random order."""
    few = full.select(slice(_SAMPLED))
    last = int(np.searchsorted(full.t[:-1], few.rest.max()))
    times = np.unique(np.linspace(0, last, _SAMPLE_TIMES).astype(int))
    state = few.state[:, :3, times].round(_DIGITS)
    return {
        "t": full.t[times], **dict(zip(PREDICTED, state.swapaxes(0, 1), strict=True)),
        "rest": few.rest.round(_DIGITS),
    }  # fmt: skip


def _band(best: TrajectoryEnsemble, full: TrajectoryEnsemble) -> dict[str, Floats]:
    """x as a function of y, up to the y that half of the draws reach."""
    ends = full.state[:, 1].max(1)
    y = np.linspace(float(best.state[0, 1, 0]), float(np.median(ends)), _BAND_POINTS)
    at = np.array([_across(state, y) for state in full.state])
    return {"y": y, "x": _across(best.state[0], y)} | _around("x", at)


def _across(state: Floats, y: Floats) -> Floats:
    """x of a trajectory at given y; NaN beyond its end."""
    rising = np.maximum.accumulate(state[1])
    new = np.concatenate([[True], np.diff(rising) > 0])
    return cast(Floats, np.interp(y, rising[new], state[0, new], left=state[0, 0], right=np.nan))


def _rest(plain: TrajectoryEnsemble, full: TrajectoryEnsemble) -> dict[str, Any]:
    ours, both = plain.state[:, :2, -1], full.state[:, :2, -1]
    return {
        "mean": [float(value) for value in both.mean(0)],
        "parameter": np.cov(ours.T).tolist(),
        "model": ((both - ours).T @ (both - ours) / len(both)).tolist(),
        "both": np.cov(both.T).tolist(),
    }


def _chances(full: TrajectoryEnsemble) -> dict[str, float]:
    x, y = full.state[:, :2, -1].T
    events = {
        "in the house": np.hypot(x, y - TEE) < HOUSE + STONE_RADIUS,
        "short of the hog line": y - STONE_RADIUS < LINES["far-hog"],
        "through the house": y > END,
    }
    return {name: float(happens.mean()) for name, happens in events.items()}


def _sensitivity(
    probed: dict[str, TrajectoryEnsemble], best: TrajectoryEnsemble
) -> dict[str, dict[str, Any]]:
    """Change of the resting position with the initial state."""
    end = best.state[0, :2, -1]
    found: dict[str, dict[str, Any]] = {}
    for name, by in VARIED.items():
        if probed[name].good[0]:
            right, along = probed[name].state[0, :2, -1] - end
            found[name] = {"by": by, "right": float(right), "along": float(along)}
    right, along = (float(way) * _HEADING_CHANGE for way in end - best.state[0, :2, 0])
    found["heading"] = {"by": _HEADING_CHANGE, "right": along, "along": -right}
    return found
