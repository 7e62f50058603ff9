"""Determined combinations of parameters, as words.

Where parameters are not determined one by one, sums of them are: "mu1_eta + mu2_eta".
A basis of these is made readable: reduced row echelon form, so that each sum has few
parameters, and weights near ratios of small whole numbers become these where that costs
little of their precision.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import compress

import numpy as np

from curlfit.inference.information.intervals import WithInterval
from curlfit.inference.information.thresholds import LITTLE_PART, NO_PART
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Booleans, Floats

_DENOMINATORS = np.arange(1.0, 7)[:, None, None]
"""Of the simple ratios to which weights are rounded."""
_WHOLE_NUMBERS = _DENOMINATORS[:1]


@dataclass(frozen=True)
class Combination(WithInterval):
    """A determined weighted sum of parameters that are not determined individually.

    `weights` are the factors of the parameters in the sum; `dof` is the number of
    degrees of freedom of `stderr`, None where sigma was given.
    """

    expression: str
    weights: dict[str, float]
    value: float
    stderr: float | None
    dof: float | None = None

    @property
    def verdict(self) -> Verdict:
        """Always "determined"."""
        return Verdict.DETERMINED


def with_combinations(
    names: Sequence[str], samples: Floats, combinations: Iterable[Combination]
) -> dict[str, Floats]:
    """Samples (..., parameters) by the name of the parameter, and by combination."""
    by_name = {name: samples[..., index] for index, name in enumerate(names)}
    sums = {
        combination.expression: np.sum(
            [weight * by_name[name] for name, weight in combination.weights.items()], 0
        )
        for combination in combinations
    }
    return by_name | sums


def combinations_of(
    null: Floats,
    loose_errors: Floats,
    weak: Booleans,
    names: Sequence[str],
    values: Floats,
    typical: Floats,
    covariance: Floats,
) -> tuple[Combination, ...]:
    """Determined combinations of the weak parameters.

    These are sums that do not move along the directions that are not determined, nor
    along those that are loosely. First they are sought as sums with whole weights, for
    which parts of 5 % in a loose direction, and of a weight, are forgiven: with weights
    of 1 and 1.03, a + b is said. Where such a sum moves along a null direction after
    all, or where the loose directions make up more than half of its variance, the sums
    are taken with weights as they are, but for simple ratios.

    Parameters
    ----------
    null : directions that are not determined, in typical sizes, shape
        (directions, parameters).
    loose_errors : directions that are loosely determined, each times the standard error
        along it, shape (directions, parameters).
    weak : which parameters take part in these, shape (parameters,).
    covariance : of all parameters, in their units.
    """
    if not weak.any():
        return ()
    loose = loose_errors / np.linalg.norm(loose_errors, axis=-1, keepdims=True)
    without_little = np.where(np.abs(loose) > LITTLE_PART, loose, 0.0)
    weights = _weights_of_sums(
        np.concatenate([null, without_little]) * typical,
        weak,
        LITTLE_PART,
        _WHOLE_NUMBERS,
    )
    variances = ((weights @ covariance) * weights).sum(-1)
    in_typical_sizes = weights * typical
    moves = np.abs(in_typical_sizes @ null.T)
    sizes = np.linalg.norm(in_typical_sizes, axis=1, keepdims=True)
    loose_variances = (in_typical_sizes @ loose_errors.T) ** 2
    if (moves >= NO_PART * sizes).any() or (
        2 * loose_variances > variances[:, None]
    ).any():
        weights = _weights_of_sums(
            np.concatenate([null, loose]) * typical, weak, NO_PART, _DENOMINATORS
        )
        variances = ((weights @ covariance) * weights).sum(-1)
    largest = typical[weak].max()
    combinations: dict[str, Combination] = {}
    for row, variance in zip(weights, variances, strict=True):
        by_name = named(row[weak], names, weak)
        stderr = math.sqrt(variance)
        if len(by_name) < 2 or stderr >= largest:
            continue
        text = expression(by_name)
        combination = Combination(text, by_name, float(row @ values), stderr)
        combinations.setdefault(text, combination)
    return tuple(combinations.values())


def _weights_of_sums(
    avoided: Floats, weak: Booleans, close: float, denominators: Floats
) -> Floats:
    """Weights of sums of the weak parameters that do not move along some directions,
    shape (sums, parameters).

    Parameters
    ----------
    avoided : changes of the parameters along these directions, in their units: sums
        with weights orthogonal to them stay.
    close, denominators : how weights are rounded, see `tidy_basis`.
    """
    _, singular, axes = np.linalg.svd(avoided[:, weak])
    rounding = max(len(avoided), weak.sum()) * np.finfo(float).eps
    rank = (singular > singular[0] * rounding).sum()
    basis = tidy_basis(axes[rank:], None, close, denominators)
    weights = np.zeros((len(basis), len(weak)))
    weights[:, weak] = basis
    return weights


def expression(weights: dict[str, float]) -> str:
    """A combination as text: {"a": 1, "b": 1} is "a + b", {"a": -2, "b": 1}
    is "b - 2 a"."""
    text = ""
    for name, weight in sorted(weights.items(), key=lambda item: item[1] < 0):
        size = abs(weight)
        ratio = Fraction(size).limit_denominator(12)
        if size == 1:
            factor = ""
        elif abs(ratio - size) > 1e-9:
            factor = f"{size:.4g} "
        else:
            factor = f"{ratio} "
        if not text:
            sign = "- " if weight < 0 else ""
        else:
            sign = " - " if weight < 0 else " + "
        text += f"{sign}{factor}{name}"
    return text


def tidy_basis(
    axes: Floats,
    scale: Floats | None,
    close: float = NO_PART,
    denominators: Floats = _DENOMINATORS,
) -> Floats:
    """A basis of the same space in reduced row echelon form, with ratios of small
    integers where close; the largest entry of each vector is 1.

    Parameters
    ----------
    axes : vectors that span the space, shape (vectors, parameters).
    scale : factors by which the components of a direction are compared, those of a
        parameter with a small unit being no smaller for that; None for weights of sums,
        which are compared as they stand.
    close : distance from a ratio, over the largest entry, within which it is taken.
    denominators : of the ratios, shape (denominators, 1, 1).
    """
    if not axes.size:
        return axes
    scale = np.ones(axes.shape[1]) if scale is None else scale
    axes = _echelon(axes) if len(axes) > 1 else axes
    sizes = np.abs(axes)
    largest = np.argmax(sizes > 0.999 * sizes.max(-1, keepdims=True), -1)[:, None]
    axes = axes / np.take_along_axis(axes, largest, -1)
    ratios = np.round(axes * denominators) / denominators
    distances = np.abs(ratios - axes)
    nearest = np.take_along_axis(ratios, distances.argmin(0)[None], 0)[0]
    shares = distances.min(0) * scale / scale[largest]
    return np.where(shares < close, nearest, axes)


def _echelon(rows: Floats) -> Floats:
    """Reduced row echelon form of independent rows; the largest entry of a column
    is its pivot."""
    rows = np.array(rows, float)
    column = 0
    for row in range(len(rows)):
        while column < rows.shape[1]:
            pivot = row + int(np.argmax(np.abs(rows[row:, column])))
            if abs(rows[pivot, column]) > 1e-6 * np.abs(rows[row:]).max():
                break
            column += 1
        if column == rows.shape[1]:
            return rows[:row]
        rows[[row, pivot]] = rows[[pivot, row]]
        rows[row] /= rows[row, column]
        for other in range(len(rows)):
            if other != row:
                rows[other] -= rows[other, column] * rows[row]
        column += 1
    return rows


def named(row: Floats, names: Sequence[str], where: Booleans) -> dict[str, float]:
    """Weights other than zero, by name, of some of the parameters.

    Parameters
    ----------
    row : weights of these, shape (chosen,).
    names, where : of all parameters, and which of them these are.
    """
    chosen = compress(names, where)
    return {
        name: float(weight)
        for name, weight in zip(chosen, row, strict=True)
        if weight != 0.0
    }
