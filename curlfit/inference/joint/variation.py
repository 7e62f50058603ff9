"""Whether throws that were fitted together agree, apart from what covariates explain.

The estimate that each throw alone would give, to first order about the joint optimum,
is compared with the shared one (Cochran 1954). Where sigma is not given it is that of
the throw alone, since the joint fit takes the misfit to a common value for noise. The
spread between throws is that at which the differences are as large as expected (Paule
and Mandel 1982).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import (
    WEAK_ERROR,
    Bounded,
    Combination,
    stderr_of,
    visible,
)
from curlfit.inference.joint.effects import Covariates
from curlfit.inference.joint.result import Variation
from curlfit.inference.least_squares import Solution, Tasks, residual_sigma
from curlfit.numerics.arrays import Booleans, Floats


class Alone(NamedTuple):
    """What a throw alone determines, to first order about the joint optimum."""

    step: Floats
    """from the joint optimum to that of the throw, in typical sizes"""
    right: Floats
    """determined directions in typical sizes, as orthonormal rows"""
    singular: Floats
    """1 over the standard errors along them"""

    @classmethod
    def of(
        cls, jacobian: Floats, residual: Floats, bounded: Bounded, typical: Floats
    ) -> Alone:
        """`jacobian`, of the weighted residuals, is in typical sizes, shape
        (channels, n, p)."""
        flat = jacobian.reshape(-1, len(typical))
        left, singular, right = np.linalg.svd(flat, full_matrices=False)
        seen = visible(singular) & ~bounded.confine(right, singular, typical)
        left, singular, right = left[:, seen], singular[seen], right[seen]
        return cls(-right.T @ (left.T @ residual.ravel() / singular), right, singular)

    def stderr(self, weights: Floats) -> float | None:
        """Standard error of a weighted sum; None where the throw does not
        determine it."""
        return stderr_of(weights, self.right, self.singular)


def wanted_of(
    verdicts: Mapping[str, str],
    combinations: Sequence[Combination],
    names: Sequence[str],
) -> dict[str, Floats]:
    """Weights of parameters in the coefficients that are determined, and
    in combinations."""
    combined = {name for item in combinations for name in item.weights}
    wanted = {
        name: {name: 1.0}
        for name, verdict in verdicts.items()
        if verdict == "determined" or (verdict == "weak" and name not in combined)
    } | {item.expression: item.weights for item in combinations}
    return {
        expression: np.array([weights.get(name, 0.0) for name in names])
        for expression, weights in wanted.items()
    }


def told_by_each(
    rows: Floats, typical: Floats, wanted: Mapping[str, Floats]
) -> dict[str, Floats]:
    """Those of some coefficients and combinations that a throw of average information
    determines beside one another, the best determined first.

    Parameters
    ----------
    typical : sizes of the parameters of a throw; 0 of fixed ones.
    wanted : weights of the parameters of a throw by coefficient or combination.
    """
    rows = rows * typical
    information = (rows.mT @ rows).mean(0)

    def errors(names: Iterable[str]) -> Floats:
        """Standard errors over typical sizes, where nothing else varies."""
        weights = np.array([wanted[name] * typical for name in names])
        directions = np.linalg.pinv(weights)
        squares = np.diagonal(np.linalg.pinv(directions.T @ information @ directions))
        size = np.abs(weights).max(1)
        known = (size > 0) & (squares > 0)
        found: Floats = np.where(
            known, np.sqrt(squares) / np.where(known, size, 1.0), np.inf
        )
        return found

    chosen: list[str] = []
    while rest := [name for name in wanted if name not in chosen]:
        worst = {name: errors([*chosen, name]).max() for name in rest}
        best = min(rest, key=worst.__getitem__)
        if not worst[best] < WEAK_ERROR:
            break
        chosen.append(best)
    return {name: wanted[name] for name in wanted if name in chosen}


def variations_of(
    throws: Sequence[tuple[Alone, Alone]],
    free: Booleans,
    best: Floats,
    wanted: Mapping[str, Floats],
    typical: Floats,
    covariates: Floats,
) -> tuple[Variation, ...]:
    """Variation of the shared coefficients as each throw alone gives them, to
    first order.

    Parameters
    ----------
    throws : each with the noise that the weights in the mean are from, and
        with its own.
    free : the parameters of each that are so, shape (throws, parameters).
    best : where the parameters in common are, beside the others of any throw.
    wanted : weights of the parameters of a throw by coefficient or combination.
    covariates : on which the coefficients depend, with mean zero, shape
        (throws, covariates).
    """
    found = []
    for expression, weights in wanted.items():
        whole, value = weights * typical, float(weights @ best)
        each: list[tuple[float, float] | None] = []
        weight = []
        for (joint, own), open_ in zip(throws, free, strict=True):
            vector = whole[open_]
            stderr, assumed = own.stderr(vector), joint.stderr(vector)
            if stderr is None or assumed is None:
                each.append(None)
                continue
            each.append((value + float(vector @ own.step), stderr))
            weight.append(assumed**-2)
        if len(weight) > 1 + covariates.shape[1]:
            found.append(_variation(expression, each, np.array(weight), covariates))
    return tuple(found)


def as_fitted_alone(
    variation: Variation,
    weights: Floats,
    fits: Sequence[FitResult | None],
    covariates: Covariates,
) -> Variation:
    """The same with the fit of each throw alone in place of a step from the joint
    optimum, which is far from it where chi squared is no quadratic; of what contains
    conditions the same as before.

    Parameters
    ----------
    weights : of the parameters of a throw, the coefficients first.
    fits : None of a throw whose fit failed.
    """
    first = next((fit for fit in fits if fit is not None), None)
    if first is None or weights[len(first.coefficients) :].any():
        return variation
    weights = weights[: len(first.coefficients)]
    each: list[tuple[float, float] | None] = []
    for fit in fits:
        stderr = None if fit is None else fit.stderr_of_coefficients(weights)
        if fit is None or stderr is None:
            each.append(None)
        else:
            each.append((float(weights @ fit.values[: len(weights)]), stderr))
    errors = np.array([one[1] for one in each if one is not None])
    if len(errors) <= 1 + covariates.values.shape[1]:
        return replace(variation, each=tuple(each), p_value=1.0, spread=0.0)
    return _variation(variation.expression, each, errors**-2, covariates.values)


def each_alone(
    solution: Solution, tasks: Tasks, unknown: Booleans, free: Booleans
) -> list[tuple[Alone, Alone]]:
    """Of each throw and its `free` parameters, shape (throws, parameters), with the
    noise of the joint fit and with that of its own where it is `unknown`, shape
    (throws, channels), since it was estimated from least squares."""
    typical = tasks.typical
    jacobians = solution.jacobian * typical

    def analysed(scale: Floats) -> list[Alone]:
        return [
            Alone.of(
                jacobian[..., own] / sigma[:, None, None],
                residual / sigma[:, None],
                Bounded(*(part[own] for part in ends)),
                typical[own],
            )
            for jacobian, residual, sigma, own, *ends in zip(
                jacobians,
                solution.residual,
                scale,
                free,
                solution.values,
                tasks.lower,
                tasks.upper,
                strict=True,
            )
        ]

    joint = analysed(np.ones(unknown.shape))
    steps = np.zeros(free.shape)
    for step, own, one in zip(steps, free, joint, strict=True):
        step[own] = one.step
    left = solution.residual + (jacobians @ steps[:, None, :, None])[..., 0]
    problems = tasks.problems
    sigma = residual_sigma(solution._replace(residual=left), problems, free)
    sigma = np.where(unknown, sigma * problems.weight.max(-1), 1.0)
    return list(zip(joint, analysed(sigma), strict=True))


def _variation(
    expression: str,
    each: Sequence[tuple[float, float] | None],
    shared: Floats,
    covariates: Floats,
) -> Variation:
    """`shared` are the weights of the throws in the joint fit."""
    from scipy.optimize import brentq  # slow to load

    known = [item is not None for item in each]
    estimate, stderr = np.array([item for item in each if item is not None]).T
    design = np.column_stack([np.ones(len(stderr)), covariates[known]])
    variance, degrees = stderr**2, len(stderr) - np.linalg.matrix_rank(design)

    def about_mean(between: float) -> tuple[float, float, float]:
        """Mean of the throws, its variance, and chi squared about the
        expected values."""
        root = (variance + between) ** -0.5
        inverse = np.linalg.pinv(design * root[:, None])
        found = inverse @ (estimate * root)
        off = (estimate - design @ found) * root
        return float(found[0]), float((inverse[0] ** 2).sum()), float(off @ off)

    q, between = about_mean(0.0)[2], 0.0
    if q > degrees:
        high = float(estimate.var())
        while about_mean(high)[2] > degrees:
            high *= 2
        between = brentq(
            lambda size: about_mean(size)[2] - degrees, 0.0, high, xtol=1e-300
        )
    mean, of_mean, _ = about_mean(between)
    share = shared / shared.sum()
    return Variation(
        expression=expression,
        each=tuple(each),
        p_value=float(chdtrc(degrees, q)),
        spread=float(np.sqrt(between)),
        mean=mean,
        stderr=float(np.sqrt(of_mean)),
        shared_stderr=float(np.sqrt(share**2 @ (variance + between))),
    )
