"""Report of a prediction as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from curlfit.output.console import terminal
from curlfit.output.display import Overview
from curlfit.output.text import format_estimate, plain_table, sided
from curlfit.sheet import FOOT, STONE_RADIUS, TEE_TO_BACK

if TYPE_CHECKING:
    from curlfit.prediction.result import HeldOut, Prediction, Quantity

_LINES = {
    "hack": "at the hack", "back": "on the near back line", "tee": "on the near tee line",
    "hog": "on the near hog line", "centre": "in the middle of the sheet",
    "far-hog": "on the far hog line", "data": "at the start of the data",
    "": "at the given position",
}  # fmt: skip
_START = {
    "v0": "speed", "omega0": "spin", "heading": "heading", "x0": "x", "y0": "y", "phi0": "angle",
}  # fmt: skip
_CHANGES = {"v0": "m/s more speed", "heading": "rad of heading", "omega0": "rad/s more spin"}
_SIDES = ("right of", "left of")


def print_prediction(prediction: Prediction, console: Console | None = None) -> None:
    """Print the report of a prediction.

    Examples
    --------
    >>> curlfit.print_prediction(prediction)
    front-back law, uniform load, fitted to ...
    """
    console = console or terminal()
    console.print(report(prediction))


def report(prediction: Prediction) -> RenderableType:
    """The report of a prediction, for a rich console."""
    parts: list[RenderableType] = [_heading(prediction), _quantities(prediction)]
    parts += [Padding(Text(line), (0, 0, 1, 0)) for line in _sentences(prediction)]
    if prediction.check is not None:
        parts += [_check(prediction.check)]
    parts += [
        Padding(Text(f"Warning: {warning}.", style="yellow"), (0, 0, 1, 0))
        for warning in prediction.warnings
    ]
    parts += [Text(f"Note: {note}.", style="dim") for note in prediction.notes]
    return Group(*parts)


def overview(prediction: Prediction) -> Overview:
    """A prediction at a glance: where the stone comes to rest, the quantities and their errors."""
    rest, *others = _sentences(prediction)
    where, _, curl = rest.partition(". It ")
    title, start, *aim = _heading(prediction).plain.splitlines()[:-1]
    return Overview(
        where[:1].lower() + where[1:],
        title,
        [*aim, f"It {curl}"],
        [start, *aim, _quantities(prediction), f"It {curl}", *others],
        prediction.warnings,
    )


def describe_rest(prediction: Prediction) -> str:
    """Position and time of rest, as a sentence."""
    found = prediction.quantities
    curl, turns = found["curl"].value, found["turns"].value
    far = found["rest_y"].value > TEE_TO_BACK + STONE_RADIUS
    text = "On longer ice it would come to rest" if far else "It comes to rest"
    text += f" after {found['time'].value:.1f} s and {abs(turns):.2f} turns"
    text += " counter-clockwise" if turns > 0 else " clockwise" if turns < 0 else ""
    text += (
        f", {_off(found['rest_y'].value, ('beyond', 'before'))} the tee line and "
        f"{_off(found['rest_x'].value, _SIDES)} the centre line"
    )
    side = "right" if curl > 0 else "left"
    if abs(curl) < 0.005:
        return f"{text}. It does not curl."
    return f"{text}. It curls {abs(curl):.2f} m ({abs(curl) / FOOT:.2f} ft) to the {side}."


def _off(value: float, sides: tuple[str, str]) -> str:
    """A distance in words, such as "0.25 m left of", or "on"."""
    return "on" if abs(value) < 0.005 else f"{abs(value):.2f} m {sides[value < 0]}"


def _heading(prediction: Prediction) -> Text:
    text = Text()
    text.append(f"{prediction.law} law", style="bold")
    text.append(f", {prediction.load} load, fitted to {prediction.fit['file']}: ")
    text.append(
        "the fitted throw, extrapolated to rest\n"
        if prediction.of == "fitted"
        else "another throw on this ice\n"
    )
    text.append(f"It starts {_LINES[prediction.line]}: ")
    shown = []
    for name, label in _START.items():
        item = prediction.start[name]
        if name in ("x0", "y0", "phi0") and item["origin"] != "given":
            continue
        unit = item["unit"]
        shown.append(f"{label} {item['value']:.5g} {unit} ({item['origin']})")
    text.append(", ".join(shown) + "\n")
    goal = prediction.goal
    if goal is not None:
        text.append(_aim(prediction) + "\n", style="bold")
    draws = prediction.draws
    source = (
        "the chain" if draws["source"] == "chain" else "the covariance of the fit (there is no "
        "chain.h5): Gaussian along determined directions, uniform along the others"
    )  # fmt: skip
    text.append(f"Bands from {draws['used']} draws of {source}")
    return text


def _aim(prediction: Prediction) -> str:
    """Speed and heading found for the goal."""
    goal, start = prediction.goal or {}, prediction.start
    found = [f"{start['v0']['value']:.4f} m/s"]
    if start["heading"]["origin"] == "found":
        heading = start["heading"]["value"]
        side = "right" if heading > 0 else "left"
        found.append(
            f"a heading of {1000 * heading:.2f} mrad ({abs(math.degrees(heading)):.2f} degrees to "
            f"the {side})"
        )
    x, y = goal["x"], goal["y"]
    where = f"{_off(y, ('beyond', 'before'))} the tee line"
    if x is not None:
        where = "on the tee" if x == y == 0 else f"{where} and {_off(x, _SIDES)} the centre line"
    if goal["speed"] == 0:
        return f"With {' and '.join(found)} it comes to rest {where}"
    place = "the tee line" if x is None else "the tee"
    return f"With {' and '.join(found)} it passes {place} at {goal['speed']:g} m/s"


def _quantities(prediction: Prediction) -> RenderableType:
    from curlfit.prediction.result import QUANTITIES

    shown = prediction.quantities
    partly = any(item.share < 1 for item in shown.values())
    table = plain_table()
    table.add_column("", no_wrap=True)
    for head in ("best", "parameters", "model"):
        table.add_column(head, justify="right", no_wrap=True)
    for head in ("68 %", "95 %", *(["of draws"] if partly else [])):
        table.add_column(head, no_wrap=True)
    for name, item in shown.items():
        meaning, unit = QUANTITIES[name]
        meaning, sign = sided(meaning, item.value)
        share = "" if item.share == 1 else f"{100 * item.share:.3g} %"
        table.add_row(f"{meaning} ({unit})" if unit else meaning, *_row(item, sign), share)
    return Padding(table, (1, 0, 1, 0))


def _row(item: Quantity, sign: float) -> list[str]:
    """Best value, both errors, and the intervals, to two digits of the larger error."""
    size = max(item.parameter_sd, item.model_sd)
    digits = 4 if size < 1e-9 else min(len(format_estimate(0.0, size)[1].partition(".")[2]), 4)
    best = "-" if math.isnan(item.value) else f"{sign * item.value:.{digits}f}"
    own = [
        f"{part:.{digits + 1}f}" if part > 1e-9 else "-"
        for part in (item.parameter_sd, item.model_sd)
    ]
    ends = sorted(sign * value for value in item.quantiles.values())
    q = {level: f"{value:.{digits}f}" for level, value in zip(item.quantiles, ends, strict=True)}
    if size < 1e-9:
        return [best, *own, "", ""]
    return [best, *own, f"{q['16']} .. {q['84']}", f"{q['2.5']} .. {q['97.5']}"]


def _sentences(prediction: Prediction) -> list[str]:
    from curlfit.prediction.result import OUTCOMES

    found = [describe_rest(prediction)]
    likely = [
        f"in {100 * chance:.3g} % of the draws it {OUTCOMES[name]}"
        for name, chance in prediction.chances.items()
        if chance > 0
    ]
    if likely:
        text = "; ".join(likely)
        found.append(f"{text[0].upper()}{text[1:]}.")
    changes = []
    for name, words in _CHANGES.items():
        item = prediction.sensitivity.get(name)
        if item is None:
            continue
        along, right = item["along"], item["right"]
        moves = [
            f"{abs(size):.2g} m {sides[size < 0]}"
            for size, sides in ((along, ("farther", "shorter")), (right, ("right", "left")))
            if abs(size) >= 0.001
        ]
        changes.append(f"{item['by']:g} {words}: {', '.join(moves) or 'no change'}")
    if changes:
        found.append("Sensitivity of the resting position: " + "; ".join(changes) + ".")
    return found


def _check(check: HeldOut) -> RenderableType:
    table = plain_table()
    table.add_column("held out", no_wrap=True)
    for head in ("rows", "rms", "within 68 %", "within 95 %", "error at end", "std. dev."):
        table.add_column(head, justify="right", no_wrap=True)
    for name, item in check.channels.items():
        unit = "rad" if name == "phi" else "m"
        off, expected = format_estimate(item["end"], item["end_sd"])
        table.add_row(
            f"{name} ({unit})", f"{item['rows']:.0f}", f"{item['rms']:.3g}",
            f"{item['inside_68']:.0%}", f"{item['inside_95']:.0%}", off, expected,
        )  # fmt: skip
    remark = Text(
        f"Rows of {check.file} from t = {check.first:g} to {check.last:g} s were not fitted; "
        "the bands include noise. Differences within one throw are correlated: a path that is off "
        "by one standard deviation has hardly a row within 68 %."
    )
    return Group(table, Padding(remark, (1, 0, 1, 0)))
