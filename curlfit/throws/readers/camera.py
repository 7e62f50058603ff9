"""Pixels of a fixed camera to metres on the ice: a plane homography from known points.

The places on the sheet are exact, the clicked pixels have errors, so the homography
minimises the distances in the image (Hartley and Zisserman 2004, sect. 4.2.2); the
residual tells how large the errors are, and so the covariance of the eight parameters
(sect. 5.2.2).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from curlfit.errors import DataError
from curlfit.foreign import counted
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.axes import AxisConvention
from curlfit.throws.readers.columns import parse_header
from curlfit.throws.readers.parsed_file import ParsedFile
from curlfit.throws.readers.text import TextFile, TextTable

_EXPECTED = (
    "expected a header u,v,x,y (pixels, and metres on the sheet) and "
    "four points or more"
)
_BLOCK, _MOST_BLOCKS = 10, 50  # rows of a block, at least, and blocks


def pixels_to_metres(
    parsed: ParsedFile,
    columns: dict[str, Floats],
    reference: str | None,
    convention: AxisConvention,
) -> tuple[Floats | None, tuple[str, ...]]:
    """Put x and y with their sigma in place of u and v.

    Returns
    -------
    the errors of the map (see `Homography`) in curlfit's axes, and the channels whose
    sigma is for one pixel of noise, because the noise is unknown.

    Raises
    ------
    DataError : there are no known points, they determine no map, or a pixel
        shows no ice.
    """
    if reference is None:
        raise parsed.error(
            "positions are in pixels; give four or more known points with "
            "`--reference FILE` (columns u,v,x,y)"
        )
    if {"x", "y"} & columns.keys():
        raise parsed.error("positions in pixels and in metres; remove one pair")
    plane = load_homography(Path(reference))
    u, v = columns.pop("u"), columns.pop("v")
    x, y = plane(u, v)
    seen = np.isfinite(u) & np.isfinite(v)
    lost = seen & ~(
        np.isfinite(x) & np.isfinite(y) & (np.abs(x) < 1e5) & (np.abs(y) < 1e5)
    )
    if lost.any():
        raise parsed.error(
            "this pixel lies on or beyond the horizon of the plane of the known points",
            int(np.argmax(lost)),
            "v",
        )
    columns["x"], columns["y"] = x, y
    if "x_mark" in columns:
        columns["x_mark"], columns["y_mark"] = plane(
            columns["x_mark"], columns["y_mark"]
        )
    sizes = plane.jacobian(*_smooth(columns["t"], u, v))
    sizes = np.where(np.isfinite(sizes), sizes, plane.jacobian(u, v))
    unknown = not {"sigma_u", "sigma_v"} <= columns.keys()
    noise = [columns.pop(f"sigma_{axis}", np.ones_like(u)) for axis in ("u", "v")]
    across, along = sizes * (1.0 if unknown else np.stack(noise))
    columns["sigma_x"], columns["sigma_y"] = np.hypot(*across), np.hypot(*along)
    if seen.any():
        parsed.notes += _of_pixels(
            plane, reference, np.stack([x, y])[:, seen], sizes[..., seen], unknown
        )
    if "phi" in columns:
        parsed.notes.append(
            "angles are taken as angles on the ice, seen from above; "
            "an oblique camera distorts them"
        )
    to_sheet = convention.matrix
    errors = (
        None
        if plane.errors is None
        else to_sheet @ plane.errors @ np.linalg.inv(to_sheet)
    )
    return errors, ("x", "y") if unknown else ()


def _smooth(t: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """The course of the pixels, by medians over blocks of rows. With its own
    pixel, the weight of a row would depend on its noise: 1 px is 1 % of the weight
    at the far end."""
    seen = np.flatnonzero(np.isfinite(u) & np.isfinite(v))
    count = min(len(seen) // _BLOCK, _MOST_BLOCKS)
    if count < 2:
        return u, v
    series = np.stack([t, u, v])
    knots = np.stack(
        [np.median(series[:, b], 1) for b in np.array_split(seen, count)], 1
    )
    first, last = 2 * knots[:, :1] - knots[:, 1:2], 2 * knots[:, -1:] - knots[:, -2:-1]
    times, *places = np.concatenate([first, knots, last], 1)
    return np.interp(t, times, places[0]), np.interp(t, times, places[1])


def _of_pixels(
    plane: Homography, reference: str, places: Floats, sizes: Floats, unknown: bool
) -> list[str]:
    """Notes on the map from pixels to metres.

    Parameters
    ----------
    places : of the rows with a position, m, shape (2, rows). sizes : of a pixel,
        (2, 2, rows).
    unknown : whether the noise of the pixels is unknown.
    """

    def extent(values: Floats) -> str:
        return f"{1000 * values.min():.2g} to {1000 * values.max():.2g} mm"

    fitted = f"pixels to metres by {plane.points} points of {reference}: "
    if plane.errors is None:
        fitted += (
            "four points are fitted exactly, so their errors are unknown and missing "
            "from the systematic errors; use more points"
        )
    else:
        across, along = np.hypot.reduce(displacements(plane.errors, *places), axis=0)
        fitted += (
            f"rms residual {plane.rms_px:.2g} px ({2 * plane.points - 8} degrees "
            "of freedom), which makes positions along the track uncertain by "
            f"{extent(across)} in x and {extent(along)} in y"
        )
    across, along = np.hypot(sizes[:, 0], sizes[:, 1])
    return [
        "; ".join(filter(None, (fitted, plane.note))),
        f"one pixel is {extent(across)} in x and {extent(along)} in y along the "
        "track: the noise "
        + (
            "of each row is that of one unknown number of pixels"
            if unknown
            else "of each row follows from its sigma_u and sigma_v"
        ),
    ]


class Homography(NamedTuple):
    """x, y in m from u, v in pixels.

    Attributes
    ----------
    matrix : shape (3, 3), acting on (u, v, 1); its third coordinate is
        positive on the ice.
    points : number of known points. rms_px : root mean square error of a coordinate of
        the known points in the image, pixels.
    errors : independent errors of the map, each of one standard deviation, shape (8, 3,
        3): a place (x, y, 1) on the sheet may in truth be at (I + error)(x, y, 1),
        homogeneous. None for four points, which leave no residual.
    """

    matrix: Floats
    points: int
    rms_px: float
    errors: Floats | None = None
    note: str = ""
    """on what of the file of the points was read"""

    def __call__(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Positions in m, shape (n,); NaN beyond the horizon."""
        x, y, w = self.matrix @ np.stack([u, v, np.ones_like(u)])
        w = np.where(w > 1e-9 * np.abs(self.matrix[2]).max(), w, np.nan)
        return x / w, y / w

    def jacobian(self, u: Floats, v: Floats) -> Floats:
        """d(x, y)/d(u, v) in m per pixel, shape (2, 2, n)."""
        x, y, w = self.matrix @ np.stack([u, v, np.ones_like(u)])
        rows = [
            [(self.matrix[i, k] - at / w * self.matrix[2, k]) / w for k in (0, 1)]
            for i, at in enumerate((x, y))
        ]
        return np.where(w > 1e-9 * np.abs(self.matrix[2]).max(), np.array(rows), np.nan)


def displacements(errors: Floats, x: Floats, y: Floats) -> Floats:
    """By how much errors of a map displace places on the sheet, to first order, in m.

    Parameters
    ----------
    errors : shape (..., errors, 3, 3). x, y : m, shape (..., n).

    Returns
    -------
    of shape (..., errors, 2, n).
    """
    places = np.stack([x, y, np.ones_like(x)], -2)[..., None, :, :]
    moved = errors @ places
    found: Floats = moved[..., :2, :] - places[..., :2, :] * moved[..., 2:, :]
    return found


def load_homography(file: Path) -> Homography:
    """Read known points (columns u, v in pixels and x, y on the sheet) and fit the
    map to them.

    Raises
    ------
    DataError : a column is missing, fewer than four points, collinear points, or points
        that are not consistent with an image of a plane.
    """
    text = TextFile.read(file)
    table = TextTable.of(text, _EXPECTED)
    columns: dict[str, int] = {}
    factors: list[float] = []
    for index, name in enumerate(table.names):
        column = parse_header(name)
        quantity = "v" if name.strip().lower() == "v" else column and column.quantity
        if quantity in ("u", "v", "x", "y") and quantity not in columns:
            columns[quantity] = index
            factors.append(column.factor if column and quantity in "xy" else 1.0)
    missing = [name for name in "uvxy" if name not in columns]
    if missing:
        raise table.error(f"no column for {' and '.join(missing)}; {_EXPECTED}")
    found = np.array(table.numbers(list(columns.values()))) * np.array(factors)[:, None]
    values = dict(zip(columns, found, strict=True))
    stacked = np.stack([values[name] for name in "uvxy"])
    bad = ~np.isfinite(stacked).all(axis=0) | (
        np.abs(np.nan_to_num(stacked)) > 1e7
    ).any(axis=0)
    if bad.any():
        fault = "each point needs four finite numbers u, v, x, y"
        raise table.file.error(fault, table.rows[np.argmax(bad)])
    return homography(stacked[:2], stacked[2:], file)._replace(note=text.note)


def homography(
    pixels: Floats, metres: Floats, file: Path | str = "reference"
) -> Homography:
    """The plane homography fitted to known points by least squares in the image.

    It begins at the normalised direct linear transform.

    Parameters
    ----------
    pixels, metres : shape (2, n), n >= 4.

    Raises
    ------
    DataError : as for `load_homography`.
    """
    n, area = pixels.shape[1], "take four corners of an area"

    def require(sound: bool, fault: str) -> None:
        if not sound:
            raise DataError(fault, file=file)

    require(n >= 4, f"{counted(n, 'point')}; a homography needs four or more")
    for what, points in (("in the image", pixels), ("on the sheet", metres)):
        spread = np.linalg.svd(
            points - points.mean(axis=1, keepdims=True), compute_uv=False
        )
        require(
            bool(spread[1] > 1e-3 * spread[0]),
            f"the points are collinear {what}; {area}",
        )
    (a, T), (b, U) = _normalise(pixels), _normalise(metres)
    inner, determined = _direct_linear_transform(a, b)
    require(determined, f"three of the points are collinear, or two coincide; {area}")
    depth = inner[2] @ np.stack([*a, np.ones(n)])
    require(
        bool((depth > 0).all() or (depth < 0).all()),
        "no image of a plane has the points in this order; two of them "
        "may be interchanged",
    )
    camera, off, slope = _least_squares(np.linalg.inv(inner * np.sign(depth[0])), a, b)
    matrix = np.linalg.inv(U) @ np.linalg.inv(camera) @ T
    fitted = Homography(matrix / np.abs(matrix).max(), n, _rms(off) / T[0, 0])
    rms_m = _rms(np.stack(fitted(*pixels)) - metres)
    require(
        bool(np.isfinite(rms_m)) and _rms(off) <= 0.1,
        f"the points do not fit an image of a plane: rms {fitted.rms_px:.3g} pixels "
        f"({rms_m:.3g} m); two of them may be interchanged",
    )
    errors = None
    if n > 4:
        # covariance s^2 (J^T J)^-1 = root root^T, with s^2 = rss/(2 n - 8)
        scale = np.sqrt((off**2).sum() / (2 * n - 8))
        root = scale * np.linalg.inv(np.linalg.qr(slope, mode="r"))
        errors = np.linalg.inv(U) @ _generators(root.T) @ U
    return fitted._replace(errors=errors)


def _direct_linear_transform(image: Floats, sheet: Floats) -> tuple[Floats, bool]:
    """A map from normalised image to normalised sheet, up to its sign, and whether the
    points determine it."""
    rows = []
    for (u, v), (x, y) in zip(image.T, sheet.T, strict=True):
        rows.append([u, v, 1, 0, 0, 0, -x * u, -x * v, -x])
        rows.append([0, 0, 0, u, v, 1, -y * u, -y * v, -y])
    _, sizes, directions = np.linalg.svd(np.array(rows, float))
    found: Floats = directions[-1].reshape(3, 3)
    return found, bool(
        sizes[7] >= 1e-4 * sizes[0] and abs(np.linalg.det(found)) >= 1e-6
    )


def _least_squares(
    camera: Floats, image: Floats, sheet: Floats
) -> tuple[Floats, Floats, Floats]:
    """The map from the sheet to the image that minimises the distances in the image:
    the initial `camera` times I + S, S having eight elements.

    Returns
    -------
    the map; measured - projected points, shape (2 n,); derivatives of the projected
    points by the elements of a further S, shape (2 n, 8).
    """
    from scipy.optimize import least_squares

    places = np.stack([*sheet, np.ones(sheet.shape[1])])

    def off(elements: Floats) -> Floats:
        u, v, w = camera @ (np.eye(3) + _generators(elements)) @ places
        return (image - np.stack([u, v]) / w).ravel()

    for _ in range(2):  # the second time about the optimum
        best = least_squares(
            off, np.zeros(8), jac="cs", xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        camera = camera @ (np.eye(3) + _generators(best.x))
    return camera, best.fun, -best.jac


def _generators(elements: Floats) -> Floats:
    """Matrices, shape (..., 3, 3), of their first eight elements; the last is 0."""
    whole = np.concatenate([elements, np.zeros_like(elements[..., :1])], -1)
    return whole.reshape(*elements.shape[:-1], 3, 3)


def _normalise(points: Floats) -> tuple[Floats, Floats]:
    """Points centred and scaled to coordinates of rms 1, and the matrix of that map."""
    centre = points.mean(axis=1)
    scale = 1 / max(_rms(points - centre[:, None]), 1e-300)
    matrix = np.array(
        [[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]]
    )
    return scale * (points - centre[:, None]), matrix


def _rms(offsets: Floats) -> float:
    return float(np.sqrt((offsets**2).mean()))
