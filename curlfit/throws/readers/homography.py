"""Pixels of a fixed camera to metres on the ice: a plane homography from known points."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.columns import parse_header
from curlfit.throws.readers.text import (
    cells,
    header_cells,
    is_number,
    read_rows,
    separator_of,
    text_of,
)

_EXPECTED = "expected a header u,v,x,y (pixels, and metres on the sheet) and four points or more"


class Homography(NamedTuple):
    """x, y in m from u, v in pixels.

    Attributes
    ----------
    matrix : shape (3, 3), acting on (u, v, 1); its third coordinate is positive on the ice.
    points : number of known points. rms_m, rms_px : root mean square distance between the
        known points and the mapped ones, on the ice and in the image.
    """

    matrix: Floats
    points: int
    rms_m: float
    rms_px: float

    def __call__(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Positions in m, shape (n,); NaN beyond the horizon."""
        x, y, w = self.matrix @ np.stack([u, v, np.ones_like(u)])
        w = np.where(w > 1e-9 * np.abs(self.matrix[2]).max(), w, np.nan)
        return x / w, y / w

    def jacobian(self, u: Floats, v: Floats) -> Floats:
        """d(x, y)/d(u, v) in m per pixel, shape (2, 2, n)."""
        x, y = self(u, v)
        w = self.matrix[2] @ np.stack([u, v, np.ones_like(u)])
        rows = [
            [(self.matrix[0, k] - x * self.matrix[2, k]) / w for k in (0, 1)],
            [(self.matrix[1, k] - y * self.matrix[2, k]) / w for k in (0, 1)],
        ]
        return np.array(rows)


def load_homography(file: Path) -> Homography:
    """Read known points (columns u, v in pixels and x, y on the sheet) and fit the map to them.

    Raises
    ------
    DataError : a column is missing, fewer than four points, collinear points, or points that are
        not consistent with an image of a plane.
    """
    lines = text_of(file).split("\n")
    first = next(
        (k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")),
        None,
    )
    if first is None:
        raise DataError(f"no points; {_EXPECTED}", file=file)
    separator = separator_of(lines[first])
    names = header_cells(lines[first], separator)
    if all(is_number(cell) for cell in cells(lines[first], separator)):
        raise DataError(f"the table begins with numbers; {_EXPECTED}", file=file, line=first + 1)
    columns: dict[str, int] = {}
    factors: dict[str, float] = {}
    for index, name in enumerate(names):
        column = parse_header(name)
        quantity = "v" if name.strip().lower() == "v" else column and column.quantity
        if quantity in ("u", "v", "x", "y") and quantity not in columns:
            columns[quantity] = index
            factors[quantity] = column.factor if column and quantity in "xy" else 1.0
    missing = [name for name in ("u", "v", "x", "y") if name not in columns]
    if missing:
        raise DataError(
            f"no column for {' and '.join(missing)}; {_EXPECTED}", file=file, line=first + 1
        )
    numbers, found = read_rows(file, lines, first + 1, names, list(columns.values()), separator)
    values = {name: found[k] * factors[name] for k, name in enumerate(columns)}
    stacked = np.stack([values[name] for name in ("u", "v", "x", "y")])
    bad = ~np.isfinite(stacked).all(axis=0) | (np.abs(np.nan_to_num(stacked)) > 1e7).any(axis=0)
    if bad.any():
        raise DataError(
            "each point needs four finite numbers u, v, x, y",
            file=file,
            line=int(numbers[np.argmax(bad)]),
        )
    return homography(stacked[:2], stacked[2:], file)


def homography(pixels: Floats, metres: Floats, file: Path | str = "reference") -> Homography:
    """The plane homography fitted to known points by the normalised direct linear transform.

    Parameters
    ----------
    pixels, metres : shape (2, n), n >= 4.

    Raises
    ------
    DataError : as for `load_homography`.
    """
    n = pixels.shape[1]
    if n < 4:
        raise DataError(f"{n} points; a homography needs four or more", file=file)
    for what, points in (("in the image", pixels), ("on the sheet", metres)):
        spread = np.linalg.svd(points - points.mean(axis=1, keepdims=True), compute_uv=False)
        if spread[1] <= 1e-3 * spread[0]:
            raise DataError(
                f"the points are collinear {what}; take four corners of an area", file=file
            )
    (a, T), (b, U) = _normalise(pixels), _normalise(metres)
    rows = []
    for (u, v), (x, y) in zip(a.T, b.T, strict=True):
        rows.append([u, v, 1, 0, 0, 0, -x * u, -x * v, -x])
        rows.append([0, 0, 0, u, v, 1, -y * u, -y * v, -y])
    _, sizes, directions = np.linalg.svd(np.array(rows, float))
    inner = directions[-1].reshape(3, 3)
    if sizes[7] < 1e-4 * sizes[0] or abs(np.linalg.det(inner)) < 1e-6:
        raise DataError(
            "three of the points are collinear, or two coincide; take four corners of an area",
            file=file,
        )
    matrix = np.linalg.inv(U) @ inner @ T
    depth = matrix[2] @ np.stack([*pixels, np.ones(n)])
    if not ((depth > 0).all() or (depth < 0).all()):
        raise DataError(
            "no image of a plane has the points in this order; two of them may be interchanged",
            file=file,
        )
    matrix = matrix * np.sign(depth[0]) / np.abs(matrix).max()
    fitted = Homography(matrix, n, 0.0, 0.0)
    back = np.linalg.inv(matrix) @ np.stack([*metres, np.ones(n)])
    rms_m = _rms(np.stack(fitted(*pixels)) - metres)
    rms_px = _rms(back[:2] / back[2] - pixels)
    size = _rms(pixels - pixels.mean(axis=1, keepdims=True))
    if not (np.isfinite(rms_m) and rms_px <= 0.1 * size):
        raise DataError(
            f"the points do not fit an image of a plane: rms {rms_px:.3g} pixels "
            f"({rms_m:.3g} m); two of them may be interchanged",
            file=file,
        )
    return fitted._replace(rms_m=rms_m, rms_px=rms_px)


def _normalise(points: Floats) -> tuple[Floats, Floats]:
    """Points centred and scaled to an rms distance of sqrt(2), and the matrix of that map."""
    centre = points.mean(axis=1)
    scale = np.sqrt(2) / max(_rms(points - centre[:, None]), 1e-300)
    matrix = np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])
    return scale * (points - centre[:, None]), matrix


def _rms(offsets: Floats) -> float:
    return float(np.sqrt((offsets**2).sum(axis=0).mean()))
