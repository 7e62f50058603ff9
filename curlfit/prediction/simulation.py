"""A throw simulated for draws of the parameters and of the model
discrepancy, in numbers."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.errors import UnusableFitError
from curlfit.friction import no_motion_because
from curlfit.inference.derived.quantiles import LEVELS, quantiles_of
from curlfit.numerics.arrays import Floats
from curlfit.prediction.discrepancy import discrepancy_posterior
from curlfit.prediction.ensemble import VARIED, ThrowFamily, TrajectoryEnsemble
from curlfit.prediction.result import (
    CENTRED,
    PREDICTED,
    QUANTITIES,
    Call,
    Discrepancy,
    Quantity,
    RestingPlace,
    Sensitivity,
)
from curlfit.sheet import CIRCLES, END, FOOT, HOUSE, LINES, STONE_RADIUS, TEE

_BAND_POINTS = 121
_FEWEST_AT_REST = 0.5  # part of the draws, below which there is no prediction
_NEARLY_ALL = 0.975  # part of the draws, at whose rest the series ends
_SAMPLED = 60  # draws kept
_SAMPLE_TIMES = 30  # of each draw kept
_DIGITS = 4  # decimals of the draws kept: 0.1 mm
# for sensitivities of the resting position
_HEADING_CHANGE = 0.001  # rad
_WEIGHT_CHANGE = 0.1  # s


class Simulation(NamedTuple):
    """Trajectories of a throw."""

    t: Floats
    """times of the series, s since the start"""
    best: TrajectoryEnsemble
    """at the best estimate, at times `t`"""
    plain: TrajectoryEnsemble
    """for the draws that come to rest, at times `t`"""
    full: TrajectoryEnsemble
    """for the same draws, each with a draw of the model discrepancy"""
    varied: dict[str, TrajectoryEnsemble]
    """at the best estimate with one component of the initial state changed, by name"""
    null_ends: list[TrajectoryEnsemble]
    """at both ends of each null direction of the fit"""
    discrepancy: Discrepancy | None

    @classmethod
    def of(
        cls,
        throws: ThrowFamily,
        values: Floats,
        random: np.random.Generator,
        joint_call: Call | None,
    ) -> Self:
        """Simulate a throw for drawn parameter vectors.

        `joint_call` is the call of a throw on the ice of a joint fit, whose draws
        contain the error of the law. It is None on that of one throw: each draw is then
        simulated again with missing accelerations.

        Raises
        ------
        UnusableFitError : it, or most of the draws, do not come to rest.
        """
        fit = throws.fit
        drawn = throws.with_start(values, joint_call or CENTRED, random)
        t = throws.times_to_rest(drawn)
        plain = throws.simulate(drawn, t)
        best = throws.simulate(throws.with_start(fit.values[None]), t)
        varied = {
            name: throws.simulate(vectors, t)
            for name, vectors in throws.varied().items()
        }
        null_ends = [throws.simulate(vectors, t) for vectors in throws.null_ends()]
        if not best.comes_to_rest[0]:
            raise UnusableFitError(
                f"the {fit.law} law as fitted does not bring this stone to rest"
                + no_motion_because(fit.load)
            )
        full = plain
        discrepancy = None
        if joint_call is None:
            posterior = discrepancy_posterior(fit)
            discrepancy = posterior.summary
            missing = posterior.draw(len(values), random)
            shifted = throws.with_start(posterior.shift_parameters(values, missing))
            full = missing.applied_to(throws.simulate(shifted, t), throws.spin_ratio)
        rests = plain.comes_to_rest & full.comes_to_rest
        if rests.mean() < _FEWEST_AT_REST:
            raise UnusableFitError(
                f"only {rests.mean():.0%} of the draws come to rest; "
                "the fit is too uncertain for this throw"
            )
        return cls(
            t=t,
            best=best,
            plain=plain.select(rests),
            full=full.select(rests),
            varied=varied,
            null_ends=null_ends,
            discrepancy=discrepancy,
        )

    def quantities(self) -> dict[str, Quantity]:
        """The quantities of the throw that some draws have, with their errors."""
        quantities = {}
        best = _throw_quantities(self.best)
        plain_by_name = _throw_quantities(self.plain)
        full_by_name = _throw_quantities(self.full)
        for name, (_, unit) in QUANTITIES.items():
            plain = plain_by_name[name]
            full = full_by_name[name]
            has_both = np.isfinite(plain) & np.isfinite(full)
            if has_both.any():
                quantities[name] = Quantity(
                    value=float(best[name][0]),
                    unit=unit,
                    parameter_sd=float(plain[has_both].std()),
                    model_sd=float(_model_sd(plain[has_both], full[has_both])),
                    quantiles=quantiles_of(full[has_both]),
                    share=float(np.isfinite(full).mean()),
                )
        return quantities

    def series(self, paths: Floats) -> dict[str, Floats]:
        """The best path with its bands over time, until nearly all draws rest; `paths`
        are x, y, phi of the draws at `t`, shape (draws, 3, times)."""
        time_of_best = float(self.best.time_of_rest[0])
        time_of_most = float(np.quantile(self.full.time_of_rest, _NEARLY_ALL))
        last = int(np.searchsorted(self.t, max(time_of_best, time_of_most)))
        times = slice(min(last + 1, len(self.t)))
        x, y, phi, _, _, omega = self.best.state[0, :, times]
        series = {"t": self.t[times], "x": x, "y": y, "phi": phi}
        series["speed"] = self.best.speed[0, times]
        series["omega"] = omega
        for row, name in enumerate(PREDICTED):
            plain = self.plain.state[:, row, times]
            full = paths[:, row, times]
            series[f"{name}_parameter_sd"] = plain.std(0)
            series[f"{name}_model_sd"] = _model_sd(plain, full)
            series |= _quantile_rows(name, full)
        return series

    def sample(self, paths: Floats) -> dict[str, Floats]:
        """The first draws: a random sample, since the draws are in random order;
        `paths` as in `series`."""
        rest = self.full.time_of_rest[:_SAMPLED]
        last = int(np.searchsorted(self.t[:-1], rest.max()))
        rows = np.unique(np.linspace(0, last, _SAMPLE_TIMES).astype(int))
        x, y, phi = paths[:_SAMPLED, :, rows].round(_DIGITS).swapaxes(0, 1)
        return {
            "t": self.t[rows],
            "x": x,
            "y": y,
            "phi": phi,
            "rest": rest.round(_DIGITS),
        }

    def band(self, paths: Floats) -> dict[str, Floats]:
        """x as a function of y, up to the y that half of the draws reach; `paths` as
        in `series`."""
        best = self.best.state[0]
        farthest = float(np.median(paths[:, 1].max(1)))
        y = np.linspace(float(best[1, 0]), farthest, _BAND_POINTS)
        x_of_draws = np.array([_x_at(path, y) for path in paths])
        return {"y": y, "x": _x_at(best, y)} | _quantile_rows("x", x_of_draws)

    def resting_place(self) -> RestingPlace:
        """Mean and covariances of x and y at rest."""
        plain = self.plain.end[:, :2]
        full = self.full.end[:, :2]
        moved = full - plain  # by the model discrepancy
        return RestingPlace(
            mean=full.mean(0).tolist(),
            parameter=np.cov(plain.T).tolist(),
            model=(moved.T @ moved / len(full)).tolist(),
            both=np.cov(full.T).tolist(),
        )

    def chances(self) -> dict[str, float]:
        """Fractions of the draws with each outcome."""
        x, y, _ = self.full.end.T
        # of the part of the stone that is nearest to the tee
        distance = np.hypot(x, y - TEE) - STONE_RADIUS
        outcomes = {
            "on the button": distance < CIRCLES[-1],
            "in the house": distance < HOUSE,
            "short of the hog line": y - STONE_RADIUS < LINES["far-hog"],
            "through the house": y > END,
        }
        return {name: float(happens.mean()) for name, happens in outcomes.items()}

    def sensitivity(self) -> dict[str, Sensitivity]:
        """How the resting place changes with the initial state and, of another throw
        of a joint fit, with the time between hog lines and the broom."""
        best_end = self.best.end[0]
        changes = {}
        for name, change in VARIED.items():
            varied = self.varied[name]
            if varied.comes_to_rest[0]:
                right, along, _ = varied.end[0] - best_end
                changes[name] = Sensitivity(change, float(right), float(along))
        # a heading turns the path clockwise about its start
        x, y, _ = _HEADING_CHANGE * (best_end - self.best.state[0, :3, 0])
        changes["heading"] = Sensitivity(_HEADING_CHANGE, float(y), float(-x))
        if self.discrepancy is not None:
            return changes
        if "v0" in changes:
            faster = changes["v0"]
            hog_to_hog = _throw_quantities(self.best)["hog_to_hog"][0]
            when_faster = _throw_quantities(self.varied["v0"])["hog_to_hog"][0]
            steps = _WEIGHT_CHANGE / (when_faster - hog_to_hog)  # of v0, negative
            if np.isfinite(steps):
                changes["hog_to_hog"] = Sensitivity(
                    by=_WEIGHT_CHANGE,
                    right=float(steps * faster.right),
                    along=float(steps * faster.along),
                )
            # the path turns about the hack, from which the broom is aimed at
            right = FOOT * best_end[1] / TEE
            changes["broom"] = Sensitivity(by=FOOT, right=float(right), along=0.0)
        return changes


def _throw_quantities(ensemble: TrajectoryEnsemble) -> dict[str, Floats]:
    """The quantities of each throw; NaN where it has none."""
    x, y, phi = ensemble.end.T
    x0, y0, phi0, vx, vy, _ = ensemble.state[..., 0].T
    hog = ensemble.crossing(LINES["hog"])
    far_hog = ensemble.crossing(LINES["far-hog"])
    tee = ensemble.crossing(LINES["far-tee"])
    return {
        "rest_x": x,
        "rest_y": y - TEE,
        "rest_to_tee": np.hypot(x, y - TEE),
        "curl": ((x - x0) * vy - (y - y0) * vx) / np.hypot(vx, vy),
        "turns": (phi - phi0) / (2 * math.pi),
        "time": ensemble.time_of_rest,
        "hog_to_hog": far_hog.time - hog.time,
        "hog_to_tee": tee.time - hog.time,
        "hog_to_rest": ensemble.time_of_rest - far_hog.time,
        "speed_at_hog": hog.speed,
        "speed_at_far_hog": far_hog.speed,
        "speed_at_tee": tee.speed,
    }


def _model_sd(plain: Floats, full: Floats) -> Any:
    """Root mean square over the draws of what the model discrepancy changes."""
    return np.sqrt(np.mean((full - plain) ** 2, axis=0))


def _quantile_rows(name: str, values: Floats) -> dict[str, Floats]:
    """Quantiles over the draws by name and level, such as "x_2.5"; the median is left
    out, since the best estimate stands in its place."""
    levels = [level for level in LEVELS if level != "50"]
    rows = np.nanquantile(values, [float(level) / 100 for level in levels], axis=0)
    return {f"{name}_{level}": row for level, row in zip(levels, rows, strict=True)}


def _x_at(path: Floats, y: Floats) -> Floats:
    """x of a path (rows x, y and more) at given y; NaN beyond its end."""
    farthest = np.maximum.accumulate(path[1])
    forward = np.diff(farthest, prepend=-np.inf) > 0  # rows that go on
    x: Floats = np.interp(
        y, farthest[forward], path[0, forward], left=path[0, 0], right=np.nan
    )
    return x
