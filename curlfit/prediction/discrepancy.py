"""Model discrepancy: accelerations that a law misses, seen or not, for the bands of predictions.

Beside the law's own, the stone has an acceleration across its velocity, along it, and in its
turning. What a law misses it misses again at the same speed, so each is a function of speed: a
Gaussian process in the logarithm of speed (friction laws are powers of it), of Matern covariance
(order 5/2, length a factor e in speed). Across and turning, it is proportional to the spin of a
throw: the mirror image of a throw is a throw, and proportion is the first order of what is odd.

Sizes. The size of each has an exponential prior, as penalised-complexity priors have it (Simpson
et al. 2017, Statistical Science 32, 1): 5 % of it lies above the friction, mu g by the mean
deceleration of the fitted rows, and it ends there: a missing force of the contact is no larger than
the contact's own. For the turning, it is the moment of friction at the ring, mu g R/rho^2, times
the share R omega/v by which sliding differs along the ring (at most 1, mean of the rows). Times the
likelihood, that makes the sizes of the draws. A record that shows nothing thus leaves the sizes
that it could not have shown, and one that is silent the prior, whose mean is a third of friction.

Identification. A law has the coefficients of least squares: the accelerations are those that do not
change these, to first order, while the start of the fitted throw follows them (as in Plumlee 2017,
Journal of the American Statistical Association 112, 1274). Coefficients at a bound or fixed cannot
change. Independent noise by channel is estimated beside it; where residuals still go together from
row to row, they count as the fewer independent values that would tell as much.

Beyond the fitted speeds the record shows nothing: what is missing there alone, a process of the
same covariance that is zero at the fitted speeds, has sizes of the prior.

A prediction is the law's own path, and its bands lie to the side of it that the residuals point
to: draws have the posterior mean with a random factor, even between 0 and 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, cast

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)
from curlfit.prediction.result import CEILING, WAYS, Misfit

# isort: split
import numpy as np
from numpy.typing import NDArray

from curlfit.friction import check_load
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import directions
from curlfit.inference.likelihood import linearize
from curlfit.inference.noise.models import independences
from curlfit.inference.problem import Origin, build_problem
from curlfit.numerics.compiled import stacked
from curlfit.prediction.ensemble import Paths, followed
from curlfit.stone import GRAVITY
from curlfit.throws.throw import CHANNELS

Floats = NDArray[np.float64]

_ABOVE = 0.05  # share of the prior of the sizes above the ceiling, where it is cut off
_EDGES = np.geomspace(0.002, 1.0, 13)
_SIZES = np.sqrt(_EDGES[1:] * _EDGES[:-1])  # over the ceiling, in the middle of equal parts
_SPEEDS = np.geomspace(0.05, 10.0, 161)  # m/s, at which accelerations are kept
_SHAPES = 20  # functions of speed that they are made of
_FEWEST = 20  # values of a channel from which its noise is judged
_TIMES = 331  # of the fitted path
_BEYOND = 1.1  # of the duration of the fitted rows that the path is followed
_FINEST = 1e-5  # m, rad, m/s or rad/s: noise is not taken to be smaller
_ROUNDS = 3  # of telling noise and its memory


class Missing(NamedTuple):
    """Draws of missing accelerations."""

    acceleration: Floats
    """at `_SPEEDS`, m/s^2 (rad/s^2), shape (draws, 3, speeds)"""
    change: Floats
    """how far the estimates are off because of it, to first order: what to add to the parameters,
    shape (draws, parameters)"""

    def on(self, paths: Paths, spin: float = 1.0) -> Paths:
        """Each path with a draw.

        Parameters
        ----------
        spin : of the throw over that of the fitted one.
        """
        middle = np.log(np.clip(paths.mean_speeds(), _SPEEDS[0], _SPEEDS[-1]))
        known = np.log(_SPEEDS)
        met = np.array(
            [
                [np.interp(at, known, way) for way in one]
                for at, one in zip(middle, self.acceleration, strict=True)
            ]
        )
        return paths.under(met * np.array([spin, 1.0, spin])[:, None])


@dataclass(frozen=True)
class Discrepancy:
    """The posterior of what a law misses.

    Attributes
    ----------
    misfit : the same in numbers.
    """

    misfit: Misfit
    _fit: FitResult
    _rows: _Rows
    """the fitted rows"""
    _noise: Floats
    """squares by channel, over the fit's"""
    _sizes: Floats
    """of a grid, over the ceilings, shape (places, 3)"""
    _chances: Floats
    """of these places"""
    _beyond: Floats
    """functions of speed that are zero at the fitted speeds, shape (functions, speeds)"""

    def drawn(self, draws: int, random: np.random.Generator) -> Missing:
        """Draws of missing accelerations."""
        places, of = np.unique(
            random.choice(len(self._sizes), draws, p=self._chances), return_inverse=True
        )
        lower, white, _ = self._rows.solved(self._noise, self._sizes[places])
        factor = random.uniform(0.0, 2.0, (draws, 1))
        right = factor * white[of] + random.standard_normal((draws, lower.shape[-1]))
        free = np.linalg.solve(lower.mT[of], right[..., None])[:, self._rows.seen :, 0]
        change = np.zeros((draws, len(self._fit.parameters)))
        change[:, _movable(self._fit)] = -free @ (self._rows.steps @ self._rows.shared).T
        weights = free @ self._rows.basis.T
        ceilings = np.array([self.misfit.ceilings[way] for way in WAYS])
        made = weights.reshape(draws, len(WAYS), -1) * ceilings[:, None]
        beyond = random.choice(_SIZES, (draws, len(WAYS)), p=_chances_of_prior()) * ceilings
        other = random.standard_normal((draws, len(WAYS), len(self._beyond))) @ self._beyond
        return Missing(made @ _shapes() + beyond[..., None] * other, change)

    def moved(self, values: Floats, missing: Missing) -> Floats:
        """Draws of the parameters with what is missing, and less sure where residuals tell less
        than independent ones would."""
        movable, rows = _movable(self._fit), self._rows
        seen = rows.seen
        less = np.maximum(self._noise, 1.0)
        lower = np.linalg.cholesky(np.tensordot(1 / less, rows.grams[:, :seen, :seen], 1))
        offset = (values - self._fit.values)[:, movable] @ rows.measured.T
        change = np.linalg.solve(lower.T, offset.T).T - offset
        found = values + missing.change
        found[:, movable] += change @ rows.steps.T
        bounds = self._fit.parameter_set
        return cast(Floats, np.clip(found, bounds.lower, bounds.upper))


def misfit_of(fit: FitResult) -> Misfit:
    """What the law of a fit misses, in numbers. See the top of this file."""
    return discrepancy_of(fit).misfit


def discrepancy_of(fit: FitResult) -> Discrepancy:
    """What the law of a fit misses: the posterior of it. See the top of this file."""
    friction = _friction(fit)
    turning = friction * fit.stone.R / fit.stone.rho**2 * _unevenness(fit)
    ceilings = CEILING * GRAVITY * np.array([friction, friction, turning])
    rows = _Rows.of(fit, ceilings)
    judged = rows.counts > _FEWEST
    noise, share = np.where(judged, rows.rough(), 1.0), np.ones(len(rows.counts))
    best = np.full(len(WAYS), 0.1)
    for _ in range(_ROUNDS):
        noise, best = rows.likeliest(noise, share, best, judged)
        before, share = share, np.where(judged, rows.effective(noise / share, best), 1.0)
        if np.allclose(share, before, rtol=0.1):
            break
    places = np.stack(np.meshgrid(*[_SIZES] * len(WAYS), indexing="ij"), -1).reshape(-1, len(WAYS))
    fitting = rows.likelihood(noise, share, places)
    plausible = fitting + _prior(places)
    chances = np.exp(plausible - plausible.max())
    chances /= chances.sum()
    sizes = ceilings * np.sqrt(chances @ places**2)
    excess = {
        way: float(np.sqrt(2 * (fitting.max() - fitting[places[:, place] == _SIZES[0]].max())))
        for place, way in enumerate(WAYS)
    }
    misfit = Misfit(
        dict(zip(WAYS, map(float, sizes), strict=True)),
        _span(fit),
        {
            name: float(sigma * math.sqrt(square * part))
            for name, sigma, square, part, use in zip(
                rows.names, rows.sigmas, noise, share, judged, strict=True
            )
            if use
        },
        excess if judged.any() else {},
        dict(zip(WAYS, map(float, ceilings), strict=True)),
        friction,
    )
    return Discrepancy(misfit, fit, rows, noise, places, chances, _beyond(fit.fitted["speed"]))


@dataclass(frozen=True)
class _Rows:
    """The fitted rows, and what parameters and missing accelerations make of them.

    Attributes
    ----------
    names, sigmas, counts : of the channels: sigma of a value as the fit weights it, and how many.
    parts : by channel, over sigma: what unit parameters, unit accelerations and, last, the data
        (their residuals) are in each row.
    grams : of these columns by channel. seen : number of parameters' columns, which are those that
        the fit sees, in units of their errors.
    steps, measured : changes of the movable parameters by these, and back.
    basis : accelerations of which the others' columns are: over the ceilings, way by way, functions
        of speed of unit variance together; all that do not change the coefficients.
    shared : parameters' columns by these.
    """

    names: tuple[str, ...]
    sigmas: Floats
    counts: NDArray[np.int64]
    parts: tuple[Floats, ...]
    grams: Floats
    seen: int
    steps: Floats
    measured: Floats
    basis: Floats
    shared: Floats

    @classmethod
    def of(cls, fit: FitResult, ceilings: Floats) -> _Rows:
        """Of a fit, and unit accelerations in m/s^2 (rad/s^2)."""
        jacobian, weight = _slopes(fit)
        names = tuple(
            name for name, own in zip(CHANNELS, weight, strict=False)
            if name in fit.observed and (own > 0).any()
        )  # fmt: skip
        made = _response(fit, names) * np.repeat(ceilings, _SHAPES)
        movable = _movable(fit)
        blocks, sigmas = [], []
        for name, response in zip(names, made, strict=True):
            place = CHANNELS.index(name)
            use = weight[place] > 0
            own = np.minimum(weight[place, use], 1 / _FINEST)[:, None]
            residual = (fit.observed[name] - fit.fitted[name])[use, None]
            blocks.append(
                own * np.hstack([jacobian[place, use][:, movable], response[use], residual])
            )
            sigmas.append(float(1 / np.sqrt(np.mean(own**2))))
        p = int(movable.sum())
        whole = np.concatenate(blocks)
        typical = fit.parameter_set.typical[movable]
        along, singular, _ = directions(whole[:, :p].T @ whole[:, :p], typical)
        steps = typical[:, None] * along.T / singular
        measured = singular[:, None] * along / typical
        shared = (whole[:, :p] @ steps).T @ whole[:, p:-1]
        own = slice(0, int(movable[: len(fit.coefficients)].sum()))
        basis = _null_space((steps @ shared)[own] / typical[own, None])
        parts = tuple(
            np.hstack([one[:, :p] @ steps, one[:, p:-1] @ basis, one[:, -1:]]) for one in blocks
        )
        return cls(
            names, np.array(sigmas), np.array([len(part) for part in parts]), parts,
            np.array([part.T @ part for part in parts]), len(singular), steps, measured, basis,
            shared @ basis,
        )  # fmt: skip

    @property
    def least(self) -> Floats:
        """Least squares of the noise over the fit's by channel."""
        return (_FINEST / self.sigmas) ** 2

    def solved(self, noise: Floats, sizes: Floats) -> tuple[Floats, Floats, Floats]:
        """The Gaussian posterior of all columns at given sizes, shape (places, 3) over ceilings.

        Returns
        -------
        Cholesky factors L of its precision, L^T times its mean, and the logarithm of the
        determinant of the prior's precision.
        """
        loose = np.repeat(1 / sizes**2, _SHAPES, axis=1)
        prior = (self.basis.T * loose[:, None]) @ self.basis
        whole = np.tensordot(1 / noise, self.grams, 1)
        precision = np.tile(whole[:-1, :-1], (len(sizes), 1, 1))
        precision[:, self.seen :, self.seen :] += prior
        lower = np.linalg.cholesky(precision)
        white = np.linalg.solve(lower, whole[:-1, -1:])[..., 0]
        return cast(Floats, lower), white, cast(Floats, np.linalg.slogdet(prior)[1])

    def likelihood(self, noise: Floats, share: Floats, sizes: Floats) -> Floats:
        """Logarithm of the restricted likelihood of sizes, shape (places, 3) over ceilings."""
        lower, white, prior = self.solved(noise, sizes)
        spread = 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(1) - prior
        left = self.grams[:, -1, -1] @ (1 / noise) - (white**2).sum(1)
        fixed = (self.counts * share) @ np.log(noise)
        return cast(Floats, -(spread + left + fixed) / 2)

    def likeliest(
        self, noise: Floats, share: Floats, sizes: Floats, judged: NDArray[np.bool_]
    ) -> tuple[Floats, Floats]:
        """The most plausible noise (squares, over the fit's) of judged channels, and sizes."""
        from scipy.optimize import minimize

        def unpacked(logs: Floats) -> tuple[Floats, Floats]:
            tried = np.ones(len(noise))
            tried[judged] = np.exp(logs[len(WAYS) :])
            return tried, np.exp(logs[None, : len(WAYS)])

        def implausible(logs: Floats) -> float:
            tried, place = unpacked(logs)
            return -float((self.likelihood(tried, share, place) + _prior(place))[0])

        limits = [(math.log(_SIZES[0]), 0.0)] * len(WAYS)
        limits += [(math.log(least), 14.0) for least in self.least[judged]]
        start = np.log(np.concatenate([sizes, noise[judged]]))
        found = minimize(implausible, start, method="L-BFGS-B", bounds=limits).x
        tried, place = unpacked(found)
        return tried, place[0]

    def rough(self) -> Floats:
        """Squares of noise over the fit's by channel, from differences of neighbours."""
        squares = np.array([np.sum(np.diff(part[:, -1]) ** 2) for part in self.parts])
        return np.maximum(squares / (2 * self.counts), self.least)

    def effective(self, noise: Floats, sizes: Floats) -> Floats:
        """Share of the values that would tell as much if independent, by channel."""
        lower, white, _ = self.solved(noise, sizes[None])
        known = np.linalg.solve(lower[0].T, white[0])
        found = np.ones(len(self.parts))
        for place, part in enumerate(self.parts):
            left = (part[:, -1] - part[:, :-1] @ known)[None, None]
            judged = independences(left, np.array([[left.size]]))[0][0]
            if judged.doubtful:
                found[place] = judged.effective / left.size
        return found


def _prior(sizes: Floats) -> Floats:
    """Logarithm of the prior density of the logarithms of sizes over their ceilings."""
    rate = -math.log(_ABOVE)
    return cast(Floats, (np.log(sizes) - rate * sizes).sum(-1))


def _chances_of_prior() -> Floats:
    chances = np.exp([_prior(np.array([size])) for size in _SIZES])
    return cast(Floats, chances / chances.sum())


def _covariance() -> Floats:
    """Of a unit acceleration at `_SPEEDS`."""
    gap = np.abs(np.log(_SPEEDS[:, None] / _SPEEDS)) * math.sqrt(5)
    found: Floats = (1 + gap + gap**2 / 3) * np.exp(-gap)
    return found


@cache
def _shapes() -> Floats:
    """Functions of speed that, with independent unit weights, make a unit acceleration, shape
    (functions, speeds)."""
    squares, vectors = np.linalg.eigh(_covariance())
    return cast(Floats, (np.sqrt(squares) * vectors).T[: -_SHAPES - 1 : -1])


def _beyond(speed: Floats) -> Floats:
    """The same, zero at the fitted speeds, where these lie within `_SPEEDS`."""
    fitted = np.clip(_SPEEDS, speed.min(), speed.max()) == _SPEEDS
    whole = _covariance()
    # the record knows its own speeds to rounding
    known = whole[fitted][:, fitted] + 1e-6 * np.eye(int(fitted.sum()))
    left = whole - whole[:, fitted] @ np.linalg.solve(known, whole[fitted])
    left[fitted] = left[:, fitted] = 0.0
    squares, vectors = np.linalg.eigh(left)
    return cast(Floats, (np.sqrt(np.maximum(squares, 0.0)) * vectors).T[: -_SHAPES - 1 : -1])


def _response(fit: FitResult, names: tuple[str, ...]) -> Floats:
    """What accelerations of each way and shape make of the rows, per unit, by central differences,
    shape (channels, rows, 3 * _SHAPES)."""
    since = fit.observed["t"] - fit.observed["t"][0]
    t = np.linspace(0.0, _BEYOND * since[-1], _TIMES)
    path = followed(fit.law_class, check_load(fit.load), fit.values[None], fit.stone, t)
    small = 1e-3 * GRAVITY * _friction(fit) * np.array([1.0, -1.0])
    unit = np.einsum("e,wv,ks->wkevs", small, np.eye(len(WAYS)), _shapes())
    each = Missing(unit.reshape(-1, len(WAYS), len(_SPEEDS)), np.zeros(0))
    state = each.on(path.of(np.zeros(len(each.acceleration), int))).state
    x, y, phi, vx, vy, omega = state.swapaxes(0, 1)
    values = {"x": x, "y": y, "phi": phi, "speed": np.hypot(vx, vy), "omega": omega}
    found = []
    for name in names:
        pairs = values[name].reshape(-1, 2, len(t))
        slopes = (pairs[:, 0] - pairs[:, 1]) / (small[0] - small[1])
        found.append(np.array([np.interp(since, t, slope) for slope in slopes]).T)
    return np.array(found)


def _movable(fit: FitResult) -> NDArray[np.bool_]:
    """Which parameters the data could move."""
    stay = ("fixed", "at bound")
    return np.array([item.verdict not in stay for item in fit.parameters.values()])


def _null_space(matrix: Floats) -> Floats:
    """Orthonormal columns that a matrix takes to nothing."""
    _, singular, rows = np.linalg.svd(matrix)
    rank = int((singular > 1e-9 * singular.max(initial=0.0)).sum())
    return cast(Floats, rows[rank:].T)


def _friction(fit: FitResult) -> float:
    """Coefficient of friction by the mean deceleration of the fitted rows."""
    speed = fit.fitted["speed"]
    return max(float(speed[0] - speed.min()) / (GRAVITY * _span(fit)), 1e-4)


def _unevenness(fit: FitResult) -> float:
    """Mean of R |omega|/v over the moving fitted rows, each at most 1."""
    speed = fit.fitted["speed"]
    moving = speed > 0
    rim = fit.stone.R * np.abs(fit.fitted["omega"][moving])
    return max(float(np.mean(np.minimum(rim / speed[moving], 1.0))), 0.01)


def _slopes(fit: FitResult) -> tuple[Floats, Floats]:
    """Derivative of the path by the parameters, shape (channels, rows, parameters), and 1/sigma, 0
    where nothing was seen."""
    throw = fit.throw
    origin = Origin.of(throw)
    problem = build_problem(throw, fit.stone, origin, fit.sigma)
    values = fit.values - origin.offset(len(fit.values))
    n = len(throw)
    one = stacked([problem])
    jacobian = linearize(fit.law_class, check_load(fit.load), values[None], one)[1]
    weighted = np.asarray(jacobian)[0, :, :n]
    weight = np.asarray(problem.weight)[:, :n]
    return weighted / np.where(weight > 0, weight, 1.0)[..., None], weight


def _span(fit: FitResult) -> float:
    """Time from the first row to the last, or to where the stone rests."""
    t, speed = fit.observed["t"], fit.fitted["speed"]
    resting = np.flatnonzero(speed <= 0)
    last = int(resting[0]) if len(resting) and resting[0] > 0 else len(t) - 1
    return float(t[last] - t[0])
