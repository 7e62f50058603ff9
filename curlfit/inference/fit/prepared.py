"""A throw prepared for a fit: rows selected, with its stone, parameters and origin."""

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
from curlfit.inference.noise.linearized import Linearized
from curlfit.inference.noise.models import WHITE, Noise, time_of_motion
from curlfit.inference.noise.whitening import Whitener
from curlfit.inference.parameters import ParameterSet
from curlfit.inference.priors import Penalty, penalty_of
from curlfit.inference.problem import Origin, Problem, build_problem
from curlfit.inference.verdict import Verdict
from curlfit.losses import LOSSES, Loss
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import stacked
from curlfit.settings.choices import Modelling
from curlfit.stone import Stone
from curlfit.throws.plausibility import require_plausible
from curlfit.throws.throw import CHANNELS, Throw

_HELD = 1e-4  # standard deviation that holds a parameter, over that of its prior


class PreparedThrow(NamedTuple):
    """A throw prepared for a fit: rows selected, with its stone,
    parameters and origin."""

    throw: Throw
    stone: Stone
    rows: dict[str, Any]
    """`since`, `until` and `exclude`, as `Throw.select_rows` takes them"""
    swept: tuple[float, float] | None
    parameters: ParameterSet
    origin: Origin
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
        stone, read_with = Stone().with_values(dict(chosen.stone)), throw.read_with
        throw = throw.with_sigma(dict(chosen.sigma)).select_rows(**chosen.rows)
        findings = require_plausible(throw)
        throw = throw.condensed()
        swept = chosen.swept is not None or others_swept
        parameters = ParameterSet.for_throw(
            find_law(chosen.law), throw, swept=swept, **chosen.parameters
        )
        return cls(
            throw,
            stone,
            chosen.rows,
            chosen.swept,
            parameters,
            Origin.of(throw),
            findings,
            (*read_with, *chosen.words()),
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

    @property
    def offset(self) -> Floats:
        """From the problem's coordinates to the data's."""
        return self.origin.offset(len(self.parameters))

    @property
    def local_parameters(self) -> ParameterSet:
        """The parameters in the problem's coordinates."""
        return self.parameters.shifted(-self.offset)

    def penalty(self, *, first: bool) -> Penalty:
        """What the priors add to chi squared, in the problem's coordinates.

        The `first` fit weights all channels equally, 1 m like 1 rad, where no sigma is
        given. Priors would outweigh the data there, and the misfit that they cause
        would be taken for noise. They are therefore left out, except that the stone's
        constants and the scales, which a path hardly determines, are held near the
        modes of their priors.
        """
        found = penalty_of(
            self.parameters.parameters, self.parameters.priors, self.offset
        )
        if not (first and self.equal_sigma()):
            return found
        held = np.isin(self.parameters.names, WEAK_CONDITIONS)
        return found._replace(weight=found.weight * held / _HELD)

    def equal_sigma(self) -> dict[str, float]:
        """Sigma in the first fit for channels whose own is unknown: equal weights."""
        given = [float(np.nanmedian(series)) for series in self.throw.sigma.values()]
        even = float(np.exp(np.mean(np.log(given)))) if given else 1.0
        return {name: even for name in self.throw.seen if name not in self.throw.sigma}

    def with_start(self, values: Floats, start: Mapping[str, float] | None) -> Floats:
        """Initial values in the problem's coordinates, with those that
        the user gives."""
        if not start:
            return values
        self.parameters.require("start", start)
        absolute = values + self.offset
        for name, value in start.items():
            absolute[self.parameters.index(name)] = value
        return (
            np.clip(absolute, self.parameters.lower, self.parameters.upper)
            - self.offset
        )


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


def problem_of(fit: FitResult) -> tuple[Problem, Origin]:
    """The problem that a fit solved, with its noise and loss, and its origin."""
    throw = fit.throw
    origin = Origin.of(throw)
    problem = build_problem(
        throw, fit.stone, origin, fit.sigma, LOSSES[fit.loss], fit.data["swept"]
    )
    data = linearized_fit(fit).first(len(problem.weight)) if fit.noise.sizes else None
    whitener = Whitener.of(
        fit.noise, problem.times, problem.weight, len(fit.values), data
    )
    return problem._replace(whitener=whitener), origin


def linearized_fit(fit: FitResult) -> Linearized:
    """The fitted path to first order, with the weights of independent noise."""
    independent = fit.sigma | fit.noise.independent
    problem, origin = problem_of(replace(fit, sigma=independent, noise=WHITE))
    path = np.array([fit.fitted[name] for name in CHANNELS]) - origin.place[:, None]
    if fit.events:
        row = np.zeros((1, path.shape[1]))
        row[0, : len(fit.events)] = [one["fitted"] for one in fit.events]
        row[0, : len(fit.events)] -= [
            origin.of_event(event) for event in fit.throw.events
        ]
        path = np.concatenate([path, row])
    verdicts = [item.verdict for item in fit.parameters.values()]
    adjustable = np.array(
        [verdict not in (Verdict.FIXED, Verdict.AT_BOUND) for verdict in verdicts]
    )
    values = fit.values - origin.offset(len(fit.values))
    typical = fit.parameter_set.typical
    return linearized(fit.model, problem, values, path, fit.stone, typical, adjustable)


def penalties(throws: Sequence[PreparedThrow], *, first: bool = False) -> Penalty:
    """The same of many throws."""
    return stacked([one.penalty(first=first) for one in throws])


def local_bounds(
    throws: Sequence[PreparedThrow], common: Booleans | None = None
) -> tuple[Floats, Floats, Floats]:
    """Offsets of many throws from the problems' coordinates to the data's, bounds in
    the former; each of shape (throws, parameters). Bounds of parameters in `common`
    hold for all throws."""
    offset = np.stack([one.offset for one in throws])
    lower = np.stack([one.parameters.lower for one in throws]) - offset
    upper = np.stack([one.parameters.upper for one in throws]) - offset
    if common is not None:
        lower[:, common], upper[:, common] = (
            lower[:, common].max(0),
            upper[:, common].min(0),
        )
    return offset, lower, upper


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
    values : of the parameters, in the coordinates of the problem.
    path : the fitted path in these coordinates, shape (5 or 6, n), of at least the rows
        that are not padding.
    typical : sizes of the parameters.
    adjustable : which parameters are neither fixed nor at a bound.
    """
    jacobian = path_jacobians(model, values[None], stacked([problem]))[0]
    times, rows, seen = problem.times, path.shape[1], len(problem.weight)
    weight, residual = np.zeros(jacobian.shape[:2]), np.zeros(jacobian.shape[:2])
    weight[:seen] = problem.weight
    there = weight[:seen, :rows] > 0
    residual[:seen, :rows] = np.where(
        there, problem.observed[:, :rows] - path[:seen], 0.0
    )
    response = Responses.of(times[:rows], path[: len(CHANNELS)], stone)
    responses = [response.at(times, row) for row in range(len(CHANNELS))]
    if len(jacobian) > len(CHANNELS):
        responses.append(np.zeros_like(responses[0]))
    found = Linearized.of(
        times,
        weight,
        residual,
        jacobian,
        typical,
        adjustable,
        len(model.law.coefficients()),
    )
    span = time_of_motion(times[:rows], path[CHANNELS.index("speed")])
    return found._replace(span=np.asarray(span), responses=np.stack(responses))
