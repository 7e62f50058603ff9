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
        call: Call | None = None,
    ) -> Self:
        """Simulate a throw for drawn parameter vectors; with a call, those of a joint
        fit, which contain the error of the law.

        Raises
        ------
        UnusableFitError : it, or most of the draws, do not come to rest.
        """
        fit = throws.fit
        plain = throws.simulate(throws.with_start(values, call or CENTRED, random))
        best = throws.simulate(throws.with_start(fit.values[None]))
        varied = {
            name: throws.simulate(vectors) for name, vectors in throws.varied().items()
        }
        null_ends = [throws.simulate(vectors) for vectors in throws.null_ends()]
        if not best.good[0]:
            raise UnusableFitError(
                f"the {fit.law} law as fitted does not bring this stone to rest"
                + no_motion_because(fit.load)
            )
        full = plain
        discrepancy = None
        if call is None:
            posterior = discrepancy_posterior(fit)
            discrepancy = posterior.summary
            missing = posterior.draw(len(values), random)
            shifted = throws.with_start(posterior.shift_parameters(values, missing))
            full = missing.applied_to(throws.simulate(shifted), throws.spin_ratio)
        rests = plain.good & full.good
        if rests.mean() < 0.5:
            raise UnusableFitError(
                f"only {rests.mean():.0%} of the draws come to rest; "
                "the fit is too uncertain for this throw"
            )
        return cls(
            t=throws.t,
            best=best,
            plain=plain.select(rests),
            full=full.select(rests),
            varied=varied,
            null_ends=null_ends,
            discrepancy=discrepancy,
        )

    def summary(self) -> dict[str, Any]:
        """The fields of a `Prediction` that follow from the trajectories."""
        path = self.full.positions_at(self.t)
        return {
            "misfit": self.discrepancy,
            "series": self._series(path),
            "band": self._band(path),
            "rest": self._rest(),
            "quantities": self._quantities(),
            "chances": self._chances(),
            "sensitivity": self._sensitivity(),
            "sample": self._sample(path),
        }

    def _quantities(self) -> dict[str, Quantity]:
        """The quantities of the throw that some draws have, with their errors."""
        quantities = {}
        best = _throw_quantities(self.best)
        by_parameters = _throw_quantities(self.plain)
        by_both = _throw_quantities(self.full)
        for name, (_, unit) in QUANTITIES.items():
            plain = by_parameters[name]
            full = by_both[name]
            has_both = np.isfinite(plain) & np.isfinite(full)
            if has_both.any():
                errors = _errors(plain[has_both], full[has_both])
                quantities[name] = Quantity(
                    value=float(best[name][0]),
                    unit=unit,
                    **{error: float(size) for error, size in errors.items()},
                    quantiles=quantiles_of(full[has_both]),
                    share=float(np.isfinite(full).mean()),
                )
        return quantities

    def _series(self, path: Floats) -> dict[str, Floats]:
        """The best path with its bands over time, until nearly all draws rest; `path`
        is x, y, phi of the draws at `t`, shape (draws, 3, times)."""
        rest_of_best = float(self.best.rest[0])
        duration = max(rest_of_best, float(np.quantile(self.full.rest, 0.975)))
        n = min(int(np.searchsorted(self.t, duration)) + 1, len(self.t))
        x, y, phi, _, _, omega = self.best.state[0, :, :n]
        series = {"t": self.t[:n], "x": x, "y": y, "phi": phi}
        series["speed"] = self.best.speed[0, :n]
        series["omega"] = omega
        for row, name in enumerate(PREDICTED):
            full = path[:, row, :n]
            errors = _errors(self.plain.state[:, row, :n], full)
            series |= {f"{name}_{error}": sizes for error, sizes in errors.items()}
            series |= _around(name, full)
        return series

    def _sample(self, path: Floats) -> dict[str, Floats]:
        """The first draws: a random sample, since the draws are in random order."""
        rest = self.full.rest[:_SAMPLED]
        last = int(np.searchsorted(self.t[:-1], rest.max()))
        rows = np.unique(np.linspace(0, last, _SAMPLE_TIMES).astype(int))
        x, y, phi = path[:_SAMPLED, :, rows].round(_DIGITS).swapaxes(0, 1)
        return {
            "t": self.t[rows],
            "x": x,
            "y": y,
            "phi": phi,
            "rest": rest.round(_DIGITS),
        }

    def _band(self, path: Floats) -> dict[str, Floats]:
        """x as a function of y, up to the y that half of the draws reach."""
        best = self.best.state[0]
        farthest = float(np.median(path[:, 1].max(1)))
        y = np.linspace(float(best[1, 0]), farthest, _BAND_POINTS)
        x_of_draws = np.array([_x_at(draw, y) for draw in path])
        return {"y": y, "x": _x_at(best, y)} | _around("x", x_of_draws)

    def _rest(self) -> RestingPlace:
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

    def _chances(self) -> dict[str, float]:
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

    def _sensitivity(self) -> dict[str, Sensitivity]:
        """Change of the resting position with the initial state: by how much this is
        changed, and m that the stone rests farther right and along."""
        end = self.best.end[0]
        effects = {}
        for name, change in VARIED.items():
            if self.varied[name].good[0]:
                right, along, _ = self.varied[name].end[0] - end
                effects[name] = (change, right, along)
        # a heading turns the path clockwise about its start
        x, y, _ = _HEADING_CHANGE * (end - self.best.state[0, :3, 0])
        effects["heading"] = (_HEADING_CHANGE, y, -x)
        if self.discrepancy is None and "v0" in effects:  # another throw of a joint fit
            hog_to_hog = _throw_quantities(self.best)["hog_to_hog"][0]
            when_faster = _throw_quantities(self.varied["v0"])["hog_to_hog"][0]
            steps = _WEIGHT_CHANGE / (when_faster - hog_to_hog)  # of v0, negative
            if np.isfinite(steps):
                _, right, along = effects["v0"]
                effects["hog_to_hog"] = (_WEIGHT_CHANGE, steps * right, steps * along)
            across = FOOT * end[1] / TEE  # about the hack, from which it is aimed
            effects["broom"] = (FOOT, across, 0.0)
        return {
            name: Sensitivity(by=change, right=float(right), along=float(along))
            for name, (change, right, along) in effects.items()
        }


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
        "time": ensemble.rest,
        "hog_to_hog": far_hog.time - hog.time,
        "hog_to_tee": tee.time - hog.time,
        "hog_to_rest": ensemble.rest - far_hog.time,
        "speed_at_hog": hog.speed,
        "speed_at_far_hog": far_hog.speed,
        "speed_at_tee": tee.speed,
    }


def _errors(plain: Floats, full: Floats) -> dict[str, Floats]:
    """Errors by the parameters and by the model discrepancy, over the draws."""
    return {
        "parameter_sd": plain.std(0),
        "model_sd": np.sqrt(np.mean((full - plain) ** 2, axis=0)),
    }


def _around(name: str, values: Floats) -> dict[str, Floats]:
    """Quantiles over the draws, except the median, by name and level."""
    levels = np.nanquantile(values, [float(level) / 100 for level in LEVELS], axis=0)
    rows = zip(LEVELS, levels, strict=True)
    return {f"{name}_{level}": row for level, row in rows if level != "50"}


def _x_at(path: Floats, y: Floats) -> Floats:
    """x of a path (rows x, y and more) at given y; NaN beyond its end."""
    farthest = np.maximum.accumulate(path[1])
    forward = np.diff(farthest, prepend=-np.inf) > 0  # rows that go on
    x: Floats = np.interp(
        y, farthest[forward], path[0, forward], left=path[0, 0], right=np.nan
    )
    return x
