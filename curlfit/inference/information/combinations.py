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

import numpy as np

from curlfit.inference.information.intervals import WithInterval
from curlfit.inference.information.verdict import Verdict
from curlfit.numerics.arrays import Booleans, Floats

NO_PART = 1e-3
"""Share of a direction below which a parameter takes no part in it."""
LITTLE_PART = 0.05
"""The same for a direction that is weakly determined."""
_WHOLE = np.arange(1.0, 7)[:, None, None]  # denominators of simple ratios


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


def combinations_of(
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
    for least, wholes in ((LITTLE_PART, _WHOLE[:1]), (0.0, _WHOLE)):
        dim = np.concatenate([null, np.where(np.abs(unit) > least, unit, 0.0)])
        _, size, rows = np.linalg.svd((dim * typical)[:, weak])
        rank = (size > size[0] * max(len(dim), weak.sum()) * np.finfo(float).eps).sum()
        rows = tidy_basis(rows[rank:], None, least or NO_PART, wholes)
        vectors = np.zeros((len(rows), len(names)))
        vectors[:, weak] = rows
        variances = ((vectors @ covariance) * vectors).sum(-1)
        scaled = vectors * typical
        if (
            np.abs(scaled @ null.T) < NO_PART * np.linalg.norm(scaled, axis=1)[:, None]
        ).all() and (2 * (scaled @ loose.T) ** 2 <= variances[:, None]).all():
            break
    sums: dict[str, Combination] = {}
    for row, vector, variance in zip(rows, vectors, variances, strict=True):
        weights, stderr = named(row, names, weak), math.sqrt(variance)
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


def tidy_basis(
    rows: Floats,
    scale: Floats | None,
    close: float = NO_PART,
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


def named(row: Floats, names: Sequence[str], where: Booleans) -> dict[str, float]:
    """Weights other than zero by name, of the parameters `where` a row has them."""
    chosen = [name for name, take in zip(names, where, strict=True) if take]
    return {
        name: float(weight)
        for name, weight in zip(chosen, row, strict=True)
        if abs(weight) > 0
    }
