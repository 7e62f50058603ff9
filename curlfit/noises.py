"""Noises: how the noise of a channel is correlated from row to row.

A noise says in words what it is, has its estimates as fields, and states what is
searched for, the parameters that follow from it, and the filter that makes such noise
independent. The engines of `curlfit.inference.noise` do the rest: restricted
likelihood, whitening of residuals and, for a noise that has a discrepancy, the
accelerations that the law lacks.

To add a noise: a subclass of `Noise`, and its entry in `NOISES`; the tests of noises
try every one that is there. JAX is imported within the methods, so that `--help` does
without.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

from curlfit.numerics.namespace import namespace

if TYPE_CHECKING:
    from curlfit.numerics.arrays import Floats

# `curlfit.records.ADDED`, whose import takes numpy, without which `--help` is quick
_ADDED = {"needed": False}

_TYPICAL = 0.1  # mean of the prior of the correlation time over the time of motion
_SHORTEST = 0.3  # correlation time over the time between rows
_LONGEST = 0.3  # correlation time over the time of motion
_TRIED = (0.02, 0.1)  # initial correlation times over the time of motion
_WHITE = 12.0  # logit of an independent share that is practically 1
_MOST = 9.0  # limit of the logit of that of correlated noise


class Unknown(NamedTuple):
    """A number that is searched for, such as a logarithm."""

    starts: tuple[float, ...]
    """initial values to try"""
    lower: float
    upper: float

    @classmethod
    def held(cls, value: float) -> Unknown:
        """One that keeps its value."""
        return cls((value,), value, value)


class Filter(Protocol):
    """Makes noise independent: a pytree of arrays, such as a `KalmanFilter`."""

    def innovations(self, columns: Any) -> Any:
        """What the rows before do not predict of each column, over its standard
        deviation; shape (channels, n, columns)."""

    def log_determinant(self) -> Any:
        """Of the whitening, by channel."""


@dataclass(frozen=True)
class Noise:
    """How noise is correlated from row to row, with its estimates.

    A subclass states `kind`, `about`, its `parameters`, each a field with values by
    channel, and `search`, `values`, `filter` and `correlation_in_words`. All records
    have the fields below, empty where a noise has no such estimates.

    Attributes
    ----------
    kind : its name in `--noise`, files and records.
    about : what `--help` says of it, after its name.
    further_names : other names of it.
    is_white : whether it is independent from row to row.
    has_discrepancy : whether it includes accelerations that the law lacks; it then
        states its `covariance` too.
    parameters : the fields that have its parameters, and the value that each has where
        noise is independent.
    has_time : whether the last unknown is the logarithm of a correlation time.
    memory : correlation time in s by channel, 0 where the noise is independent.
    white : independent share of the variance by channel.
    sizes : with a discrepancy, the standard deviation of the missing acceleration over
        that by friction, by component (`across`, `along`, `turning`).
    independent : with a discrepancy, sigma of the fit with independent noise, by
        channel: the coefficients and the path of the law are nearest to the data with
        these weights.
    initial_state : covariance of the change of the initial state (x0, y0, heading,
        v0, phi0, omega0; SI) that compensates the discrepancy, part of the error of
        its estimate.
    """

    kind: str = ""
    memory: dict[str, float] = field(default_factory=dict)
    white: dict[str, float] = field(default_factory=dict, metadata=_ADDED)
    sizes: dict[str, float] = field(default_factory=dict)
    independent: dict[str, float] = field(default_factory=dict, metadata=_ADDED)
    initial_state: list[list[float]] = field(default_factory=list, metadata=_ADDED)

    about: ClassVar[str]
    further_names: ClassVar[tuple[str, ...]] = ()
    is_white: ClassVar[bool] = False
    has_discrepancy: ClassVar[bool] = False
    parameters: ClassVar[Mapping[str, float]] = {}
    has_time: ClassVar[bool] = False

    def search(
        self, correlated: Sequence[bool], gap: float, span: float
    ) -> list[Unknown]:
        """What is searched for.

        Parameters
        ----------
        correlated : by channel, whether its noise may be correlated; unknowns that
            concern no such channel are held where noise is independent.
        gap : typical time between rows, s.
        span : time during which the stone moves, s.
        """
        raise NotImplementedError

    def values(self, unknowns: Any) -> dict[str, Any]:
        """The parameters by channel, from what is searched for; for JAX."""
        raise NotImplementedError

    def log_prior(self, unknowns: Any, span: Any) -> Any:
        """Log-density of the prior of the unknowns, up to a constant; for JAX."""
        return 0.0

    def filter(self, values: Mapping[str, Any], gaps: Any, seen: Any) -> Filter:
        """The filter of noise of variance 1; for JAX.

        Parameters
        ----------
        values : of the parameters, by channel.
        gaps : time to the next row, s, shape (n,).
        seen : which values were observed, shape (channels, n).
        """
        raise NotImplementedError

    def covariance(self, channel: str, times: Floats) -> Floats:
        """Covariance of correlated noise of variance 1 at some times, in s."""
        raise NotImplementedError

    def correlation_in_words(self, channel: str) -> str:
        """What reports say of a channel whose noise is correlated."""
        raise NotImplementedError

    @property
    def suffix(self) -> str:
        """What headings say of it: ", ar1 noise"; nothing of independent noise."""
        return "" if self.is_white else f", {self.kind} noise"

    @property
    def correlated(self) -> tuple[str, ...]:
        """The channels whose noise is correlated."""
        channels: dict[str, None] = {}
        for name, independent in self.parameters.items():
            for channel, value in getattr(self, name).items():
                if value != independent:
                    channels[channel] = None
        return tuple(channels)

    @property
    def number_of_parameters(self) -> int:
        """The number of its estimates: parameters of correlated channels, and sizes of
        a discrepancy."""
        return len(self.parameters) * len(self.correlated) + len(self.sizes)

    def words(self, channel: str) -> str:
        """The noise of a channel in a few words."""
        parts = ["discrepancy"] if self.sizes else []
        if channel in self.correlated:
            parts.append(self.correlation_in_words(channel))
        return ", ".join(parts) or "independent"


@dataclass(frozen=True)
class White(Noise):
    """Noise that is independent from row to row."""

    kind: str = "white"

    about = "has none"
    is_white = True


@dataclass(frozen=True)
class Ar1(Noise):
    """Independent noise, and noise whose correlation decays exponentially.

    The correlation of the second is exp(-gap/memory) between rows (an
    Ornstein-Uhlenbeck process; AR(1) where rows are evenly spaced). For noise of the
    tracker: filters, a swaying camera. All channels have one correlation time, since
    one camera measures them, and each its independent share of the variance.
    """

    kind: str = "ar1"

    about = (
        "has independent and exponentially correlated noise, as from a filter or a "
        "swaying camera"
    )
    parameters: ClassVar[Mapping[str, float]] = {"memory": 0.0, "white": 1.0}
    has_time = True

    def search(
        self, correlated: Sequence[bool], gap: float, span: float
    ) -> list[Unknown]:
        """Logits of the shares, and the logarithm of the correlation time."""
        shares = [
            Unknown((0.0,), -_MOST, _MOST) if is_correlated else Unknown.held(_WHITE)
            for is_correlated in correlated
        ]
        shortest = math.log(_SHORTEST * gap)
        if not any(correlated):
            return [*shares, Unknown.held(shortest)]
        longest = max(math.log(_LONGEST * span), shortest)
        starts = tuple(math.log(part * span) for part in _TRIED)
        return [*shares, Unknown(starts, shortest, longest)]

    def values(self, unknowns: Any) -> dict[str, Any]:
        import jax

        shares = jax.nn.sigmoid(unknowns[:-1])
        memory = jax.numpy.exp(unknowns[-1])
        return {"memory": jax.numpy.full(len(shares), memory), "white": shares}

    def log_prior(self, unknowns: Any, span: Any) -> Any:
        # exponential in the correlation time (in its logarithm, hence the Jacobian),
        # uniform in the logits of the shares
        log_time = unknowns[-1]
        return log_time - namespace(log_time).exp(log_time) / (_TYPICAL * span)

    def filter(self, values: Mapping[str, Any], gaps: Any, seen: Any) -> Filter:
        from curlfit.numerics.kalman import KalmanFilter

        return KalmanFilter.of(values["memory"], values["white"], gaps, seen)

    def covariance(self, channel: str, times: Floats) -> Floats:
        xp = namespace(times)
        share = self.white[channel]
        decay = xp.exp(-abs(times[:, None] - times) / self.memory[channel])
        covariance: Floats = share * xp.eye(len(times)) + (1 - share) * decay
        return covariance

    def correlation_in_words(self, channel: str) -> str:
        time = f"correlation time {self.memory[channel]:.2g} s"
        return f"{time}, {self.white[channel]:.0%} independent"

    @property
    def number_of_parameters(self) -> int:
        """Distinct correlation times, independent shares, sizes of a discrepancy."""
        times = {self.memory[channel] for channel in self.correlated}
        return len(times) + len(self.correlated) + len(self.sizes)


@dataclass(frozen=True)
class Discrepancy(Ar1):
    """The noise of `Ar1`, and accelerations that the law lacks.

    They are functions of speed, propagated to all channels by the equations of motion
    (`curlfit.inference.noise.accelerations`), for a law that is not exact (Kennedy and
    O'Hagan 2001, J. R. Stat. Soc. B 63, 425). Slow noise and an inexact law leave
    similar residuals, so that neither is estimated without the other.
    """

    kind: str = "discrepancy"

    about = (
        "has the noise of `ar1` and accelerations that an inexact law lacks, as "
        "functions of speed"
    )
    further_names = ("ar1+discrepancy",)
    has_discrepancy = True


WHITE, AR1, DISCREPANCY = White(), Ar1(), Discrepancy()
NOISES: dict[str, Noise] = {noise.kind: noise for noise in (WHITE, AR1, DISCREPANCY)}
"""By name, independent noise first; none has been estimated."""
