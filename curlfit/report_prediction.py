"""What a prediction says, as text. Nothing is computed here."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from curlfit.report import number, plain_table
from curlfit.sheet import FOOT

if TYPE_CHECKING:
    from curlfit.prediction import HeldOut, Prediction, Quantity

_LINES = {
    "hack": "at the hack", "back": "on the near back line", "tee": "on the near tee line",
    "hog": "on the near hog line", "centre": "in the middle of the sheet",
    "far-hog": "on the far hog line", "data": "where the data do", "": "where it was told to",
}  # fmt: skip
_START = {
    "v0": "speed", "omega0": "spin", "heading": "heading", "x0": "x", "y0": "y", "phi0": "angle",
}  # fmt: skip
_CHANGES = {"v0": "m/s more speed", "heading": "rad of heading", "omega0": "rad/s more spin"}
_ON_SHEET = {
    "rest_x", "rest_y", "rest_to_tee", "hog_to_hog", "hog_to_tee", "hog_to_rest", "speed_at_hog",
    "speed_at_far_hog", "speed_at_tee",
}  # fmt: skip


def print_prediction(prediction: Prediction, console: Console | None = None) -> None:
    """Print the report of a prediction."""
    console = console or Console()
    console.print(report(prediction))


def report(prediction: Prediction) -> RenderableType:
    """The report of a prediction, for a rich console."""
    parts: list[RenderableType] = [_heading(prediction), _quantities(prediction)]
    parts += [Padding(Text(line), (0, 0, 1, 0)) for line in _sentences(prediction)]
    if prediction.check is not None:
        parts += [_check(prediction.check)]
    parts += [
        Padding(Text(f"Mind: {note}.", style="yellow"), (0, 0, 1, 0)) for note in prediction.notes
    ]
    return Group(*parts)


def in_words(prediction: Prediction) -> str:
    """Where and when the stone comes to rest, as a sentence."""
    found = prediction.quantities
    curl, turns = found["curl"].value, found["turns"].value
    text = f"It comes to rest after {found['time'].value:.1f} s and {abs(turns):.2f} turns"
    text += "" if turns == 0 else " counter-clockwise" if turns > 0 else " clockwise"
    if prediction.line != "data":
        x, y = found["rest_x"].value, found["rest_y"].value
        text += (
            f", {_distance(y)} {'beyond' if y > 0 else 'before'} the tee line and "
            f"{_distance(x)} {'right' if x > 0 else 'left'} of the centre line"
        )
    text += (
        f". It curls {abs(curl):.2f} m ({abs(curl) / FOOT:.2f} ft) to the "
        f"{'right' if curl > 0 else 'left'}."
    )
    return text


def _distance(value: float) -> str:
    return f"{abs(value):.2f} m"


def _heading(prediction: Prediction) -> RenderableType:
    text = Text()
    text.append(f"{prediction.law} law", style="bold")
    text.append(f", {prediction.load} load, fitted to {prediction.fit['file']}: ")
    text.append(
        "the fitted throw carried to rest\n"
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
        "chain.h5): Gaussian along what is determined, even along what is not"
    )  # fmt: skip
    text.append(f"Bands from {draws['used']} draws of {source}")
    return text


def _aim(prediction: Prediction) -> str:
    """What was found to meet the goal."""
    goal, start = prediction.goal or {}, prediction.start
    found = [f"{start['v0']['value']:.4f} m/s"]
    if start["heading"]["origin"] == "found":
        heading = start["heading"]["value"]
        side = "right" if heading > 0 else "left"
        found.append(
            f"a heading of {1000 * heading:.2f} mrad ({abs(math.degrees(heading)):.2f} degrees to "
            f"the {side})"
        )
    where = "on the centre line" if goal["x"] in (0, 0.0) else f"at x = {goal['x']} m"
    if goal["x"] is None:
        where = "wherever that is across"
    height = (
        "on the tee line" if goal["y"] == 0
        else f"{abs(goal['y']):.3f} m {'beyond' if goal['y'] > 0 else 'before'} the tee line"
    )  # fmt: skip
    what = "comes to rest" if goal["speed"] == 0 else f"passes with {goal['speed']:g} m/s"
    return f"With {' and '.join(found)} it {what} {height}, {where}"


def _quantities(prediction: Prediction) -> RenderableType:
    from curlfit.prediction import QUANTITIES

    table = plain_table()
    table.add_column("", no_wrap=True)
    for head in ("best", "parameters", "law"):
        table.add_column(head, justify="right", no_wrap=True)
    for head in ("68 %", "95 %"):
        table.add_column(head, no_wrap=True)
    for name, item in prediction.quantities.items():
        if prediction.line == "data" and name in _ON_SHEET:
            continue
        meaning, unit = QUANTITIES[name]
        table.add_row(f"{meaning} ({unit})", *_row(item))
    return Padding(table, (1, 0, 1, 0))


def _row(item: Quantity) -> list[str]:
    sizes = [size for size in (item.parameter_sd, item.model_sd) if size > 0]
    least = max(sizes, default=0.0) or None
    digits = 3 if least is None else len(number(0.0, least)[1].partition(".")[2])
    digits = min(max(digits, 1), 6)
    best = "-" if math.isnan(item.value) else f"{item.value:.{digits}f}"
    q = {level: f"{value:.{digits}f}" for level, value in item.quantiles.items()}
    own = [f"{size:.{digits}f}" if size > 0 else "-" for size in (item.parameter_sd, item.model_sd)]
    share = "" if item.share > 0.999 else f"  ({item.share:.0%} of the draws)"
    return [best, *own, f"{q['16']} .. {q['84']}", f"{q['2.5']} .. {q['97.5']}{share}"]


def _sentences(prediction: Prediction) -> list[str]:
    from curlfit.prediction import CHANCES

    found = [in_words(prediction)]
    if prediction.line != "data":
        likely = [
            f"{chance:.1%} of the draws: {CHANCES[name]}"
            for name, chance in prediction.chances.items()
            if chance > 0
        ]
        if likely:
            found.append("; ".join(likely) + ".")
    changes = []
    for name, words in _CHANGES.items():
        item = prediction.sensitivity.get(name)
        if item is None:
            continue
        along, right = item["along"], item["right"]
        changes.append(
            f"{item['by']:g} {words}: {abs(along):.2f} m {'farther' if along > 0 else 'shorter'}, "
            f"{abs(right):.3f} m {'right' if right > 0 else 'left'}"
        )
    if changes:
        found.append("What changes the place: " + "; ".join(changes) + ".")
    return found


def _check(check: HeldOut) -> RenderableType:
    table = plain_table()
    table.add_column("held out", no_wrap=True)
    for head in ("rows", "rms", "within 68 %", "within 95 %", "last row off", "expected"):
        table.add_column(head, justify="right", no_wrap=True)
    for name, item in check.channels.items():
        unit = "rad" if name == "phi" else "m"
        off, expected = number(item["end"], item["end_sd"])
        table.add_row(
            f"{name} ({unit})", f"{item['rows']:.0f}", f"{item['rms']:.3g}",
            f"{item['inside_68']:.0%}", f"{item['inside_95']:.0%}", off, expected,
        )  # fmt: skip
    said = Text(
        f"Rows of {check.file} from t = {check.first:g} to {check.last:g} s, which the fit had not "
        "seen, noise included in the bands. Rows of one throw go together: a path that is off by "
        "one standard deviation has hardly a row within 68 %."
    )
    return Group(table, Padding(said, (1, 0, 1, 0)))
