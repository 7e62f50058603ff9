"""Prediction of a throw: the fitted one extrapolated to rest, or another one on
the same ice.

Two errors are propagated separately. The error of the parameters: each draw from the
posterior (the chain or, without one, the covariance of the fit: Gaussian along
determined directions, uniform within the bounds along the others; where values that fit
lie on a curve, draws along it) is simulated to rest.
The error of the law, the model discrepancy (see `curlfit.prediction.discrepancy`): each
draw is simulated again with missing accelerations. Neither contains measurement noise,
which is added where a prediction is compared with measured rows.

A given initial state is taken as exact, a spin that is not given has the errors of
the fit. Without any the throw is the fitted one, whose initial state has the
errors of the fit.

Positions are on the sheet: x to the right of the centre line, y from the hack that the
stone is thrown from (`curlfit.sheet`). The origin of the data is arbitrary, so the
initial position is placed on a line of the sheet, by default the near hog line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from curlfit.errors import InputError, Option, UnusableFitError
from curlfit.findings import Finding, Level, Remedy
from curlfit.friction import Law
from curlfit.inference.fit.fit import fit as fit_throw, refit
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.model.parameters import START
from curlfit.inference.sampling.chain import Chain
from curlfit.inference.sampling.draws import draws_along_ridge
from curlfit.inference.sampling.ridge import ridge_proposal
from curlfit.inference.together.another import another
from curlfit.inference.together.result import JointResult
from curlfit.noises import WHITE
from curlfit.numerics.arrays import Floats
from curlfit.prediction import diagnostics
from curlfit.prediction.ensemble import ThrowFamily, prepare_ensemble, weights_of
from curlfit.prediction.request import PlannedThrow, planned, with_turn
from curlfit.prediction.result import (
    CENTRED,
    Call,
    Draws,
    Prediction,
    Source,
    Start,
)
from curlfit.prediction.simulation import Simulation
from curlfit.throws.channels import CHANNELS
from curlfit.throws.throw import Throw

_FEWEST_DRAWS = 100  # that can be asked for
_ROUNDS = 200  # of draws, until enough are within the bounds
_FEW_INDEPENDENT = 100
"""Independent draws, below which the ends of a 95 % band are rough."""


def predict(
    fit: FitResult | JointResult,
    chain: Chain | None = None,
    *,
    start: Mapping[str, float] | None = None,
    call: Call = CENTRED,
    line: str | None = None,
    target: tuple[float, float] | None = None,
    weight: str | None = None,
    tee_speed: float | None = None,
    draws: int = 1000,
    seed: int = 0,
    check: Throw | None = None,
) -> Prediction:
    """Predict a throw, from a fit of a throw on the same ice.

    Without `start`, `target` and `weight` it is the fitted throw, extrapolated to rest.
    Otherwise it is another one: along the centre line from `line`, with the speed and
    spin of the fitted one unless these are given.

    Parameters
    ----------
    fit, chain : a converged fit and, if there is one, its posterior sample. A joint fit
        of throws that vary, or that of a season, predicts another one of them: the
        bands contain the spread between throws.
    call : the throw in curlers' terms, and its group in a joint fit.
    start : any of x0, y0 (m on the sheet), heading (rad), v0 (m/s), phi0 (rad), omega0
        (rad/s); taken as exact.
    line : where the throw starts: "hack", "back", "tee", "hog", "centre" or "far-hog";
        "data" is the start of the data, whose y must then be measured from the hack. By
        default "hog", or "data" for the fitted throw if its file states that y is
        measured from the hack.
    target : (x, y), m to the right of the tee and beyond it, where the stone is to
        rest; speed and heading are found.
    weight : "draw", "guard" or "takeout" (see `WEIGHTS`); the speed and, unless it is
        given, the heading to the centre line are found.
    tee_speed : speed in m/s at which a takeout passes the tee.
    draws : number of draws from the posterior. seed : of the draws.
    check : the fitted throw with later rows; not with `start`, `target` or `weight`.

    Returns
    -------
    Prediction.

    Raises
    ------
    InputError : an unknown name, contradictory arguments, a target that no throw
        reaches, a fit that does not determine the spin where none is given, a `check`
        that is another throw or has no later rows.
    UnusableFitError : the fit did not converge, or its law does not bring the
        stone to rest.

    Examples
    --------
    >>> prediction = curlfit.predict(sampled, chain, draws=200)
    >>> round(prediction.quantities["time"].value, 1)
    24.3
    """
    start = start or {}
    if call.turn == "both":
        predictions = []
        for turn in ("in", "out"):
            call_of_turn, start_of_turn = with_turn(call, start, turn)
            prediction = predict(
                fit,
                chain,
                start=start_of_turn,
                call=call_of_turn,
                line=line,
                target=target,
                weight=weight,
                tee_speed=tee_speed,
                draws=draws,
                seed=seed,
                check=check,
            )
            predictions.append(prediction)
        in_turn, out_turn = predictions
        return replace(in_turn, other=out_turn)
    random = np.random.default_rng(seed)
    joint: JointResult | None = None
    if isinstance(fit, JointResult):
        joint = fit
        fit, values = another(fit, call.labels, draws, random)
        posterior = _Posterior(fit, values, "throws")
    else:
        posterior = _posterior_of_throw(fit, chain, call, draws, random)
        fit = posterior.fit
    _require_predictable(fit, draws)
    throw = planned(fit, call, start, line, target, weight, tee_speed)
    if joint is not None and not throw.new:
        raise InputError(
            "a joint fit predicts another throw: give its weight as hog to hog time "
            "or v0, or where it is to rest"
        )
    if check is not None and throw.new:
        raise InputError(
            "measured rows are compared with the fitted throw; leave out the start, "
            "target or weight"
        )
    prepare_ensemble(fit)
    simulation = Simulation.of(
        ThrowFamily(throw), posterior.values, random, None if joint is None else call
    )
    findings = [
        *posterior.findings,
        *diagnostics.findings_of(throw, simulation, line_assumed=line is None),
    ]
    used = len(simulation.plain.t)
    if used < draws:
        fraction = 1 - used / draws
        findings.append(Finding.warning("draws-without-rest", fraction=fraction))
    comparison = None
    if check is not None:
        comparison = diagnostics.compare_held_out(check, throw, simulation, random)
    paths = simulation.full.positions_at(simulation.t)
    return Prediction(
        law=fit.law,
        load=fit.load,
        stone=fit.stone,
        fit=fit.data.extent,
        start={
            component.name: Start(
                value=float(throw.values[component.name]),
                unit=component.unit,
                origin=throw.origins[component.name],
            )
            for component in START
        },
        of="new" if throw.new else "fitted",
        line="" if throw.origins["y0"] == "given" else throw.line,
        goal=throw.goal,
        draws=Draws(number=draws, used=used, source=posterior.source, seed=seed),
        misfit=simulation.discrepancy,
        series=simulation.series(paths),
        band=simulation.band(paths),
        rest=simulation.resting_place(),
        quantities=simulation.quantities(),
        chances=simulation.chances(),
        sensitivity=simulation.sensitivity(),
        warnings=tuple(
            finding for finding in findings if finding.level is Level.WARNING
        ),
        notes=tuple(finding for finding in findings if finding.level is Level.NOTE),
        call=call,
        odd_rows=() if joint is None else joint.odd_rows,
        weights=() if joint is None else weights_of(fit, throw.values["omega0"]),
        check=comparison,
        measured=_measured_rows(throw) if joint is None else {},
        sample=simulation.sample(paths),
    )


def _require_predictable(fit: FitResult, draws: int) -> None:
    """Raise `UnusableFitError` or `InputError` if no throw can be
    predicted from a fit."""
    if not fit.converged:
        raise UnusableFitError(f"nothing can be predicted from this fit: {fit.status}")
    for name in ("length_scale", "time_scale"):
        if name in fit.conditions and fit.parameters[name].value != 1.0:
            raise InputError(
                f"{name} of this fit is not 1: measured lengths or times differ from "
                "the true ones; use a fit of corrected data"
            )
    if draws < _FEWEST_DRAWS:
        raise InputError(f"{draws} draws: expected at least {_FEWEST_DRAWS}")


def held_out(
    throw: Throw,
    law: str | type[Law] = "front-back",
    *,
    until: float,
    draws: int = 1000,
    seed: int = 0,
    **options: Any,
) -> Prediction:
    """Fit the first rows of a throw, predict the rest, and compare (`check` of
    the result).

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
    fit = fit_throw(throw, law, until=until, **options)
    return predict(fit, draws=draws, seed=seed, check=throw)


@dataclass(frozen=True)
class _Posterior:
    """The fit that a prediction is made from, and draws of its parameters.

    Attributes
    ----------
    values : parameter vectors, shape (draws, parameters).
    source : what they were drawn from.
    findings : about the fit and the draws.
    """

    fit: FitResult
    values: Floats
    source: Source
    findings: tuple[Finding, ...] = ()


def _posterior_of_throw(
    fit: FitResult,
    chain: Chain | None,
    call: Call,
    draws: int,
    random: np.random.Generator,
) -> _Posterior:
    """Draws from the posterior of one throw: from its chain, along the curve of values
    that fit, or by its covariance.

    Raises
    ------
    InputError, UnusableFitError : no fit of one throw, one that cannot be used, a call
        of groups or with a thrower's scatter, which one throw lacks, or the chain of
        another fit.
    """
    require_fit(fit)
    if call.labels:
        raise InputError(
            f"{', '.join(call.labels)}: the fit of one throw has no "
            "groups; leave it out"
        )
    if call.thrower is not None:
        raise InputError(
            f"{Option('thrower-sd')}: the fit of one throw predicts a stone that is "
            "released as it is given; leave it out, or fit several throws together"
        )
    _require_predictable(fit, draws)
    findings: tuple[Finding, ...] = ()
    if fit.noise.has_discrepancy:
        # the simulation adds the accelerations that the law lacks by itself
        fit = refit(fit, WHITE)
        chain = None
        findings = (Finding.note("law-without-discrepancy"),)
    if chain is not None:
        if chain.names != tuple(fit.parameters):
            raise InputError("the chain is of another fit: its parameters differ")
        samples = chain.flat
        chosen = random.choice(len(samples), draws, replace=len(samples) < draws)
        return _Posterior(fit, samples[chosen], "chain", findings)
    if fit.ridge:
        values, independent = draws_along_ridge(fit, draws, random)
        if independent < _FEW_INDEPENDENT:
            remedy = Remedy("sample-posterior")
            warning = Finding.warning("few-draws", remedy, draws=float(independent))
            findings = (*findings, warning)
        return _Posterior(fit, values, "ridge", findings)
    values = _draws_by_covariance(fit, draws, random)
    return _Posterior(fit, values, "covariance", findings)


def _draws_by_covariance(
    fit: FitResult, draws: int, random: np.random.Generator
) -> Floats:
    """Parameter vectors from the covariance of a fit, within the bounds."""
    proposal = ridge_proposal(fit)
    free = fit.parameter_set.free
    lower = fit.parameter_set.lower[free]
    upper = fit.parameter_set.upper[free]
    accepted: list[Floats] = []
    for _ in range(_ROUNDS):
        proposed = proposal.draw(draws, random, gaussian=True)
        accepted.extend(proposed[((proposed >= lower) & (proposed <= upper)).all(1)])
        if len(accepted) >= draws:
            break
    # where too few are within the bounds, the others are moved to them
    accepted.extend(np.clip(proposed, lower, upper))
    values = np.tile(fit.values, (draws, 1))
    values[:, free] = accepted[:draws]
    return values


def _measured_rows(throw: PlannedThrow) -> dict[str, Floats]:
    """The fitted rows on the sheet, if x and y were measured, translated and rotated to
    the initial position and heading of the throw."""
    fit = throw.fit
    start = throw.values
    measured = fit.observed
    if not all(np.isfinite(measured.get(name, np.nan)).any() for name in ("x", "y")):
        return {}
    step = len(measured["t"]) // diagnostics.MOST_ROWS + 1
    right = measured["x"][::step] - fit.parameters["x0"].value
    along = measured["y"][::step] - fit.parameters["y0"].value
    # from +y toward +x
    turn = start["heading"] - fit.parameters["heading"].value
    rows = {
        "t": measured["t"][::step] - measured["t"][0],
        "x": start["x0"] + right * math.cos(turn) + along * math.sin(turn),
        "y": start["y0"] + along * math.cos(turn) - right * math.sin(turn),
    }
    for name in CHANNELS[2:]:
        if name in measured:
            rows[name] = measured[name][::step]
    return rows
