"""Residuals of a fit, and outliers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from curlfit.inference.least_squares import Solution
from curlfit.inference.likelihood import SIGMA_FLOOR
from curlfit.inference.problem import Problem
from curlfit.losses import MAD_TO_SIGMA, Loss, robust_sigma
from curlfit.numerics.arrays import Floats
from curlfit.throws.channels import running_median
from curlfit.throws.throw import CHANNELS, Throw

_FEWEST = 10  # values of a channel in which outliers are sought
_FEW = 50  # values, below which a single one pulls the fit
_BY_CHANCE = 1e-3  # fraction of throws that may have an outlier by chance
_SMOOTH = 0.5  # lag-1 correlation above which residuals are called smooth
_NEIGHBOURS = 9  # rows of a running median, in which up to four outliers do not count


def residuals_of(
    problems: Problem, solutions: Solution, paths: Floats | None
) -> Floats:
    """Measured - fitted of many throws, 0 where nothing was observed, shape (throws,
    channels, n); from their paths, or from residuals by least squares with
    independent noise."""
    there = problems.weight > 0
    if paths is None:
        return -solutions.residual / np.where(there, problems.weight, 1.0)
    return np.where(there, problems.observed - paths[:, : there.shape[1]], 0.0)


def outliers_of(
    throw: Throw,
    residual: Floats,
    lag1: Mapping[str, float],
    dof: Floats,
    leverage: Floats,
    loss: Loss,
) -> tuple[dict[str, Any], ...]:
    """Values too far from the fit to be noise; in channels whose residuals do not look
    like noise, those as far from the residuals of the rows about them too.

    Either more than 5 + 30/(n - 6) sigmas of the bulk, a limit that Gaussian noise in
    three channels of n values exceeds in one of 1,000 throws, for n from 12 to 400
    (Hampel's identifier, with constants simulated as by Davies and Gather 1993); or,
    since a value pulls a fit of few rows toward itself, an externally studentized
    residual beyond a limit of the same probability (Cook and Weisberg 1982, sect. 2.2).

    Parameters
    ----------
    dof : degrees of freedom of each channel's sigma.
    leverage : of each value on its own fitted value, shape (channels, n).
    """
    found = []
    for row, name in enumerate(CHANNELS[: len(residual)]):
        there = np.flatnonzero(throw.finite[row])
        if len(there) < _FEWEST:
            continue
        limit = 5 + 30 / (len(there) - 6)
        series = throw.sigma.get(name)
        off = residual[row, there]
        if series is None:
            off = off / throw.sigma_over_smallest(name)[there]
        size = np.abs(off)
        # A law that does not follow the path, or that outliers have drawn aside, is off
        # by as much in the next rows.
        smooth = lag1.get(name, 1.0) > _SMOOTH
        studentized = (
            not smooth
            and len(there) < _FEW
            and not loss.is_robust
            and series is None
            and dof[row] > 2
        )
        if not studentized and 2 * (
            size > size.max() / (limit * MAD_TO_SIGMA)
        ).sum() > len(there):
            continue  # the median size is so large that no value is far off
        bulk = max(robust_sigma(size), SIGMA_FLOOR)
        sigma = (
            np.full(len(throw), bulk) if series is None else np.maximum(series, bulk)
        )
        far = size > limit * sigma[there]
        if smooth:
            alone = np.abs(off - running_median(off, _NEIGHBOURS))
            far &= alone > limit * sigma[there]
            half = _NEIGHBOURS // 2
            far[:half] = far[-half:] = False  # no rows on both sides
        if studentized:
            from scipy.special import stdtrit  # slow to load, and few throws need it

            free = np.maximum(1 - leverage[row, there], 1e-6)
            others = np.maximum((size**2).sum() - size**2 / free, SIGMA_FLOOR**2) / (
                dof[row] - 1
            )
            chance = _BY_CHANCE / (2 * residual.shape[0] * len(there))
            far |= size > -stdtrit(dof[row] - 1, chance) * np.sqrt(free * others)
        for index, out in zip(there[far], size[far], strict=True):
            found.append(
                {
                    "channel": name,
                    "t": float(throw.t[index]),
                    "line": None if throw.lines is None else int(throw.lines[index]),
                    "off": float(residual[row, index]),
                    "sigmas": float(out / sigma[index]),
                }
            )
    return tuple(sorted(found, key=lambda item: -item["sigmas"]))
