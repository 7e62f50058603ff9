"""Noise that goes together from row to row: models of it, and what residuals say of them.

Three models, by channel:

- "white": independent from row to row.
- "ar1": the noise forgets itself exponentially, with correlation exp(-gap/memory) between rows (an
  Ornstein-Uhlenbeck process; AR(1) where rows are evenly spaced). For noise of the tracker:
  filters, a camera that sways.
- "gp": independent noise on top of a smooth discrepancy, a Gaussian process of Matern's kernel with
  nu = 5/2 (Rasmussen and Williams 2006, eq. 4.17): (1 + q + q^2/3) exp(-q), q = sqrt(5) gap/memory.
  For a law that is not exact (Kennedy and O'Hagan 2001): what it misses depends on speed and spin,
  which change over the whole throw. So its memory is the time for which the stone moves; to leave
  it open is to take what is left of a slow discrepancy, once the fit has hidden most of it, for a
  small quick one.

Sizes, and the memory of "ar1", are those of greatest restricted likelihood (Patterson and Thompson
1971) of the residuals of a fit with white noise: that of what no change of the parameters can make,
since the fit has hidden the rest. How the channels' sizes compare is taken from those residuals and
held: else one channel would be fitted perfectly and taken to be exact, and the others pay for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import InputError
from curlfit.inference.parameters import NOISES
from curlfit.throws.throw import CHANNELS

if TYPE_CHECKING:
    from curlfit.throws.throw import Throw

Floats = NDArray[np.float64]

_FEWEST = 20  # values of a channel from which its residuals are judged
_MOST = 300  # values of a channel looked at; more are condensed to means
_LASTING = (1e-3, 10.0)  # memory of "ar1" noise, the same
_PURE = 300.0  # greatest discrepancy over the independent noise
_NEGLIGIBLE = 0.05  # the same, below which there is none
_FAR = (-30.0, 30.0)  # logarithms beyond which nothing is sought
_SURE = 3.5  # standard deviations from which residuals are not taken for independent
_MATTERS = 0.2  # lag-1 correlation below which errors would hardly change


def check_noise(kind: str, loss: str = "linear") -> str:
    """The name of a noise model, if it is one and goes with the loss. Raises `InputError`."""
    if kind not in NOISES:
        raise InputError(f"unknown noise {kind!r}; expected one of {', '.join(NOISES)}")
    if kind != "white" and loss != "linear":
        raise InputError(
            f"noise {kind} and loss {loss} do not go together: a robust loss judges each value by "
            "itself"
        )
    return kind


@dataclass(frozen=True)
class Noise:
    """How noise goes together from row to row.

    Attributes
    ----------
    kind : "white", "ar1" or "gp".
    memory : of "ar1" by channel, the time in s over which it does.
    sizes : of "gp" by channel, standard deviation of the discrepancy (SI).
    span : of "gp", the time in s after the first row for which the stone moves: the discrepancy's
        memory, and after it stands still.
    """

    kind: str = "white"
    memory: dict[str, float] = field(default_factory=dict)
    sizes: dict[str, float] = field(default_factory=dict)
    span: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


WHITE = Noise()


def matern(gap: Floats, memory: float) -> Floats:
    """Correlation of a discrepancy between times that far apart, s."""
    q = math.sqrt(5) * np.abs(gap) / memory
    return (1 + q + q**2 / 3) * np.exp(-q)


def alike(gaps: Floats, memory: float) -> Floats:
    """Correlation of "ar1" noise over gaps in s."""
    return np.exp(-gaps / memory)


def fitted_noise(
    kind: str, throw: Throw, residual: Floats, jacobian: Floats, weight: Floats, span: float
) -> tuple[Noise, dict[str, float]]:
    """The noise that residuals of a fit with white noise show, and the sigmas that go with it.

    Parameters
    ----------
    kind : "ar1" or "gp".
    residual, jacobian : over sigma, shapes (channels, n) and (channels, n, free parameters).
    weight : 1/sigma, 0 where nothing was seen, shape (channels, n).
    span : time after the first row for which the stone moves, s.

    Returns
    -------
    the noise, and by channel its sigma (for "gp" that of the independent part); a channel whose
    sigma was given, or of few values, keeps its own and is not named.

    Raises
    ------
    InputError : all channels are of few values.
    """
    left, singular, _ = np.linalg.svd(jacobian.reshape(-1, jacobian.shape[-1]), full_matrices=False)
    basis = left[:, singular > 1e-9 * singular[0]].reshape(*residual.shape, -1)
    channels = [
        _Channel.of(name, throw, residual[row], basis[row], weight[row])
        for row, name in enumerate(CHANNELS[: len(residual)])
        if (weight[row] > 0).sum() >= _FEWEST
    ]
    if not channels:
        raise InputError(f"{throw.name}: too few values to tell how noise goes together")
    found = _forgetful(channels, span) if kind == "ar1" else _smooth(channels, span)
    sigma, more = {}, {}
    for item, (own, other) in zip(channels, found, strict=True):
        if not item.given:
            sigma[item.name] = own * item.scale
        if kind == "ar1":
            more[item.name] = other
        elif other > _NEGLIGIBLE:
            more[item.name] = other * own * item.scale
    noise = Noise(kind, memory=more) if kind == "ar1" else Noise(kind, sizes=more, span=span)
    return noise, sigma


class _Channel(NamedTuple):
    """A channel's residuals over sigma, where seen and condensed."""

    name: str
    t: Floats
    both: Floats
    """residuals, and an orthonormal basis of the Jacobian over all channels; shape (rows, 1 + p)"""
    uneven: Floats
    """1/sigma of a row, over the channel's"""
    scale: float
    """sigma of the channel, SI"""
    block: int
    """rows that a mean is of"""
    given: bool

    @classmethod
    def of(
        cls, name: str, throw: Throw, residual: Floats, basis: Floats, weight: Floats
    ) -> _Channel:
        seen = weight > 0
        block = -(-int(seen.sum()) // _MOST)
        typical = float(np.sqrt(np.mean(weight[seen] ** 2)))
        both = np.column_stack([residual, basis])[seen]
        return cls(
            name, block_means(throw.t[seen] - throw.t[0], block),
            math.sqrt(block) * block_means(both, block),
            block_means(weight[seen] / typical, block), 1 / typical, block, name in throw.sigma,
        )  # fmt: skip

    @property
    def squares(self) -> float:
        """Mean square of the residuals."""
        return float(np.mean(self.both[:, 0] ** 2)) + 1e-20

    def independent(self) -> float:
        """Variance of what is independent from row to row, from second differences."""
        steady = float(np.mean(np.diff(self.both[:, 0], 2) ** 2)) / 6
        return 1.0 if self.given else max(steady, self.squares / _PURE**2)

    def forgetful(self, variance: float, memory: float) -> tuple[Floats, float]:
        """Residuals and basis with "ar1" noise made independent, and half its log-determinant."""
        # The noise of means over blocks is taken to be that of single rows so far apart.
        steps = alike(np.diff(self.t), memory)[:, None]
        left = np.sqrt(np.maximum(1 - steps**2, 1e-14))
        white = self.both / math.sqrt(variance * self.block)
        white[1:] = (white[1:] - steps * white[:-1]) / left
        spread = len(white) / 2 * math.log(variance * self.block)
        return white, spread + float(np.log(left).sum())

    def turned(self, span: float) -> tuple[Floats, Floats]:
        """Residuals and basis along the axes of "gp" noise, and the squares of a discrepancy of
        unit size along these."""
        t = np.minimum(self.t, span)
        wave = self.block * matern(t[:, None] - t, span)
        squares, axes = np.linalg.eigh(self.uneven[:, None] * wave * self.uneven)
        return axes.T @ self.both, np.maximum(squares, 0.0)


def _forgetful(channels: list[_Channel], span: float) -> list[tuple[float, float]]:
    """By channel, sigma over the one so far, and memory; one scale for all sigmas not given."""

    def parts(logs: Floats) -> list[tuple[float, float]]:
        memories = np.exp(np.clip(logs[1:], *np.log(np.multiply(_LASTING, span))))
        return [
            (1.0 if item.given else math.sqrt(item.squares) * math.exp(logs[0]), float(memory))
            for item, memory in zip(channels, memories, strict=True)
        ]

    def roots(logs: Floats) -> list[tuple[Floats, float]]:
        pairs = zip(channels, parts(logs), strict=True)
        return [item.forgetful(sigma**2, memory) for item, (sigma, memory) in pairs]

    starts = [[0.0] + [math.log(share * span)] * len(channels) for share in (0.01, 0.1)]
    return parts(_likeliest(roots, starts))


def _smooth(channels: list[_Channel], span: float) -> list[tuple[float, float]]:
    """By channel, sigma over the one so far, and size of the discrepancy over this; one scale for
    all discrepancies, and one for all sigmas not given."""
    steady = [item.independent() for item in channels]
    pairs = list(zip(channels, steady, strict=True))
    turned = [item.turned(span) for item in channels]
    excess = [math.sqrt(max(item.squares / own - 1, 0.0)) for item, own in pairs]

    def parts(logs: Floats) -> list[tuple[float, float]]:
        scale, size = math.exp(logs[0]), math.exp(logs[1])
        return [
            (1.0 if item.given else math.sqrt(own) * scale, min(size * over, _PURE))
            for (item, own), over in zip(pairs, excess, strict=True)
        ]

    def roots(logs: Floats) -> list[tuple[Floats, float]]:
        found = []
        for (both, squares), (sigma, size) in zip(turned, parts(logs), strict=True):
            spread = sigma * np.sqrt(1 + size**2 * squares)
            found.append((both / spread[:, None], float(np.log(spread).sum())))
        return found

    return parts(_likeliest(roots, [[0.0, 0.0], [0.0, 3.0]]))


def _likeliest(
    roots: Callable[[Floats], list[tuple[Floats, float]]], starts: list[list[float]]
) -> Floats:
    """The place of greatest restricted likelihood.

    Parameters
    ----------
    roots : from a place, by channel, the residuals and then the basis of the Jacobian, made
        independent, and half the log-determinant of the covariance.
    """
    from scipy.optimize import minimize

    def unlikely(logs: Floats) -> float:
        try:
            parts = roots(np.clip(logs, *_FAR))
        except np.linalg.LinAlgError:
            return math.inf
        white = np.concatenate([part for part, _ in parts])
        q, triangle = np.linalg.qr(white[:, 1:])
        left = white[:, 0] - q @ (q.T @ white[:, 0])
        spent = float(np.log(np.abs(np.diag(triangle))).sum())
        return sum(half for _, half in parts) + spent + float(left @ left) / 2

    found = [
        minimize(unlikely, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-3})
        for start in starts
    ]
    return np.clip(min(found, key=lambda item: float(item.fun)).x, *_FAR)


def block_means(values: Floats, block: int) -> Floats:
    """Means over blocks of rows; a last block that is not full is left out."""
    whole = len(values) // block * block
    return np.asarray(values[:whole].reshape(whole // block, block, *values.shape[1:]).mean(1))


@dataclass(frozen=True)
class Independence:
    """How far the residuals of a channel are from independent noise.

    Attributes
    ----------
    lag1 : correlation of neighbours.
    runs : z of the number of runs of one sign, negative where there are too few (Wald and
        Wolfowitz 1940).
    effective : number of independent values that would tell as much of a mean, n(1 - r)/(1 + r)
        (Bayley and Hammersley 1946).
    """

    lag1: float
    runs: float
    effective: float

    @property
    def doubtful(self) -> bool:
        """Whether independence is out of the question, and errors are the worse for it."""
        n = self.effective * (1 + self.lag1) / max(1 - self.lag1, 1e-9)
        sure = self.lag1 * math.sqrt(n) > _SURE or self.runs < -_SURE
        return sure and self.lag1 > _MATTERS


def lag1_of(residual: Floats, count: NDArray[np.int64]) -> Floats:
    """Correlation of neighbouring residuals; 0 for independent noise.

    Parameters
    ----------
    residual : shape (..., n), of which the first `count` are meant, shape (...).
    """
    return _lag1(_centred(residual, count))


def _lag1(centred: Floats) -> Floats:
    total = (centred**2).sum(-1)
    found: Floats = (centred[..., 1:] * centred[..., :-1]).sum(-1) / np.where(total > 0, total, 1.0)
    return found


def _centred(residual: Floats, count: NDArray[np.int64]) -> Floats:
    there = np.arange(residual.shape[-1]) < count[..., None]
    mean = np.where(there, residual, 0.0).sum(-1) / np.maximum(count, 1)
    return np.where(there, residual - mean[..., None], 0.0)


def independences(residual: Floats, count: NDArray[np.int64]) -> list[list[Independence]]:
    """Of the residuals of channels of throws, shape (throws, channels, n), the first `count`."""
    centred = _centred(residual, count)
    lag1 = _lag1(centred)
    up, n = centred > 0, np.maximum(count, 2)
    above = up.sum(-1)
    pairs = np.arange(1, residual.shape[-1]) < count[..., None]
    runs = 1 + ((up[..., 1:] != up[..., :-1]) & pairs).sum(-1)
    mean = 1 + 2 * above * (count - above) / n
    variance = (mean - 1) * (mean - 2) / (n - 1)
    sure = variance > 0
    z = np.where(sure, (runs - mean) / np.sqrt(np.where(sure, variance, 1.0)), 0.0)
    effective = count * np.minimum((1 - lag1) / (1 + lag1), 1.0)
    parts = np.stack([lag1, z, effective], -1).tolist()
    return [[Independence(*channel) for channel in throw] for throw in parts]
