"""What a prediction says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.text import Text

from curlfit.output.document import Document, Said, Section, show
from curlfit.output.table import Column, Table
from curlfit.output.text import labelled, sided, stone_text
from curlfit.prediction.result import (
    OUTCOMES,
    QUANTITIES,
    Goal,
    HeldOut,
    Prediction,
    Quantity,
    Weight,
)
from curlfit.sheet import FOOT, STONE_RADIUS, TEE, TEE_TO_BACK
from curlfit.throws.channels import UNITS
from curlfit.throws.odd_row import odd_rows_in_words
from curlfit.wording import capital, decimals, format_estimate, lower

_LINES = {
    "hack": "at the hack",
    "back": "on the near back line",
    "tee": "on the near tee line",
    "hog": "on the near hog line",
    "centre": "in the middle of the sheet",
    "far-hog": "on the far hog line",
    "data": "at the start of the data",
    "": "at the given position",
}
_START = {
    "v0": "speed",
    "omega0": "spin",
    "heading": "heading",
    "x0": "x",
    "y0": "y",
    "phi0": "angle",
}
_PLACE = ("x0", "y0", "phi0")
_CHANGES = {
    "v0": "m/s more speed",
    "heading": "rad of heading",
    "omega0": "rad/s more spin",
    "hog_to_hog": "s longer hog to hog",
    "broom": "m (1 ft) of broom to the right",
}
_SOURCES = {
    "throws": "the throws of the joint fit",
    "chain": "the chain",
    "ridge": "the posterior, along the values that fit (there is no chain.h5)",
    "covariance": "the covariance of the fit (there is no chain.h5): Gaussian along "
    "determined directions, uniform along the others",
}
_STRAIGHT = 0.005
"""Curl in m, below which a path is called straight."""
_ON = 0.005
"""Distance in m, below which a stone is on a line: it rounds to 0.00 m."""
_NO_CHANGE = 0.001
"""Change of the resting position in m that is not told."""
_ACROSS = ("rest_x", "rest_to_tee", "curl")
"""Quantities that a law without a curl says nothing of."""
_ALONG = ("beyond", "before")
_SIDES = ("right of", "left of")
_NO_ERROR = 1e-9
"""Standard deviation, in the unit of the quantity, below which there is none."""


def print_prediction(prediction: Prediction, console: Console | None = None) -> None:
    """Print the report of a prediction.

    Examples
    --------
    >>> curlfit.print_prediction(prediction)
    front-back law, uniform load, fitted to ...
    """
    show(document(prediction), console)


def document(prediction: Prediction) -> Document:
    """Where the stone comes to rest, the quantities and their errors."""
    fit = prediction.fit
    draws = prediction.draws
    rest, curl = describe_rest(prediction)
    odd = odd_rows_in_words(prediction.odd_rows)
    aim = []
    if prediction.goal is not None:
        aim.append(_aim(prediction, prediction.goal))
    if prediction.of == "fitted":
        throw = "the fitted throw, extrapolated to rest"
        title = "the throw to rest"
    else:
        throw = "another throw on this ice"
        title = "another throw"
        aim.append(_called(prediction))
    predicted = Section(
        "predicted",
        "What is predicted",
        (
            _quantities(prediction),
            Said(f"{rest} {curl}"),
            _outcomes(prediction),
            _sensitivity(prediction),
        ),
    )
    sections = [predicted]
    if prediction.other is not None:
        sections.append(_other(prediction.other))
    sections.append(Section("weights", "Weights and brooms", (_weights(prediction),)))
    held_out = () if prediction.check is None else _check(prediction.check)
    sections.append(
        Section("held-out", "Rows that were not fitted", held_out, brief=False)
    )
    return Document(
        finding=lower(rest).rstrip("."),
        subject=Text.assemble(
            (f"{prediction.law} law", "bold"),
            f", {prediction.load} load, fitted to {fit.file}: {throw}",
        ),
        about=(
            *map(Said, odd),
            _start(prediction),
            *(Said(line, style="bold") for line in aim),
            f"Bands from {draws.used} draws of {_SOURCES[draws.source]}",
        ),
        lines=[*odd, *aim, curl],
        sections=sections,
        warnings=prediction.warnings,
        notes=prediction.notes,
        title=f"{Path(fit.file).name}: {title}",
        settings={
            "Law, load": f"{prediction.law}, {prediction.load}",
            "Fit": f"{fit.file}, {fit.in_words}",
            "Stone": stone_text(prediction.stone),
            "Start": ", ".join(
                f"{name} = {component.value:.6g} {component.unit} ({component.origin})"
                for name, component in prediction.start.items()
            ),
            "Draws": f"{draws.used} of {draws.number}, seed {draws.seed}",
        },
        command=prediction.command,
        names=prediction.start,
    )


def _other(prediction: Prediction) -> Section:
    """The prediction of the throw with the other turn."""
    rest, curl = describe_rest(prediction)
    turn = capital(f"{prediction.call.turn}-turn")
    called = lower(_called(prediction))
    text = Said(f"{turn}: {called} {rest} {curl} {_outcomes(prediction)}")
    return Section("other", f"The {turn.lower()}", (_quantities(prediction), text))


def _knows_no_curl(prediction: Prediction) -> bool:
    """Whether it is of draws without a measured curl, whose law leaves it open: such a
    law goes straight on, and no stone does."""
    curl = prediction.quantities["curl"].value
    return prediction.draws.source == "throws" and abs(curl) < _STRAIGHT


def describe_rest(prediction: Prediction) -> tuple[str, str]:
    """Position and time of rest, and the curl, as a sentence each."""
    quantities = prediction.quantities
    x = quantities["rest_x"].value
    y = quantities["rest_y"].value
    curl = quantities["curl"].value
    turns = quantities["turns"].value
    off_ice = y > TEE_TO_BACK + STONE_RADIUS
    rest = "On longer ice it would come to rest" if off_ice else "It comes to rest"
    rest += f" after {quantities['time'].value:.1f} s and {abs(turns):.2f} turns"
    if turns > 0:
        rest += " counter-clockwise"
    elif turns < 0:
        rest += " clockwise"
    rest += f", {_offset(y, _ALONG)} the tee line"
    if _knows_no_curl(prediction):
        return f"{rest}.", f"The {prediction.law} law says nothing of its curl."
    rest += f" and {_offset(x, _SIDES)} the centre line."
    if abs(curl) < _STRAIGHT:
        return rest, "It does not curl."
    size = f"{abs(curl):.2f} m ({abs(curl) / FOOT:.2f} ft)"
    return rest, f"It curls {size} to the {_side(curl)}."


def _offset(distance: float, sides: tuple[str, str]) -> str:
    """A distance in words, such as "0.25 m left of", or "on"; in m, positive and
    negative to either side."""
    if abs(distance) < _ON:
        return "on"
    positive, negative = sides
    return f"{abs(distance):.2f} m {negative if distance < 0 else positive}"


def _start(prediction: Prediction) -> str:
    """Where and how the throw starts."""
    components = []
    for name, label in _START.items():
        component = prediction.start[name]
        origin = component.origin
        if origin == "given" or name not in _PLACE:
            value = f"{component.value:.5g} {component.unit}"
            components.append(f"{label} {value} ({origin})")
    return f"It starts {_LINES[prediction.line]}: {', '.join(components)}"


def _aim(prediction: Prediction, goal: Goal) -> str:
    """Speed and heading that were solved for, and the goal that they reach."""
    start = prediction.start
    aim = f"With {start['v0'].value:.4f} m/s"
    if start["heading"].origin == "found":
        heading = start["heading"].value
        aim += (
            f" and a heading of {1000 * heading:.2f} mrad "
            f"({abs(math.degrees(heading)):.2f} degrees to the {_side(heading)})"
        )
    x = goal.x
    y = goal.y
    tee = "the tee line" if x is None else "the tee"
    if goal.speed:
        return f"{aim} it passes {tee} at {goal.speed:g} m/s"
    if x or y:
        across = "" if x is None else f" and {_offset(x, _SIDES)} the centre line"
        return f"{aim} it comes to rest {_offset(y, _ALONG)} the tee line{across}"
    return f"{aim} it comes to rest on {tee}"


def _called(prediction: Prediction) -> str:
    """The throw in curlers' terms."""
    start = {name: component.value for name, component in prediction.start.items()}
    broom = start["x0"] + math.tan(start["heading"]) * (TEE - start["y0"])
    words = [f"{label} {name}" for label, name in prediction.call.labels.items()]
    if "hog_to_hog" in prediction.quantities:
        words.append(f"{prediction.quantities['hog_to_hog'].value:.2f} s hog to hog")
    if not _knows_no_curl(prediction):
        distance = _feet_and_inches(broom)
        position = f"{distance} to the {_side(broom)} of" if distance else "on"
        words.append(f"broom {position} the centre line at the tee")
    return f"{capital(', '.join(words))}."


def _resting_place(weight: Weight) -> str:
    """Where a stone of a weight rests."""
    if not weight.y:
        return "tee"
    return f"{weight.rests}, {_offset(weight.y, _ALONG)} the tee"


def _broom(x: float) -> str:
    """A position across the sheet, such as "3 ft 1 in left"; empty on the centre
    line."""
    distance = _feet_and_inches(x)
    return f"{distance} {_side(x)}" if distance else ""


def _feet_and_inches(x: float) -> str:
    """The size of a distance in m, such as "3 ft 1 in"; empty below half an inch."""
    inches = round(abs(x) / FOOT * 12)
    return f"{inches // 12} ft {inches % 12} in" if inches else ""


def _side(x: float) -> str:
    """The side on which a position or turn is, positive to the right."""
    return "right" if x > 0 else "left"


_WEIGHT_COLUMNS: tuple[Column[Weight], ...] = (
    Column("rests", _resting_place),
    Column("hog to hog", format=".2f", unit="s", right=True, key="hog_to_hog"),
    Column(
        "hog to tee", format=".2f", unit="s", missing="", right=True, key="hog_to_tee"
    ),
    Column("broom, in-turn", lambda weight: weight.brooms[0], _broom),
    Column("broom, out-turn", lambda weight: weight.brooms[1], _broom),
)


def _weights(prediction: Prediction) -> Table[Weight]:
    """What to throw for places from guard to hack."""
    return Table(
        prediction.weights,
        _WEIGHT_COLUMNS,
        "Weights and brooms, at the far tee; turns of a right-hander",
    )


@dataclass(frozen=True)
class _PredictedRow:
    """A predicted quantity in words.

    Attributes
    ----------
    meaning : of the side on which the quantity lies.
    sign : -1 where the words are of the other side, else 1.
    """

    meaning: str
    unit: str
    sign: float
    quantity: Quantity

    @classmethod
    def of(cls, name: str, quantity: Quantity) -> _PredictedRow:
        """The row of a quantity."""
        meaning, unit = QUANTITIES[name]
        meaning, sign = sided(meaning, quantity.value)
        return cls(meaning, unit, sign, quantity)

    @property
    def size(self) -> float:
        """The larger error, to two digits of which all numbers are rounded."""
        return max(self.quantity.parameter_sd, self.quantity.model_sd)

    @property
    def digits(self) -> int:
        """Decimal places of the numbers."""
        return min(decimals(self.size), 4)

    def best(self) -> str:
        """The best estimate."""
        best = self.sign * self.quantity.value
        return "-" if math.isnan(best) else f"{best:.{self.digits}f}"

    def error(self, sd: float) -> str:
        """An error, with a digit more."""
        return f"{sd:.{self.digits + 1}f}" if sd > _NO_ERROR else "-"

    def interval(self, low: str, high: str) -> str:
        """The interval between two quantiles; empty without an error."""
        if self.size < _NO_ERROR:
            return ""
        # increasing, as the quantiles of the other side are in reverse
        ends = sorted(self.sign * value for value in self.quantity.quantiles.values())
        end = dict(zip(self.quantity.quantiles, ends, strict=True))
        return f"{end[low]:.{self.digits}f} .. {end[high]:.{self.digits}f}"


def _quantities(prediction: Prediction) -> Table[_PredictedRow]:
    """The predicted quantities with their errors; a joint fit has one error."""
    has_model_error = prediction.misfit is not None
    unknown = _ACROSS if _knows_no_curl(prediction) else ()
    rows = [
        _PredictedRow.of(name, quantity)
        for name, quantity in prediction.quantities.items()
        if name not in unknown
    ]
    parameter_error: Column[_PredictedRow] = Column(
        "parameters" if has_model_error else "std. dev.",
        lambda row: row.error(row.quantity.parameter_sd),
        right=True,
    )
    model_error: Column[_PredictedRow] = Column(
        "model", lambda row: row.error(row.quantity.model_sd), right=True
    )
    errors = "standard deviation and intervals"
    if has_model_error:
        errors = (
            "standard deviations by the errors of the parameters and by the "
            "model discrepancy, intervals by both"
        )
    columns: list[Column[_PredictedRow]] = [
        Column("", lambda row: labelled(row.meaning, row.unit)),
        Column("best", lambda row: row.best(), right=True),
        parameter_error,
        *([model_error] if has_model_error else []),
        Column("68 %", lambda row: row.interval("16", "84")),
        Column("95 %", lambda row: row.interval("2.5", "97.5")),
        Column("of draws", lambda row: row.quantity.share, _part_of_draws),
    ]
    return Table(rows, columns, f"Predicted quantities: best estimate, {errors}")


def _part_of_draws(share: float) -> str:
    """The draws that have a quantity, unless all have it."""
    return "" if share == 1 else f"{100 * share:.3g} %"


def _outcomes(prediction: Prediction) -> str:
    if _knows_no_curl(prediction):
        return ""
    likely = [
        f"in {100 * chance:.3g} % of the draws it {OUTCOMES[name]}"
        for name, chance in prediction.chances.items()
        if chance > 0
    ]
    text = "; ".join(likely)
    return f"{capital(text)}." if text else ""


def _sensitivity(prediction: Prediction) -> str:
    changes = []
    for name, words in _CHANGES.items():
        effect = prediction.sensitivity.get(name)
        if effect is None:
            continue
        along = effect.along
        right = effect.right
        moves = []
        if abs(along) >= _NO_CHANGE:
            way = "shorter" if along < 0 else "farther"
            moves.append(f"{abs(along):.2g} m {way}")
        if abs(right) >= _NO_CHANGE:
            moves.append(f"{abs(right):.2g} m {_side(right)}")
        changes.append(f"{effect.by:.3g} {words}: {', '.join(moves) or 'no change'}")
    if not changes:
        return ""
    return f"Sensitivity of the resting position: {'; '.join(changes)}."


class _HeldOutRow(NamedTuple):
    """A channel of the rows that were not fitted, with its entry in
    `HeldOut.channels`."""

    name: str
    numbers: dict[str, float]


_CHECK_COLUMNS: tuple[Column[_HeldOutRow], ...] = (
    Column("held out", lambda row: f"{row.name} ({UNITS[row.name]})"),
    Column("rows", lambda row: row.numbers["rows"], ".0f", right=True),
    Column("rms", lambda row: row.numbers["rms"], ".3g", right=True),
    Column("within 68 %", lambda row: row.numbers["inside_68"], ".0%", right=True),
    Column("within 95 %", lambda row: row.numbers["inside_95"], ".0%", right=True),
    Column(
        "error at end",
        lambda row: row.numbers["end"],
        words=lambda row: format_estimate(row.numbers["end"], row.numbers["end_sd"])[0],
        right=True,
    ),
    Column(
        "std. dev.",
        lambda row: row.numbers["end_sd"],
        words=lambda row: format_estimate(row.numbers["end"], row.numbers["end_sd"])[1],
        right=True,
    ),
)


def _check(check: HeldOut) -> tuple[Table[_HeldOutRow], str]:
    """The comparison with rows that were not fitted, and what it is worth."""
    rows = [_HeldOutRow(name, channel) for name, channel in check.channels.items()]
    remark = (
        f"Rows of {check.file} from t = {check.first:g} to {check.last:g} s were "
        "not fitted; the bands include noise. Differences within one throw are "
        "correlated: a path that is off by one standard deviation has hardly a "
        "row within 68 %."
    )
    return Table(rows, _CHECK_COLUMNS, "Rows that were not fitted"), remark
