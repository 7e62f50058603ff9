"""What a law misses, found in the residuals of a fit and carried into predictions.

Residuals that go together from row to row are not noise: the law lacks something. What that does
to the rest of a path, or to another throw, follows from the plainest picture that grows as it
should: beside the law's, the stone has an acceleration that drifts (from zero at the first row, at
a rate that does a random walk), across, along and in its turning, each of one size. It is as smooth
as what laws miss is found to be. Integrated twice, it is a
deviation d(t) of the path, which stays as it is once the stone rests. What a law misses, it misses
again at the same speed: another throw on the same ice meets the same accelerations at other times,
those across and turning in proportion to its spin (the mirror image of a throw is a throw, so that
they are odd in the spin; to first order, as in eq. 27, they are proportional to it).

Sizes. A fit hides what its parameters can imitate: to first order it leaves the residuals
M (d + noise), M = 1 - J (J^T W J)^-1 J^T W, and has its estimates bent by (J^T W J)^-1 J^T W d. So
the sizes are those for which M (d + noise) has, on average, the squares and the slow products
(neighbours within a twentieth of the throw) of the residuals that are there: moments, matched by
non-negative least squares; where they cannot all be met, no channel is taken to be missed by less
than it was. A channel whose slow products are within three standard deviations of those of
independent noise counts as having none.

What it does not know: why the law fails, and how the ice differs from throw to throw. Beyond the
speeds and spins that were fitted, a law may fail worse than it did among them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, cast

from curlfit import backend  # noqa: F401  (configures JAX before its first use)

# isort: split
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from curlfit.friction import check_load
from curlfit.identifiability import directions
from curlfit.likelihood import frame_of, linearised, problem_of, stacked
from curlfit.noise import block_means
from curlfit.results import FitResult
from curlfit.throw import CHANNELS

Floats = NDArray[np.float64]

WAYS = ("across", "along", "turning")
"""The ways in which an acceleration drifts: across the first heading of the fitted throw (to its
right), along it, and in turning."""
_ACROSS, _ALONG, _TURNING = range(len(WAYS))
_MAINLY = {"x": _ACROSS, "y": _ALONG, "speed": _ALONG, "phi": _TURNING, "omega": _TURNING}
_FEWEST = 20  # values of a channel from which its residuals are judged
_MOST = 120  # values looked at; more are condensed to means
_SLOW = 0.05  # share of the throw within which values count as neighbours
_BELIEVED = 3.0  # standard deviations
_GRID = 301  # times at which an acceleration is drawn


@dataclass(frozen=True)
class Misfit:
    """Accelerations that a law misses.

    Attributes
    ----------
    sizes : by way, standard deviation that the acceleration has reached at the end of the fitted
        rows, in m/s^2 (rad/s^2 for "turning"); 0 where the residuals look like noise.
    span : duration of the fitted rows up to rest, in s.
    noise : independent noise beside it by channel, SI; only channels that could be judged.
    excess : by channel, how far the slow products of the residuals are above those of independent
        noise, in standard deviations.
    """

    sizes: dict[str, float]
    span: float
    noise: dict[str, float]
    excess: dict[str, float]

    @property
    def known(self) -> bool:
        """Whether there were enough rows to judge any channel."""
        return bool(self.excess)

    @property
    def found(self) -> bool:
        """Whether the law misses something."""
        return any(size > 0 for size in self.sizes.values())


class Deviation(NamedTuple):
    """Draws of what missing accelerations make of a path, across, along and in turning."""

    value: Floats
    """m (rad), shape (draws, 3, times)"""
    slope: Floats
    """its time derivative, m/s (rad/s)"""


def misfit_of(fit: FitResult) -> Misfit:
    """What the law of a fit misses, from the residuals. See the top of this file."""
    rows = _condensed(fit)
    judged = [row for row in rows if len(row.t) > _FEWEST // 2 and row.values > _FEWEST]
    span = _span(fit)
    sizes = dict.fromkeys(WAYS, 0.0)
    if not judged:
        return Misfit(sizes, span, {}, {})
    whole = np.concatenate([row.jacobian for row in rows])
    left = _left_over(whole)
    residual = np.concatenate([row.residual for row in rows])
    ends = np.cumsum([0, *(len(row.t) for row in rows)])
    places = {row.name: slice(a, b) for row, a, b in zip(rows, ends, ends[1:], strict=False)}

    # Covariance of what the fit leaves of each channel's noise, and of each way's deviation.
    noises = [left[:, places[row.name]] @ left[places[row.name]] for row in judged]
    forms, counts, excess = [], [], {}
    for row, noise in zip(judged, noises, strict=True):
        here = places[row.name]
        gap = np.abs(row.t[:, None] - row.t)
        near = max(_SLOW * span, 1.01 * float(np.diff(row.t).min()))
        slow = ((gap > 0) & (gap <= near)).astype(float)
        own, total = noise[here, here], float(residual[here] @ residual[here])
        own = own * (total / np.trace(own))
        mixed = slow @ own
        above = residual[here] @ slow @ residual[here] - np.trace(mixed)
        excess[row.name] = float(above / np.sqrt(2 * np.sum(mixed * mixed.T)))
        forms += [(here, np.eye(len(row.t))), (here, slow)]
        counts += [total, total]
    ways = [
        way for way in range(len(WAYS))
        if any(excess.get(name, 0.0) > _BELIEVED for name, main in _MAINLY.items() if main == way)
    ]  # fmt: skip
    heading = fit.parameters["heading"].value
    wanderings = [_covariance(left @ _response(rows, way, span, heading)) for way in ways]
    # Each moment in units of what is there, each unknown so that it makes at most about one.
    matrix = np.array(
        [[np.sum(form * part[here, here]) for part in (*noises, *wanderings)]
         for here, form in forms]
    ) / np.array(counts)[:, None]  # fmt: skip
    right = np.array([residual[here] @ form @ residual[here] for here, form in forms])
    scale = np.abs(matrix).max(0)
    right /= np.array(counts)
    found = nnls(matrix / scale, right)[0] / scale
    made = (matrix @ found)[::2]
    for place, way in enumerate(ways, len(judged)):
        shown = [part for row, part in zip(judged, made, strict=True) if _MAINLY[row.name] == way]
        found[place] *= max(1.0, *(1 / part for part in shown))
    for way, square in zip(ways, found[len(judged) :], strict=True):
        sizes[WAYS[way]] = float(np.sqrt(square))
    noise_by = {
        row.name: float(np.sqrt(found[place])) * row.sigma for place, row in enumerate(judged)
    }
    return Misfit(sizes, span, noise_by, excess)


class Missing(NamedTuple):
    """Draws of missing accelerations, as a function of the time in the fitted throw."""

    times: Floats
    """s since its first row, shape (times,); negative for speeds before it"""
    acceleration: Floats
    """m/s^2 (rad/s^2), shape (draws, 3, times)"""

    def deviation(self, t: Floats, times: Floats) -> Deviation:
        """What it makes of a path.

        Parameters
        ----------
        t : evenly spaced times since the start of the path, s.
        times : the times in the fitted throw that they correspond to.
        """
        draws = len(self.acceleration)
        flat = self.acceleration.reshape(draws * len(WAYS), -1)
        met = np.array([np.interp(times, self.times, one) for one in flat]).T
        slope = _integral(met, t[1] - t[0])
        value = _integral(slope, t[1] - t[0])
        shape = (draws, len(WAYS), len(t))
        return Deviation(value.T.reshape(shape), slope.T.reshape(shape))


def drawn(
    misfit: Misfit, first: float, last: float, draws: int, random: np.random.Generator
) -> Missing:
    """Draws of what the law misses, between two times of the fitted throw (first <= 0 < last)."""
    after = np.linspace(0.0, last, _GRID)
    before = np.linspace(first, 0.0, _GRID // 4)[:-1] if first < 0 else np.zeros(0)
    sizes = np.array([misfit.sizes[way] for way in WAYS])[:, None]
    sizes = sizes * np.sqrt(3 / misfit.span**3)  # an integrated walk has variance t^3/3

    def drift(times: Floats) -> Floats:
        """The integral of a random walk, both from zero at the first of the times."""
        gaps = np.diff(times)
        steps = random.standard_normal((draws, len(WAYS), len(gaps))) * np.sqrt(np.abs(gaps))
        walk = np.concatenate([np.zeros((draws, len(WAYS), 1)), np.cumsum(steps, 2)], 2)
        return _integral(walk.T, gaps[0]).T * sizes

    there = drift(after)
    if len(before):
        back = drift(np.append(before, 0.0)[::-1])[:, :, :0:-1]
        there = np.concatenate([back, there], 2)
    return Missing(np.concatenate([before, after]), there)


def same_speed(fit: FitResult, speed: Floats) -> Floats:
    """When the fitted throw had given speeds: s since its first row.

    Beyond the fitted rows it is taken to slow down as at their ends.
    """
    t, known = fit.observed["t"] - fit.observed["t"][0], fit.fitted["speed"]
    moving = known > 0
    t, known = t[moving], np.minimum.accumulate(known[moving])
    tenth = max(len(t) // 10, 1)
    slowing = [
        max((known[a] - known[b]) / (t[b] - t[a]), 1e-4) for a, b in ((0, tenth), (-1 - tenth, -1))
    ]
    within = np.interp(-speed, -known, t)
    sooner = np.maximum(speed - known[0], 0.0) / slowing[0]
    later = np.maximum(known[-1] - speed, 0.0) / slowing[1]
    return cast(Floats, within - sooner + later)


def bent(fit: FitResult, times: Floats, deviation: Deviation) -> Floats:
    """What deviations in the fitted rows do to the estimates, to first order.

    Parameters
    ----------
    times, deviation : s since the first row, over the fitted rows at least, and the deviation then.

    Returns
    -------
    changes of the parameters, shape (draws, parameters).
    """
    slopes = _slopes(fit)
    verdicts = [item.verdict for item in fit.parameters.values()]
    movable = np.array([verdict not in ("fixed", "at bound") for verdict in verdicts])
    names = [name for name, take in zip(fit.parameters, movable, strict=True) if take]
    order = [fit.information["names"].index(name) for name in names]
    information = np.array(fit.information["matrix"])[np.ix_(order, order)]
    typical = fit.parameter_set.typical[movable]
    seen, singular, _ = directions(information, typical)
    inverse = (seen.T * typical[:, None]) / singular
    since = np.minimum(fit.observed["t"] - fit.observed["t"][0], _span(fit))
    heading = fit.parameters["heading"].value
    pull = np.zeros((len(deviation.value), int(movable.sum())))
    for row, name in enumerate(CHANNELS[: len(slopes.weight)]):
        series = np.zeros_like(deviation.value[:, 0])
        for way, integrals, share in _shares(name, heading):
            series += share * (deviation.slope if integrals == 1 else deviation.value)[:, way]
        there = np.stack([np.interp(since, times, one) for one in series])
        weighted = slopes.weight[row][:, None] ** 2 * slopes.jacobian[row][:, movable]
        pull += there @ weighted
    change = np.zeros((len(pull), len(movable)))
    change[:, movable] = pull @ inverse @ inverse.T
    return change


class _Slopes(NamedTuple):
    jacobian: Floats
    """derivative of the path by the parameters, shape (channels, rows, parameters)"""
    weight: Floats
    """1/sigma, 0 where nothing was seen, shape (channels, rows)"""


def _slopes(fit: FitResult) -> _Slopes:
    throw = fit.throw
    frame = frame_of(throw)
    problem = problem_of(throw, fit.stone, frame, fit.sigma)
    values = fit.values - frame.offset(len(fit.values))
    n = len(throw)
    one = stacked([problem])
    jacobian = linearised(fit.law_class, check_load(fit.load), values[None], one)[1]
    weighted = np.asarray(jacobian)[0, :, :n]
    weight = np.asarray(problem.weight)[:, :n]
    return _Slopes(weighted / np.where(weight > 0, weight, 1.0)[..., None], weight)


class _Row(NamedTuple):
    """A channel's residuals over their sigma, condensed to means over blocks."""

    name: str
    t: Floats
    """s since the first row, not beyond rest"""
    residual: Floats
    jacobian: Floats
    scale: Floats
    """1 over the sigma of each mean"""
    sigma: float
    """typical sigma of one value"""
    values: int


def _condensed(fit: FitResult) -> list[_Row]:
    slopes, span = _slopes(fit), _span(fit)
    free = fit.parameter_set.free
    found = []
    for row, name in enumerate(CHANNELS[: len(slopes.weight)]):
        seen = slopes.weight[row] > 0
        if not seen.any():
            continue
        count = int(seen.sum())
        block = -(-count // _MOST)
        t = np.minimum(fit.observed["t"] - fit.observed["t"][0], span)[seen]
        weight = slopes.weight[row, seen]
        residual = (fit.observed[name] - fit.fitted[name])[seen]
        scale = np.sqrt(block_means(weight**2, block) * block)
        found.append(
            _Row(
                name,
                block_means(t, block),
                block_means(residual, block) * scale,
                block_means(slopes.jacobian[row, seen][:, free], block) * scale[:, None],
                scale,
                float(1 / np.sqrt(np.mean(weight**2))),
                count,
            )
        )
    return found


def _left_over(jacobian: Floats) -> Floats:
    """The projection onto what no parameter can make."""
    size = np.linalg.norm(jacobian, axis=0)
    left, singular, _ = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), full_matrices=False)
    own = left[:, singular > 1e-7 * singular[0]]
    return cast(Floats, np.eye(len(jacobian)) - own @ own.T)


def _response(rows: list[_Row], way: int, span: float, heading: float) -> Floats:
    """What an acceleration at each time of a grid does to the rows, over sigma."""
    grid = np.linspace(0.0, span, _GRID)
    once = _integral(np.eye(_GRID), grid[1])
    weights = {1: once, 2: _integral(once, grid[1])}
    blocks = []
    for row in rows:
        at = np.zeros((len(row.t), _GRID))
        for shown, order, share in _shares(row.name, heading):
            if shown == way:
                columns = weights[order].T
                at = share * np.array([np.interp(row.t, grid, column) for column in columns]).T
        blocks.append(at * row.scale[:, None])
    return np.concatenate(blocks)


def _covariance(response: Floats) -> Floats:
    """Covariance of the rows, for accelerations that drift to unit size within the span."""
    grid = np.linspace(0.0, 1.0, _GRID)
    sooner, later = np.minimum(grid[:, None], grid), np.maximum(grid[:, None], grid)
    found: Floats = response @ (sooner**2 * (3 * later - sooner) / 2) @ response.T
    return found


def _shares(channel: str, heading: float) -> tuple[tuple[int, int, float], ...]:
    """The ways that show in a channel, how often the acceleration is integrated, and by how much
    it counts."""
    s, c = float(np.sin(heading)), float(np.cos(heading))
    return {
        "x": ((_ACROSS, 2, c), (_ALONG, 2, s)),
        "y": ((_ALONG, 2, c), (_ACROSS, 2, -s)),
        "speed": ((_ALONG, 1, 1.0),),
        "phi": ((_TURNING, 2, 1.0),),
        "omega": ((_TURNING, 1, 1.0),),
    }[channel]


def _span(fit: FitResult) -> float:
    """Time from the first row to the last, or to where the stone rests."""
    t, speed = fit.observed["t"], fit.fitted["speed"]
    resting = np.flatnonzero(speed <= 0)
    last = int(resting[0]) if len(resting) and resting[0] > 0 else len(t) - 1
    return float(t[last] - t[0])


def _integral(values: Floats, step: float) -> Floats:
    """Running integral along the first axis, by the trapezoid rule."""
    middle = (values[1:] + values[:-1]) / 2 * step
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(middle, 0)])
