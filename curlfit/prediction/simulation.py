"""A throw simulated for draws of the parameters and of the model
discrepancy, in numbers."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self

import numpy as np

from curlfit.errors import UnusableFitError
from curlfit.friction import no_motion_because
from curlfit.inference.derived import LEVELS, quantiles_of
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
)
from curlfit.sheet import CIRCLES, END, FOOT, HOUSE, LINES, STONE_RADIUS, TEE

_BAND_POINTS = 121
_SAMPLED, _SAMPLE_TIMES = 60, 30  # draws kept, and times of each
_DIGITS = 4  # decimals of these: 0.1 mm
# for sensitivities of the resting position, rad and s
_HEADING_CHANGE, _WEIGHT_CHANGE = 0.001, 0.1


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
    probed: dict[str, TrajectoryEnsemble]
    """at the best estimate with small changes"""
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
        fit, plain = (
            throws.fit,
            throws.simulate(throws.with_start(values, call or CENTRED, random)),
        )
        best = throws.simulate(throws.with_start(fit.values[None]))
        probed = {name: throws.simulate(some) for name, some in throws.probes().items()}
        if not best.good[0]:
            raise UnusableFitError(
                f"the {fit.law} law as fitted does not bring this stone to rest"
                + no_motion_because(fit.load)
            )
        full, summary = plain, None
        if call is None:
            discrepancy = discrepancy_posterior(fit)
            missing, summary = (
                discrepancy.draw(len(values), random),
                discrepancy.summary,
            )
            shifted = throws.with_start(discrepancy.shift_parameters(values, missing))
            full = missing.applied_to(throws.simulate(shifted), throws.spin_ratio)
        use = plain.good & full.good
        if use.mean() < 0.5:
            raise UnusableFitError(
                f"only {use.mean():.0%} of the draws come to rest; "
                "the fit is too uncertain for this throw"
            )
        return cls(throws.t, best, plain.select(use), full.select(use), probed, summary)

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
        found = {}
        each = [_throw_quantities(ensemble) for ensemble in self[1:4]]
        for name, (_, unit) in QUANTITIES.items():
            value, plain, full = (values[name] for values in each)
            there = np.isfinite(plain) & np.isfinite(full)
            if there.any():
                errors = _errors(plain[there], full[there])
                found[name] = Quantity(
                    value=float(value[0]),
                    unit=unit,
                    **{error: float(size) for error, size in errors.items()},
                    quantiles=quantiles_of(full[there]),
                    share=float(np.isfinite(full).mean()),
                )
        return found

    def _series(self, path: Floats) -> dict[str, Floats]:
        duration = max(
            float(self.best.rest[0]), float(np.quantile(self.full.rest, 0.975))
        )
        n = min(int(np.searchsorted(self.t, duration)) + 1, len(self.t))
        best = self.best.state[0, :, :n]
        found = {"t": self.t[:n], **dict(zip(PREDICTED, best, strict=False))}
        found |= {"speed": self.best.speed[0, :n], "omega": best[5]}
        for row, name in enumerate(PREDICTED):
            full = path[:, row, :n]
            errors = _errors(self.plain.state[:, row, :n], full)
            found |= {f"{name}_{error}": values for error, values in errors.items()}
            found |= _around(name, full)
        return found

    def _sample(self, path: Floats) -> dict[str, Floats]:
        """The first draws: a random sample, since the draws are in random order."""
        rest = self.full.rest[:_SAMPLED]
        last = int(np.searchsorted(self.t[:-1], rest.max()))
        times = np.unique(np.linspace(0, last, _SAMPLE_TIMES).astype(int))
        places = path[:_SAMPLED, :, times].round(_DIGITS).swapaxes(0, 1)
        named = dict(zip(PREDICTED, places, strict=True))
        return {"t": self.t[times], **named, "rest": rest.round(_DIGITS)}

    def _band(self, path: Floats) -> dict[str, Floats]:
        """x as a function of y, up to the y that half of the draws reach."""
        best = self.best.state[0]
        y = np.linspace(
            float(best[1, 0]), float(np.median(path[:, 1].max(1))), _BAND_POINTS
        )
        at = np.array([_across(one, y) for one in path])
        return {"y": y, "x": _across(best, y)} | _around("x", at)

    def _rest(self) -> dict[str, Any]:
        plain, full = self.plain.end[:, :2], self.full.end[:, :2]
        return {
            "mean": full.mean(0).tolist(),
            "parameter": np.cov(plain.T).tolist(),
            "model": ((full - plain).T @ (full - plain) / len(full)).tolist(),
            "both": np.cov(full.T).tolist(),
        }

    def _chances(self) -> dict[str, float]:
        x, y, _ = self.full.end.T
        away = np.hypot(x, y - TEE) - STONE_RADIUS
        events = {
            "on the button": away < CIRCLES[-1],
            "in the house": away < HOUSE,
            "short of the hog line": y - STONE_RADIUS < LINES["far-hog"],
            "through the house": y > END,
        }
        return {name: float(happens.mean()) for name, happens in events.items()}

    def _sensitivity(self) -> dict[str, dict[str, Any]]:
        """Change of the resting position with the initial state."""
        end = self.best.end[0]
        along, right, _ = _HEADING_CHANGE * (end - self.best.state[0, :3, 0])
        changes = {
            name: (by, *(self.probed[name].end[0] - end))
            for name, by in VARIED.items()
            if self.probed[name].good[0]
        } | {"heading": (_HEADING_CHANGE, right, -along, 0.0)}
        if self.discrepancy is None and "v0" in changes:  # another throw of a joint fit
            hog = [
                _throw_quantities(one)["hog_to_hog"][0]
                for one in (self.best, self.probed["v0"])
            ]
            slower = _WEIGHT_CHANGE / (hog[1] - hog[0])
            if np.isfinite(slower):
                changes["hog_to_hog"] = (
                    _WEIGHT_CHANGE,
                    *(slower * np.array(changes["v0"][1:])),
                )
            across = FOOT * end[1] / TEE  # about the hack, from which it is aimed
            changes["broom"] = (FOOT, across, 0.0, 0.0)
        return {
            name: {"by": by, "right": float(right), "along": float(along)}
            for name, (by, right, along, _) in changes.items()
        }


def _throw_quantities(ensemble: TrajectoryEnsemble) -> dict[str, Floats]:
    """The quantities of each throw; NaN where it has none."""
    x, y, phi = ensemble.end.T
    x0, y0, phi0, vx, vy, _ = ensemble.state[..., 0].T
    hog, far_hog, tee = (
        ensemble.crossing(LINES[name]) for name in ("hog", "far-hog", "far-tee")
    )
    return {
        "rest_x": x,
        "rest_y": y - TEE,
        "rest_to_tee": np.hypot(x, y - TEE),
        "curl": ((x - x0) * vy - (y - y0) * vx) / np.hypot(vx, vy),
        "turns": (phi - phi0) / (2 * math.pi),
        "time": ensemble.rest,
        "hog_to_hog": far_hog[0] - hog[0],
        "hog_to_tee": tee[0] - hog[0],
        "hog_to_rest": ensemble.rest - far_hog[0],
        "speed_at_hog": hog[1],
        "speed_at_far_hog": far_hog[1],
        "speed_at_tee": tee[1],
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


def _across(state: Floats, y: Floats) -> Floats:
    """x of a trajectory at given y; NaN beyond its end."""
    rising = np.maximum.accumulate(state[1])
    new = np.diff(rising, prepend=-np.inf) > 0
    found: Floats = np.interp(
        y, rising[new], state[0, new], left=state[0, 0], right=np.nan
    )
    return found
