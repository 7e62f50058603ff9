"""Noise that goes together from row to row: models of it, and what residuals say of them.

Three models, by channel:

- "white": independent from row to row.
- "ar1": the noise forgets itself exponentially, with correlation exp(-gap/memory) between rows (an
  Ornstein-Uhlenbeck process; AR(1) where rows are evenly spaced). For noise of the tracker:
  filters, a camera that sways.
- "gp": independent noise on top of a smooth discrepancy, a Gaussian process of Matern's kernel with
  nu = 5/2 (Rasmussen and Williams 2006, eq. 4.17): (1 + q + q^2/3) exp(-q), q = sqrt(5) gap/memory.
  For a law that is not exact (Kennedy and O'Hagan 2001): what it misses is integrated twice on its
  way into the path and is far smoother than any tracker's noise.

Memory and size are the likeliest for the residuals of a fit with white noise, channel by channel.
Such a fit hides what its parameters can imitate: it leaves M e of a noise e, M = 1 - Q Q^T, Q an
orthonormal basis of the Jacobian's columns, all over sigma. So the residuals of a channel have the
covariance M' C M', M' being the channel's own part of M and C its noise's. What the other channels
pull into it counts as its own, and the fit is held: else one channel would be fitted perfectly, and
taken to be exact, while the others pay for it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import InputError
from curlfit.parameters import NOISES
from curlfit.throw import CHANNELS

if TYPE_CHECKING:
    from curlfit.throw import Throw

Floats = NDArray[np.float64]

_FEWEST = 20  # values of a channel from which its residuals are judged
_MOST = 300  # values of a channel looked at; more are condensed to means
_WAVES = (0.03, 2.0)  # memory of a discrepancy, over the time of the throw
_LASTING = (1e-3, 10.0)  # memory of "ar1" noise, the same
_SIZES = (1e-2, 300.0)  # of a discrepancy over the independent noise
_NEGLIGIBLE = 0.05  # the same, below which there is none
_HIDDEN = 1e-6  # share of a direction that is left where a fit hides it
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
    memory : by channel, the time in s over which it does; channels that are not here are white.
    sizes : of "gp" by channel, standard deviation of the discrepancy (SI).
    """

    kind: str = "white"
    memory: dict[str, float] = field(default_factory=dict)
    sizes: dict[str, float] = field(default_factory=dict)

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
    kind: str, throw: Throw, residual: Floats, jacobian: Floats, weight: Floats
) -> tuple[Noise, dict[str, float]]:
    """The noise that residuals of a fit with white noise show, and the sigmas that go with it.

    Parameters
    ----------
    kind : "ar1" or "gp".
    residual, jacobian : over sigma, shapes (channels, n) and (channels, n, free parameters).
    weight : 1/sigma, 0 where nothing was seen, shape (channels, n).

    Returns
    -------
    the noise, and by channel its sigma (for "gp" that of the independent part); a channel whose
    sigma was given, or of few values, keeps its own and is not named.
    """
    left, singular, _ = np.linalg.svd(jacobian.reshape(-1, jacobian.shape[-1]), full_matrices=False)
    basis = left[:, singular > 1e-9 * singular[0]].reshape(*residual.shape, -1)
    channels = {
        name: _Channel.of(throw.t, residual[row], basis[row], weight[row], name in throw.sigma)
        for row, name in enumerate(CHANNELS[: len(residual)])
        if (weight[row] > 0).sum() >= _FEWEST
    }
    memory, sizes, sigma = {}, {}, {}
    for name, item in channels.items():
        part = item.likeliest(kind)
        if kind == "ar1" or part.size > _NEGLIGIBLE:
            memory[name] = part.memory
            sizes[name] = part.size * part.sigma * item.scale
        if not item.given:
            sigma[name] = part.sigma * item.scale
    return Noise(kind, memory, sizes if kind == "gp" else {}), sigma


class _Part(NamedTuple):
    """Noise of a channel over the sigma so far: sigma, memory in s, and of "gp" the size of the
    discrepancy over this sigma."""

    sigma: float
    memory: float
    size: float


class _Channel(NamedTuple):
    """A channel's residuals over sigma, where seen and condensed."""

    t: Floats
    residual: Floats
    basis: Floats
    """rows of Q, shape (rows, parameters)"""
    uneven: Floats
    """1/sigma of a row, over the channel's"""
    scale: float
    """sigma of the channel, SI"""
    block: int
    """rows that a mean is of"""
    given: bool

    @classmethod
    def of(
        cls, t: Floats, residual: Floats, basis: Floats, weight: Floats, given: bool
    ) -> _Channel:
        seen = weight > 0
        block = -(-int(seen.sum()) // _MOST)
        typical = float(np.sqrt(np.mean(weight[seen] ** 2)))
        root = math.sqrt(block)
        return cls(
            _means(t[seen], block), root * _means(residual[seen], block),
            root * _means(basis[seen], block), _means(weight[seen] / typical, block), 1 / typical,
            block, given,
        )  # fmt: skip

    @property
    def span(self) -> float:
        return float(self.t[-1] - self.t[0])

    def first(self, kind: str) -> _Part:
        """Where to begin: noise from row to row, and all the rest a discrepancy."""
        r = self.residual
        sigma = math.sqrt(max(float(np.mean(np.diff(r, 2) ** 2)) / 6, 1e-20))
        whole = math.sqrt(float(np.mean(r**2)) + 1e-20)
        if kind == "ar1":
            return _Part(1.0 if self.given else whole, self.span / 20, 0.0)
        return _Part(1.0 if self.given else sigma, self.span / 5, whole / sigma)

    def covariance(self, kind: str, part: _Part) -> Floats:
        """Of the noise, shape (rows, rows)."""
        gap = np.abs(self.t[:, None] - self.t)
        if kind == "ar1":
            # of means over blocks, whose noise is taken to be that of single rows so far apart
            return part.sigma**2 * self.block * alike(gap, part.memory)
        wave = part.size**2 * self.block * matern(gap, part.memory)
        together = np.eye(len(self.t)) + self.uneven[:, None] * wave * self.uneven
        return np.asarray(part.sigma**2 * together)

    def likeliest(self, kind: str) -> _Part:
        """The noise that the residuals are likeliest under."""
        from scipy.linalg import solve_triangular
        from scipy.optimize import minimize

        q = self.basis
        left, share, _ = np.linalg.svd(q, full_matrices=False)
        gone = left[:, share**2 > 1 - _HIDDEN]
        limits = np.log([np.multiply(_LASTING if kind == "ar1" else _WAVES, self.span)])
        if kind == "gp":
            limits = np.concatenate([limits, np.log([_SIZES])])

        def part_of(logs: Floats) -> _Part:
            memory, *size = np.exp(np.clip(logs[: len(limits)], *limits.T))
            sigma = 1.0 if self.given else math.exp(logs[-1])
            return _Part(sigma, memory, size[0] if size else 0.0)

        def unlikely(logs: Floats) -> float:
            covariance = self.covariance(kind, part_of(logs))
            cq = covariance @ q
            crossed = q @ cq.T
            seen = covariance - crossed - crossed.T + q @ (q.T @ cq) @ q.T
            # What the fit hides altogether says nothing, whatever its variance.
            full = seen + float(np.trace(covariance)) * gone @ gone.T
            full[np.diag_indices_from(full)] += 1e-10 * float(np.mean(np.diag(covariance)))
            try:
                lower = np.linalg.cholesky(full)
            except np.linalg.LinAlgError:
                return math.inf
            white = solve_triangular(lower, self.residual, lower=True)
            variance = float(np.trace(covariance)) if gone.size else 1.0
            spent = gone.shape[1] / 2 * math.log(variance)
            return float(np.log(np.diag(lower)).sum() - spent + white @ white / 2)

        near, starts = self.first(kind), []
        for memory in (near.memory, near.memory / 4):
            start = [math.log(memory)]
            start += [math.log(near.size)] if kind == "gp" else []
            start += [] if self.given else [math.log(near.sigma)]
            starts.append(np.array(start))
        found = [
            minimize(unlikely, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-3})
            for start in starts
        ]
        return part_of(min(found, key=lambda item: float(item.fun)).x)


def _means(values: Floats, block: int) -> Floats:
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


def independence(residual: Floats) -> Independence:
    """Of the residuals of a channel, shape (n,)."""
    centred = residual - residual.mean()
    total = float((centred**2).sum())
    n = len(residual)
    if not total > 0:
        return Independence(0.0, 0.0, float(n))
    lag1 = float((centred[1:] * centred[:-1]).sum() / total)
    up = centred > 0
    above, below = int(up.sum()), int((~up).sum())
    runs = 1 + int((up[1:] != up[:-1]).sum())
    mean = 1 + 2 * above * below / n
    variance = (mean - 1) * (mean - 2) / (n - 1)
    return Independence(
        lag1,
        (runs - mean) / math.sqrt(variance) if variance > 0 else 0.0,
        n * min((1 - lag1) / (1 + lag1), 1.0),
    )
