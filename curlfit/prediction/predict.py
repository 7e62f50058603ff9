"""Prediction of a throw: the fitted one carried to rest, or another one on the same ice.

Two errors are kept apart. That of the parameters: draws from the posterior (the chain, or else the
fit's covariance: Gaussian along what the data determine, even within the bounds along what they do
not) are each followed to rest. That of the law, the model discrepancy (see
`curlfit.prediction.discrepancy`): each draw is followed once more with missing accelerations. Noise
of a measurement is in neither; it is added where a prediction is compared with measured rows.

What is given of a throw is taken as exact. Without any start the throw is the fitted one, whose
start is as uncertain as the fit has it.

Places are those of the sheet: x to the right of the centre line, y from the hack that the stone is
thrown from (`curlfit.sheet`). Data have a zero of their own, so the start is laid on a line of the
sheet, the near hog line if nothing else is said.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import InputError, UnusableFitError
from curlfit.friction import Law, no_motion_because
from curlfit.inference.fit.result import FitResult
from curlfit.inference.mcmc.chain import Chain
from curlfit.inference.mcmc.sampler import ridge_move
from curlfit.prediction.discrepancy import discrepancy_of
from curlfit.prediction.ensemble import VARIED, Family, Paths
from curlfit.prediction.request import Begun, Wanted, begin, on_the_sheet
from curlfit.prediction.result import (
    QUANTITIES,
    SHOWN,
    WORDS,
    HeldOut,
    Misfit,
    Prediction,
    Quantity,
)
from curlfit.sheet import END, HOUSE, LINES, STONE_RADIUS, TEE, WIDTH
from curlfit.throws.throw import Throw

Floats = NDArray[np.float64]

LEVELS = ("2.5", "16", "50", "84", "97.5")
FORETOLD = ("x", "y", "phi")


_LEVELS_ALONG = 121
_MORE_HEADING = 0.001  # the same, rad
_MOST_CHECKED = 2000  # measured rows that a prediction is held against
_MARGIN = 1.02  # of the fitted range of speed or spin, beyond which is extrapolation
_MATTERS = 1e-3  # m of the resting place, below which an unknown parameter does not matter


def predict(
    fit: FitResult,
    chain: Chain | None = None,
    *,
    start: Mapping[str, float] | None = None,
    line: str | None = None,
    target: tuple[float, float] | None = None,
    weight: str | None = None,
    tee_speed: float | None = None,
    draws: int = 1000,
    seed: int = 0,
    check: Throw | None = None,
) -> Prediction:
    """Predict a throw, from a fit of one on the same ice.

    With no `start`, `target` or `weight` it is the fitted throw, carried to rest. Otherwise it is
    another one: straight along the centre line from `line`, with speed and spin of the fitted one,
    but for what is given.

    Parameters
    ----------
    fit, chain : a converged fit and, if there is one, its posterior sample.
    start : some of x0 y0 (m on the sheet), heading (rad), v0 (m/s), phi0 (rad), omega0 (rad/s);
        taken as exact.
    line : where the throw starts: "hack", "back", "tee", "hog", "centre" or "far-hog"; "data"
        where the data do, which must then count from the hack. By default "hog", and "data" for the
        fitted throw where its file says that it counts from the hack.
    target : (x, y) in m from the tee (right, beyond); speed and heading that bring the stone to
        rest there are found.
    weight : "draw", "guard" or "takeout" (see `WEIGHTS`): speed, and if not given the heading, that
        bring the stone there on the centre line.
    tee_speed : speed in m/s with which a takeout passes the tee.
    draws : from the posterior. seed : of the draws.
    check : the throw that was fitted, with rows later than those that were; no start may be given.

    Returns
    -------
    Prediction.

    Raises
    ------
    InputError : an unknown name, contradicting wishes, a place that no throw reaches, a fit that
        does not know the spin where none is given, a `check` that is another throw or has no rows
        left.
    UnusableFitError : the fit did not converge, or its law brings no stone to rest.
    """
    wanted = Wanted(dict(start or {}), line or "hog", target, weight, tee_speed)
    if line is None and not wanted.new and on_the_sheet(fit):
        wanted = wanted._replace(line="data")
    wanted.require(fit, check)
    if not fit.converged:
        raise UnusableFitError(f"nothing can be predicted from this fit: {fit.status}")
    if fit.noise.kind != "white":
        raise InputError(
            f"noise {fit.noise.kind}: a prediction has a model discrepancy of its own; make it "
            "from a fit with white noise"
        )
    if draws < 100:
        raise InputError(f"{draws} draws: expected at least 100")
    random = np.random.default_rng(seed)
    begun = begin(fit, wanted)
    values, source = _drawn_values(fit, chain, draws, random)
    family = Family(fit, begun, wanted.new)
    probes = family.probes()
    own = [family.begin(fit.values[None]), *probes.values(), family.begin(values)]
    every = family.follow(np.concatenate(own))
    ends = np.cumsum([len(item) for item in own])
    best, plain = every.of(slice(0, 1)), every.of(slice(ends[-2], None))
    probed = {
        name: every.of(slice(low, high))
        for name, low, high in zip(probes, ends, ends[1:], strict=False)
    }
    if not best.good[0]:
        raise UnusableFitError(
            f"the {fit.law} law as fitted does not bring this stone to rest"
            + no_motion_because(fit.load)
        )
    discrepancy = discrepancy_of(fit)
    misfit = discrepancy.misfit
    missing = discrepancy.drawn(draws, random)
    full = missing.on(family.follow(family.begin(discrepancy.moved(values, missing))), family.spin)
    use = plain.good & full.good
    if use.mean() < 0.5:
        raise UnusableFitError(
            f"only {use.mean():.0%} of the draws come to rest; the fit knows too little for this "
            "throw"
        )
    plain, full = plain.of(use), full.of(use)
    quantities = _quantities(best, plain, full)
    matter, rest = _unknowns(fit, probed, best)
    lacking, limits = _of_the_law(misfit)
    warnings = [
        *_extrapolation(fit, best, wanted.new),
        *matter,
        *lacking,
        *_off_the_sheet(best),
    ]
    notes = [*rest, *limits]
    if wanted.new:
        notes.append("how much the ice differs from throw to throw, the fit of one cannot tell")
    if not use.all():
        warnings.append(f"{1 - use.mean():.1%} of the draws do not come to rest and are left out")
    held = None
    if check is not None:
        held = _held_out(check, fit, begun, misfit, best, full, random)
    return Prediction(
        law=fit.law,
        load=fit.load,
        stone=fit.stone,
        fit={key: fit.data[key] for key in ("file", "rows", "from", "to")},
        start=begun.record(fit, wanted),
        of="new" if wanted.new else "fitted",
        line="" if "y0" in wanted.start else begun.line,
        goal=wanted.goal(),
        draws={"number": draws, "used": int(use.sum()), "source": source, "seed": seed},
        misfit=misfit,
        series=_series(best, plain, full),
        band=_band(best, full),
        rest=_rest(plain, full),
        measured={} if wanted.new else _measured_path(fit, begun),
        quantities=quantities,
        chances=_chances(full),
        sensitivity=_sensitivity(probed, best),
        warnings=tuple(warnings),
        notes=tuple(notes),
        check=held,
    )


def held_out(
    throw: Throw,
    law: str | type[Law] = "front-back",
    *,
    until: float,
    draws: int = 1000,
    seed: int = 0,
    **options: Any,
) -> Prediction:
    """Fit the first rows of a throw, predict the rest, and compare: the result's `check`.

    Parameters
    ----------
    throw : the data, with rows after `until` (s). law, options : as in `curlfit.fit`.
    draws, seed : as in `predict`.

    Raises
    ------
    InputError, UnusableFitError : as in `curlfit.fit` and `predict`.
    """
    from curlfit.inference.fit.fit import fit

    return predict(fit(throw, law, until=until, **options), draws=draws, seed=seed, check=throw)


def _drawn_values(
    fit: FitResult, chain: Chain | None, draws: int, random: np.random.Generator
) -> tuple[Floats, str]:
    """Parameter vectors from the posterior, and where they are from."""
    if chain is not None:
        if chain.names != tuple(fit.parameters):
            raise InputError("the chain is not of this fit: its parameters have other names")
        flat = chain.flat
        return flat[random.choice(len(flat), draws, replace=len(flat) < draws)], "chain"
    parameters = fit.parameter_set
    free = parameters.free
    move = ridge_move(fit, np.zeros(len(parameters)))
    lower, upper = parameters.lower[free], parameters.upper[free]
    kept: list[Floats] = []
    for _ in range(200):
        tried = move.draw(draws, random, gaussian=True)
        kept.extend(tried[((tried >= lower) & (tried <= upper)).all(1)])
        if len(kept) >= draws:
            break
    else:
        kept += list(np.clip(move.draw(draws, random, gaussian=True), lower, upper))
    values = np.tile(fit.values, (draws, 1))
    values[:, free] = kept[:draws]
    return values, "covariance"


def _measured_path(fit: FitResult, begun: Begun) -> dict[str, Floats]:
    """The fitted rows on the sheet, where x and y were measured."""
    seen = fit.observed
    if "x" not in seen or "y" not in seen:
        return {}
    rows = _thinned(np.arange(len(seen["t"])))
    return {
        "t": seen["t"][rows] - seen["t"][0],
        "x": seen["x"][rows] + begun.shift[0],
        "y": seen["y"][rows] + begun.shift[1],
    }


def _thinned(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """At most `_MOST_CHECKED` of some rows, evenly."""
    places = np.linspace(0, len(rows) - 1, min(len(rows), _MOST_CHECKED)).astype(int)
    return cast(NDArray[np.int64], rows[np.unique(places)])


def _quantities(best: Paths, plain: Paths, full: Paths) -> dict[str, Quantity]:
    each = [_measured(paths) for paths in (best, plain, full)]
    found = {}
    for name, (_, unit) in QUANTITIES.items():
        value, ours, both = (values[name] for values in each)
        there = np.isfinite(ours) & np.isfinite(both)
        if not there.any():
            continue
        found[name] = Quantity(
            value=float(value[0]),
            unit=unit,
            parameter_sd=float(ours[there].std()),
            model_sd=float(_size((both - ours)[there])),
            quantiles=_quantiles(both[there]),
            share=float(np.isfinite(both).mean()),
        )
    return found


def _measured(paths: Paths) -> dict[str, Floats]:
    """The quantities of each path; NaN where it has none."""
    first, last = paths.state[:, :3, 0], paths.state[:, :3, -1]
    vx, vy = paths.state[:, 3, 0], paths.state[:, 4, 0]
    dx, dy = (last - first)[:, :2].T
    passed = {name: paths.passing(LINES[name]) for name in ("hog", "far-hog", "far-tee")}
    hog, far_hog, tee = (passed[name][0] for name in ("hog", "far-hog", "far-tee"))
    return {
        "rest_x": last[:, 0],
        "rest_y": last[:, 1] - TEE,
        "rest_to_tee": np.hypot(last[:, 0], last[:, 1] - TEE),
        "curl": (dx * vy - dy * vx) / np.hypot(vx, vy),
        "turns": (last - first)[:, 2] / (2 * math.pi),
        "time": paths.rest,
        "hog_to_hog": far_hog - hog,
        "hog_to_tee": tee - hog,
        "hog_to_rest": paths.rest - far_hog,
        "speed_at_hog": passed["hog"][1],
        "speed_at_far_hog": passed["far-hog"][1],
        "speed_at_tee": passed["far-tee"][1],
    }


def _quantiles(values: Floats) -> dict[str, float]:
    found = np.quantile(values, [float(level) / 100 for level in LEVELS])
    return dict(zip(LEVELS, map(float, found), strict=True))


def _size(values: Floats) -> Floats:
    """Root mean square over the draws."""
    return cast(Floats, np.sqrt(np.mean(values**2, axis=0)))


def _series(best: Paths, plain: Paths, full: Paths) -> dict[str, Floats]:
    longest = max(float(best.rest[0]), float(np.quantile(full.rest, 0.975)))
    n = min(int(np.searchsorted(best.t, longest)) + 1, len(best.t))
    state = best.state[0, :, :n]
    found = {"t": best.t[:n], **dict(zip(FORETOLD, state[:3], strict=True))}
    found |= {"speed": np.hypot(state[3], state[4]), "omega": state[5]}
    for row, name in enumerate(FORETOLD):
        ours, both = plain.state[:, row, :n], full.state[:, row, :n]
        found[f"{name}_parameter_sd"] = ours.std(0)
        found[f"{name}_model_sd"] = _size(both - ours)
        levels = np.quantile(both, [float(level) / 100 for level in LEVELS], axis=0)
        for level, values in zip(LEVELS, levels, strict=True):
            if level != "50":
                found[f"{name}_{level}"] = values
    return found


def _band(best: Paths, full: Paths) -> dict[str, Floats]:
    """x as a function of y, as far as half of the draws go."""
    ends = full.state[:, 1].max(1)
    y = np.linspace(float(best.state[0, 1, 0]), float(np.median(ends)), _LEVELS_ALONG)
    at = np.array([_across(state, y) for state in full.state])
    levels = np.nanquantile(at, [float(level) / 100 for level in LEVELS], axis=0)
    bands = {f"x_{level}": row for level, row in zip(LEVELS, levels, strict=True) if level != "50"}
    return {"y": y, "x": _across(best.state[0], y)} | bands


def _across(state: Floats, y: Floats) -> Floats:
    """x of one path where it has come to given y, as far as it comes."""
    rising = np.maximum.accumulate(state[1])
    new = np.concatenate([[True], np.diff(rising) > 0])
    return cast(Floats, np.interp(y, rising[new], state[0, new], left=state[0, 0], right=np.nan))


def _rest(plain: Paths, full: Paths) -> dict[str, Any]:
    ours, both = plain.state[:, :2, -1], full.state[:, :2, -1]
    return {
        "mean": [float(value) for value in both.mean(0)],
        "parameter": np.cov(ours.T).tolist(),
        "model": ((both - ours).T @ (both - ours) / len(both)).tolist(),
        "both": np.cov(both.T).tolist(),
    }


def _chances(full: Paths) -> dict[str, float]:
    x, y = full.state[:, :2, -1].T
    events = {
        "in the house": np.hypot(x, y - TEE) < HOUSE + STONE_RADIUS,
        "short of the hog line": y - STONE_RADIUS < LINES["far-hog"],
        "through the house": y > END,
    }
    return {name: float(happens.mean()) for name, happens in events.items()}


def _sensitivity(probed: dict[str, Paths], best: Paths) -> dict[str, dict[str, Any]]:
    """How the resting place moves with the start."""
    end = best.state[0, :2, -1]
    found: dict[str, dict[str, Any]] = {}
    for name, by in VARIED.items():
        if probed[name].good[0]:
            right, along = probed[name].state[0, :2, -1] - end
            found[name] = {"by": by, "right": float(right), "along": float(along)}
    right, along = (float(way) * _MORE_HEADING for way in end - best.state[0, :2, 0])
    found["heading"] = {"by": _MORE_HEADING, "right": along, "along": -right}
    return found


def _extrapolation(fit: FitResult, best: Paths, new: bool) -> list[str]:
    """Where the throw goes beyond what the fit has seen."""
    seen_speed, seen_spin = fit.fitted["speed"], fit.fitted["omega"]
    speed = np.hypot(*best.state[0, 3:5])
    omega, y = best.state[0, 5], best.state[0, 1]
    found = []
    fastest, slowest = float(seen_speed.max()), float(seen_speed.min())
    if speed[0] > _MARGIN * fastest:
        found.append(
            f"it begins with {speed[0]:.3g} m/s; the fit saw no more than {fastest:.3g} m/s, so "
            "the beginning is an extrapolation"
        )
    slow = np.flatnonzero(speed < slowest / _MARGIN)
    way = float(y[-1] - y[slow[0]]) if len(slow) else 0.0
    if way > 0.01:
        found.append(
            f"the last {way:.2g} m, below {slowest:.2g} m/s, are slower than anything that was "
            "fitted: an extrapolation"
        )
    spins = np.abs(seen_spin)
    if new and abs(omega[0]) > _MARGIN * spins.max():
        found.append(
            f"it spins with {abs(omega[0]):.3g} rad/s; the fit saw no more than "
            f"{spins.max():.3g} rad/s: an extrapolation"
        )
    if new and 0 < abs(omega[0]) < spins.min() / _MARGIN:
        found.append(
            f"it spins with {abs(omega[0]):.3g} rad/s; the fit saw no less than "
            f"{spins.min():.3g} rad/s: an extrapolation"
        )
    if new and omega[0] * seen_spin[0] < 0:
        found.append(
            "it turns the other way round than the fitted throw: the ice is taken to mirror it"
        )
    return found


def _unknowns(fit: FitResult, probed: dict[str, Paths], best: Paths) -> tuple[list[str], list[str]]:
    """What the fit does not know, where it matters here and where it does not."""
    matter: list[str] = []
    rest: list[str] = []
    for place, direction in enumerate(fit.null_directions):
        ends = probed[f"unseen {place}"]
        names = " and ".join(direction) if len(direction) < 3 else ", ".join(direction)
        what = f"{names} {'is' if len(direction) == 1 else 'are'} not known"
        what += " one by one" if len(direction) > 1 else ""
        if not ends.good.all():
            matter.append(f"{what}; at the ends of what is allowed the stone does not come to rest")
            continue
        moved = float(np.hypot(*(ends.state[:, :2, -1] - best.state[0, :2, -1]).T).max())
        turned = float(np.abs(ends.state[:, 2, -1] - best.state[0, 2, -1]).max())
        if max(moved, turned) < _MATTERS:
            size = "less than 0.01 mm" if moved < 1e-5 else f"{1000 * moved:.2g} mm"
            rest.append(
                f"{what}, which does not matter here: from one end of what is allowed to the "
                f"other, the resting place moves by {size}"
            )
        else:
            matter.append(
                f"{what}, and it matters here: the stone may rest {moved:.2g} m off and be turned "
                f"by {turned:.2g} rad more; the bands hold this, evenly over what is allowed"
            )
    return matter, rest


def _of_the_law(misfit: Misfit) -> tuple[list[str], list[str]]:
    """Of the model discrepancy: warnings and notes."""

    def listed(sizes: Mapping[str, float], shown: Collection[str]) -> str:
        return ", ".join(
            f"{size:.2g} {'rad' if way == 'turning' else 'm'}/s^2 {WORDS[way]}"
            for way, size in sizes.items()
            if way in shown
        )

    limit = (
        f"its prior lies below the friction itself (mu = {misfit.friction:.2g}, mu g = "
        f"{misfit.ceilings['along']:.2g} m/s^2; 5 % of it would be above, a third is its mean)"
    )
    if not misfit.known:
        return [
            "too few rows were fitted to estimate the model discrepancy; the bands take it from "
            f"its prior alone: {listed(misfit.sizes, WORDS)}"
        ], [f"the size of a missing acceleration is limited: {limit}"]
    found = [way for way, excess in misfit.excess.items() if excess > SHOWN]
    rest = [way for way in WORDS if way not in found]
    warnings = [
        "the law does not describe the fitted rows: their residuals are those of a missing "
        f"acceleration of about {listed(misfit.sizes, found)}. The bands hold this and lie to the "
        "side of the law's own path to which the residuals point, but beyond the speeds and spins "
        "that were fitted the law may fail worse"
    ] if found else []  # fmt: skip
    undetected = (
        f"an acceleration too small to be detected in the fitted rows is in the bands: about "
        f"{listed(misfit.sizes, rest)}; "
    )
    return warnings, [
        (undetected if rest else "the size of a missing acceleration is limited: ") + limit
    ]


def _off_the_sheet(best: Paths) -> list[str]:
    x, y = best.state[0, :2]
    outside = np.flatnonzero(np.abs(x) + STONE_RADIUS > WIDTH / 2)
    if len(outside):
        return [
            f"it touches the side of a sheet {WIDTH:g} m wide {abs(y[outside[0]] - TEE):.3g} m "
            f"{'before' if y[outside[0]] < TEE else 'beyond'} the tee, and would be removed"
        ]
    return []


def _held_out(
    throw: Throw,
    fit: FitResult,
    begun: Begun,
    misfit: Misfit,
    best: Paths,
    full: Paths,
    random: np.random.Generator,
) -> HeldOut:
    """Measured rows after the fitted ones beside what was predicted. Raises `InputError`."""
    first, last = fit.data["from"], fit.data["to"]
    _require_same(throw, fit)
    later = np.flatnonzero(throw.t > last)
    if not len(later):
        raise InputError(
            f"{throw.name}: no rows after t = {last:g} s, the last that was fitted; fit with a "
            "smaller --until"
        )
    later = _thinned(later)
    t = throw.t[later] - first
    at, middle = full.when(t), best.when(t)[0]
    shift = (*begun.shift, 0.0)
    channels, observed = {}, {"t": t}
    for row, name in enumerate(FORETOLD):
        values = getattr(throw, name)[later] + shift[row]
        observed[name] = values
        seen = np.isfinite(values)
        if not seen.any():
            continue
        sigma = misfit.noise.get(name, fit.sigma.get(name, 0.0))
        given = throw.sigma.get(name)
        noise = np.full(len(later), sigma) if given is None else given[later]
        noisy = at[:, row] + noise * random.standard_normal(at[:, row].shape)
        low95, low68, high68, high95 = np.quantile(noisy, [0.025, 0.16, 0.84, 0.975], axis=0)
        off = (values - middle[row])[seen]
        end = int(np.flatnonzero(seen)[-1])
        channels[name] = {
            "rows": float(seen.sum()),
            "rms": float(np.sqrt(np.mean(off**2))),
            "inside_68": float(((values >= low68) & (values <= high68))[seen].mean()),
            "inside_95": float(((values >= low95) & (values <= high95))[seen].mean()),
            "end": float(off[-1]),
            "end_sd": float(noisy[:, end].std()),
        }
    if not channels:
        raise InputError(f"{throw.name}: no x, y or phi after t = {last:g} s")
    return HeldOut(
        throw.name, float(throw.t[later[0]]), float(throw.t[later[-1]]), channels, observed
    )


def _require_same(throw: Throw, fit: FitResult) -> None:
    """Raise `InputError` where the rows that were fitted are not in a throw."""
    for name in FORETOLD:
        if name not in fit.rms:
            continue
        own = np.interp(fit.observed["t"], throw.t, getattr(throw, name))
        off = np.abs(own - fit.observed[name])
        size = 10 * fit.rms[name] + 0.05 * float(np.nanmax(np.abs(np.ptp(fit.fitted[name]))))
        overlap = np.isfinite(off)
        if not overlap.any() or float(np.nanmedian(off)) > size:
            raise InputError(
                f"{throw.name}: this is not the throw that was fitted ({fit.data['file']}): "
                f"{name} differs before t = {fit.data['to']:g} s"
            )
