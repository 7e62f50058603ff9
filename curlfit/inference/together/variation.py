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
    in_combinations = {name for item in combinations for name in item.weights}
    weights_by_name: dict[str, Mapping[str, float]] = {}
    for name, verdict in verdicts.items():
        is_weak = verdict == Verdict.WEAK and name not in in_combinations
        if verdict == Verdict.DETERMINED or is_weak:
            weights_by_name[name] = {name: 1.0}
    for item in combinations:
        weights_by_name[item.expression] = item.weights
    return {
        expression: np.array([weights.get(name, 0.0) for name in names])
        for expression, weights in weights_by_name.items()
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
        estimates = alone.estimates(expression, of_sum)
        each: list[tuple[float, float] | None] = []
        shares = []
        for estimate, error in zip(estimates, errors, strict=True):
            if estimate is None or error is None:
                each.append(None)
            else:
                each.append(estimate)
                shares.append(error**-2)
        if len(shares) > 1 + covariates.shape[1]:
            variations[expression] = _variation(
                expression, each, np.array(shares), covariates
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
            errors_or_none = errors_by_rows(jointly, of_sum, typical)
            errors = [error for error in errors_or_none if error is not None]
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
    each: Sequence[tuple[float, float] | None],
    shares: Floats,
    covariates: Floats,
) -> Variation:
    """How a coefficient or combination varies between throws.

    Parameters
    ----------
    each : estimate and standard error from each throw; None where it gives none.
    shares : weights in the joint fit of the throws that give one.
    covariates : on which it depends, with mean zero, shape (throws, covariates).
    """
    from scipy.optimize import brentq  # slow to load

    gives_one = [pair is not None for pair in each]
    estimate, stderr = np.array([pair for pair in each if pair is not None]).T
    design = np.column_stack([np.ones(len(stderr)), covariates[gives_one]])
    degrees = len(stderr) - np.linalg.matrix_rank(design)
    variance = stderr**2

    def fitted(between: float) -> tuple[float, float, float]:
        """Mean of the throws and its variance, and chi squared about the regression on
        the covariates, where throws have a variance `between` them."""
        root = (variance + between) ** -0.5
        inverse = np.linalg.pinv(design * root[:, None])
        solution = inverse @ (estimate * root)
        residual = (estimate - design @ solution) * root
        of_mean = (inverse[0] ** 2).sum()
        return float(solution[0]), float(of_mean), float(residual @ residual)

    _, _, q = fitted(0.0)
    between = 0.0
    if q > degrees:
        high = float(estimate.var())
        while fitted(high)[2] > degrees:
            high *= 2
        between = brentq(
            lambda variance: fitted(variance)[2] - degrees, 0.0, high, xtol=1e-300
        )
    mean, variance_of_mean, _ = fitted(between)
    share = shares / shares.sum()
    return Variation(
        expression=expression,
        each=tuple(each),
        p_value=float(chdtrc(degrees, q)),
        spread=float(np.sqrt(between)),
        mean=mean,
        stderr=float(np.sqrt(variance_of_mean)),
        shared_stderr=float(np.sqrt(share**2 @ (variance + between))),
    )
