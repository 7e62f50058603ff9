"""Sliders for the parameters of a fit: a page that needs neither network nor Python,
and its place in a notebook."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import InputError
from curlfit.html_report.blocks import InteractiveBlock
from curlfit.html_report.direction import HEIGHT, WIDTH, Drawing, size_in_words
from curlfit.html_report.page import page_alone
from curlfit.html_report.replay import Numbers, rounded
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
from curlfit.throws.channels import UNITS
from curlfit.wording import join_words

_ID = "sliders"
_POSITIONS = 250  # of a slider, from the fit to either end
_POINTS = 200  # of the data in the drawing
_PANEL = 90.0  # height of the residuals of a channel
_UNIT = 1e-5  # m, rad, m/s, rad/s: in which changes are written in the page
_FRAME = 540  # pixels of the frame in a notebook, but for residuals and sliders
_PER_CHANNEL = 130  # of it for the residuals of a channel
_PER_SLIDER = 42


@dataclass(frozen=True)
class SliderData:
    """A slider: weights by the number of each parameter; steps along it, with the
    changes of the curves, in multiples of `_UNIT`, and chi squared at each."""

    direction: list[tuple[int, float]]
    steps: list[float]
    changes: list[list[int]]
    chi_squared: list[float]


@dataclass(frozen=True)
class PairData:
    """What two sliders, by their numbers, do beyond their sum at each pair of their
    ends, in multiples of `_UNIT`, shape (2, 2, values)."""

    sliders: tuple[int, int]
    ends: list[list[list[int]]]


@dataclass(frozen=True)
class ResidualPanel:
    """Residuals of a channel: its SI unit, and where they are among the curves."""

    name: str
    unit: str
    span: tuple[int, int]


@dataclass(frozen=True)
class SlidersData:
    """What `sliders.js` reads.

    Attributes
    ----------
    names, values, bounds : of the parameters; None for no bound.
    positions : of a slider, from the fit to either end.
    unit : in which changes are written (SI, rad).
    base : curves of the fit, the path and then the residuals.
    drawn : where the path is among the curves. instants : its times, s.
    t : times of the residuals, s.
    data : what was measured, along the two sides of the drawing.
    origin, scale, margin : of the `Drawing`.
    """

    names: list[str]
    values: list[float]
    bounds: list[tuple[float | None, float | None]]
    sliders: list[SliderData]
    pairs: list[PairData]
    positions: int
    unit: float
    base: Numbers
    chi_squared: float
    drawn: list[tuple[int, int]]
    residuals: list[ResidualPanel]
    instants: list[float]
    t: list[float]
    data: list[Numbers]
    origin: list[float]
    scale: list[float]
    margin: float


@dataclass(frozen=True)
class SliderControl:
    """A slider as it is shown: its label and meaning, the value at the fit, and its
    first and last position."""

    label: str
    meaning: str
    value: str
    first: int
    last: int


@dataclass(frozen=True)
class Sliders(InteractiveBlock):
    """Sliders for the parameters of a fit.

    Attributes
    ----------
    measured : channels, whose residuals are shown in panels of a height.
    axes : what the drawing of the path shows.
    reach : how far the curves move, in words.
    half, whole : errors of the curves, in words, with all sliders half the way to their
        ends and at their ends; the largest of some trials.
    intervals : of the table along a slider, on either side of the fit.
    """

    template = "sliders"
    data: SlidersData
    sliders: list[SliderControl]
    measured: list[str]
    axes: str
    reach: str
    half: str
    whole: str
    intervals: int = INTERVALS
    trials: int = TRIALS
    width: float = WIDTH
    height: float = HEIGHT
    panel: float = _PANEL


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
        title = f"Sliders of a fit to {Path(fit.data.file).name}"
        sliders = _sliders(curves, self.errors)
        self.page = page_alone(title, sliders, ("moving.js", "sliders.js"))
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


def _sliders(curves: SliderCurves, errors: dict[float, dict[str, float]]) -> Sliders:
    """The sliders of a fit, with their data; `errors` are those of the curves by share
    of the way to the ends, and by channel."""
    layout = curves.layout
    labels = [f"{side} ({UNITS[side]})" for side in layout.sides]
    return Sliders(
        id=_ID,
        data=_data(curves),
        sliders=[_control(curves.fit, slider) for slider in curves.sliders],
        measured=list(layout.residuals),
        axes=f"{labels[1]} against {labels[0]}",
        reach=_in_words({name: REACH[name] for name in layout.residuals}, "or"),
        half=_errors_in_words(errors[HALF]),
        whole=_errors_in_words(errors[WHOLE]),
    )


def _control(fit: FitResult, slider: Slider) -> SliderControl:
    """Label, meaning and range of a slider, with the value at the fit."""
    names = list(slider.direction)
    first = -_POSITIONS if slider.ends.backward < 0 else 0
    last = _POSITIONS if slider.ends.forward > 0 else 0
    if len(names) > 1:
        label = f"along {join_words(names)}"
        meaning = "a direction that the data do not determine"
        return SliderControl(label, meaning, "+0", first, last)
    parameter = fit.parameters[names[0]]
    meaning = f"{parameter.meaning}: {parameter.verdict}"
    return SliderControl(names[0], meaning, f"{parameter.value:.6g}", first, last)


def _errors_in_words(errors: dict[str, float]) -> str:
    """How near the curves are to those of the model."""
    if not np.isfinite(list(errors.values())).all():
        return "in places where the law admits no motion"
    return f"within {_in_words(errors)} of the model"


def _in_words(sizes: dict[str, float], last: str = "and") -> str:
    """Sizes by channel, as "0.4 mm in y and 2 mrad in phi"."""
    words = [f"{size_in_words(size, name)} in {name}" for name, size in sizes.items()]
    return join_words(words, last)


def _data(curves: SliderCurves) -> SlidersData:
    """What the program of the page moves."""
    fit = curves.fit
    layout = curves.layout
    drawing = _drawing(curves)
    names = list(fit.parameters)
    sliders = []
    for slider in curves.sliders:
        weights = slider.direction.items()
        sliders.append(
            SliderData(
                direction=[(names.index(name), weight) for name, weight in weights],
                steps=slider.steps.tolist(),
                changes=_multiples(slider.changes).tolist(),
                chi_squared=slider.chi_squared.tolist(),
            )
        )
    pairs = []
    for numbers, ends in curves.pairs.items():
        multiples = _multiples(ends)
        if multiples.any():
            pairs.append(PairData(numbers, multiples.tolist()))
    return SlidersData(
        names=names,
        values=fit.values.tolist(),
        bounds=[
            (_finite(parameter.lower), _finite(parameter.upper))
            for parameter in fit.parameters.values()
        ],
        sliders=sliders,
        pairs=pairs,
        positions=_POSITIONS,
        unit=_UNIT,
        base=rounded(curves.base, 6),
        chi_squared=fit.chi_squared,
        drawn=[(part.start, part.stop) for part in layout.path.values()],
        residuals=[
            ResidualPanel(name, UNITS[name], (part.start, part.stop))
            for name, part in layout.residuals.items()
        ],
        instants=layout.t[layout.instants].tolist(),
        t=fit.observed["t"][layout.rows].tolist(),
        data=[rounded(side, 4) for side in _measured(curves)],
        origin=drawing.origin,
        scale=drawing.scale,
        margin=drawing.margin,
    )


def _multiples(changes: Floats) -> NDArray[np.int_]:
    """Changes as whole multiples of the unit in which the page has them."""
    return np.round(changes / _UNIT).astype(int)


def _finite(bound: float) -> float | None:
    """A bound, or None where there is none."""
    return bound if math.isfinite(bound) else None


def _measured(curves: SliderCurves) -> list[Floats]:
    """What was measured, along the two sides of the drawing."""
    rows = some_rows(len(curves.fit.observed["t"]), _POINTS)
    return [curves.fit.observed[side][rows] for side in curves.layout.sides]


def _drawing(curves: SliderCurves) -> Drawing:
    """One that shows the data and the curves at all positions of each slider alone."""
    layout = curves.layout
    moved = np.concatenate([slider.changes for slider in curves.sliders])
    measured = _measured(curves)
    low = np.array([np.nanmin(values) for values in measured])
    high = np.array([np.nanmax(values) for values in measured])
    for name, part in layout.path.items():
        side = layout.sides.index(name)
        reached = (curves.base + moved)[:, part]
        low[side] = min(low[side], reached.min())
        high[side] = max(high[side], reached.max())
    return Drawing.of(low, high, from_above=layout.has_path)
