"""A throw foretold: one fit carried to rest, or another throw on the same ice, with its errors.

Two errors are kept apart. That of the parameters: draws from the posterior (the chain, or else the
fit's covariance: Gaussian along what the data determine, even within the bounds along what they do
not) are each followed to rest. That of the law: what it misses (see `curlfit.misfit`) bends the
estimates and makes the path deviate; each draw is followed once more with both. Noise of a
measurement is in neither; it is added where a prediction is held against measured rows.

What is given of a throw is taken as exact. Without any start the throw is the fitted one, whose
start is as uncertain as the fit has it.

Places are those of the sheet: x to the right of the centre line, y from the hack that the stone is
thrown from (`curlfit.sheet`). Data have a zero of their own, so the start is laid on a line of the
sheet, the near hog line if nothing else is said.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, cast

from curlfit.motion import simulate

# isort: split
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from curlfit.aiming import aim
from curlfit.chain import Chain
from curlfit.errors import DataError, InputError, UnusableFitError
from curlfit.files import Migration, known, read_json, strict, write_json
from curlfit.friction import Law, Load, check_load, no_motion_because
from curlfit.likelihood import split
from curlfit.misfit import Misfit, bent, drawn, misfit_of, same_speed
from curlfit.parameters import START
from curlfit.programs import kept
from curlfit.results import FitResult
from curlfit.sampling import ridge_move
from curlfit.sheet import END, HOUSE, LINES, STONE_RADIUS, TEE, TEE_TO_HOG, WIDTH
from curlfit.stone import Stone
from curlfit.throw import Throw

Floats = NDArray[np.float64]

SCHEMA = 1
MIGRATIONS: dict[int, Migration] = {}
LEVELS = ("2.5", "16", "50", "84", "97.5")
FORETOLD = ("x", "y", "phi")

GUARD = -(HOUSE + TEE_TO_HOG) / 2
"""Where a guard rests, beyond the tee: halfway between the house and the hog line (m)."""
TAKEOUT = 1.5
"""Speed in m/s with which a takeout passes the tee."""
WEIGHTS = {
    "draw": "rests on the tee line",
    "guard": f"rests halfway between hog line and house, {-GUARD:.3f} m before the tee line",
    "takeout": f"passes the tee line at {TAKEOUT:g} m/s",
}

_TIMES = 301
_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # s between times
_LEVELS_ALONG = 121
VARIED = {"v0": 0.01, "omega0": 0.1}
"""By how much a start is varied to tell how the resting place follows, in m/s and rad/s."""
_MORE_HEADING = 0.001  # the same, rad
_FILLED = 0.8  # share of the grid of times within which paths come to rest
_FEW = 0.01  # share of paths that may take longer
_MOST_CHECKED = 2000  # measured rows that a prediction is held against
_MARGIN = 1.02  # of the fitted range of speed or spin, beyond which is extrapolation
_MATTERS = 1e-3  # m of the resting place, below which an unknown parameter does not matter
_LEAST_SPIN = 1e-3  # rad/s of the fitted throw, below which another's is not compared with it
_ON_LINE = 1e-3  # m; a stone that rests on a line has not passed it
_AT_START = 0.1  # m past a line within which a throw counts as beginning on it


@dataclass(frozen=True)
class Quantity:
    """A number foretold.

    Attributes
    ----------
    value : for the best estimate; NaN where that throw has none (it never reaches the line).
    parameter_sd, model_sd : standard deviations from the errors of the parameters and of the law.
    quantiles : of both together, keys "2.5", "16", "50", "84", "97.5".
    share : of the draws that have it.
    """

    value: float
    unit: str
    parameter_sd: float
    model_sd: float
    quantiles: dict[str, float]
    share: float

    @property
    def sd(self) -> float:
        """Standard deviation from both errors."""
        return math.hypot(self.parameter_sd, self.model_sd)


@dataclass(frozen=True)
class HeldOut:
    """A prediction beside measured rows that the fit had not seen.

    Attributes
    ----------
    file, first, last : where the rows came from, first and last time (s, the clock of the data).
    channels : by channel "rows", "rms" of measured - foretold, "inside_68" and "inside_95" (share
        of rows within the bands, noise included), "end" (measured - foretold at its last row) and
        "end_sd" (what was foretold for that difference).
    observed : t (s since the start) and the channels, on the sheet.
    """

    file: str
    first: float
    last: float
    channels: dict[str, dict[str, float]]
    observed: dict[str, Floats]


@dataclass(frozen=True)
class Prediction:
    """A throw foretold. `save` writes it, `load_prediction` reads it.

    Attributes
    ----------
    law, load, stone, fit : what was fitted to what; `fit` has "file", "rows", "from", "to".
    start : by name (x0 y0 heading v0 phi0 omega0) "value", "unit" and "origin" ("given", "fitted",
        "default", "found").
    of : "fitted" for the fitted throw carried on, "new" for another one.
    line : the line on which it starts, "data" for where the data do, "" for a place given.
    goal : None, or "words", "x", "y" (m from the tee; x None where not aimed at), "speed".
    draws : "number", "used", "source" ("chain" or "covariance"), "seed".
    misfit : accelerations that the law misses.
    series : t (s since the start) and x, y, phi, speed, omega of the best estimate; of x, y, phi
        also "x_parameter_sd", "x_model_sd" and the quantiles "x_2.5" ...
    band : x as a function of y: "y", "x" and "x_2.5" ..., where at least half of the draws pass.
    rest : "mean" of the resting place and "parameter", "model": covariances of both errors (m^2).
    quantities : by name, see `QUANTITIES`.
    chances : by name, shares of the draws.
    sensitivity : by name of the start, the change of the resting place (m right, m along) by "by".
    warnings : what the reader has to mind. notes : what else there is to say.
    check : None, or how measured rows compare.
    """

    law: str
    load: str
    stone: Stone
    fit: dict[str, Any]
    start: dict[str, dict[str, Any]]
    of: str
    line: str
    goal: dict[str, Any] | None
    draws: dict[str, Any]
    misfit: Misfit
    series: dict[str, Floats]
    band: dict[str, Floats]
    rest: dict[str, Any]
    quantities: dict[str, Quantity]
    chances: dict[str, float]
    sensitivity: dict[str, dict[str, Any]]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    check: HeldOut | None = None

    def to_json(self) -> dict[str, Any]:
        """The record as written to `predict.json`; see the README for its fields."""
        found = {item.name: getattr(self, item.name) for item in fields(self)}
        listed = {name: values.tolist() for name, values in self.series.items()}
        check = None
        if self.check is not None:
            observed = {name: values.tolist() for name, values in self.check.observed.items()}
            check = asdict(self.check) | {"observed": observed}
        return {"schema": SCHEMA} | found | {
            "stone": self.stone.as_dict(),
            "misfit": asdict(self.misfit),
            "quantities": {name: asdict(item) for name, item in self.quantities.items()},
            "warnings": list(self.warnings),
            "notes": list(self.notes),
            "check": check,
            "series": listed,
            "band": {name: values.tolist() for name, values in self.band.items()},
        }  # fmt: skip

    def summary(self) -> dict[str, Any]:
        """The JSON record without the series."""
        record = strict(self.to_json())
        if record["check"] is not None:
            record["check"].pop("observed")
        return {key: value for key, value in record.items() if key not in ("series", "band")}

    @classmethod
    def from_json(cls, found: dict[str, Any]) -> Prediction:
        """The record from what `to_json` gave. Raises KeyError or TypeError if it is not one."""
        check = found["check"]
        return cls(
            **known(cls, found)
            | {
                "stone": Stone(**known(Stone, found["stone"])),
                "misfit": Misfit(**known(Misfit, found["misfit"])),
                "series": _arrays(found["series"]),
                "band": _arrays(found["band"]),
                "quantities": {
                    name: Quantity(**known(Quantity, item) | {"value": _number(item["value"])})
                    for name, item in found["quantities"].items()
                },
                "warnings": tuple(found["warnings"]),
                "notes": tuple(found["notes"]),
                "check": None
                if check is None
                else HeldOut(**known(HeldOut, check) | {"observed": _arrays(check["observed"])}),
            }
        )

    def save(self, file: str | PathLike[str]) -> None:
        """Write the record as JSON, whole or not at all."""
        write_json(self.to_json(), Path(file))

    def table(self) -> str:
        """The path with its bands as CSV text, a row for each time."""
        names = list(self.series)
        lines = [
            f"# {self.law} law fitted to {self.fit['file']}, "
            + ("carried on" if self.of == "fitted" else "another throw"),
            "# t in s since the start, lengths in m, angles in rad; x to the right of the centre "
            f"line, y from the hack thrown from (far tee at {TEE:.3f})",
            "# _parameter_sd, _model_sd: standard deviations; _2.5 .. _97.5: percentiles, both "
            "errors together",
            ",".join(names),
        ]
        for row in zip(*self.series.values(), strict=True):
            lines.append(",".join(f"{value:.9g}" for value in row))
        return "\n".join(lines) + "\n"


QUANTITIES = {
    "rest_x": ("rests right of centre line", "m"),
    "rest_y": ("rests beyond tee line", "m"),
    "rest_to_tee": ("rests from the tee", "m"),
    "curl": ("curls to the right", "m"),
    "turns": ("turns counter-clockwise", ""),
    "time": ("time to rest", "s"),
    "hog_to_hog": ("hog line to hog line", "s"),
    "hog_to_tee": ("near hog line to tee line", "s"),
    "hog_to_rest": ("far hog line to rest", "s"),
    "speed_at_hog": ("speed at near hog line", "m/s"),
    "speed_at_far_hog": ("speed at far hog line", "m/s"),
    "speed_at_tee": ("speed at tee line", "m/s"),
}
"""What is foretold besides the path: meaning and unit by name. Curl is the distance of the resting
place from the line of delivery, the straight line along the first velocity."""
CHANCES = {
    "in the house": "rests in the house or touches it",
    "short of the hog line": "does not get over the far hog line and is removed",
    "through the house": "passes the back line and is out of play",
}


def load_prediction(file: str | PathLike[str]) -> Prediction:
    """Read a saved `predict.json`, or the one in a folder.

    Raises
    ------
    DataError : it is not there, is not a prediction, or has a schema this version cannot read.
    """
    path = Path(file)
    if path.is_dir():
        path = path / "predict.json"
    found = read_json(path, SCHEMA, MIGRATIONS)
    try:
        return Prediction.from_json(found)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(
            f"not a complete predict.json of curlfit ({type(error).__name__}: {error})", file=path
        ) from None


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
    """Foretell a throw, from a fit of one on the same ice.

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
    wanted = _Wanted(dict(start or {}), line or "hog", target, weight, tee_speed)
    if line is None and not wanted.new and _on_the_sheet(fit):
        wanted = wanted._replace(line="data")
    wanted.require(fit, check)
    if not fit.converged:
        raise UnusableFitError(f"nothing can be foretold from this fit: {fit.status}")
    if fit.noise.kind != "white":
        raise InputError(
            f"noise {fit.noise.kind}: a prediction carries what the law misses by itself; make it "
            "from a fit with white noise"
        )
    if draws < 100:
        raise InputError(f"{draws} draws: expected at least 100")
    random = np.random.default_rng(seed)
    begun = _begin(fit, wanted)
    values, source = _drawn_values(fit, chain, draws, random)
    family = _Family(fit, begun, wanted.new)
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
    misfit = misfit_of(fit)
    full = family.deviated(values, best, misfit, random) if misfit.found else plain
    use = plain.good & full.good
    if use.mean() < 0.5:
        raise UnusableFitError(
            f"only {use.mean():.0%} of the draws come to rest; the fit knows too little for this "
            "throw"
        )
    plain, full = plain.of(use), full.of(use)
    quantities = _quantities(best, plain, full)
    matter, rest = _unknowns(fit, probed, best)
    warnings = [
        *_extrapolation(fit, best, wanted.new),
        *matter,
        *_of_the_law(misfit),
        *_off_the_sheet(best),
    ]
    notes = [*rest]
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
    """Fit the first rows of a throw, foretell the rest, and compare: the result's `check`.

    Parameters
    ----------
    throw : the data, with rows after `until` (s). law, options : as in `curlfit.fit`.
    draws, seed : as in `predict`.

    Raises
    ------
    InputError, UnusableFitError : as in `curlfit.fit` and `predict`.
    """
    from curlfit.fitting import fit

    return predict(fit(throw, law, until=until, **options), draws=draws, seed=seed, check=throw)


class _Wanted(NamedTuple):
    """What throw is asked for."""

    start: dict[str, float]
    line: str
    target: tuple[float, float] | None
    weight: str | None
    tee_speed: float | None

    @property
    def new(self) -> bool:
        """Whether it is another throw than the fitted one."""
        return bool(self.start) or self.aimed

    @property
    def aimed(self) -> bool:
        return self.target is not None or self.weight is not None

    def require(self, fit: FitResult, check: Throw | None) -> None:
        """Raise `InputError` where this cannot be meant."""
        names = [item.name for item in START]
        for name, value in self.start.items():
            if name not in names:
                raise InputError(f"start: no {name!r}; a throw starts with {', '.join(names)}")
            if not math.isfinite(value):
                raise InputError(f"{name} = {value}: expected a finite number")
        if not 0 < self.start.get("v0", 1.0) <= 10:
            raise InputError(f"v0 = {self.start['v0']:g} m/s: expected a speed up to 10 m/s")
        if not abs(self.start.get("omega0", 0.0)) <= 100:
            raise InputError(f"omega0 = {self.start['omega0']:g} rad/s: expected at most 100 rad/s")
        if self.line not in (*list(LINES)[:-1], "data"):
            raise InputError(
                f"start on {self.line!r}: expected one of {', '.join(list(LINES)[:-1])}, data"
            )
        if self.target is not None and self.weight is not None:
            raise InputError("a target and a weight are given; expected one of them")
        if self.weight is not None and self.weight not in WEIGHTS:
            raise InputError(f"weight {self.weight!r}: expected {', '.join(WEIGHTS)}")
        if self.tee_speed is not None and self.weight != "takeout":
            raise InputError("a speed at the tee is that of the weight takeout only")
        if self.aimed and "v0" in self.start:
            raise InputError("v0 is given, and the target or weight asks for it to be found")
        if self.target is not None and "heading" in self.start:
            raise InputError("heading is given, and the target asks for it to be found")
        if check is not None and self.new:
            raise InputError(
                "measured rows are compared with the fitted throw carried on; leave out its start"
            )
        spin = fit.parameters["omega0"]
        if self.new and "omega0" not in self.start and spin.verdict == "not identifiable":
            raise InputError("the fit does not know the spin (omega0); give one")

    def place(self) -> tuple[float | None, float, float] | None:
        """x and y from the tee, and the speed there; x is None where it is not aimed at."""
        x = None if "heading" in self.start else 0.0
        if self.target is not None:
            return (*self.target, 0.0)
        if self.weight is None:
            return None
        if self.weight == "takeout":
            return x, 0.0, TAKEOUT if self.tee_speed is None else self.tee_speed
        return x, GUARD if self.weight == "guard" else 0.0, 0.0

    def goal(self) -> dict[str, Any] | None:
        """The same as it is kept."""
        place = self.place()
        if place is None:
            return None
        x, y, speed = place
        words = self.weight or ("to the tee" if (x, y) == (0.0, 0.0) else "target")
        return {"words": words, "x": x, "y": y, "speed": speed}


class _Begun(NamedTuple):
    """Where and how the throw starts."""

    values: dict[str, float]
    """of the best estimate, on the sheet"""
    shift: tuple[float, float]
    """what to add to the data's x and y"""
    line: str

    def record(self, fit: FitResult, wanted: _Wanted) -> dict[str, dict[str, Any]]:
        """The same by name, with where each value is from."""
        found = {}
        for item in START:
            origin = "default"
            if item.name in wanted.start:
                origin = "given"
            elif wanted.aimed and item.name in ("v0", "heading"):
                origin = "found"
            elif item.name in ("v0", "omega0") or not wanted.new:
                origin = "fitted"
            if origin == "fitted" and item.name in ("x0", "y0") and self.line != "data":
                origin = "default"
            found[item.name] = {
                "value": float(self.values[item.name]), "unit": item.unit, "origin": origin,
            }  # fmt: skip
        return found


def _on_the_sheet(fit: FitResult) -> bool:
    """Whether the readers laid the data on the sheet, y counted from the hack."""
    return any(
        note.startswith("y from the hack") or (note.startswith("axes:") and "from-" in note)
        for note in fit.data["notes"]
    )


def _begin(fit: FitResult, wanted: _Wanted) -> _Begun:
    fitted = {item.name: fit.parameters[item.name].value for item in START}
    line = wanted.line
    place = (fitted["x0"], fitted["y0"]) if line == "data" else (0.0, LINES[line])
    shift = place[0] - fitted["x0"], place[1] - fitted["y0"]
    values = fitted | {"x0": place[0], "y0": place[1]}
    if not wanted.new:
        return _Begun(values, shift, line)
    values |= {"heading": 0.0, "phi0": 0.0} | wanted.start
    goal = wanted.place()
    if goal is not None:
        x, y, speed = goal
        law, _ = split(fit.law_class, fit.values)
        found = aim(
            law, fit.stone, (x or 0.0, TEE + y), omega0=values["omega0"],
            start=(values["x0"], values["y0"]),
            heading=values["heading"] if x is None else None, speed=speed, load=fit.load,
        )  # fmt: skip
        values |= {"v0": found.v0, "heading": found.heading}
    return _Begun(values, (0.0, 0.0), line)


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


class _Paths:
    """Many paths to rest on one grid of times.

    Attributes
    ----------
    t : the grid in s since the start, shape (times,).
    state : x, y, phi, vx, vy, omega, shape (paths, 6, times). good : whether a path comes to rest.
    rest : time at rest in s, shape (paths,). clock : `t`, stopped there, shape (paths, times).
    late : what a deviation adds to the time at rest, shape (paths,).
    """

    def __init__(self, t: Floats, state: Floats) -> None:
        self.t, self.state = t, state
        speed = np.hypot(state[:, 3], state[:, 4])
        turning = np.abs(state[:, 5])
        self.good = np.isfinite(state).all((1, 2)) & (speed[:, -1] <= 0) & (turning[:, -1] <= 0)
        self.rest = _rest_times(t, state, speed)
        self.clock = np.minimum(t, self.rest[:, None])
        self.late = np.zeros(len(state))

    def __len__(self) -> int:
        return len(self.state)

    def of(self, which: Any) -> _Paths:
        """Some of the paths."""
        found = object.__new__(_Paths)
        found.t, found.state = self.t, self.state[which]
        for name in ("good", "rest", "clock", "late"):
            setattr(found, name, getattr(self, name)[which])
        return found

    def slowing(self) -> Floats:
        """Mean deceleration over the last quarter of each path's time, m/s^2."""
        speed = np.hypot(self.state[:, 3], self.state[:, 4])
        quarter = np.array(
            [
                np.interp(0.75 * rest, self.t, one)
                for rest, one in zip(self.rest, speed, strict=True)
            ]
        )
        return cast(Floats, np.maximum(quarter / (0.25 * self.rest), 1e-6))

    def at(self, k: NDArray[np.int64], part: Floats) -> tuple[Floats, Floats]:
        """x, y, phi and their rates in interval k (k - 1 to k), at a part 0..1 of it, by cubics."""
        rows = np.arange(len(self))
        step = (self.clock[rows, k] - self.clock[rows, k - 1])[:, None]
        a, b = self.state[rows, :3, k - 1], self.state[rows, :3, k]
        slope_a, slope_b = self.state[rows, 3:, k - 1] * step, self.state[rows, 3:, k] * step
        s = part[:, None]
        value = (
            a * (1 + 2 * s) * (1 - s) ** 2 + b * s**2 * (3 - 2 * s)
            + slope_a * s * (1 - s) ** 2 - slope_b * s**2 * (1 - s)
        )  # fmt: skip
        rate = (
            6 * s * (1 - s) * (b - a) + slope_a * (1 - s) * (1 - 3 * s) + slope_b * s * (3 * s - 2)
        ) / np.where(step > 0, step, 1.0)
        return value, rate

    def passing(self, level: float) -> tuple[Floats, Floats]:
        """Time and speed at which each path first passes a y; NaN where it does not.

        A path that starts within `_AT_START` beyond it counts as starting on it.
        """
        y = self.state[:, 1]
        beyond = y >= level
        beyond &= (y[:, -1] > level + _ON_LINE)[:, None]
        k = np.argmax(beyond, 1)
        low, high = np.zeros(len(self)), np.ones(len(self))
        crossing = beyond.any(1) & (k > 0)
        inside = np.maximum(k, 1)
        for _ in range(50):
            middle = (low + high) / 2
            under = self.at(inside, middle)[0][:, 1] < level
            low, high = np.where(under, middle, low), np.where(under, high, middle)
        rows = np.arange(len(self))
        before, after = self.clock[rows, inside - 1], self.clock[rows, inside]
        time = before + (after - before) * high
        speed = np.hypot(*self.at(inside, high)[1][:, :2].T)
        since = y[:, 0] - level
        on_it = (since >= 0) & (since < _AT_START)
        first = np.hypot(self.state[:, 3, 0], self.state[:, 4, 0])
        ahead = np.where(self.state[:, 4, 0] > 0, self.state[:, 4, 0], np.nan)
        time = np.where(on_it, -since / ahead, np.where(crossing, time, np.nan))
        return time, np.where(on_it, first, np.where(crossing, speed, np.nan))

    def when(self, times: Floats) -> Floats:
        """x, y, phi at times since the start, shape (paths, 3, times)."""
        found = np.empty((len(self), 3, len(times)))
        for place, time in enumerate(times):
            k = int(np.clip(np.searchsorted(self.t, time), 1, len(self.t) - 1))
            before, after = self.clock[:, k - 1], self.clock[:, k]
            step = np.where(after > before, after - before, 1.0)
            part = np.clip((np.minimum(time, self.rest) - before) / step, 0.0, 1.0)
            found[:, :, place] = self.at(np.full(len(self), k), part)[0]
        return found


def _rest_times(t: Floats, state: Floats, speed: Floats) -> Floats:
    """When each path comes to rest.

    Toward rest a rate v goes as a power q of the time left, so that the way left, s, tells that
    time: s = v tau/(1 + q); and two moments tell q, for s goes as v to the power 1 + 1/q. It is
    taken from the turning, which has no loops, and from the place where the stone does not turn or
    its turning does not die away with the sliding.
    """
    last = np.maximum((speed > 0).sum(1) - 1, 1)
    rows, step = np.arange(len(state)), t[1] - t[0]

    def wait(way: list[Floats], rate: list[Floats]) -> Floats:
        with np.errstate(all="ignore"):
            power = np.log(way[0] / way[1]) / np.log(rate[0] / rate[1])
            found = way[1] / rate[1] * power / (power - 1)
        return np.where((found >= 0) & (found <= step) & (power > 1.1), found, np.nan)

    moments = (last - 1, last)
    place = [np.hypot(*(state[:, :2, -1] - state[rows, :2, k]).T) for k in moments]
    angle = [np.abs(state[:, 2, -1] - state[rows, 2, k]) for k in moments]
    sliding = wait(place, [speed[rows, k] for k in moments])
    turning = wait(angle, [np.abs(state[rows, 5, k]) for k in moments])
    left = np.where(np.isnan(turning), sliding, turning)
    return cast(Floats, t[last] + np.where(np.isnan(left), step / 2, left))


@kept("law", "load")
def _carried(law: type[Law], load: Load, values: Array, stone: Stone, times: Array) -> Array:
    def one(values: Array) -> Array:
        friction, start = split(law, values)
        path = simulate(friction, stone, start, times, load=load, t0=0.0)
        return jnp.stack([path.x, path.y, path.phi, path.vx, path.vy, path.omega])

    return jax.vmap(one)(values)


class _Family:
    """The throw asked for, under many parameter vectors."""

    def __init__(self, fit: FitResult, begun: _Begun, new: bool) -> None:
        self.fit, self.begun, self.new = fit, begun, new
        self._first = len(fit.parameters) - len(START)
        self._turned = begun.values["heading"] - fit.parameters["heading"].value if new else 0.0
        spin = fit.parameters["omega0"].value
        known = new and abs(spin) > _LEAST_SPIN
        self._spin = begun.values["omega0"] / spin if known else 1.0
        self._grid: Floats | None = None
        self._size = 0

    def begin(self, values: Floats) -> Floats:
        """Parameter vectors with the start of this throw."""
        own = values.copy()
        if self.new:
            own[:, self._first :] = [self.begun.values[item.name] for item in START]
        else:
            own[:, self._first : self._first + 2] += self.begun.shift
        return own

    def probes(self) -> dict[str, Floats]:
        """The best estimate varied: in speed, in spin, and to both ends of unseen directions."""
        best, names = self.fit.values, list(self.fit.parameters)
        found = {}
        for name, by in VARIED.items():
            found[name] = self.begin(best[None])
            found[name][0, names.index(name)] += by
        parameters = self.fit.parameter_set
        for place, direction in enumerate(self.fit.null_directions):
            along = np.array([direction.get(name, 0.0) for name in names])
            with np.errstate(all="ignore"):
                ends = np.stack([parameters.lower - best, parameters.upper - best]) / along
            ends = np.sort(ends[:, (along != 0) & np.isfinite(ends).all(0)], axis=0)
            room = [max(ends[0], default=0.0), min(ends[1], default=0.0)]
            found[f"unseen {place}"] = self.begin(best + np.outer(room, along))
        return found

    def follow(self, own: Floats) -> _Paths:
        """The paths of vectors that `begin` gave, on one grid for all calls."""
        self._size = max(self._size, len(own))
        every = np.concatenate([own, np.repeat(own[:1], self._size - len(own), 0)])
        law, load = self.fit.law_class, check_load(self.fit.load)

        def on(t: Floats) -> _Paths:
            return _Paths(t, np.asarray(_carried(law, load, every, self.fit.stone, t)))

        if self._grid is not None:
            return on(self._grid).of(slice(0, len(own)))
        guess = self._guess()
        for step in _STEPS:
            grid: Floats = step * np.arange(_TIMES, dtype=np.float64)
            if grid[-1] < guess:
                continue
            paths = on(grid)
            late = ~paths.good | (paths.rest > _FILLED * grid[-1])
            if (late & np.isfinite(paths.state).all((1, 2))).mean() < _FEW:
                break
        self._grid = grid
        return paths.of(slice(0, len(own)))

    def _guess(self) -> float:
        """About how long the throw takes, in s, from how the fitted one slowed."""
        t, speed = self.fit.observed["t"], self.fit.fitted["speed"]
        slowing = max((speed[0] - speed[-1]) / (t[-1] - t[0]), 1e-4)
        return min(float(1.2 * self.begun.values["v0"] / slowing), _STEPS[-1] * (_TIMES - 1))

    def deviated(
        self, values: Floats, best: _Paths, misfit: Misfit, random: np.random.Generator
    ) -> _Paths:
        """Draws with what the law misses: bent estimates, and a deviation of the path."""
        t, span = np.linspace(0.0, float(best.t[-1]), _TIMES), misfit.span
        speed = np.interp(t, best.t, np.hypot(best.state[0, 3], best.state[0, 4]))
        there = same_speed(self.fit, speed) if self.new else t
        horizon = max(float(there.max()), span)
        missing = drawn(misfit, float(min(there.min(), 0.0)), horizon, len(values), random)
        fitted = np.linspace(0.0, span, _TIMES)
        # The data were the law's path and a deviation, of which the estimates took their part.
        moved = values - bent(self.fit, fitted, missing.deviation(fitted, fitted))
        found = self.follow(self.begin(moved))
        deviation = missing.deviation(t, there)
        s, c = math.sin(self._turned), math.cos(self._turned)

        def taken(series: Floats, clock: Floats) -> tuple[Floats, ...]:
            """To the right, along and turning on the clocks of the paths, as the sheet has them."""
            pairs = [zip(clock, series[:, way], strict=True) for way in range(3)]
            u, w, turned = (
                np.array([np.interp(own, t, one) for own, one in pair]) for pair in pairs
            )
            u, turned = self._spin * u, self._spin * turned
            return c * u + s * w, c * w - s * u, turned

        moving = found.t < found.rest[:, None]
        state = found.state.copy()
        for way, there in enumerate(taken(deviation.value, found.clock)):
            state[:, way] += there
        for way, there in enumerate(taken(deviation.slope, found.clock)):
            state[:, 3 + way] += there * moving
        faster = taken(deviation.slope, found.rest[:, None])[1][:, 0]
        found.late = np.clip(faster / found.slowing(), -found.rest / 2, found.rest / 2)
        found.state = state
        return found


def _quantities(best: _Paths, plain: _Paths, full: _Paths) -> dict[str, Quantity]:
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
            model_sd=float((both - ours)[there].std()),
            quantiles=_quantiles(both[there]),
            share=float(np.isfinite(both).mean()),
        )
    return found


def _measured(paths: _Paths) -> dict[str, Floats]:
    """The quantities of each path; NaN where it has none."""
    first, last = paths.state[:, :3, 0], paths.state[:, :3, -1]
    vx, vy = paths.state[:, 3, 0], paths.state[:, 4, 0]
    dx, dy = (last - first)[:, :2].T
    passed = {name: paths.passing(LINES[name]) for name in ("hog", "far-hog", "far-tee")}
    hog, far_hog, tee = (passed[name][0] for name in ("hog", "far-hog", "far-tee"))
    time = paths.rest + paths.late
    return {
        "rest_x": last[:, 0],
        "rest_y": last[:, 1] - TEE,
        "rest_to_tee": np.hypot(last[:, 0], last[:, 1] - TEE),
        "curl": (dx * vy - dy * vx) / np.hypot(vx, vy),
        "turns": (last - first)[:, 2] / (2 * math.pi),
        "time": time,
        "hog_to_hog": far_hog - hog,
        "hog_to_tee": tee - hog,
        "hog_to_rest": time - far_hog,
        "speed_at_hog": passed["hog"][1],
        "speed_at_far_hog": passed["far-hog"][1],
        "speed_at_tee": passed["far-tee"][1],
    }


def _quantiles(values: Floats) -> dict[str, float]:
    found = np.quantile(values, [float(level) / 100 for level in LEVELS])
    return dict(zip(LEVELS, map(float, found), strict=True))


def _series(best: _Paths, plain: _Paths, full: _Paths) -> dict[str, Floats]:
    longest = max(float(best.rest[0]), float(np.quantile(full.rest, 0.975)))
    n = min(int(np.searchsorted(best.t, longest)) + 1, len(best.t))
    state = best.state[0, :, :n]
    found = {"t": best.t[:n], **dict(zip(FORETOLD, state[:3], strict=True))}
    found |= {"speed": np.hypot(state[3], state[4]), "omega": state[5]}
    for row, name in enumerate(FORETOLD):
        ours, both = plain.state[:, row, :n], full.state[:, row, :n]
        found[f"{name}_parameter_sd"] = ours.std(0)
        found[f"{name}_model_sd"] = (both - ours).std(0)
        levels = np.quantile(both, [float(level) / 100 for level in LEVELS], axis=0)
        for level, values in zip(LEVELS, levels, strict=True):
            if level != "50":
                found[f"{name}_{level}"] = values
    return found


def _band(best: _Paths, full: _Paths) -> dict[str, Floats]:
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


def _rest(plain: _Paths, full: _Paths) -> dict[str, Any]:
    ours, both = plain.state[:, :2, -1], full.state[:, :2, -1]
    return {
        "mean": [float(value) for value in both.mean(0)],
        "parameter": np.cov(ours.T).tolist(),
        "model": np.cov((both - ours).T).tolist(),
    }


def _chances(full: _Paths) -> dict[str, float]:
    x, y = full.state[:, :2, -1].T
    events = {
        "in the house": np.hypot(x, y - TEE) < HOUSE + STONE_RADIUS,
        "short of the hog line": y - STONE_RADIUS < LINES["far-hog"],
        "through the house": y > END,
    }
    return {name: float(happens.mean()) for name, happens in events.items()}


def _sensitivity(probed: dict[str, _Paths], best: _Paths) -> dict[str, dict[str, Any]]:
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


def _extrapolation(fit: FitResult, best: _Paths, new: bool) -> list[str]:
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


def _unknowns(
    fit: FitResult, probed: dict[str, _Paths], best: _Paths
) -> tuple[list[str], list[str]]:
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


def _of_the_law(misfit: Misfit) -> list[str]:
    if not misfit.known:
        return [
            "too few rows were fitted to tell what the law misses; the bands hold the errors of "
            "the parameters alone"
        ]
    if not misfit.found:
        return []
    where = [name for name, size in misfit.sizes.items() if size > 0]
    sizes = ", ".join(
        f"{size:.2g} {'rad' if way == 'turning' else 'm'}/s^2 {way}"
        for way, size in misfit.sizes.items()
        if size > 0
    )
    return [
        f"the law misses something: its residuals are as of a missing acceleration that drifts "
        f"to {sizes} within {misfit.span:.3g} s. The bands hold this ({len(where)} of 3 ways), but "
        "beyond the speeds and spins that were fitted the law may fail worse"
    ]


def _off_the_sheet(best: _Paths) -> list[str]:
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
    begun: _Begun,
    misfit: Misfit,
    best: _Paths,
    full: _Paths,
    random: np.random.Generator,
) -> HeldOut:
    """Measured rows after the fitted ones beside what was foretold. Raises `InputError`."""
    first, last = fit.data["from"], fit.data["to"]
    _require_same(throw, fit)
    later = np.flatnonzero(throw.t > last)
    if not len(later):
        raise InputError(
            f"{throw.name}: no rows after t = {last:g} s, the last that was fitted; fit with a "
            "smaller --until"
        )
    later = later[
        np.unique(np.linspace(0, len(later) - 1, min(len(later), _MOST_CHECKED)).astype(int))
    ]
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


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _arrays(found: Mapping[str, list[float | None]]) -> dict[str, Floats]:
    return {name: np.array([_number(value) for value in values]) for name, values in found.items()}
