"""A quantity derived from the parameters of a fit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from curlfit.inference.derived.quantiles import Quantiles, quantiles_of
from curlfit.inference.information.intervals import WithInterval
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.output.text import sided
from curlfit.records import ADDED


@dataclass(frozen=True)
class Derived(WithInterval):
    """A quantity derived from the parameters of a fit.

    Attributes
    ----------
    expression : arithmetic of the parameters, or the name of a quantity of the path.
    value : at the estimates.
    stderr : standard error, from the covariance to first order, or what the ridge of
        the fit demands; None where the quantity is not determined, or depends on a
        parameter at its bound.
    verdict : "determined"; "prior" (it rests on priors); "weak" (its standard error is
        more than half of what typical sizes of its parameters imply, or it moves along
        the ridge by more than a quarter of that); "not identifiable" (it depends on a
        direction that the path does not determine); "at bound" or "fixed".
    systematic : error due to the conditions that the fit holds fixed; None where
        there is none, or where it is not known.
    dof : degrees of freedom of `stderr`, the smallest of its parameters'; None where
        sigma was given.
    quantiles : of the posterior, "2.5" to "97.5"; empty without a chain.
    meaning : of a quantity of the path; of a product that the fit derives, how its
        factors change along the ridge.
    unit : of a quantity of the path.
    reason : of one that moves along the ridge, the values that fit nearly as well.
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
    reason: str = field(default="", metadata=ADDED)


def scaled(quantity: Derived, factor: float) -> Derived:
    """The quantity times a factor."""

    def scaled_error(error: float | None) -> float | None:
        return None if error is None else error * abs(factor)

    # a negative factor turns their order
    quantiles = sorted(value * factor for value in quantity.quantiles.values())
    return replace(
        quantity,
        value=quantity.value * factor,
        stderr=scaled_error(quantity.stderr),
        systematic=scaled_error(quantity.systematic),
        quantiles=dict(zip(quantity.quantiles, quantiles, strict=True)),
    )


def to_its_side(quantity: Derived) -> Derived:
    """A signed quantity as a positive one, with its side in words."""
    meaning, sign = sided(quantity.meaning, quantity.value)
    if sign >= 0:
        return quantity
    return scaled(replace(quantity, meaning=meaning), sign)


def with_quantiles(quantity: Derived, samples: Floats) -> Derived:
    """The quantity with the quantiles of its finite samples."""
    finite = samples[np.isfinite(samples)]
    if not len(finite):
        return quantity
    return replace(quantity, quantiles=quantiles_of(finite))
