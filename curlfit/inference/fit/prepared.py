"""A throw prepared for a fit: rows selected, with its stone and parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from curlfit.findings import Finding
from curlfit.friction import find_law
from curlfit.inference.conditions import WEAK_CONDITIONS
from curlfit.inference.fit.result import FitResult
from curlfit.inference.least_squares import Solution
from curlfit.inference.likelihood import path_jacobians
from curlfit.inference.model import Model
from curlfit.inference.noise.accelerations import Responses
from curlfit.inference.noise.independence import time_of_motion
from curlfit.inference.noise.linearized import Linearized
from curlfit.inference.noise.whitening import Whitener
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.priors import Penalty
from curlfit.inference.problem import Problem, build_problem
from curlfit.inference.verdict import Verdict
from curlfit.losses import LOSSES, Loss
from curlfit.noises import WHITE, Noise
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked
from curlfit.settings.choices import Modelling
from curlfit.stone import Stone
from curlfit.throws.plausibility import require_plausible
from curlfit.throws.throw import CHANNELS, Throw

_HELD = 1e-4  # standard deviation that holds a parameter, over that of its prior


class PreparedThrow(NamedTuple):
    """A throw prepared for a fit: rows selected, with its stone and parameters."""

    throw: Throw
    stone: Stone
    rows: dict[str, Any]
    """`since`, `until` and `exclude`, as `Throw.select_rows` takes them"""
    swept: tuple[float, float] | None
    parameters: ParameterSet
    findings: tuple[Finding, ...] = ()
    """what is unusual about the throw"""
    flags: tuple[str, ...] = ()
    """those that make this fit of the throw's file"""

    @classmethod
    def of(
        cls, throw: Throw, chosen: Modelling, *, others_swept: bool = False
    ) -> PreparedThrow:
        """Prepare a throw, whose own defaults are among the choices; a very long one
        is condensed.

        `others_swept` makes `sweep` a parameter also of a throw that was not swept, on
        which it has no effect.

        Raises
        ------
        InputError : as in `fit`.
        """
        stone = Stone().with_values(dict(chosen.stone))
        flags = (*throw.read_with, *chosen.words())
        throw = throw.with_sigma(dict(chosen.sigma)).select_rows(**chosen.rows)
        findings = require_plausible(throw)
        throw = throw.condensed()
        swept = chosen.swept is not None or others_swept
        parameters = ParameterSet.for_throw(
            find_law(chosen.law), throw, swept=swept, **chosen.parameters
        )
        return cls(
            throw=throw,
            stone=stone,
            rows=chosen.rows,
            swept=chosen.swept,
            parameters=parameters,
            findings=findings,
            flags=flags,
        )

    @property
    def assumed_spin(self) -> float:
        """The spin in rad/s that the throw assumes where nothing determines
        it; 0 if none."""
        spin = self.throw.assumed.get("omega0", 0.0)
        return spin if self.parameters.fixed.get("omega0") == spin else 0.0

    @property
    def spin_taken_for_zero(self) -> bool:
        """Whether only lines and times were measured, and nothing tells the spin."""
        held_at_zero = self.parameters.fixed.get("omega0") == 0.0
        return held_at_zero and self.throw.assumed.get("omega0") == 0.0

    def penalty(self, *, first: bool) -> Penalty:
        """What the priors add to chi squared.

        The `first` fit weights all channels equally, 1 m like 1 rad, where no sigma is
        given. Priors would outweigh the data there, and the misfit that they cause
        would be taken for noise. They are therefore left out, except that the stone's
        constants and the scales, which a path hardly determines, are held near the
        modes of their priors.
        """
        penalty = self.parameters.penalty
        if not (first and self.equal_sigma()):
            return penalty
        held = np.isin(self.parameters.names, WEAK_CONDITIONS)
        return penalty._replace(weight=penalty.weight * held / _HELD)

    def equal_sigma(self) -> dict[str, float]:
        """Sigma in the first fit for channels whose own is unknown: equal weights."""
        medians = [float(np.nanmedian(series)) for series in self.throw.sigma.values()]
        equal = float(np.exp(np.mean(np.log(medians)))) if medians else 1.0
        unknown = [name for name in self.throw.seen if name not in self.throw.sigma]
        return dict.fromkeys(unknown, equal)

    def with_start(self, values: Floats, start: Mapping[str, float] | None) -> Floats:
        """Initial values, with those that the user gives."""
        if not start:
            return values
        self.parameters.require("start", start)
        values = values.copy()
        for name, value in start.items():
            values[self.parameters.index(name)] = value
        return np.clip(values, self.parameters.lower, self.parameters.upper)


class LeastSquaresFit(NamedTuple):
    """The outcome of a fit, and what was fitted."""

    prepared: PreparedThrow
    model: Model
    loss: Loss
    noise: Noise
    problem: Problem
    sigma: dict[str, float]
    """of the channels for which it was not given"""
    solution: Solution
    tried: int
    """number of initial values tried"""
    rival: Solution | None = None
    """another optimum that fits as well"""


def problem_of(fit: FitResult) -> Problem:
    """The problem that a fit solved, with its noise and loss."""
    problem = build_problem(
        fit.throw, fit.stone, fit.sigma, LOSSES[fit.loss], fit.data.swept
    )
    data = linearized_fit(fit).first(len(problem.weight)) if fit.noise.sizes else None
    whitener = Whitener.of(
        fit.noise, problem.times, problem.weight, len(fit.values), data
    )
    return problem._replace(whitener=whitener)


def linearized_fit(fit: FitResult) -> Linearized:
    """The fitted path to first order, with the weights of independent noise."""
    independent = fit.sigma | fit.noise.independent
    problem = problem_of(replace(fit, sigma=independent, noise=WHITE))
    path = np.array([fit.fitted[name] for name in CHANNELS])
    if fit.events:
        # one more row, with a column for each event
        row = np.zeros((1, path.shape[1]))
        for column, event in enumerate(fit.events):
            off = event.fitted - event.event.value
            row[0, column] = problem.observed[-1, column] + off
        path = np.concatenate([path, row])
    verdicts = [estimate.verdict for estimate in fit.parameters.values()]
    adjustable = np.array(
        [verdict not in (Verdict.FIXED, Verdict.AT_BOUND) for verdict in verdicts]
    )
    typical = fit.parameter_set.typical
    return linearized(
        fit.model, problem, fit.values, path, fit.stone, typical, adjustable
    )


def penalties(throws: Sequence[PreparedThrow], *, first: bool = False) -> Penalty:
    """What the priors of each throw add to its chi squared: see
    `PreparedThrow.penalty`."""
    return stacked([throw.penalty(first=first) for throw in throws])


def bounds_of(
    throws: Sequence[PreparedThrow], common: Booleans | None = None
) -> tuple[Floats, Floats]:
    """Lower and upper bounds of many throws, each of shape (throws, parameters). Those
    of parameters in `common` hold for all throws."""
    lower = np.stack([throw.parameters.lower for throw in throws])
    upper = np.stack([throw.parameters.upper for throw in throws])
    if common is not None:
        lower[:, common] = lower[:, common].max(axis=0)
        upper[:, common] = upper[:, common].min(axis=0)
    return lower, upper


def linearized(
    model: Model,
    problem: Problem,
    values: Floats,
    path: Floats,
    stone: Stone,
    typical: Floats,
    adjustable: Booleans,
) -> Linearized:
    """A fitted path of all channels, and of events if there are any, to first order.

    Parameters
    ----------
    values : of the parameters.
    path : the fitted path, shape (5 or 6, n), of at least the rows that are not
        padding.
    typical : sizes of the parameters.
    adjustable : which parameters are neither fixed nor at a bound.
    """
    jacobian = path_jacobians(model, values[None], stacked([problem]))[0]
    times = problem.times
    rows = path.shape[1]  # without padding
    measured = len(problem.weight)
    weight = np.zeros(jacobian.shape[:2])
    weight[:measured] = problem.weight
    off = problem.observed[:, :rows] - path[:measured]
    residual = np.zeros(jacobian.shape[:2])
    residual[:measured, :rows] = np.where(weight[:measured, :rows] > 0, off, 0.0)
    response = Responses.of(times[:rows], path[: len(CHANNELS)], stone)
    responses = [response.at(times, row) for row in range(len(CHANNELS))]
    if len(jacobian) > len(CHANNELS):
        responses.append(np.zeros_like(responses[0]))  # of events
    data = Linearized.of(
        times,
        weight,
        residual,
        jacobian,
        typical,
        adjustable,
        len(model.law.coefficients()),
    )
    span = time_of_motion(times[:rows], path[CHANNELS.index("speed")])
    return data._replace(span=np.asarray(span), responses=np.stack(responses))
