"""Residuals of fits, the sigmas that they show, and outliers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from curlfit.inference.fit.entries import Outlier
from curlfit.inference.information.directions import inverted
from curlfit.inference.model.likelihood import SIGMA_FLOOR
from curlfit.inference.model.problem import Problem
from curlfit.inference.solve.least_squares import Solution
from curlfit.losses import MAD_TO_SIGMA, Loss, robust_sigma
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.throws.channels import CHANNELS, running_median
from curlfit.throws.throw import Throw

_FEWEST = 10
"""Values of a channel in which outliers are sought."""
_FEW = 50
"""Values, below which a single one pulls the fit."""
_BY_CHANCE = 1e-3
"""Share of throws that may have an outlier by chance."""
_SMOOTH = 0.5
"""Correlation of neighbouring residuals, above which they are called smooth."""
_NO_LENGTH = 1e-7
"""Length of a column, over the longest, below which it is rounding error."""
_ROUNDING = 1e-12
"""Eigenvalue, with columns of length 1, that may be rounding error."""
_NEIGHBOURS = 9
"""Rows of a running median, in which up to four outliers do not count."""


def residuals_of(
    problems: Problem, solutions: Solution, paths: Floats | None
) -> Floats:
    """Measured - fitted of many throws, 0 where nothing was observed, shape (throws,
    channels, n); from their paths, or from residuals by least squares with
    independent noise."""
    observed = problems.weight > 0
    if paths is None:
        return -solutions.residual / np.where(observed, problems.weight, 1.0)
    channels = observed.shape[1]
    return np.where(observed, problems.observed - paths[:, :channels], 0.0)


def residual_sigma(solutions: Solution, problems: Problem, free: Booleans) -> Floats:
    """sqrt(sum of squares/(n - p)) by channel of many throws; p is a channel's share
    of parameters.

    Parameters
    ----------
    free : which parameters were fitted, shape (throws, parameters).

    Returns
    -------
    In the channels' units, shape (throws, channels); 0 where nothing was observed.
    """
    jacobian = np.asarray(solutions.jacobian)
    of_free = free[:, None, :, None] & free[:, None, None, :]
    normal = jacobian.mT @ jacobian * of_free
    of_all_channels = normal.sum(1)
    # The normal matrix with columns of length 1, so that its smallest eigenvalues tell
    # rounding errors from directions that are hardly determined.
    length = np.sqrt(np.diagonal(of_all_channels, axis1=1, axis2=2))
    longest = length.max(1, initial=0.0)[:, None]
    scale = inverted(length, length > _NO_LENGTH * longest)
    eigenvalues, axes = np.linalg.eigh(
        of_all_channels * scale[:, None] * scale[..., None]
    )
    axes = axes * scale[..., None]
    inverse = axes * inverted(eigenvalues, eigenvalues > _ROUNDING)[:, None] @ axes.mT
    share = (normal * inverse[:, None]).sum((-1, -2))
    dof = np.maximum((problems.weight > 0).sum(-1) - share, 1.0)
    largest = problems.weight.max(-1)
    rms = np.sqrt((solutions.residual**2).sum(-1) / dof)
    return np.where(largest > 0, rms / np.where(largest > 0, largest, 1.0), 0.0)


def outliers_of(
    throw: Throw,
    residual: Floats,
    lag1: Mapping[str, float],
    dof: Floats,
    leverage: Floats,
    loss: Loss,
) -> tuple[Outlier, ...]:
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
    outliers = []
    for row, channel in enumerate(CHANNELS[: len(residual)]):
        observed = np.flatnonzero(throw.finite[row])
        count = len(observed)
        if count < _FEWEST:
            continue
        given_sigma = throw.sigma.get(channel)
        off = residual[row, observed]
        if given_sigma is None:
            off = off / throw.sigma_over_smallest(channel)[observed]
        size = np.abs(off)
        is_smooth = lag1.get(channel, 1.0) > _SMOOTH
        is_studentized = (
            not is_smooth
            and count < _FEW
            and not loss.is_robust
            and given_sigma is None
            and dof[row] > 2
        )
        limit = 5 + 30 / (count - 6)
        large = size > size.max() / (limit * MAD_TO_SIGMA)
        if not is_studentized and 2 * large.sum() > count:
            continue  # the median size is so large that no value is far off
        bulk = max(robust_sigma(size), SIGMA_FLOOR)
        sigma = np.full(count, bulk)
        if given_sigma is not None:
            sigma = np.maximum(given_sigma[observed], bulk)
        if is_smooth:
            is_far = _far_from_neighbours(off, limit * sigma)
        else:
            is_far = size > limit * sigma
        if is_studentized:
            chance = _BY_CHANCE / (2 * residual.shape[0] * count)
            is_far |= _studentized_far(size, leverage[row, observed], dof[row], chance)
        for index in np.flatnonzero(is_far):
            at_row = observed[index]
            outliers.append(
                Outlier(
                    channel=channel,
                    t=float(throw.t[at_row]),
                    line=None if throw.lines is None else int(throw.lines[at_row]),
                    off=float(residual[row, at_row]),
                    sigmas=float(size[index] / sigma[index]),
                )
            )
    return tuple(sorted(outliers, key=lambda outlier: -outlier.sigmas))


def _far_from_neighbours(off: Floats, limits: Floats) -> Booleans:
    """Values far from the fit and as far from the residuals about them: a law that does
    not follow the path, or that outliers have drawn aside, is off by as much in the
    next rows. The first and last have no rows on both sides."""
    from_neighbours = np.abs(off - running_median(off, _NEIGHBOURS))
    is_far: Booleans = (np.abs(off) > limits) & (from_neighbours > limits)
    half = _NEIGHBOURS // 2
    is_far[:half] = False
    is_far[-half:] = False
    return is_far


def _studentized_far(
    size: Floats, leverage: Floats, dof: float, chance: float
) -> Booleans:
    """Residuals whose externally studentized size is exceeded by `chance` on either
    side: each over the sigma of the others, as a fit without it has them."""
    from scipy.special import stdtrit  # slow to load, and few throws need it

    share = np.maximum(1 - leverage, 1e-6)  # of the noise of a value in its residual
    squares_of_others = (size**2).sum() - size**2 / share
    variance = np.maximum(squares_of_others, SIGMA_FLOOR**2) / (dof - 1)
    far: Booleans = size > -stdtrit(dof - 1, chance) * np.sqrt(share * variance)
    return far
