"""Known points of a camera: their table, and those that were clicked wrongly.

A point is odd if it is farther from where the others put it than chance allows:
externally studentised residuals in the image, by the F distribution with 2 and
2 n - 10 degrees of freedom, and 1 % for the whole table by Bonferroni (Cook and
Weisberg 1982, Residuals and Influence in Regression, sect. 2.2). Odd points hide one
another, so that the first map is that of the four points with the least median
distance of all (Rousseeuw and Leroy 1987, Robust Regression and Outlier Detection).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from math import comb
from pathlib import Path

import numpy as np

from curlfit.errors import DataError, Option
from curlfit.findings import Finding, Remedy
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.throws.readers.columns import Column, parse_header
from curlfit.throws.readers.homography import (
    Homography,
    homography,
    normalised,
    transform_rows,
)
from curlfit.throws.readers.quantities import read_quantities
from curlfit.throws.readers.table import Table
from curlfit.throws.readers.text import TextFile

_EXPECTED = (
    "expected a header u,v,x,y (pixels, and metres on the sheet) and "
    "four points or more"
)
_QUANTITIES = ("u", "v", "x", "y")
_CHANCE = 0.01
"""Probability that points without a gross error have an odd one."""
_CLICK = 0.3
"""px; error of a coordinate that is expected at least, as pixels are whole numbers."""
_FEWEST = 6
"""Points, below which none is called odd."""
_MOST_ODD = 5
"""One point in so many may be odd."""
_MOST_FOURS = 1000
"""Fours of points, from whose maps the first one is chosen."""
_LARGEST = 1e7
"""Pixels or metres; no camera and no sheet has as many."""
_ROUNDS = 10
"""Maps at most, until the points that count are those that agree."""


def load_homography(file: Path, as_given: bool = False) -> Homography:
    """Read known points (columns u, v in pixels and x, y on the sheet) and fit the
    map to them. One that is listed twice is one; odd ones are left out, and named in
    a note.

    Parameters
    ----------
    as_given : whether odd points are used.

    Raises
    ------
    DataError : a column is missing, fewer than four points, collinear points, or points
        that are not consistent with an image of a plane.
    """
    text = TextFile.read(file)
    return _fitted(file, tuple(text.lines), text.note, as_given)


# The choices of a file are checked before it is read, and a batch has one camera for
# all of its files: the fit takes far longer than the rest of a reading.
@lru_cache(maxsize=4)
def _fitted(
    file: Path, lines_of_file: tuple[str, ...], note: Finding | None, as_given: bool
) -> Homography:
    """The map of the points in the lines of a file, as of `load_homography`.

    Parameters
    ----------
    note : on what of the file was read, if it has more.
    """
    text = TextFile(file, list(lines_of_file), note)
    table, values, _ = read_quantities(text, _meaning, _QUANTITIES, _EXPECTED)
    points = np.stack([values[quantity] for quantity in _QUANTITIES])
    _require_numbers(table, points)
    lines = np.array(table.rows) + 1
    notes = [*table.findings]
    if note is not None:
        notes.append(note)
    _, first_of_each = np.unique(points, axis=1, return_index=True)
    first_of_each.sort()
    repeated = points.shape[1] - len(first_of_each)
    if repeated:
        notes.append(Finding.note("points-listed-twice", count=repeated))
    points = points[:, first_of_each]
    lines = lines[first_of_each]
    odd = {} if as_given else odd_points(points[:2], points[2:])
    if odd:
        left_out = Finding.note(
            "odd-points",
            Remedy("uses", Option("as-given"), {"count": len(odd)}),
            points=[
                {
                    "line": int(lines[k]),
                    "x": float(points[2, k]),
                    "y": float(points[3, k]),
                    "off": off,
                }
                for k, off in odd.items()
            ],
        )
        notes.append(left_out)
    good = np.delete(points, list(odd), axis=1)
    return homography(good[:2], good[2:], file)._replace(notes=tuple(notes))


def _meaning(heading: str) -> Column | None:
    """What a column of known points holds; None for another column."""
    column = parse_header(heading)
    if heading.strip().lower() == "v":  # not a speed
        return Column("v", "px", 1.0)
    return column if column and column.quantity in _QUANTITIES else None


def _require_numbers(table: Table, points: Floats) -> None:
    """Raise `DataError` for a point without all of its coordinates, shape (4, points),
    or with one that is too large."""
    bad = ~np.isfinite(points).all(axis=0)
    bad |= (np.abs(np.nan_to_num(points)) > _LARGEST).any(axis=0)
    if bad.any():
        fault = "each point needs four finite numbers u, v, x, y"
        raise table.file.error(fault, table.rows[np.argmax(bad)])


def odd_points(pixels: Floats, metres: Floats) -> dict[int, float]:
    """The points that are not where the others put them, by index, with their distance
    from there in pixels; none where more than one in five would be.

    Parameters
    ----------
    pixels, metres : shape (2, n).
    """
    from scipy.special import fdtrc  # slow to load

    n = pixels.shape[1]
    if n < _FEWEST:
        return {}
    counts = _closest(pixels, metres)
    distance = np.zeros(n)
    for _ in range(_ROUNDS):
        freedom = 2 * int(counts.sum()) - 8
        try:
            plane = homography(pixels[:, counts], metres[:, counts])
        except DataError:
            return {}
        off, slopes = _residuals(plane, pixels, metres)
        # The leverage of a point is J (J^T J)^-1 J^T, shape (2, 2), of its slopes J and
        # those of the points in the map.
        root = np.linalg.qr(slopes[counts].reshape(-1, 8), mode="r")
        shares = slopes @ np.linalg.pinv(root)
        leverage = shares @ np.swapaxes(shares, 1, 2)
        # of a point in the map, the residual is smaller than its error; of one that is
        # not, larger
        sign = np.where(counts, -1.0, 1.0)[:, None, None]
        scaled = np.linalg.solve(np.eye(2) + sign * leverage, off[..., None])[..., 0]
        square = (off * scaled).sum(axis=1)
        rest = (off[counts] ** 2).sum() - np.where(counts, square, 0.0)
        free = np.where(counts, freedom - 2, freedom)
        variance = np.maximum(rest / np.maximum(free, 1), _CLICK**2)
        p = fdtrc(2, free, square / (2 * variance))
        distance = np.hypot(*np.where(counts[:, None], scaled, off).T)
        agree = (p >= _CHANCE / n) | (free < 2)
        if n - agree.sum() > n // _MOST_ODD:
            return {}
        if (agree == counts).all():
            break
        counts = agree
    return {int(k): float(distance[k]) for k in np.flatnonzero(~counts)}


def _closest(pixels: Floats, metres: Floats) -> Booleans:
    """The four fifths of the points that agree best: of the maps that four points
    determine, that for which the farthest of them is the closest. Shape (n,)."""
    n = pixels.shape[1]
    image, _ = normalised(pixels)
    sheet, _ = normalised(metres)
    if comb(n, 4) <= _MOST_FOURS:
        fours = np.array(list(combinations(range(n), 4)))
    else:
        chance = np.random.default_rng(n)
        fours = np.argsort(chance.random((_MOST_FOURS, n)), axis=1)[:, :4]
    rows = transform_rows(sheet, image)
    *_, directions = np.linalg.svd(rows[fours].reshape(-1, 8, 9))
    cameras = directions[:, -1].reshape(-1, 3, 3)
    u, v, depth = np.moveaxis(cameras @ np.stack([*sheet, np.ones(n)]), 1, 0)
    # A camera is known up to its sign: most of the points lie before it.
    front = depth * np.sign(np.median(depth, axis=1, keepdims=True))
    in_front = front > 1e-9  # of the camera
    depth = np.where(in_front, depth, 1.0)
    distance = np.hypot(u / depth - image[0], v / depth - image[1])
    distance = np.where(in_front, distance, np.inf)
    agreeing = n - n // _MOST_ODD
    farthest = np.sort(distance, axis=1)[:, agreeing - 1]
    best = distance[np.argmin(farthest)]
    closest = np.zeros(n, bool)
    closest[np.argsort(best, kind="stable")[:agreeing]] = True
    return closest


def _residuals(
    plane: Homography, pixels: Floats, metres: Floats
) -> tuple[Floats, Floats]:
    """Measured - projected points in pixels, shape (n, 2), and the derivatives of the
    projected ones by eight elements S of a map times I + S, shape (n, 2, 8)."""
    camera = np.linalg.inv(plane.matrix)
    on_sheet = np.stack([*metres, np.ones(metres.shape[1])])
    u, v, depth = camera @ on_sheet
    projected = np.stack([u, v]) / depth
    moved = camera[:, :, None, None] * on_sheet  # by each element of S
    slopes = (moved[:2] - projected[:, None, None] * moved[2]) / depth
    slopes = slopes.reshape(2, 9, -1)[:, :8]
    return (pixels - projected).T, np.moveaxis(slopes, 2, 0)
