"""What a prediction says."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Said, Section, show
from curlfit.output.text import labelled, rows_text, sided, stone_text
from curlfit.prediction.result import (
    OUTCOMES,
    QUANTITIES,
    HeldOut,
    Prediction,
    Quantity,
)
from curlfit.sheet import FOOT, STONE_RADIUS, TEE, TEE_TO_BACK
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
    "throws": "the throws of the joint fit, by Student's t",
    "chain": "the chain",
    "ridge": "the posterior, along the values that fit (there is no chain.h5)",
    "covariance": "the covariance of the fit (there is no chain.h5): Gaussian along "
    "determined directions, uniform along the others",
}
_STRAIGHT = 0.005
"""Curl in m, below which a path is called straight."""
_ACROSS = ("rest_x", "rest_to_tee", "curl")
"""Quantities that a law without a curl says nothing of."""
_ALONG = ("beyond", "before")
_SIDES = ("right of", "left of")


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
    fit, draws, check = prediction.fit, prediction.draws, prediction.check
    rest, curl = describe_rest(prediction)
    fitted = prediction.of == "fitted"
    what = (
        "the fitted throw, extrapolated to rest"
        if fitted
        else "another throw on this ice"
    )
    odd = odd_rows_in_words(prediction.odd_rows)
    aim = [] if prediction.goal is None else [_aim(prediction)]
    aim += [] if fitted else [_called(prediction)]
    source = _SOURCES[draws["source"]]
    return Document(
        finding=lower(rest).rstrip("."),
        subject=Text.assemble(
            (f"{prediction.law} law", "bold"),
            f", {prediction.load} load, fitted to {fit['file']}: {what}",
        ),
        about=(
            *map(Said, odd),
            _start(prediction),
            *(Said(line, style="bold") for line in aim),
            f"Bands from {draws['used']} draws of {source}",
        ),
        lines=[*odd, *aim, curl],
        sections=(
            Section(
                "predicted",
                "What is predicted",
                (
                    _quantities(prediction),
                    Said(f"{rest} {curl}"),
                    _outcomes(prediction),
                    _sensitivity(prediction),
                ),
            ),
            *([] if prediction.other is None else [_other(prediction.other)]),
            Section("weights", "Weights and brooms", (_weights(prediction),)),
            Section(
                "held-out",
                "Rows that were not fitted",
                _check(check) if check else (),
                brief=False,
            ),
        ),
        warnings=prediction.warnings,
        notes=prediction.notes,
        title=(
            f"{Path(fit['file']).name}: "
            f"{'the throw to rest' if fitted else 'another throw'}"
        ),
        settings={
            "Law, load": f"{prediction.law}, {prediction.load}",
            "Fit": f"{fit['file']}, {rows_text(fit)}",
            "Stone": stone_text(prediction.stone),
            "Start": ", ".join(
                f"{name} = {item['value']:.6g} {item['unit']} ({item['origin']})"
                for name, item in prediction.start.items()
            ),
            "Draws": f"{draws['used']} of {draws['number']}, seed {draws['seed']}",
        },
        command=prediction.command,
        names=prediction.start,
    )


def _other(prediction: Prediction) -> Section:
    """The same throw with the other turn."""
    rest, curl = describe_rest(prediction)
    turn = capital(f"{prediction.call.turn}-turn")
    said = f"{turn}: {lower(_called(prediction))} {rest} {curl} {_outcomes(prediction)}"
    return Section(
        "other", f"The {turn.lower()}", (_quantities(prediction), Said(said))
    )


def _knows_no_curl(prediction: Prediction) -> bool:
    """Whether it is of draws without a measured curl, whose law leaves it open: such a
    law goes straight on, and no stone does."""
    curl = prediction.quantities["curl"].value
    return prediction.draws["source"] == "throws" and abs(curl) < _STRAIGHT


def describe_rest(prediction: Prediction) -> tuple[str, str]:
    """Position and time of rest, and the curl, as a sentence each."""
    found = prediction.quantities
    curl, turns = found["curl"].value, found["turns"].value
    far = found["rest_y"].value > TEE_TO_BACK + STONE_RADIUS
    text = "On longer ice it would come to rest" if far else "It comes to rest"
    text += f" after {found['time'].value:.1f} s and {abs(turns):.2f} turns"
    text += " counter-clockwise" if turns > 0 else " clockwise" if turns < 0 else ""
    text += f", {_off(found['rest_y'].value, _ALONG)} the tee line"
    if _knows_no_curl(prediction):
        return f"{text}.", f"The {prediction.law} law says nothing of its curl."
    text += f" and {_off(found['rest_x'].value, _SIDES)} the centre line."
    side = "right" if curl > 0 else "left"
    if abs(curl) < _STRAIGHT:
        return text, "It does not curl."
    return (
        text,
        f"It curls {abs(curl):.2f} m ({abs(curl) / FOOT:.2f} ft) to the {side}.",
    )


def _off(value: float, sides: tuple[str, str]) -> str:
    """A distance in words, such as "0.25 m left of", or "on"."""
    return "on" if abs(value) < 0.005 else f"{abs(value):.2f} m {sides[value < 0]}"


def _start(prediction: Prediction) -> str:
    """Where and how the throw starts."""
    shown = [
        f"{label} {item['value']:.5g} {item['unit']} ({item['origin']})"
        for name, label in _START.items()
        if (item := prediction.start[name])["origin"] == "given" or name not in _PLACE
    ]
    return f"It starts {_LINES[prediction.line]}: {', '.join(shown)}"


def _aim(prediction: Prediction) -> str:
    """Speed and heading found for the goal."""
    goal, start = prediction.goal or {}, prediction.start
    found = f"{start['v0']['value']:.4f} m/s"
    if start["heading"]["origin"] == "found":
        heading = start["heading"]["value"]
        found += (
            f" and a heading of {1000 * heading:.2f} mrad "
            f"({abs(math.degrees(heading)):.2f} degrees to the "
            f"{'right' if heading > 0 else 'left'})"
        )
    x, y = goal["x"], goal["y"]
    place = "the tee line" if x is None else "the tee"
    if goal["speed"]:
        return f"With {found} it passes {place} at {goal['speed']:g} m/s"
    if x or y:
        across = "" if x is None else f" and {_off(x, _SIDES)} the centre line"
        return f"With {found} it comes to rest {_off(y, _ALONG)} the tee line{across}"
    return f"With {found} it comes to rest on {place}"


def _called(prediction: Prediction) -> str:
    """The throw in curlers' terms."""
    start = {name: item["value"] for name, item in prediction.start.items()}
    broom = start["x0"] + math.tan(start["heading"]) * (TEE - start["y0"])
    found = [f"{name} {label}" for name, label in prediction.call.labels.items()]
    if "hog_to_hog" in prediction.quantities:
        found.append(f"{prediction.quantities['hog_to_hog'].value:.2f} s hog to hog")
    if not _knows_no_curl(prediction):
        aimed = _broom(broom).replace(" in ", " in to the ")
        place = f"{aimed} of" if aimed else "on"
        found.append(f"broom {place} the centre line at the tee")
    text = ", ".join(found)
    return f"{capital(text)}."


def _weights(prediction: Prediction) -> PlainTable:
    return PlainTable(
        [
            {
                "rests": f"{one.rests}, {_off(one.y, _ALONG)} the tee"
                if one.y
                else "tee",
                ">hog to hog (s)": f"{one.hog_to_hog:.2f}",
                ">hog to tee (s)": ""
                if one.hog_to_tee is None
                else f"{one.hog_to_tee:.2f}",
                "broom, in-turn": _broom(one.brooms[0]),
                "broom, out-turn": _broom(one.brooms[1]),
            }
            for one in prediction.weights
        ],
        "Weights and brooms, at the far tee; turns of a right-hander",
    )


def _broom(place: float) -> str:
    """A place across the sheet in feet and inches, such as "3 ft 1 in left"."""
    inches = round(abs(place) / FOOT * 12)
    side = "right" if place > 0 else "left"
    return f"{inches // 12} ft {inches % 12} in {side}" if inches else ""


def _quantities(prediction: Prediction) -> PlainTable:
    rows, both = [], prediction.misfit is not None
    unknown = _ACROSS if _knows_no_curl(prediction) else ()
    for name, item in prediction.quantities.items():
        if name in unknown:
            continue
        meaning, unit = QUANTITIES[name]
        meaning, sign = sided(meaning, item.value)
        share = "" if item.share == 1 else f"{100 * item.share:.3g} %"
        rows.append(
            {"": labelled(meaning, unit), **_row(item, sign, both), "of draws": share}
        )
    errors = (
        "standard deviations by the errors of the parameters and by the "
        "model discrepancy"
    )
    return PlainTable(
        rows,
        "Predicted quantities: best estimate, "
        + (
            f"{errors}, intervals by both"
            if both
            else "standard deviation and intervals"
        ),
    )


def _row(item: Quantity, sign: float, both: bool) -> dict[str, str]:
    """Best value, both errors or the one of a joint fit, and the intervals, to two
    digits of the larger error."""
    size = max(item.parameter_sd, item.model_sd)
    known = size >= 1e-9
    digits = min(decimals(size), 4)
    own, model = (
        f"{part:.{digits + 1}f}" if part > 1e-9 else "-"
        for part in (item.parameter_sd, item.model_sd)
    )
    ends = sorted(sign * value for value in item.quantiles.values())
    q = {
        level: f"{value:.{digits}f}"
        for level, value in zip(item.quantiles, ends, strict=True)
    }
    return {
        ">best": "-" if math.isnan(item.value) else f"{sign * item.value:.{digits}f}",
        **({">parameters": own, ">model": model} if both else {">std. dev.": own}),
        "68 %": f"{q['16']} .. {q['84']}" * known,
        "95 %": f"{q['2.5']} .. {q['97.5']}" * known,
    }


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
        if (item := prediction.sensitivity.get(name)) is None:
            continue
        moves = [
            f"{abs(size):.2g} m {sides[size < 0]}"
            for size, sides in (
                (item["along"], ("farther", "shorter")),
                (item["right"], ("right", "left")),
            )
            if abs(size) >= 0.001
        ]
        changes.append(f"{item['by']:.3g} {words}: {', '.join(moves) or 'no change'}")
    return (
        f"Sensitivity of the resting position: {'; '.join(changes)}." if changes else ""
    )


def _check(check: HeldOut) -> tuple[PlainTable, str]:
    rows: list[dict[str, Any]] = []
    for name, item in check.channels.items():
        off, expected = format_estimate(item["end"], item["end_sd"])
        rows.append(
            {
                "held out": f"{name} ({'rad' if name == 'phi' else 'm'})",
                ">rows": f"{item['rows']:.0f}",
                ">rms": f"{item['rms']:.3g}",
                ">within 68 %": f"{item['inside_68']:.0%}",
                ">within 95 %": f"{item['inside_95']:.0%}",
                ">error at end": off,
                ">std. dev.": expected,
            }
        )
    remark = (
        f"Rows of {check.file} from t = {check.first:g} to {check.last:g} s were "
        "not fitted; the bands include noise. Differences within one throw are "
        "correlated: a path that is off by one standard deviation has hardly a "
        "row within 68 %."
    )
    return PlainTable(rows, "Rows that were not fitted"), remark
