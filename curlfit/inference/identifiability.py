"""What the data determine: singular values of the scaled Jacobian, and their
directions in words.

Columns of the Jacobian of the residuals (in units of their sigma) are scaled by the
typical size of each parameter. A singular value s then means that the data determine
its direction to 1/s typical sizes: below 1 the direction is weakly determined; below
`_UNSEEN`, or below the rounding error of the largest singular value, it is not
determined at all. Nor is a weak one along which the bounds leave less room than a tenth
of a standard error: only the bounds determine it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.verdict import Verdict
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.principal_axes import principal_axes

_UNSEEN = 1e-3  # known to no better than a thousand typical sizes
_ROUNDING = 1e-9  # over the largest singular value
_NO_PART = 1e-3  # share of a direction below which a parameter takes no part in it
_LITTLE_PART = 0.05  # the same for a direction that is weakly determined
# standard errors within the bounds, below which these determine a direction
_ROOM = 0.1
_WHOLE = np.arange(1.0, 7)[:, None, None]  # denominators of simple ratios
# singular value below which a direction is known to no better than typical sizes
_WEAK = 1.0
# share of a sum outside the determined directions, above which it is unknown
_UNDETERMINED = 1e-3
UNKNOWN = 3.0
"""Typical sizes from an estimate, beyond which nothing is known in any case."""
WEAK_ERROR = 0.5
"""Standard error over typical size, from which an estimate is weakly determined: a 95 %
interval then reaches a typical size to either side."""
LITTLE = math.sqrt(2.0)
"""Factor up to which an error along the ridge is about that at the optimum."""
STRETCHED = 2.0
"""Factor by which the error of a sum or a derived quantity may be larger along the
ridge than at the optimum, so that it is still determined ..."""
WIDE = 0.25
"""... or this error over the typical size, up to which it is determined even then."""
FAR_LESS = 4.0
"""Error at a point of the ridge over that at the optimum, above which far less is known
there: nothing of a force of the spin, where a stone may not have spun."""
INTERVAL = 6.63
"""Rise of chi squared at the ends of a 99 % interval, of one degree of freedom: values
within it fit nearly as well."""


class WithInterval:
    """A value with its standard error and the degrees of freedom of that."""

    value: float
    stderr: float | None
    dof: float | None

    def interval(self, level: float = 0.95) -> tuple[float, float] | None:
        """Confidence interval by Student's t; None where there is no standard error."""
        if self.stderr is None:
            return None
        reach = student_quantile(level, self.dof) * self.stderr
        return self.value - reach, self.value + reach


@dataclass(frozen=True)
class Combination(WithInterval):
    """A determined weighted sum of parameters that are not determined individually.

    `dof` is the number of degrees of freedom of `stderr`; None where sigma was given.
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
    found = {name: samples[..., place] for place, name in enumerate(names)}
    sums = {
        item.expression: np.sum(
            [weight * found[name] for name, weight in item.weights.items()], 0
        )
        for item in combinations
    }
    return found | sums


@dataclass(frozen=True)
class Identifiability:
    """Directions in parameter space, by how well the data determine them.

    Attributes
    ----------
    names : the free parameters, in the order used below.
    rank : number of directions that the data determine.
    singular_values : of the scaled Jacobian, largest first.
    null_directions : directions along which the residuals stay the same, as weights by
        name, the largest being 1.
    covariance : of the free parameters, along the determined directions only.
    unseen : for each free parameter, whether it takes part in a null direction.
    combinations : what is determined in place of parameters that are not, or
        only weakly.
    """

    names: tuple[str, ...]
    rank: int
    singular_values: Floats
    null_directions: tuple[dict[str, float], ...]
    covariance: Floats
    unseen: Booleans
    combinations: tuple[Combination, ...]

    def determined(self) -> dict[str, Floats]:
        """Weights of the parameters in what is determined: themselves and
        the combinations."""
        unit = np.eye(len(self.names))
        weights = {
            name: unit[row]
            for row, name in enumerate(self.names)
            if not self.unseen[row]
        }
        for item in self.combinations:
            row = [item.weights.get(name, 0.0) for name in self.names]
            weights[item.expression] = np.array(row)
        return weights


def student_quantile(level: float, dof: float | None) -> float:
    """Half width, in standard errors, of a two-sided confidence interval at a level.

    Student's t with `dof` degrees of freedom; Gaussian where `dof` is None
    (sigma known).
    """
    from scipy.special import ndtri, stdtrit  # slow to load

    upper = (1 + level) / 2
    return float(ndtri(upper) if dof is None else stdtrit(dof, upper))


def directions(information: Floats, typical: Floats) -> tuple[Floats, Floats, Floats]:
    """Determined directions and null directions from the information matrix J^T J.

    Returns
    -------
    seen, singular, null : rows of orthonormal directions in scaled parameters that the
        data determine, the singular value of each, and rows that span the rest.
    """
    squared, rows = principal_axes(typical[:, None] * information * typical)
    singular = np.sqrt(np.maximum(squared, 0.0))
    # Squaring costs half the digits, hence about the square root of the rounding error.
    seen = singular > max(_UNSEEN, 1e-7 * singular[0])
    return rows[seen], singular[seen], rows[~seen]


def visible(singular: Floats) -> Booleans:
    """Which directions the data determine, from the singular values of
    scaled Jacobians."""
    found: Booleans = singular > np.maximum(_UNSEEN, _ROUNDING * singular[..., :1])
    return found


class Bounded(NamedTuple):
    """Values of parameters and their bounds, of one vector or of many."""

    values: Floats
    lower: Floats
    upper: Floats

    def confine(self, right: Floats, singular: Floats, typical: Floats) -> Booleans:
        """Which weakly determined directions, rows of `right` in scaled parameters,
        have so little room within the bounds, compared with their standard error
        1/`singular`, that only the bounds limit them."""
        step = right * typical / np.maximum(singular, 1e-300)[..., None]
        moved = (self.upper > self.lower)[..., None, :] & (np.abs(right) > _ROUNDING)
        below = np.where(moved, (self.values - self.lower)[..., None, :], np.inf)
        above = np.where(moved, (self.upper - self.values)[..., None, :], np.inf)
        size = np.maximum(np.abs(step), 1e-300)
        forward = np.where(step > 0, above, below) / size
        backward = np.where(step > 0, below, above) / size
        found: Booleans = (forward.min(-1) + backward.min(-1) < _ROOM) & (
            singular < _WEAK
        )
        return found


def confined(jacobian: Floats, bounded: Bounded, typical: Floats) -> Floats:
    """A Jacobian, or each of a stack, without the directions that only the
    bounds determine."""
    free = bounded.upper > bounded.lower
    scaled = jacobian * (typical * free)[..., None, :]
    _, singular, right = np.linalg.svd(scaled, full_matrices=False)
    null = bounded.confine(right, singular, typical) & visible(singular)
    if not null.any():
        return jacobian
    rows = right * null[..., None]
    return jacobian - (scaled @ rows.mT) @ rows / typical[..., None, :]


def demanded_errors(moved: Floats, rises: Floats) -> Floats:
    """Standard errors that the points of a ridge demand of a quantity: to first order,
    its value is within sqrt(rise) of them of the estimate.

    Parameters
    ----------
    moved : distances of its values there from the estimate. rises : of chi squared.
    """
    demanded: Floats = moved / np.sqrt(np.maximum(rises, 1.0))
    return demanded


def errors_of(slopes: Floats, weights: Floats, sizes: Floats) -> Floats:
    """Standard errors of weighted sums of parameters to first order; infinite where
    nothing is known of a sum.

    A direction moves a sum by no more than its parameters may move along it. Nothing is
    known of a sum that null directions move by more than `WIDE` of its size.

    Parameters
    ----------
    slopes : R factor of the derivatives of the residuals over their sigma.
    weights : shape (sums, parameters).
    sizes : typical sizes of the parameters; 0 of those that do not move.
    """
    _, singular, right = np.linalg.svd(slopes * sizes, full_matrices=False)
    seen = visible(singular)
    scaled = weights * sizes
    along = scaled @ right[seen].T
    outside = UNKNOWN * np.linalg.norm(scaled - along @ right[seen], axis=1)
    unknown = outside > WIDE * np.abs(scaled).max(axis=1)
    reach = np.minimum(1 / singular[seen], UNKNOWN)
    inside = np.linalg.norm(along * reach, axis=1)
    return np.where(unknown, np.inf, np.hypot(inside, outside))


def stderr_of(weights: Floats, right: Floats, singular: Floats) -> float | None:
    """Standard error of a weighted sum; None where it is undetermined.

    Parameters
    ----------
    weights : in scaled parameters.
    right, singular : determined directions, as orthonormal rows, and the singular
        value of each.
    """
    along = right @ weights
    if np.linalg.norm(weights - right.T @ along) > _UNDETERMINED * np.linalg.norm(
        weights
    ):
        return None
    return float(np.linalg.norm(along / singular))


def stderr_told(rows: Floats, weights: Floats, typical: Floats) -> float | None:
    """Standard error of a weighted sum of parameters, as rows of unit errors tell it,
    shape (rows, parameters); None where they do not."""
    _, singular, axes = np.linalg.svd(rows * typical, full_matrices=False)
    seen = visible(singular)
    return stderr_of(weights * typical, axes[seen], singular[seen])


def inverted(singular: Floats, counts: Booleans) -> Floats:
    """1/singular where it counts, else 0: the singular values of the pseudoinverse."""
    return np.where(counts, 1 / np.where(counts, singular, 1.0), 0.0)


def r_factor(matrix: Floats) -> Floats:
    """R factor (QR decomposition) of a matrix or of each of a stack: at most as many
    rows as columns, which replace all rows in least squares."""
    found: Any = np.linalg.qr(matrix, mode="r")
    return found


def r_factors(jacobians: Floats, residuals: Floats) -> Floats:
    """R factors of the Jacobians of many throws with the residuals as the last column.

    Parameters
    ----------
    jacobians : shape (throws, channels, n, parameters); `residuals` lack the last axis.
    """
    whole = np.concatenate([jacobians, residuals[..., None]], -1)
    return r_factor(whole.reshape(len(whole), -1, whole.shape[-1]))


def analyse(
    jacobian: Floats,
    names: Sequence[str],
    values: Floats,
    typical: Floats,
    slack: Floats | None = None,
    bounded: Bounded | None = None,
) -> Identifiability:
    """Split the space of the free parameters into what the data determine and what
    they do not.

    Parameters
    ----------
    jacobian : of the residuals over their sigma, shape (residuals, parameters).
    names, values, typical : of the parameters; values at which the Jacobian
        was evaluated.
    slack : contribution of other parameters, at their bounds, to the spread of these:
        columns whose outer products add to the covariance, shape (parameters, others).
    bounded : values and bounds, in the same coordinates; without them the bounds
        do not count.
    """
    rows, p = jacobian.shape
    if rows > 2 * p:
        jacobian = r_factor(jacobian)
    elif rows < p:
        jacobian = np.concatenate([jacobian, np.zeros((p - rows, p))])
    _, all_singular, right = np.linalg.svd(jacobian * typical, full_matrices=False)
    seen = visible(all_singular)
    if bounded is not None:
        seen &= ~bounded.confine(right, all_singular, typical)
    order = np.argsort(~seen, kind="stable")  # the others last
    seen, singular, right = seen[order], all_singular[order], right[order]
    inverse = right.T * inverted(singular, seen)
    covariance = typical[:, None] * (inverse @ inverse.T) * typical
    if slack is not None:
        covariance = covariance + slack @ slack.T

    def part(some: Booleans) -> Floats:
        """How much each parameter takes part in some directions, 0 to 1."""
        return np.sqrt((right[some] ** 2).sum(0))

    strong = seen & (singular >= _WEAK)
    unseen = part(~seen) > _NO_PART
    weak = unseen | (part(seen & ~strong) > _LITTLE_PART)
    null = _tidy_basis((right[~seen] * typical)[:, unseen], 1 / typical[unseen])
    return Identifiability(
        names=tuple(names),
        rank=int(seen.sum()),
        singular_values=all_singular,
        null_directions=tuple(_named(row, names, unseen) for row in null),
        covariance=covariance,
        unseen=unseen,
        combinations=_combinations(
            right[~seen],
            inverse[:, seen & ~strong].T,
            weak,
            names,
            values,
            typical,
            covariance,
        ),
    )


def classify(
    typical: float, at_bound: bool, known: Identifiability, place: int
) -> tuple[float | None, Verdict]:
    """Standard error, where there is one, and verdict of a free parameter.

    The 95 % interval of a weakly determined parameter reaches its typical size to
    either side. `place` is the index of the parameter in `known`.
    """
    if at_bound:
        return None, Verdict.AT_BOUND
    if known.unseen[place]:
        return None, Verdict.NOT_IDENTIFIABLE
    stderr = float(np.sqrt(known.covariance[place, place]))
    determined = stderr < WEAK_ERROR * typical
    return stderr, Verdict.DETERMINED if determined else Verdict.WEAK


def _combinations(
    null: Floats,
    loose: Floats,
    weak: Booleans,
    names: Sequence[str],
    values: Floats,
    typical: Floats,
    covariance: Floats,
) -> tuple[Combination, ...]:
    """Determined combinations of the weak parameters, from the directions that are not
    determined and those that are weakly, times the standard errors along these.
    Weights near whole numbers become these where that makes no variance more than
    twice as large."""
    if not weak.any():
        return ()
    unit = loose / np.linalg.norm(loose, axis=-1, keepdims=True)
    for least, wholes in ((_LITTLE_PART, _WHOLE[:1]), (0.0, _WHOLE)):
        dim = np.concatenate([null, np.where(np.abs(unit) > least, unit, 0.0)])
        _, size, rows = np.linalg.svd((dim * typical)[:, weak])
        rank = (size > size[0] * max(len(dim), weak.sum()) * np.finfo(float).eps).sum()
        rows = _tidy_basis(rows[rank:], None, least or _NO_PART, wholes)
        vectors = np.zeros((len(rows), len(names)))
        vectors[:, weak] = rows
        variances = ((vectors @ covariance) * vectors).sum(-1)
        scaled = vectors * typical
        if (
            np.abs(scaled @ null.T) < _NO_PART * np.linalg.norm(scaled, axis=1)[:, None]
        ).all() and (2 * (scaled @ loose.T) ** 2 <= variances[:, None]).all():
            break
    sums: dict[str, Combination] = {}
    for row, vector, variance in zip(rows, vectors, variances, strict=True):
        weights, stderr = _named(row, names, weak), math.sqrt(variance)
        if len(weights) > 1 and stderr < typical[weak].max():
            text, value = expression(weights), float(vector @ values)
            sums.setdefault(text, Combination(text, weights, value, stderr))
    return tuple(sums.values())


def expression(weights: dict[str, float]) -> str:
    """A combination as text: {"a": 1, "b": 1} is "a + b", {"a": -2, "b": 1}
    is "b - 2 a"."""
    text = ""
    for name, weight in sorted(weights.items(), key=lambda item: item[1] < 0):
        size = abs(weight)
        factor = "" if size == 1 else f"{Fraction(size).limit_denominator(12)} "
        if factor and abs(Fraction(size).limit_denominator(12) - size) > 1e-9:
            factor = f"{size:.4g} "
        sign = (
            ("- " if weight < 0 else "")
            if not text
            else (" - " if weight < 0 else " + ")
        )
        text += f"{sign}{factor}{name}"
    return text


def _tidy_basis(
    rows: Floats,
    scale: Floats | None,
    close: float = _NO_PART,
    wholes: Floats = _WHOLE,
) -> Floats:
    """A basis of the same space in reduced row echelon form, with ratios of small
    integers where close.

    Parameters
    ----------
    scale : factors of the columns by which components are compared, since those of
        parameters of other units are no smaller for being small numbers; the same for
        all if None.
    """
    if not rows.size:
        return rows
    scale = np.ones(rows.shape[1]) if scale is None else scale
    rows = _echelon(rows) if len(rows) > 1 else rows
    size = np.abs(rows)
    first = np.argmax(size > 0.999 * size.max(-1, keepdims=True), -1)[:, None]
    rows = rows / np.take_along_axis(rows, first, -1)
    near = np.round(rows * wholes) / wholes
    off = np.abs(near - rows)
    near = np.take_along_axis(near, off.argmin(0)[None], 0)[0]
    share = off.min(0) * scale / scale[first]
    return np.where(share < close, near, rows)


def _echelon(rows: Floats) -> Floats:
    """Reduced row echelon form of independent rows; the largest entry of a column
    is its pivot."""
    rows = np.array(rows, float)
    place = 0
    for row in range(len(rows)):
        while place < rows.shape[1]:
            pivot = row + int(np.argmax(np.abs(rows[row:, place])))
            if abs(rows[pivot, place]) > 1e-6 * np.abs(rows[row:]).max():
                break
            place += 1
        if place == rows.shape[1]:
            return rows[:row]
        rows[[row, pivot]] = rows[[pivot, row]]
        rows[row] /= rows[row, place]
        for other in range(len(rows)):
            if other != row:
                rows[other] -= rows[other, place] * rows[row]
        place += 1
    return rows


def _named(row: Floats, names: Sequence[str], where: Booleans) -> dict[str, float]:
    chosen = [name for name, take in zip(names, where, strict=True) if take]
    return {
        name: float(weight)
        for name, weight in zip(chosen, row, strict=True)
        if abs(weight) > 0
    }
