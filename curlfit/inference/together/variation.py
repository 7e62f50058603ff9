"""Whether throws that were fitted together agree, apart from what covariates explain.

The estimates of the throws, each fitted by itself, are compared with one another
(Cochran 1954). Where sigma is not given it is that of the throw alone, since the joint
fit takes the misfit to a common value for noise. The spread between throws is that at
which the differences are as large as expected (Paule and Mandel 1982).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np
from scipy.special import chdtrc

from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.together.alone import ThrowsAlone, errors_by_rows
from curlfit.inference.together.result import Variation
from curlfit.numerics.arrays import Floats

_FEWEST = 3  # throws that tell how something varies
_LEAST_SPREAD = 0.1  # over the standard error from a throw, where a search begins


def weights_of_known(
    verdicts: Mapping[str, Verdict],
    combinations: Sequence[Combination],
    names: Sequence[str],
) -> dict[str, Floats]:
    """Weights of parameters in the coefficients that are determined, and
    in combinations."""
    in_combinations = {
        name for combination in combinations for name in combination.weights
    }
    weights_by_expression: dict[str, Mapping[str, float]] = {}
    for name, verdict in verdicts.items():
        is_weak = verdict == Verdict.WEAK and name not in in_combinations
        if verdict == Verdict.DETERMINED or is_weak:
            weights_by_expression[name] = {name: 1.0}
    for combination in combinations:
        weights_by_expression[combination.expression] = combination.weights
    return {
        expression: np.array([weights.get(name, 0.0) for name in names])
        for expression, weights in weights_by_expression.items()
    }


def variations_of(
    alone: ThrowsAlone,
    jointly: Floats,
    weights: Mapping[str, Floats],
    covariates: Floats,
) -> dict[str, Variation]:
    """How coefficients and combinations, by expression, vary between throws.

    Parameters
    ----------
    jointly : rows of what each throw tells within the joint fit, of which its weight in
        a shared estimate follows, shape (throws, rows, parameters).
    weights : of the parameters, by expression.
    covariates : on which the coefficients depend, with mean zero, shape
        (throws, covariates).
    """
    variations = {}
    for expression, of_sum in weights.items():
        errors = errors_by_rows(jointly, of_sum, alone.typical)
        estimates: list[tuple[float, float] | None] = []
        shares = []
        for estimate, error in zip(
            alone.estimates(expression, of_sum), errors, strict=True
        ):
            if estimate is None or error is None:
                estimates.append(None)
            else:
                estimates.append(estimate)
                shares.append(error**-2)
        if len(shares) > 1 + covariates.shape[1]:
            variations[expression] = _variation(
                expression, estimates, np.array(shares), covariates
            )
    return variations


class Varying(NamedTuple):
    """What varies between throws."""

    weights: dict[str, Floats]
    """of the parameters in common, by coefficient or combination"""
    first_spreads: Floats
    """standard deviations between throws above zero, from which better ones
    are searched"""

    @classmethod
    def of(
        cls,
        jointly: Floats,
        weights: Mapping[str, Floats],
        variations: Mapping[str, Variation],
        typical: Floats,
    ) -> Self:
        """What enough throws tell of within the joint fit."""
        first_spreads = {}
        for expression, of_sum in weights.items():
            error_by_throw = errors_by_rows(jointly, of_sum, typical)
            errors = [error for error in error_by_throw if error is not None]
            if len(errors) >= _FEWEST:
                least = _LEAST_SPREAD * float(np.median(errors))
                variation = variations.get(expression)
                spread = 0.0 if variation is None else variation.spread
                first_spreads[expression] = max(spread, least)
        return cls(
            {name: weights[name] for name in first_spreads},
            np.array([*first_spreads.values()]),
        )


def _variation(
    expression: str,
    estimate_by_throw: Sequence[tuple[float, float] | None],
    shares: Floats,
    covariates: Floats,
) -> Variation:
    """How a coefficient or combination varies between throws.

    Parameters
    ----------
    estimate_by_throw : estimate and standard error from each throw; None where it
        gives none.
    shares : weights in the joint fit of the throws that give one.
    covariates : on which it depends, with mean zero, shape (throws, covariates).
    """
    from scipy.optimize import brentq  # slow to load

    gives_estimate = [estimate is not None for estimate in estimate_by_throw]
    estimates = np.array([pair for pair in estimate_by_throw if pair is not None])
    regression = _Regression(
        values=estimates[:, 0],
        variances=estimates[:, 1] ** 2,
        design=np.column_stack([np.ones(len(estimates)), covariates[gives_estimate]]),
    )
    degrees = len(estimates) - np.linalg.matrix_rank(regression.design)
    q = regression.fitted(0.0).chi_squared
    between = 0.0  # variance between throws
    if q > degrees:
        high = float(regression.values.var())
        while regression.fitted(high).chi_squared > degrees:
            high *= 2
        between = brentq(
            lambda variance: regression.fitted(variance).chi_squared - degrees,
            0.0,
            high,
            xtol=1e-300,
        )
    fit = regression.fitted(between)
    share = shares / shares.sum()
    variance_of_shared = share**2 @ (regression.variances + between)
    return Variation(
        expression=expression,
        each=tuple(estimate_by_throw),
        p_value=float(chdtrc(degrees, q)),
        spread=float(np.sqrt(between)),
        mean=fit.mean,
        stderr=float(np.sqrt(fit.variance_of_mean)),
        shared_stderr=float(np.sqrt(variance_of_shared)),
    )


class _RegressionFit(NamedTuple):
    """Estimates of throws on their covariates, for some variance between throws."""

    mean: float
    variance_of_mean: float
    chi_squared: float
    """of the estimates about the regression"""


class _Regression(NamedTuple):
    """Estimates of throws and what they depend on."""

    values: Floats
    """of the throws, shape (throws,)"""
    variances: Floats
    """squared standard errors, shape (throws,)"""
    design: Floats
    """a column of ones and the covariates, shape (throws, 1 + covariates)"""

    def fitted(self, between: float) -> _RegressionFit:
        """By weighted least squares, where throws have a variance `between` them."""
        root = (self.variances + between) ** -0.5
        inverse = np.linalg.pinv(self.design * root[:, None])
        solution = inverse @ (self.values * root)
        residual = (self.values - self.design @ solution) * root
        variance_of_mean = (inverse[0] ** 2).sum()
        return _RegressionFit(
            float(solution[0]), float(variance_of_mean), float(residual @ residual)
        )
