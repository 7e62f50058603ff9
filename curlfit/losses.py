"""Losses: how much a residual counts when it is too large to be noise.

Each replaces the square of a residual r (in units of its sigma) by rho(r), which grows
more slowly, but without bound. Least squares minimises the sum of rho as the square of
`sqrt(rho)` with the sign of r, so that one solver serves all. The constants of huber
and cauchy are those of 95 % efficiency for Gaussian noise (Huber 1981; Holland and
Welsch 1977); Student's t has 4 degrees of freedom.

To add a loss: a subclass of `Loss`, and its entry in `LOSSES`; the tests of losses try
every one that is there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from curlfit.numerics.namespace import namespace

if TYPE_CHECKING:
    from numpy.random import Generator

    from curlfit.numerics.arrays import Floats

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""
_MEDIAN_EFFICIENCY = 0.37
"""Of sigma from the median absolute residual, for Gaussian noise (Huber 1981)."""
_DRAWN = 200.0
"""Sigmas within which the noise of a robust loss is drawn."""
_BESSEL_K1 = 0.6019072301972346
"""K_1(1), so as not to load `scipy.special` for it alone."""


def robust_sigma(values: Floats) -> float:
    """Standard deviation of the bulk: 1.4826 times the median absolute value."""
    if not len(values):
        return 0.0
    xp = namespace(values)
    return MAD_TO_SIGMA * float(xp.median(xp.abs(values)))


@dataclass(frozen=True)  # two of one class are equal
class Loss:
    """How much a residual counts that may be too large to be noise.

    Every loss is the likelihood of some noise, of the density exp(-rho/2)/norm: rho is
    r^2 near 0, and far out exceeds (1 + e) log r^2 for some e > 0, so that the density
    has an integral and a likeliest sigma exists. A bounded rho (of Tukey, of Geman and
    McClure) is no such loss. A subclass states its `name`, its `norm` and the formulas
    `signed_root`, `psi` and `psi_slope`; residuals are in units of their sigma
    throughout.

    Attributes
    ----------
    name : in `--loss`, files and records.
    about : what `--help` says of it in parentheses, if anything.
    norm : the integral of exp(-rho/2) over all residuals.
    is_robust : whether large residuals count less than their square.
    sigma_efficiency : degrees of freedom of an estimated sigma, over those of the rms
        of Gaussian noise: of the median, by which all robust losses estimate it.
    """

    name: ClassVar[str]
    about: ClassVar[str] = ""
    norm: ClassVar[float]
    is_robust: ClassVar[bool] = True
    sigma_efficiency: ClassVar[float] = _MEDIAN_EFFICIENCY

    def signed_root(self, r: Any) -> Any:
        """sqrt(rho) with the sign of r, for arrays of NumPy, or of JAX within a
        program; its derivative is finite at 0."""
        raise NotImplementedError

    def psi(self, r: Floats) -> Floats:
        """Influence of a residual on the optimum: psi = rho'/2."""
        raise NotImplementedError

    def psi_slope(self, r: Floats) -> Floats:
        """Derivative of `psi` by r."""
        raise NotImplementedError

    @property
    def suffix(self) -> str:
        """What headings say of it: ", huber loss"; nothing of least squares."""
        return f", {self.name} loss" if self.is_robust else ""

    def root_slope(self, r: Floats) -> Floats:
        """Derivative of `signed_root` by r."""
        size = namespace(r).maximum(abs(r), 1e-6)  # even in r, and flat at 0
        slope: Floats = self.psi(size) / self.signed_root(size)
        return slope

    def log_density(self, r: Floats) -> Floats:
        """Log of the density of noise of unit sigma, which integrates to 1."""
        density: Floats = -(self.signed_root(r) ** 2) / 2 - math.log(self.norm)
        return density

    def draw(self, random: Generator, shape: tuple[int, ...]) -> Floats:
        """Noise of unit sigma, by inverse transform sampling from the tabulated
        distribution function."""
        uniform = random.random(shape)
        xp = namespace(uniform)
        end = math.asinh(_DRAWN)
        grid = xp.sinh(xp.linspace(-end, end, 4001))
        density = xp.exp(self.log_density(grid))
        areas = xp.diff(grid) * (density[1:] + density[:-1]) / 2
        share = xp.concatenate([[0.0], xp.cumsum(areas)])
        drawn: Floats = xp.interp(uniform, share / share[-1], grid)
        return drawn

    def size(self, residual: Floats) -> float:
        """Size of residuals that outliers do not change: that of their bulk."""
        return robust_sigma(residual)

    def likeliest_sigma(self, residual: Floats, floor: float = 1e-12) -> float:
        """Maximum-likelihood sigma of residuals."""
        largest = float(abs(residual).max(initial=0.0))
        if largest <= floor:
            return floor

        # of the log-likelihood by log sigma, per value
        def slope(log_sigma: float) -> float:
            r = residual / math.exp(log_sigma)
            return float((r * self.psi(r)).mean()) - 1

        low = math.log(floor)
        if slope(low) <= 0:
            return floor
        from scipy.optimize import brentq  # slow to load

        return math.exp(brentq(slope, low, math.log(largest)))

    def precision(self, r: Floats) -> float:
        """Information of a residual over that of a Gaussian one of the same sigma
        (Huber 1981)."""
        if not len(r):
            return 1.0
        slope = max(float(self.psi_slope(r).mean()), 0.05)
        return slope**2 / max(float((self.psi(r) ** 2).mean()), 1e-300)


class Linear(Loss):
    """Least squares: rho = r^2, the likelihood of Gaussian noise."""

    name = "linear"
    about = "least squares"
    norm = math.sqrt(2 * math.pi)
    is_robust = False
    sigma_efficiency = 1.0

    def signed_root(self, r: Any) -> Any:
        return r

    def psi(self, r: Floats) -> Floats:
        return r

    def psi_slope(self, r: Floats) -> Floats:
        ones: Floats = namespace(r).ones_like(r)
        return ones

    def root_slope(self, r: Floats) -> Floats:
        ones: Floats = namespace(r).ones_like(r)
        return ones

    def draw(self, random: Generator, shape: tuple[int, ...]) -> Floats:
        return random.standard_normal(shape)

    def size(self, residual: Floats) -> float:
        """Their rms."""
        return math.sqrt((residual**2).mean())

    def likeliest_sigma(self, residual: Floats, floor: float = 1e-12) -> float:
        return max(self.size(residual), floor) if len(residual) else floor

    def precision(self, r: Floats) -> float:
        return 1.0


class Huber(Loss):
    """rho = r^2 up to k, 2 k |r| - k^2 beyond: Gaussian noise with exponential
    tails."""

    name = "huber"
    k = 1.345
    norm = (
        math.sqrt(2 * math.pi) * math.erf(k / math.sqrt(2))
        + 2 * math.exp(-(k**2) / 2) / k
    )

    def signed_root(self, r: Any) -> Any:
        xp = namespace(r)
        size = abs(r)
        outer = xp.sqrt(xp.maximum(2 * self.k * size - self.k**2, self.k**2))
        return xp.where(size <= self.k, r, xp.sign(r) * outer)

    def psi(self, r: Floats) -> Floats:
        return r.clip(-self.k, self.k)

    def psi_slope(self, r: Floats) -> Floats:
        return (abs(r) <= self.k).astype(float)


class SoftL1(Loss):
    """rho = 2 (sqrt(1 + r^2) - 1): hyperbolic noise."""

    name = "soft-l1"
    norm = 2 * math.e * _BESSEL_K1

    def signed_root(self, r: Any) -> Any:
        xp = namespace(r)
        return r * xp.sqrt(2 / (xp.sqrt(1 + r**2) + 1))

    def psi(self, r: Floats) -> Floats:
        psi: Floats = r / namespace(r).sqrt(1 + r**2)
        return psi

    def psi_slope(self, r: Floats) -> Floats:
        return (1 + r**2) ** -1.5


class Cauchy(Loss):
    """rho = c^2 log(1 + r^2/c^2): Student's t with c^2 - 1 = 4.7 degrees of freedom,
    widened."""

    name = "cauchy"
    c = 2.385
    norm = (
        c * math.gamma(0.5) * math.gamma((c**2 - 1) / 2) / math.gamma(c**2 / 2)
    )  # c times the beta function

    def signed_root(self, r: Any) -> Any:
        return r * namespace(r).sqrt(_log_ratio(r**2 / self.c**2))

    def psi(self, r: Floats) -> Floats:
        return r / (1 + r**2 / self.c**2)

    def psi_slope(self, r: Floats) -> Floats:
        q = 1 + r**2 / self.c**2
        return (2 - q) / q**2


class Student(Loss):
    """rho = (n + 1) log(1 + r^2/n): Student's t with n = 4 degrees of freedom."""

    name = "student"
    about = "4 degrees of freedom"
    n = 4.0
    norm = (
        math.sqrt(n) * math.gamma(0.5) * math.gamma(n / 2) / math.gamma((n + 1) / 2)
    )  # sqrt(n) times the beta function

    def signed_root(self, r: Any) -> Any:
        ratio = _log_ratio(r**2 / self.n)
        return r * namespace(r).sqrt((1 + 1 / self.n) * ratio)

    def psi(self, r: Floats) -> Floats:
        return r * (self.n + 1) / (self.n + r**2)

    def psi_slope(self, r: Floats) -> Floats:
        return (self.n + 1) * (self.n - r**2) / (self.n + r**2) ** 2


def _log_ratio(q: Any) -> Any:
    """log(1 + q)/q, also at 0."""
    xp = namespace(q)
    small = q < 1e-8
    return xp.where(small, 1 - q / 2, xp.log1p(q) / xp.where(small, 1.0, q))


LINEAR = Linear()
LOSSES: dict[str, Loss] = {
    loss.name: loss for loss in (LINEAR, Huber(), SoftL1(), Cauchy(), Student())
}
"""By name, least squares first. Compiled programs have the places of losses here as
their numbers, files have their names."""


def place_of(loss: Loss) -> int:
    """The place of a loss in `LOSSES`."""
    return list(LOSSES).index(loss.name)


def loss_at(place: int) -> Loss:
    """The loss at a place in `LOSSES`."""
    return list(LOSSES.values())[place]
