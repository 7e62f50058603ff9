"""Pixels of a fixed camera as metres on the ice, with the noise of each row."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from curlfit.errors import Option
from curlfit.findings import Finding
from curlfit.numerics.arrays import Floats
from curlfit.throws.readers.axes import AxisConvention
from curlfit.throws.readers.homography import Homography, displacements
from curlfit.throws.readers.known_points import load_homography
from curlfit.throws.readers.parsed_file import ParsedFile

_BLOCK = 10  # rows of a block, at least
_MOST_BLOCKS = 50
_HORIZON = 1e5  # m; a place so far away is none on the ice


def pixels_to_metres(
    parsed: ParsedFile,
    columns: dict[str, Floats],
    reference: str | None,
    convention: AxisConvention,
    as_given: bool,
) -> tuple[Floats | None, tuple[str, ...]]:
    """Put x and y with their sigma in place of u and v.

    Parameters
    ----------
    as_given : whether odd known points are used.

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
        give = Option("reference", "FILE")
        raise parsed.error(
            f"positions are in pixels; give four or more known points with {give} "
            "(columns u,v,x,y)",
            options=(give,),
        )
    if {"x", "y"} & columns.keys():
        raise parsed.error("positions in pixels and in metres; remove one pair")
    for name in ("u", "v"):
        if name not in columns:
            raise parsed.error(
                f"no values of {name} that change: a place on the ice needs both "
                "coordinates of its pixel, u and v"
            )
    plane = load_homography(Path(reference), as_given)
    u = columns.pop("u")
    v = columns.pop("v")
    x, y = plane(u, v)
    measured = np.isfinite(u) & np.isfinite(v)
    on_ice = (np.abs(x) < _HORIZON) & (np.abs(y) < _HORIZON)  # not of NaN
    beyond = measured & ~on_ice
    if beyond.any():
        raise parsed.error(
            "this pixel lies on or beyond the horizon of the plane of the known points",
            int(np.argmax(beyond)),
            "v",
        )
    columns["x"] = x
    columns["y"] = y
    if {"x_mark", "y_mark"} <= columns.keys():
        columns["x_mark"], columns["y_mark"] = plane(
            columns["x_mark"], columns["y_mark"]
        )
    sizes = plane.jacobian(*_smooth(columns["t"], u, v))
    sizes = np.where(np.isfinite(sizes), sizes, plane.jacobian(u, v))
    unknown = not {"sigma_u", "sigma_v"} <= columns.keys()
    one_pixel = np.ones_like(u)
    sigma_u = columns.pop("sigma_u", one_pixel)
    sigma_v = columns.pop("sigma_v", one_pixel)
    across, along = sizes if unknown else sizes * np.stack([sigma_u, sigma_v])
    columns["sigma_x"] = np.hypot(*across)
    columns["sigma_y"] = np.hypot(*along)
    if measured.any():
        places = np.stack([x, y])[:, measured]
        parsed.notes += _notes_on_map(
            plane, reference, places, sizes[..., measured], unknown
        )
    if "phi" in columns:
        parsed.notes.append(Finding.note("angles-in-the-picture"))
    errors = plane.errors
    if errors is not None:
        to_sheet = convention.matrix
        errors = to_sheet @ errors @ np.linalg.inv(to_sheet)
    return errors, ("x", "y") if unknown else ()


def _smooth(t: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """The course of the pixels, by medians over blocks of rows. With its own
    pixel, the weight of a row would depend on its noise: 1 px is 1 % of the weight
    at the far end."""
    measured = np.flatnonzero(np.isfinite(u) & np.isfinite(v))
    blocks = min(len(measured) // _BLOCK, _MOST_BLOCKS)
    if blocks < 2:
        return u, v
    series = np.stack([t, u, v])
    medians = [
        np.median(series[:, rows], 1) for rows in np.array_split(measured, blocks)
    ]
    knots = np.stack(medians, 1)
    # on straight lines, a block before the first knot and after the last one
    first = 2 * knots[:, :1] - knots[:, 1:2]
    last = 2 * knots[:, -1:] - knots[:, -2:-1]
    times, smooth_u, smooth_v = np.concatenate([first, knots, last], 1)
    return np.interp(t, times, smooth_u), np.interp(t, times, smooth_v)


def _notes_on_map(
    plane: Homography, reference: str, places: Floats, sizes: Floats, unknown: bool
) -> list[Finding]:
    """Notes on the map from pixels to metres.

    Parameters
    ----------
    places : of the rows with a position, m, shape (2, rows). sizes : of a pixel,
        (2, 2, rows).
    unknown : whether the noise of the pixels is unknown.
    """
    if plane.errors is None:
        fitted = Finding.note("pixels-to-metres-by-four-points", file=reference)
    else:
        errors = np.hypot.reduce(displacements(plane.errors, *places), axis=0)
        fitted = Finding.note(
            "pixels-to-metres",
            points=plane.points,
            file=reference,
            pixels=plane.rms_px,
            freedom=2 * plane.points - 8,
            **_extent(errors),
        )
    pixel = Finding.note(
        "one-pixel" if unknown else "one-pixel-of-known-noise",
        **_extent(np.hypot(sizes[:, 0], sizes[:, 1])),
    )
    return [fitted, *plane.notes, pixel]


def _extent(sizes: Floats) -> dict[str, float]:
    """The least and the largest of sizes in x and y, m, shape (2, rows), in mm."""
    low_x, low_y = 1000 * sizes.min(axis=1)
    high_x, high_y = 1000 * sizes.max(axis=1)
    return {
        "x_low": float(low_x),
        "x_high": float(high_x),
        "y_low": float(low_y),
        "y_high": float(high_y),
    }
