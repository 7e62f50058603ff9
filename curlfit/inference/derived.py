"""Quantities derived from the parameters of a fit, with errors to first order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, NamedTuple

import numpy as np

from curlfit.errors import InputError
from curlfit.foreign import quoted
from curlfit.inference.expression import CONSTANTS, parse
from curlfit.inference.identifiability import (
    WEAK_ERROR,
    Combination,
    Verdict,
    WithInterval,
)
from curlfit.numerics.arrays import Floats
from curlfit.output.text import sided
from curlfit.records import Names
from curlfit.stone import UNITS as STONE_UNITS

LEVELS = ("2.5", "16", "50", "84", "97.5")
"""Quantiles in percent."""
Quantiles = Annotated[dict[str, float], Names(LEVELS)]
# share of a gradient along null directions below which it counts as zero
_NO_PART = 1e-3
_TRIES = 4  # further points of the ridge at which the gradient is checked


@dataclass(frozen=True)
class Derived(WithInterval):
    """A quantity derived from the parameters of a fit.

    Attributes
    ----------
    expression : arithmetic of the parameters, or the name of a quantity of the path.
    value : at the estimates.
    stderr : standard error, from the covariance to first order; None where the quantity
        is not determined, or depends on a parameter at its bound.
    verdict : "determined"; "prior" (it rests on priors); "weak" (its standard error is
        more than half of what typical sizes of its parameters imply); "not
        identifiable" (it depends on a direction that the path does not determine); "at
        bound" or "fixed".
    systematic : error due to the conditions that the fit holds fixed; None where
        there is none.
    dof : degrees of freedom of `stderr`, the smallest of its parameters'; None where
        sigma was given.
    quantiles : of the posterior, "2.5" to "97.5"; empty without a chain.
    meaning, unit : of a quantity of the path.
    """

    expression: str
    value: float
    stderr: float | None
    verdict: Verdict
    systematic: float | None = None
    dof: float | None = None
    quantiles: Quantiles = field(default_factory=dict)
    meaning: str = ""
    unit: str = ""


def scaled(item: Derived, factor: float) -> Derived:
    """The quantity times a factor."""

    def times(value: float | None) -> float | None:
        return None if value is None else value * abs(factor)

    quantiles = sorted(value * factor for value in item.quantiles.values())
    return replace(
        item,
        value=item.value * factor,
        stderr=times(item.stderr),
        systematic=times(item.systematic),
        quantiles=dict(zip(item.quantiles, quantiles, strict=True)),
    )


def to_its_side(item: Derived) -> Derived:
    """A signed quantity as a positive one, with its side in words."""
    meaning, sign = sided(item.meaning, item.value)
    return scaled(replace(item, meaning=meaning), sign) if sign < 0 else item


class FirstOrder(NamedTuple):
    """What a fit says about its parameters, to first order."""

    parameters: Mapping[str, Any]
    """an `Estimate` each (`curlfit.inference.fit.estimates`)"""
    covariance: Mapping[str, Any]
    """{"names", "matrix"} of the parameters that can move"""
    null_directions: Sequence[Mapping[str, float]]
    combinations: Sequence[Combination]
    widths: Mapping[str, float]
    """standard uncertainties of the conditions that the fit holds fixed"""
    shifts: Mapping[str, Mapping[str, float]]
    """by determined parameter or combination, and by condition"""
    stone: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that can move."""
        return tuple(self.covariance["names"])

    def vector(self, weights: Mapping[str, float]) -> Floats:
        """Weights in the order of the parameters that can move."""
        return np.array([weights.get(name, 0.0) for name in self.names])

    def stderr(self, gradient: Mapping[str, float]) -> float:
        """Standard error of a quantity with this gradient; null directions
        are ignored."""
        row = self.vector(gradient)
        return math.sqrt(
            max(float(row @ np.array(self.covariance["matrix"]) @ row), 0.0)
        )

    def null_space(self) -> Floats:
        """Orthonormal null directions in units of typical sizes, shape
        (directions, parameters)."""
        rows = [self.vector(item) / self._typical for item in self.null_directions]
        rows = [row for row in rows if row.any()]
        if not rows:
            return np.zeros((0, len(self.names)))
        _, size, basis = np.linalg.svd(np.array(rows), full_matrices=False)
        return np.asarray(basis[size > 1e-9 * size[0]])

    @property
    def _typical(self) -> Floats:
        return np.array([self.parameters[name].typical for name in self.names])

    def sees(self, gradient: Mapping[str, float]) -> bool:
        """Whether the data determine a quantity with this gradient."""
        row = self.vector(gradient) * self._typical
        size = float(np.linalg.norm(row))
        return not np.linalg.norm(self.null_space() @ row) > _NO_PART * size

    def shift(self, condition: str) -> Floats:
        """Shift from the estimates to the true values if a condition is off by
        one width, along the determined directions, in the order of the parameters
        that can move."""
        known = [name for name in self.names if name in self.shifts]
        found = self.vector(
            {name: self.shifts[name].get(condition, 0.0) for name in known}
        )
        sums = [item for item in self.combinations if item.expression in self.shifts]
        hidden = np.array([name not in known for name in self.names])
        if hidden.any() and sums:
            rows = np.array([self.vector(item.weights) for item in sums])
            right = [self.shifts[item.expression].get(condition, 0.0) for item in sums]
            rest = np.array(right) - rows @ found
            found[hidden] = np.linalg.lstsq(rows[:, hidden], rest, rcond=None)[0]
        return found

    def assess(
        self,
        name: str,
        value: float,
        gradient: Mapping[str, float],
        changes: Mapping[str, float],
        *,
        seen: bool = True,
        held_counts: bool = True,
    ) -> Derived:
        """The quantity with its errors.

        Parameters
        ----------
        gradient : by the parameters. changes : for one width of each condition, at
            fixed parameters.
        seen : whether it is determined elsewhere on the ridge as well.
        held_counts : whether dependence on a parameter at its bound leaves it
            without an error.
        """
        used = {key: self.parameters[key] for key, slope in gradient.items() if slope}
        free = [key for key, item in used.items() if item.verdict != "fixed"]
        if not free:
            return Derived(name, value, None, "fixed")
        if not (seen and self.sees(gradient)):
            return Derived(name, value, None, "not identifiable")
        verdicts = {used[key].verdict for key in free}
        if held_counts and any(key not in self.names for key in free):
            return Derived(name, value, None, "at bound")
        stderr = self.stderr(gradient)
        hidden = {key for key in free if used[key].verdict == "not identifiable"}
        sums = [item for item in self.combinations if hidden & set(item.weights)]
        dof = [*(used[key].dof for key in free), *(item.dof for item in sums)]
        known = [one for one in dof if one is not None]
        verdict = "prior" if "prior" in verdicts else "determined"
        if stderr >= WEAK_ERROR * np.linalg.norm(self.vector(gradient) * self._typical):
            verdict = "weak"
        row = self.vector(gradient)
        by_condition = [
            float(row @ self.shift(condition)) + changes.get(condition, 0.0)
            for condition in self.widths
        ]
        systematic = math.hypot(*by_condition) if by_condition else None
        return Derived(
            name, value, stderr, verdict, systematic, dof=min(known) if known else None
        )


def check_derived(texts: Sequence[str], names: Sequence[str]) -> None:
    """Raise `InputError`, before a fit, for an expression that is not valid for
    its parameters."""
    for text in texts:
        parse(
            text,
            (*names, *(key for key in (*STONE_UNITS, *CONSTANTS) if key not in names)),
            {},
        )


def derive(
    known: FirstOrder, text: str, samples: Mapping[str, Floats] | None = None
) -> Derived:
    """A derived quantity from its expression.

    Parameters
    ----------
    text : arithmetic of parameters, determined combinations, the stone's R, rho, h and
        m, g and pi.
    samples : of the posterior, by parameter.

    Raises
    ------
    InputError : it is not arithmetic of such names, or has no finite value or
        derivative at the estimates.
    """
    constants = {**CONSTANTS, **known.stone}
    values = {name: item.value for name, item in known.parameters.items()}
    constants = {name: value for name, value in constants.items() if name not in values}
    sums = {item.expression: item.weights for item in known.combinations}
    expression = parse(text, (*values, *constants), sums)
    at = {**constants, **values}
    value, gradient = float(expression.of(at)), expression.gradient(at)
    own = {name: slope for name, slope in gradient.items() if name in values}
    for sound, fault in (
        (math.isfinite(value), "it has no finite value at the estimates"),
        (
            all(map(math.isfinite, gradient.values())),
            "it has no derivative at the estimates",
        ),
        (
            own,
            "it contains no parameter of the fit; the parameters are "
            + ", ".join(values),
        ),
    ):
        if not sound:
            raise InputError(f"derive {quoted(expression.text)}: {fault}")
    changes = {
        name: slope * known.widths[name]
        for name, slope in gradient.items()
        if name not in values and name in known.widths
    }

    def slopes(moved: Mapping[str, float]) -> dict[str, float]:
        found = expression.gradient({**constants, **moved})
        return {name: slope for name, slope in found.items() if name in values}

    seen = _seen_along_the_ridge(known, values, slopes)
    found = known.assess(expression.text, value, own, changes, seen=seen)
    if samples is None:
        return found
    return with_quantiles(found, expression.of({**constants, **samples}))


def with_quantiles(quantity: Derived, samples: Floats) -> Derived:
    """The quantity with the quantiles of its finite samples."""
    known = samples[np.isfinite(samples)]
    return replace(quantity, quantiles=quantiles_of(known)) if len(known) else quantity


def quantiles_of(samples: Floats) -> dict[str, float]:
    """Quantiles of samples, by `LEVELS`."""
    found = np.quantile(samples, [float(level) / 100 for level in LEVELS])
    return dict(zip(LEVELS, map(float, found), strict=True))


def _seen_along_the_ridge(
    known: FirstOrder,
    values: Mapping[str, float],
    slopes: Callable[[Mapping[str, float]], dict[str, float]],
) -> bool:
    """Whether the gradient vanishes along the null directions elsewhere on the ridge as
    well: that of a product a b vanishes along a - b only where a = b."""
    space = known.null_space()
    if not len(space):
        return True
    random = np.random.default_rng(0)
    for step in random.standard_normal((_TRIES, len(space))) @ space:
        moved = dict(values)
        for name, by in zip(known.names, step, strict=True):
            item = known.parameters[name]
            ends = max(item.lower, -1e300), min(item.upper, 1e300)
            moved[name] = min(max(values[name] + by * item.typical, ends[0]), ends[1])
        gradient = slopes(moved)
        if all(map(math.isfinite, gradient.values())) and not known.sees(gradient):
            return False
    return True
