"""Laws as rivals: each fitted to throws that another one makes, and what is left then.

A throw is made without noise. Its rival has an initial state of its own for each
throw; in common are its coefficients and the conditions that a fit holds fixed, which
have their usual widths (`curlfit.inference.fit.systematics`). About the optimum of a
throw, or of throws together, what is left is linear in these: rows of a small problem
of least squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from curlfit.errors import CurlfitError, InputError
from curlfit.inference.fit.fit import fitted
from curlfit.inference.fit.prepared import PreparedThrow
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.systematics import residual_changes, widths_of
from curlfit.inference.identifiability import r_factor, visible
from curlfit.inference.joint.effects import Covariates
from curlfit.inference.joint.fit import solved_together
from curlfit.inference.least_squares import Indices, Solution
from curlfit.inference.likelihood import predict_many
from curlfit.inference.parameters import START, ParameterSet
from curlfit.inference.problem import problem_shape
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.batches import side_by_side, stacked
from curlfit.optimal_design.information import (
    Assumptions,
    PlannedThrow,
    apart_from,
    clock_of,
    ends_of,
    paths_of,
)
from curlfit.settings.choices import Fitting
from curlfit.stone import Stone
from curlfit.throws.plausibility import require_plausible
from curlfit.throws.throw import CHANNELS, Throw

_POINTS = 128  # rows of a throw without noise, weighted as all rows of its record


class Truth(NamedTuple):
    """The throws that a law makes."""

    assumed: Assumptions
    throws: list[Throw]
    rows: list[int]
    """of the record of each"""
    ends: Floats
    """time of rest (s) and distance (m), shape (throws, 2)"""

    @classmethod
    def of(cls, assumed: Assumptions, planned: Sequence[PlannedThrow]) -> Truth:
        """Without noise, at a few times.

        Raises
        ------
        InputError : as in `record_information`.
        """
        ends = ends_of(assumed, planned)
        clocks = [
            clock_of(assumed, *each) for each in zip(planned, ends[:, 0], strict=True)
        ]
        times = [
            np.linspace(0.0, clock[-1], min(_POINTS, len(clock))) for clock in clocks
        ]
        throws = []
        for one, clock, t, path in zip(
            planned, clocks, times, paths_of(assumed, planned, times), strict=True
        ):
            fewer = math.sqrt(len(t) / len(clock))
            seen: Any = {
                name: path[row, : len(t)]
                for row, name in enumerate(CHANNELS)
                if name in assumed.sigma
            }
            sigma: Any = {name: fewer * size for name, size in assumed.sigma.items()}
            label = f"{one.v0:g} m/s, {one.omega0:g} rad/s"
            throws.append(Throw.from_arrays(t, **seen, sigma=sigma, name=label))
        return cls(assumed, throws, [*map(len, clocks)], ends)

    @property
    def law(self) -> str:
        """Its name."""
        return self.assumed.law.name

    def at(self, which: Indices) -> Truth:
        """Some of the throws."""
        throws, rows = zip(
            *((self.throws[one], self.rows[one]) for one in which), strict=True
        )
        return Truth(self.assumed, [*throws], [*rows], self.ends[which])

    def plausible(self) -> Booleans:
        """Which throws stay on the sheet and are possible in other ways."""
        found = np.ones(len(self.throws), bool)
        for row, throw in enumerate(self.throws):
            try:
                require_plausible(throw)
            except InputError:
                found[row] = False
        return found


class Rival:
    """A law that is fitted to the throws of others.

    Attributes
    ----------
    typical : sizes of its coefficients. bounds : lower and upper, over these.
    """

    def __init__(
        self,
        assumed: Assumptions,
        stone: Stone,
        systematics: Mapping[str, float] | None = None,
    ) -> None:
        """Of a law and load; `systematics` as in `widths_of`."""
        self.model = assumed.model
        self._widths = widths_of(self.model, systematics)
        own = ParameterSet.build(assumed.law)
        self.size = len(assumed.law.coefficients())
        self.typical = own.typical[: self.size]
        self.bounds = tuple(
            end[: self.size] / self.typical for end in (own.lower, own.upper)
        )
        self._chosen = {
            "law": assumed.law,
            "load": assumed.load,
            "stone": stone.as_dict(),
        }

    def alone(self, throws: Sequence[Throw]) -> tuple[Floats, Floats]:
        """The coefficients that fit each throw, and its rows; NaN where none do."""
        chosen = Fitting.of(**self._chosen)
        prepared = [PreparedThrow.of(_accepted(throw), chosen) for throw in throws]
        channels, rows = zip(
            *(problem_shape(one.throw) for one in prepared), strict=True
        )
        shape = max(channels), max(rows)
        rounds = Rounds(
            self.model, prepared, shape=shape, batch=side_by_side(len(throws))
        )
        each = []
        for one in fitted(rounds, None):
            if isinstance(one, CurlfitError):
                raise one
            each.append(one.solution)
        solutions = stacked(each)
        found = self._reduced(rounds, solutions)
        found[~np.asarray(solutions.success)] = np.nan
        return solutions.values[:, : self.size], found

    def together(self, throws: Sequence[Throw], start: Floats) -> tuple[Floats, bool]:
        """The rows of throws about the coefficients that fit all of them, found from a
        `start` over typical sizes, and whether this fit converged."""
        names = [item.name for item in self.model.law.coefficients()]
        first = dict(zip(names, (start * self.typical).tolist(), strict=True))
        chosen = [Fitting.of(**self._chosen, start=first)] * len(throws)
        none = Covariates.of([("", {})] * len(throws), (), ())
        found = solved_together([*map(_accepted, throws)], chosen, names, none, None)
        return self._reduced(found.rounds, found.solution), bool(
            np.all(found.solution.success)
        )

    def _reduced(self, rounds: Rounds, solutions: Solution) -> Floats:
        """What is left of the residuals of each throw whatever its initial state.

        Shape (throws, rows, columns). Columns are coefficients over typical sizes,
        conditions over widths, and the residual where all of these are zero.
        """
        parameters, values = rounds.throws[0].parameters, solutions.values
        paths = predict_many(self.model, values, rounds.problems, rounds.batch)
        changes = residual_changes(
            self.model, rounds.problems, values, paths, self._widths, rounds.batch
        )
        scaled = solutions.jacobian * (parameters.typical * parameters.free)
        of_law = (values / parameters.typical)[:, None, None, : self.size]
        at_zero = solutions.residual - (scaled[..., : self.size] * of_law).sum(-1)
        whole = np.concatenate([scaled, np.stack([*changes.values(), at_zero], -1)], -1)
        whole = r_factor(whole.reshape(len(values), -1, whole.shape[-1]))
        own = np.arange(self.size, self.size + len(START))
        return apart_from(whole[..., own], np.delete(whole, own, -1))

    def fit(self, rows: Floats) -> tuple[float, Floats]:
        """Chi squared of throws together, and the coefficients over typical sizes,
        within bounds; conditions contribute to it by their widths."""
        from scipy.optimize import lsq_linear  # slow to load

        whole = r_factor(rows.reshape(-1, rows.shape[-1]))
        conditions = whole.shape[-1] - 1 - self.size
        width = self.size + conditions
        matrix = np.concatenate([whole[:, :-1], np.eye(conditions, width, self.size)])
        aim = -np.append(whole[:, -1], np.zeros(conditions))
        free = np.full(conditions, np.inf)
        ends = np.append(self.bounds[0], -free), np.append(self.bounds[1], free)
        found = lsq_linear(matrix, aim, ends, method="bvls")
        return 2 * float(found.cost), found.x[: self.size]

    def rank(self, rows: Floats) -> int:
        """Number of directions of the coefficients that throws together determine."""
        whole = r_factor(rows[..., : self.size].reshape(-1, self.size))
        singular = np.asarray(np.linalg.svd(whole, compute_uv=False), float)
        return int(visible(singular).sum())


def _accepted(throw: Throw) -> Throw:
    """A throw that is fitted even if it is not possible: it is left out later."""
    return throw.with_defaults(as_given=True)
