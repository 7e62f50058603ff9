"""The map from an image to the ice: a plane homography from known points.

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
from curlfit.findings import Finding
from curlfit.foreign import counted
from curlfit.numerics.arrays import Floats

_LEAST_WIDTH = 1e-3  # of the length of the points; narrower ones are on one line
_MOST_OFF = 0.1  # rms of the residuals over that of the points about their centre
# of the equations of the map, relative to the largest; below it they leave a further
# direction open
_LEAST_SINGULAR_VALUE = 1e-4
_LEAST_DETERMINANT = 1e-6  # of the map between normalised points, of norm 1


class Homography(NamedTuple):
    """x, y in m from u, v in pixels.

    Attributes
    ----------
    matrix : shape (3, 3), acting on (u, v, 1); its third coordinate is
        positive on the ice.
    points : number of known points.
    rms_px : root mean square error of a coordinate of the known points in the image,
        pixels.
    errors : independent errors of the map, each of one standard deviation, shape (8, 3,
        3): a place (x, y, 1) on the sheet may in truth be at (I + error)(x, y, 1),
        homogeneous. None for four points, which leave no residual.
    """

    matrix: Floats
    points: int
    rms_px: float
    errors: Floats | None = None
    notes: tuple[Finding, ...] = ()
    """on what of the file of the points was read"""

    def __call__(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Positions in m, shape (n,); NaN beyond the horizon."""
        x, y, w = self.matrix @ np.stack([u, v, np.ones_like(u)])
        w = np.where(w > 1e-9 * np.abs(self.matrix[2]).max(), w, np.nan)
        return x / w, y / w

    def jacobian(self, u: Floats, v: Floats) -> Floats:
        """d(x, y)/d(u, v) in m per pixel, shape (2, 2, n)."""
        x, y, w = self.matrix @ np.stack([u, v, np.ones_like(u)])
        of_x, of_y, of_w = self.matrix[:, :2]
        slopes = np.array(
            [
                [(of_x[0] - x / w * of_w[0]) / w, (of_x[1] - x / w * of_w[1]) / w],
                [(of_y[0] - y / w * of_w[0]) / w, (of_y[1] - y / w * of_w[1]) / w],
            ]
        )
        return np.where(w > 1e-9 * np.abs(self.matrix[2]).max(), slopes, np.nan)


def displacements(errors: Floats, x: Floats, y: Floats) -> Floats:
    """By how much errors of a map displace places on the sheet, to first order, in m.

    Parameters
    ----------
    errors : shape (..., errors, 3, 3). x, y : m, shape (..., n).

    Returns
    -------
    of shape (..., errors, 2, n).
    """
    on_sheet = np.stack([x, y, np.ones_like(x)], -2)[..., None, :, :]
    moved = errors @ on_sheet
    off: Floats = moved[..., :2, :] - on_sheet[..., :2, :] * moved[..., 2:, :]
    return off


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
    DataError : fewer than four points, collinear points, or points that are not
        consistent with an image of a plane.
    """
    n = pixels.shape[1]
    area = "take four corners of an area"

    def require(sound: bool, fault: str) -> None:
        if not sound:
            raise DataError(fault, file=file)

    require(n >= 4, f"{counted(n, 'point')}; a homography needs four or more")
    for what, points in (("in the image", pixels), ("on the sheet", metres)):
        centred = points - points.mean(axis=1, keepdims=True)
        spread = np.linalg.svd(centred, compute_uv=False)
        require(
            bool(spread[1] > _LEAST_WIDTH * spread[0]),
            f"the points are collinear {what}; {area}",
        )
    image, to_image = normalised(pixels)
    sheet, to_sheet = normalised(metres)
    initial, determined = _direct_linear_transform(image, sheet)
    require(determined, f"three of the points are collinear, or two coincide; {area}")
    depth = initial[2] @ np.stack([*image, np.ones(n)])
    require(
        bool((depth > 0).all() or (depth < 0).all()),
        "no image of a plane has the points in this order; two of them "
        "may be interchanged",
    )
    initial_camera = np.linalg.inv(initial * np.sign(depth[0]))
    camera, off, slope = _least_squares(initial_camera, image, sheet)
    matrix = np.linalg.inv(to_sheet) @ np.linalg.inv(camera) @ to_image
    rms_px = _rms(off) / to_image[0, 0]
    fitted = Homography(matrix / np.abs(matrix).max(), n, rms_px)
    rms_m = _rms(np.stack(fitted(*pixels)) - metres)
    require(
        bool(np.isfinite(rms_m)) and _rms(off) <= _MOST_OFF,
        f"the points do not fit an image of a plane: rms {fitted.rms_px:.3g} pixels "
        f"({rms_m:.3g} m); two of them may be interchanged",
    )
    errors = None
    if n > 4:
        # covariance s^2 (J^T J)^-1 = root root^T, with s^2 = rss/(2 n - 8)
        scale = np.sqrt((off**2).sum() / (2 * n - 8))
        root = scale * np.linalg.inv(np.linalg.qr(slope, mode="r"))
        errors = np.linalg.inv(to_sheet) @ _generators(root.T) @ to_sheet
    return fitted._replace(errors=errors)


def transform_rows(image: Floats, sheet: Floats) -> Floats:
    """Equations of the direct linear transform: their product with the elements of a
    map from image to sheet is 0. Two for each point, shape (points, 2, 9)."""
    u, v = image
    x, y = sheet
    ones = np.ones_like(u)
    zeros = np.zeros_like(u)
    first = np.stack([u, v, ones, zeros, zeros, zeros, -x * u, -x * v, -x], 1)
    second = np.stack([zeros, zeros, zeros, u, v, ones, -y * u, -y * v, -y], 1)
    return np.stack([first, second], 1)


def _direct_linear_transform(image: Floats, sheet: Floats) -> tuple[Floats, bool]:
    """A map from normalised image to normalised sheet, up to its sign, and whether the
    points determine it."""
    rows = transform_rows(image, sheet)
    _, sizes, directions = np.linalg.svd(rows.reshape(-1, 9))
    matrix: Floats = directions[-1].reshape(3, 3)
    one_direction = sizes[7] >= _LEAST_SINGULAR_VALUE * sizes[0]
    invertible = abs(np.linalg.det(matrix)) >= _LEAST_DETERMINANT
    return matrix, bool(one_direction and invertible)


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

    on_sheet = np.stack([*sheet, np.ones(sheet.shape[1])])

    def off(elements: Floats) -> Floats:
        u, v, w = camera @ (np.eye(3) + _generators(elements)) @ on_sheet
        return (image - np.stack([u, v]) / w).ravel()

    for _ in range(2):  # the second time about the optimum
        best = least_squares(
            off, np.zeros(8), jac="cs", xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        camera = camera @ (np.eye(3) + _generators(best.x))
    return camera, best.fun, -best.jac


def _generators(elements: Floats) -> Floats:
    """Matrices, shape (..., 3, 3), of their first eight elements; the last is 0."""
    all_nine = np.concatenate([elements, np.zeros_like(elements[..., :1])], -1)
    return all_nine.reshape(*elements.shape[:-1], 3, 3)


def normalised(points: Floats) -> tuple[Floats, Floats]:
    """Points centred and scaled to coordinates of rms 1, and the matrix of that map."""
    centre = points.mean(axis=1)
    scale = 1 / max(_rms(points - centre[:, None]), 1e-300)
    matrix = np.array(
        [[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]]
    )
    return scale * (points - centre[:, None]), matrix


def _rms(offsets: Floats) -> float:
    return float(np.sqrt((offsets**2).mean()))
