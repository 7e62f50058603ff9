"""The angle of a stone from two points on it: its centre, and the handle or any other mark."""

from __future__ import annotations

import numpy as np

from curlfit.numerics.arrays import Floats
from curlfit.throws.channels import scatter
from curlfit.throws.readers.axes import AmbiguousTurnError, unwrap
from curlfit.throws.readers.parsed_file import ParsedFile

_FARTHEST = 0.3  # m; the stone's diameter is 0.29 m


def add_angle_of_mark(
    parsed: ParsedFile, columns: dict[str, Floats], mark: tuple[Floats, Floats]
) -> None:
    """Add phi and sigma_phi from the direction from the stone's position to the mark.

    With d = (x_mark - x, y_mark - y), phi = atan2(d_y, d_x), unwrapped. To first order the error of
    phi is the noise of d across its direction, divided by |d|. With given sigmas, the same for mark
    and stone, var(phi) = 2 (sigma_x^2 sin^2 phi + sigma_y^2 cos^2 phi) / |d|^2. Without them, the
    noise across d is taken to equal that along d, where the true length is constant: sigma_phi is
    the scatter of |d| from row to row, divided by its median.

    Parameters
    ----------
    columns : with x and y in m and curlfit's axes, shape (n,); phi and sigma_phi are added.
    mark : x and y of the mark, likewise.

    Raises
    ------
    DataError : there is an angle already, the mark is not on the stone, or it turns too fast for
        the rows.
    """
    if "phi" in columns:
        raise parsed.error(
            "an angle and a second mark are both given; leave one of them out", quantity="phi"
        )
    dx, dy = mark[0] - columns["x"], mark[1] - columns["y"]
    length = np.hypot(dx, dy)
    seen = np.isfinite(length)
    if seen.sum() < 2:
        raise parsed.error("stone and mark are never seen together; expected both in many rows")
    typical = float(np.median(length[seen]))
    if not 0 < typical < _FARTHEST:
        raise parsed.error(
            f"the mark is {typical:.3g} m from the stone, and a stone's diameter is 0.29 m; "
            "expected a point of the same stone (--handle N)"
        )
    phi = np.arctan2(dy, dx)
    try:
        columns["phi"], _, _ = unwrap(columns["t"], phi)
    except AmbiguousTurnError as error:
        raise parsed.error(
            "the mark turns so far from row to row that the sense is ambiguous; expected rows "
            "closer in time",
            error.row,
        ) from None
    note = f"phi is the direction of the mark, {1000 * typical:.3g} mm from the stone's position"
    if {"sigma_x", "sigma_y"} <= columns.keys():
        across = columns["sigma_x"] ** 2 * np.sin(phi) ** 2
        across += columns["sigma_y"] ** 2 * np.cos(phi) ** 2
        columns["sigma_phi"] = np.sqrt(2 * across) / typical
        how = "from sigma_x and sigma_y"
    elif (noise := float(scatter(length[seen]))) > 0:
        columns["sigma_phi"] = np.full(len(phi), noise / typical)
        how = f"from the scatter of that length, {1000 * noise:.2g} mm"
    if "sigma_phi" in columns:
        note += f"; its sigma, {float(np.nanmedian(columns['sigma_phi'])):.2g} rad, {how}"
    parsed.notes.append(note)
