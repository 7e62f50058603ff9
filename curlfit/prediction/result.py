"""Predictions as frozen records, in JSON, and as CSV."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from os import PathLike
from typing import Annotated, Any, ClassVar, Literal

from curlfit.findings import Finding
from curlfit.inference.derived.quantiles import LEVELS, Quantiles
from curlfit.inference.fit.entries import Extent
from curlfit.inference.model.parameters import START_NAMES
from curlfit.loads import Load
from curlfit.numerics.arrays import Floats
from curlfit.output.frames import frame
from curlfit.records import (
    ADDED,
    SERIES,
    Arrays,
    Entry,
    Names,
    OneOf,
    Record,
    require,
    require_rows,
)
from curlfit.sheet import TEE
from curlfit.stone import Stone
from curlfit.throws.odd_row import OddRow

PREDICTED = ("x", "y", "phi")
"""Predicted channels."""
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
"""Predicted quantities: meaning and unit by name. Curl is the distance of the resting
position from the line of delivery, the straight line along the initial velocity."""
OUTCOMES = {
    "on the button": "rests on the button or touches it",
    "in the house": "rests in the house or touches it",
    "short of the hog line": "does not cross the far hog line and is removed",
    "through the house": "passes the back line and is out of play",
}


_ALWAYS = ("rest_x", "rest_y", "curl", "turns", "time")
_AROUND = [f"_{level}" for level in LEVELS if level != "50"]
_SERIES = (
    "t",
    *PREDICTED,
    "speed",
    "omega",
    *(
        f"{name}{end}"
        for name in PREDICTED
        for end in ("_parameter_sd", "_model_sd", *_AROUND)
    ),
)
_BAND = ("y", "x", *(f"x{end}" for end in _AROUND))


@dataclass(frozen=True)
class Call:
    """A throw in curlers' terms.

    Attributes
    ----------
    labels : its group in a joint fit, such as the sheet.
    hog_to_hog : s between the hog lines, which gives the speed.
    broom : m to the right of the centre line at the far tee, where the stone is aimed
        from the hack.
    thrower : standard deviations of the time between hog lines in s, and of the aim at
        the broom in m.
    turn : "clockwise" or "counter-clockwise"; "in" and "out" as of a right-hander;
        "both" for one throw of each.

    Examples
    --------
    >>> call = curlfit.Call({"sheet": "2"}, hog_to_hog=12.75, broom=-0.9, turn="in")
    >>> call.broom
    -0.9
    """

    labels: dict[str, str] = field(default_factory=dict)
    hog_to_hog: float | None = None
    broom: float | None = None
    thrower: tuple[float, float] | None = None
    turn: str | None = None


CENTRED = Call()
"""Along the centre line, with the speed and spin of the fitted throw."""


@dataclass(frozen=True)
class Weight:
    """A stone that comes to rest on the centre line.

    Attributes
    ----------
    rests : the name of the place, and `y`, m beyond the far tee.
    hog_to_hog, hog_to_tee : s from the near hog line; the latter None if it
        stops short.
    brooms : m to the right of the centre line at the far tee, of a stone that turns
        clockwise and of one that turns counter-clockwise.
    """

    rests: str
    y: float
    hog_to_hog: float
    hog_to_tee: float | None
    brooms: tuple[float, float]


@dataclass(frozen=True)
class Quantity:
    """A predicted number.

    Attributes
    ----------
    value : for the best estimate; NaN where it has none (the throw does not
        reach the line).
    parameter_sd : standard deviation due to the errors of the parameters.
    model_sd : root mean square difference due to the model discrepancy.
    quantiles : with both errors, keys "2.5", "16", "50", "84", "97.5".
    share : fraction of the draws that have a value.
    """

    value: float
    unit: str
    parameter_sd: float
    model_sd: float
    quantiles: Quantiles
    share: float

    @property
    def sd(self) -> float:
        """Both errors added in quadrature."""
        return math.hypot(self.parameter_sd, self.model_sd)


@dataclass(frozen=True)
class HeldOut:
    """A prediction compared with measured rows that were not fitted.

    Attributes
    ----------
    file, first, last : the file of the rows, first and last time (s, on the clock
        of the data).
    channels : by channel "rows", "rms" of measured - predicted, "inside_68" and
        "inside_95" (share of rows within the bands, noise included), "end"
        (measured - predicted at the last row) and "end_sd" (standard deviation
        predicted for that difference).
    observed : t (s since the start) and the channels, on the sheet.
    """

    file: str
    first: float
    last: float
    channels: dict[str, dict[str, float]]
    observed: dict[str, Floats] = field(metadata=SERIES)


Origin = Literal["given", "call", "fitted", "default", "found"]
Source = Literal["chain", "covariance", "ridge", "throws"]
Covariance = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Start(Entry):
    """A component of the initial state.

    Attributes
    ----------
    value, unit : SI, rad.
    origin : where the value comes from; "found" is that which leads to a goal.
    """

    value: float
    unit: str
    origin: Origin


@dataclass(frozen=True)
class Goal(Entry):
    """Where the stone is to come to rest.

    Attributes
    ----------
    words : as it was asked for.
    x, y : m from the tee; x None where it is free.
    speed : m/s at that place.
    """

    words: str
    x: float | None
    y: float
    speed: float


@dataclass(frozen=True)
class Draws(Entry):
    """The draws of a prediction.

    Attributes
    ----------
    number, used : how many were asked for, and how many of these give a motion.
    source : of the parameters: "chain", "covariance", "ridge" where values that fit lie
        on a curve, or "throws" of a joint fit.
    seed : of the random numbers.
    """

    number: int
    used: int
    source: Source
    seed: int


@dataclass(frozen=True)
class RestingPlace(Entry):
    """Where the stone comes to rest.

    Attributes
    ----------
    mean : x and y, m.
    parameter, model, both : covariances, m^2, due to the errors of the parameters, to
        the model discrepancy (about zero), and to both.
    """

    mean: tuple[float, float]
    parameter: Covariance
    model: Covariance
    both: Covariance


@dataclass(frozen=True)
class Sensitivity(Entry):
    """How the resting place changes with a component of the initial state.

    Attributes
    ----------
    by : the change of the component, SI.
    right, along : the changes of the resting place, m.
    """

    by: float
    right: float
    along: float


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Prediction(Record):
    """A predicted throw. `save` writes it, `load_prediction` reads it.

    Attributes
    ----------
    law, load, stone, fit : of the fit, and how much of which file it is of.
    start : initial state, by name (x0 y0 heading v0 phi0 omega0).
    of : "fitted" for the fitted throw, extrapolated to rest, "new" for another one.
    line : the line on which it starts, "data" for the start of the data, "" for a
        given position.
    goal : where it is to come to rest; None if that was not asked for.
    draws : how many, and from what.
    call : the throw in curlers' terms, as asked for.
    command : that made it; empty if it was made in Python.
    odd_rows : of the tables of a joint fit, which were left out of it unless they are
        many.
    weights : what to throw for several places, on the ice of a joint fit.
    misfit : the model discrepancy; None where the throws of a joint fit
        contain its effect.
    series : t (s since the start) and x, y, phi, speed, omega of the best estimate; of
        x, y, phi also "x_parameter_sd", "x_model_sd" and the quantiles "x_2.5" ...
    band : x as a function of y: "y", "x" and "x_2.5" ..., up to the y that half of the
        draws reach.
    rest : where it comes to rest, with covariances.
    quantities : by name, see `QUANTITIES`.
    chances : fractions of the draws by outcome.
    sensitivity : how the resting position changes with a component of the initial
        state, by name of the component.
    warnings, notes : for the reader.
    other : the same throw with the other turn, where both were asked for.
    check : None, or the comparison with measured rows.
    measured : t (s since the start) and the measured channels of the fitted rows, on
        the sheet; for a new throw translated and rotated to its initial state.
    sample : the first draws, both errors included: "t" (s since the start, shape
        (times,)), "x", "y", "phi" (shape (draws, times)), constant after rest, and
        "rest", the time of rest, shape (draws,).

    Examples
    --------
    >>> prediction
    Prediction, it comes to rest after 24.3 s and 2.65 turns counter-clockwise, ...
    front-back law, uniform load, fitted to ...: the fitted throw, extrapolated to rest
    It curls 0.90 m (2.94 ft) to the left.
    2 warnings, see curlfit.print_prediction
    >>> prediction.to_frame().columns[:4].tolist()
    ['t', 'x', 'y', 'phi']
    """

    kind: ClassVar[str] = "predict"

    law: str
    load: Load
    stone: Stone
    fit: Extent
    start: Annotated[dict[str, Start], Names(START_NAMES)]
    of: Literal["fitted", "new"]
    line: str
    goal: Goal | None
    draws: Draws
    misfit: Discrepancy | None
    series: Annotated[dict[str, Floats], Names(_SERIES)] = field(metadata=SERIES)
    band: Annotated[dict[str, Floats], Names(_BAND)] = field(metadata=SERIES)
    rest: RestingPlace
    quantities: Annotated[
        dict[Annotated[str, OneOf(QUANTITIES)], Quantity], Names(_ALWAYS)
    ]
    chances: Annotated[dict[str, float], Names(OUTCOMES)]
    sensitivity: dict[str, Sensitivity]
    warnings: tuple[Finding, ...]
    notes: tuple[Finding, ...]
    call: Call = field(default_factory=Call)
    command: str = ""
    odd_rows: tuple[OddRow, ...] = field(default=(), metadata=ADDED)
    weights: tuple[Weight, ...] = ()
    other: Prediction | None = None
    check: HeldOut | None = None
    measured: dict[str, Floats] = field(default_factory=dict, metadata=SERIES)
    sample: Annotated[Arrays, Names(("t", *PREDICTED, "rest"))] = field(
        default_factory=dict, metadata=SERIES
    )

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        for name in ("series", "band", "start", "quantities", "chances"):
            require(name, bool(getattr(self, name)), "no empty object")
        for quantity in self.quantities.values():
            require("quantities", bool(quantity.quantiles), "quantiles of each")
        require_rows("series", self.series, len(self.series["t"]))
        require_rows("band", self.band, len(self.band["y"]))
        if self.measured:
            require("measured", {"t", "x", "y"} <= self.measured.keys(), "t, x and y")
            require_rows("measured", self.measured, len(self.measured["t"]))
        if self.sample:
            shapes = {self.sample[name].shape for name in PREDICTED}
            shape = (*self.sample["rest"].shape, *self.sample["t"].shape)
            require("sample", shapes == {shape}, f"arrays of the shape {shape}")

    def to_frame(self) -> Any:
        """The path with its bands as a pandas DataFrame, the columns of
        `series` (SI, rad).

        Raises
        ------
        InputError : pandas is not installed.
        """
        return frame(self.series)

    def table(self) -> str:
        """The path with its bands as CSV text, one row per time."""
        names = list(self.series)
        lines = [
            f"# {self.law} law fitted to {self.fit.file}, "
            + ("extrapolated to rest" if self.of == "fitted" else "another throw"),
            "# t in s since the start, lengths in m, angles in rad; x to the right of "
            f"the centre line, y from the hack thrown from (far tee at {TEE:.3f})",
            "# _parameter_sd: standard deviation; _model_sd: rms effect of the model "
            "discrepancy; _2.5 .. _97.5: percentiles including both",
            ",".join(names),
        ]
        for row in zip(*self.series.values(), strict=True):
            lines.append(",".join(f"{value:.9g}" for value in row))
        return "\n".join(lines) + "\n"


def load_prediction(file: str | PathLike[str]) -> Prediction:
    """Read a saved `predict.json`, or the one in a folder.

    Raises
    ------
    DataError : missing, not a prediction, or of a schema that this version cannot read.

    Examples
    --------
    >>> prediction.save("predict.json")
    >>> curlfit.load_prediction("predict.json").law
    'front-back'
    """
    return Prediction.read(file)


COMPONENT_LABELS = {
    "across": "across the path",
    "along": "along the path",
    "turning": "in the spin",
}
"""Components of missing accelerations: to the right of the velocity, along it,
and angular."""

DETECTION = 3.0
"""Standard deviations above which a missing acceleration is detected."""


@dataclass(frozen=True)
class Discrepancy:
    """Model discrepancy: accelerations that a law does not describe, by component.

    Attributes
    ----------
    sizes : posterior root mean square of the size, m/s^2 (rad/s^2 for "turning").
    span : time from the first fitted row to the last in which the stone moves, s.
    noise : independent noise by channel, SI; only channels with enough rows to
        estimate it.
    excess : significance of a missing acceleration in standard deviations (square root
        of twice the logarithm of the likelihood ratio); empty where no channel has
        enough rows.
    ceilings : upper limit of the prior, in the unit of `sizes`.
    friction : coefficient of friction mu from the mean deceleration of the fitted rows.
    """

    sizes: dict[str, float]
    span: float
    noise: dict[str, float]
    excess: dict[str, float]
    ceilings: dict[str, float] = field(default_factory=dict)
    friction: float = math.nan

    @property
    def estimated(self) -> bool:
        """Whether any channel had enough rows to estimate it."""
        return bool(self.excess)

    @property
    def detected(self) -> bool:
        """Whether the residuals show a missing acceleration."""
        return any(excess > DETECTION for excess in self.excess.values())
