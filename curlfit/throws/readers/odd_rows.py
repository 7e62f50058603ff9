"""Rows of a stopwatch table that contradict the others: typing errors, as a rule.

Each column is regressed on what else is known of the rows: their order, for ice that
changes along an evening, labels such as the sheet, and the column that goes with it (a
time with the place at rest, a curl with the turns). A value is odd if it is farther
from what the rows without it say than chance allows: externally studentised residuals,
by Student's t with n - p - 1 degrees of freedom, and 1 % for the whole table by
Bonferroni (Cook and Weisberg 1982, Residuals and Influence in Regression, sect. 2.2).
Odd rows hide one another, so that the first fit is by least absolute deviations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from curlfit.numerics.arrays import Booleans, Floats

_PARTNERS = {
    "back_to_hog": "rest",
    "hog_to_hog": "rest",
    "hog_to_tee": "rest",
    "hog_to_rest": "rest",
    "speed": "rest",
    "rest": "hog_to_hog",
    "curl": "turns",
}
"""The column that goes with another."""
_SHARE = 0.7
"""Of the median, within which two weights in play may differ."""
_CHANCE = 0.01
"""Probability that a table without errors has an odd value."""
_ROWS_PER_TERM = 4
"""Rows for each term of a regression, below which it gets no further one."""
_FEWEST = 3
"""Degrees of freedom of the scatter, below which nothing is called odd."""
_FIRST_GUESS = 3.5
"""Robust standard deviations from the first fit, beyond which a value does not count
in the second."""
_ROUNDS = 10
"""Fits at most, until those that count are those that agree."""
_REWEIGHTED = 30
"""Fits that approach the least absolute deviations."""
_MOST_GROUPS = 12
"""Groups of a label that is used, as sheets or teams are: the time of a regression
grows with the square of its terms."""


class OddValue(NamedTuple):
    """A value that contradicts the other rows."""

    row: int
    column: str
    value: float
    off: float
    """the value less what the others say"""
    p: float
    """probability of a value so far off by chance"""


def odd_values(
    columns: Mapping[str, Floats],
    floors: Mapping[str, float],
    usual: Mapping[str, float],
    labels: Sequence[Mapping[str, str]],
) -> list[OddValue]:
    """The odd value of each odd row, in their order.

    Parameters
    ----------
    columns : values by name, NaN where a row has none, each of shape (rows,).
    floors : scatter of a column that is expected at least, from its measurement.
    usual : differences by which a player may throw otherwise than before.
    labels : of each row.
    """
    rows = len(labels)
    terms = _terms(labels)
    level = _CHANCE / (2 * rows * max(len(columns), 1))
    odd: dict[int, OddValue] = {}
    usable = np.ones(rows, bool)
    # A partner with a gross error would bend the regression, so its row goes first.
    # By itself a value is odd only if no player throws so differently.
    for with_partner in (False, True):
        for name, values in columns.items():
            design = terms
            least = max(usual[name], _SHARE * abs(float(np.nanmedian(values))))
            if with_partner:
                partner = columns.get(_PARTNERS.get(name, ""))
                if partner is None:
                    continue
                design = np.column_stack([terms[:, :1], partner, terms[:, 1:]])
                least = 0.0
            for value in _beyond(name, values, design, floors[name], usable, level):
                if abs(value.off) <= least:
                    continue
                other_of_row = odd.get(value.row)
                if other_of_row is None or value.p < other_of_row.p:
                    odd[value.row] = value
        usable[list(odd)] = False
    return [odd[row] for row in sorted(odd)]


def _terms(labels: Sequence[Mapping[str, str]]) -> Floats:
    """Columns of a regression, the most common first: a mean, the order of the rows,
    and the groups of each label that has few."""
    rows = len(labels)
    columns = [np.ones(rows), np.linspace(-1.0, 1.0, rows)]
    names = {name: None for row in labels for name in row}
    for name in names:
        groups = [row.get(name, "") for row in labels]
        members = sorted(set(groups))
        if 1 < len(members) <= min(_MOST_GROUPS, rows / _ROWS_PER_TERM):
            columns += [
                np.array([group == member for group in groups], float)
                for member in members[1:]
            ]
    return np.column_stack(columns)


def _beyond(
    name: str,
    values: Floats,
    design: Floats,
    floor: float,
    usable: Booleans,
    level: float,
) -> list[OddValue]:
    """The values of a column that are farther from the others than chance allows.

    Parameters
    ----------
    design : terms of the regression, the most common first, shape (rows, terms).
    floor : scatter that is expected at least.
    usable : rows that may count. level : probability below which a value is odd.
    """
    from scipy.special import stdtr  # slow to load

    complete = np.flatnonzero(
        usable & np.isfinite(values) & np.isfinite(design).all(axis=1)
    )
    terms = min(design.shape[1], max(len(complete) // _ROWS_PER_TERM, 1))
    rows = design[complete, :terms]
    measured = values[complete]
    left = measured - rows @ _least_absolute(rows, measured, floor)
    scatter = max(1.4826 * float(np.median(np.abs(left))), floor)  # of normal values
    counts = np.abs(left) <= _FIRST_GUESS * scatter
    p = np.ones(len(complete))
    for _ in range(_ROUNDS):
        freedom = int(counts.sum()) - terms
        if freedom < _FEWEST:
            return []
        inverse = np.linalg.pinv(rows[counts].T @ rows[counts])
        left = measured - rows @ (inverse @ (rows[counts].T @ measured[counts]))
        leverage = ((rows @ inverse) * rows).sum(axis=1)
        squares = float(left[counts] @ left[counts])
        inside = np.maximum(1.0 - leverage, 1e-9)
        without = np.where(counts, squares - left**2 / inside, squares)
        free = np.where(counts, freedom - 1, freedom)
        variance = np.maximum(without / free, floor**2)
        t = np.abs(left) / np.sqrt(variance * np.where(counts, inside, 1.0 + leverage))
        p = 2.0 * stdtr(free, -t)
        agree = p >= level
        if (agree == counts).all():
            break
        counts = agree
    # what a value is off by is from a fit without it
    off = np.where(counts, left / inside, left)
    return [
        OddValue(int(complete[k]), name, float(measured[k]), float(off[k]), float(p[k]))
        for k in np.flatnonzero(p < level)
    ]


def _least_absolute(rows: Floats, values: Floats, floor: float) -> Floats:
    """Coefficients with the least sum of absolute deviations, by reweighting."""
    weights = np.ones(len(values))
    solution: Floats = np.zeros(rows.shape[1])
    for _ in range(_REWEIGHTED):
        root = np.sqrt(weights)
        solution = np.linalg.pinv(rows * root[:, None]) @ (values * root)
        weights = 1.0 / np.maximum(np.abs(values - rows @ solution), floor / 10.0)
    return solution
