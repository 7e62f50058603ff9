"""Sliders for the parameters of a fit: a page that needs neither network nor Python,
and its place in a notebook."""

from __future__ import annotations

import math
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.html_report.blocks import Block
from curlfit.html_report.direction import HEIGHT, WIDTH, Drawing, size_in_words
from curlfit.html_report.page import page_alone
from curlfit.html_report.replay import rounded
from curlfit.html_report.slider_curves import (
    HALF,
    INTERVALS,
    REACH,
    TRIALS,
    WHOLE,
    Slider,
    SliderCurves,
)
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.numerics.arrays import Floats
from curlfit.output.figures import some_rows
from curlfit.throws.throw import UNITS
from curlfit.wording import join_words

_ID = "sliders"
_POSITIONS = 250  # of a slider, from the fit to either end
_POINTS = 200  # of the data in the drawing
_PANEL = 90.0  # height of the residuals of a channel
_UNIT = 1e-5  # m, rad, m/s, rad/s: in which changes are written in the page
_FRAME = 540  # pixels of the frame in a notebook, but for residuals and sliders
_PER_CHANNEL = 130  # of it for the residuals of a channel
_PER_SLIDER = 42


class Explorer:
    """The sliders of `explore`, shown in a notebook.

    Attributes
    ----------
    fit : whose curves move.
    page : the whole as an HTML page of its own.
    errors : largest errors of the curves by measured channel (SI, rad), with all
        sliders at once half the way to their ends (0.5), and at their ends (1.0).
    """

    def __init__(self, fit: FitResult) -> None:
        self.fit = fit
        curves = SliderCurves(fit)
        if not curves.sliders:
            raise InputError("no parameter of this fit can be moved within its bounds")
        self.errors = {reach: curves.errors(reach) for reach in (HALF, WHOLE)}
        drawing = _drawing(curves)
        block = Block("sliders", _shown(curves, self.errors))
        title = f"Sliders of a fit to {Path(fit.data.file).name}"
        data = {_ID: _data(curves, drawing)}
        self.page = page_alone(title, block, data, ("moving.js", "sliders.js"))
        height = _FRAME + _PER_CHANNEL * len(fit.rms)
        self._height = height + _PER_SLIDER * len(curves.sliders)

    def __repr__(self) -> str:
        return f"Explorer of a fit of the {self.fit.law} law to {self.fit.data.file}"

    def _repr_html_(self) -> str:
        """The page in a frame: neither its style nor its ids meet those of the
        notebook, and its script reaches nothing around it."""
        return (
            f'<iframe srcdoc="{escape(self.page)}" sandbox="allow-scripts" '
            f'title="Sliders of the fit" style="width: 100%; height: {self._height}px; '
            'border: 0"></iframe>'
        )


def explore(fit: FitResult) -> Explorer:
    """Sliders for a fit, in a notebook: one for each parameter, and one along each
    direction that the data do not determine. Path and residuals follow.

    They need no kernel, so that they also work in a notebook on a web site. The curves
    along a slider are those of the model; those of several at once are put together,
    with an error that is measured and said beneath the sliders.

    Parameters
    ----------
    fit : fit of one throw, new or loaded; of a joint fit, one of its `throws`.

    Raises
    ------
    InputError : the fit is of timed events alone, which have no path, or no parameter
        can be moved within its bounds.

    Examples
    --------
    >>> explorer = curlfit.explore(fit)
    >>> explorer.errors[0.5]["y"] < 0.01
    True
    """
    require_fit(fit)
    if not fit.rms:
        raise InputError("a fit of timed events alone has no path for sliders to move")
    return Explorer(fit)


def _shown(
    curves: SliderCurves, errors: dict[float, dict[str, float]]
) -> dict[str, Any]:
    """What the template shows."""
    layout = curves.layout
    axes = [f"{side} ({UNITS[side]})" for side in layout.sides]
    return {
        "id": _ID,
        "sliders": [_slider_shown(curves.fit, slider) for slider in curves.sliders],
        "measured": layout.measured,
        "axes": f"{axes[1]} against {axes[0]}",
        "reach": _in_words({name: REACH[name] for name in layout.measured}, "or"),
        "intervals": INTERVALS,
        "half": _errors_in_words(errors[HALF]),
        "whole": _errors_in_words(errors[WHOLE]),
        "trials": TRIALS,
        "width": WIDTH,
        "height": HEIGHT,
        "panel": _PANEL,
    }


def _slider_shown(fit: FitResult, slider: Slider) -> dict[str, Any]:
    """Label, meaning and range of a slider, with the value at the fit."""
    names = list(slider.direction)
    backward, forward = slider.ends
    parameter = fit.parameters[names[0]]
    shown = {
        "label": names[0],
        "meaning": f"{parameter.meaning}: {parameter.verdict}",
        "value": f"{parameter.value:.6g}",
        "first": -_POSITIONS if backward < 0 else 0,
        "last": _POSITIONS if forward > 0 else 0,
    }
    if len(names) > 1:
        shown["label"] = f"along {join_words(names)}"
        shown["meaning"] = "a direction that the data do not determine"
        shown["value"] = "+0"
    return shown


def _errors_in_words(errors: dict[str, float]) -> str:
    """How near the curves are to those of the model."""
    if not np.isfinite(list(errors.values())).all():
        return "in places where the law admits no motion"
    return f"within {_in_words(errors)} of the model"


def _in_words(sizes: dict[str, float], last: str = "and") -> str:
    """Sizes by channel, as "0.4 mm in y and 2 mrad in phi"."""
    words = [f"{size_in_words(size, name)} in {name}" for name, size in sizes.items()]
    return join_words(words, last)


def _data(curves: SliderCurves, drawing: Drawing) -> dict[str, Any]:
    """What the program of the page moves; changes are whole multiples of `_UNIT`."""
    fit = curves.fit
    layout = curves.layout
    names = list(fit.parameters)
    pairs = []
    for numbers, ends in curves.pairs.items():
        multiples = _multiples(ends)
        if multiples.any():
            pairs.append({"sliders": numbers, "ends": multiples.tolist()})
    sliders = []
    for slider in curves.sliders:
        weights = slider.direction.items()
        sliders.append(
            {
                "direction": [(names.index(name), weight) for name, weight in weights],
                "steps": slider.steps.tolist(),
                "changes": _multiples(slider.changes).tolist(),
                "chi_squared": slider.chi_squared.tolist(),
            }
        )
    spans = [(values.start, values.stop) for _, values in layout.channels]
    paths = spans[: len(layout.drawn)]
    residuals = [
        {"name": name, "unit": UNITS[name], "span": span}
        for name, span in zip(layout.measured, spans[len(paths) :], strict=True)
    ]
    bounds = [
        (_finite(parameter.lower), _finite(parameter.upper))
        for parameter in fit.parameters.values()
    ]
    return {
        "kind": "sliders",
        "names": names,
        "values": fit.values.tolist(),
        "bounds": bounds,
        "sliders": sliders,
        "pairs": pairs,
        "positions": _POSITIONS,
        "unit": _UNIT,
        "base": rounded(curves.base, 6),
        "chi_squared": fit.chi_squared,
        "drawn": paths,
        "residuals": residuals,
        "instants": layout.t[layout.instants].tolist(),
        "t": fit.observed["t"][layout.rows].tolist(),
        "data": [rounded(side, 4) for side in _measured(curves)],
        **drawing._asdict(),
    }


def _multiples(changes: Floats) -> Any:
    return np.round(changes / _UNIT).astype(int)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _measured(curves: SliderCurves) -> list[Floats]:
    """What was measured, along the two sides of the drawing."""
    rows = some_rows(len(curves.fit.observed["t"]), _POINTS)
    return [curves.fit.observed[side][rows] for side in curves.layout.sides]


def _drawing(curves: SliderCurves) -> Drawing:
    """One that shows the data and the curves at all positions of each slider alone."""
    layout = curves.layout
    moved = np.concatenate([slider.changes for slider in curves.sliders])
    measured = _measured(curves)
    low = [float(np.nanmin(side)) for side in measured]
    high = [float(np.nanmax(side)) for side in measured]
    drawn = [values for _, values in layout.channels[: len(layout.drawn)]]
    # of one channel against time, the time is the first side
    for side, values in enumerate(drawn, start=2 - len(drawn)):
        reached = (curves.base + moved)[:, values]
        low[side] = min(low[side], float(reached.min()))
        high[side] = max(high[side], float(reached.max()))
    return Drawing.of(np.array(low), np.array(high), from_above=layout.has_path)
