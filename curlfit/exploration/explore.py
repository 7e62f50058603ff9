"""Paths under the law of a fit at other values of its parameters, and
sliders for these."""

from __future__ import annotations

import math
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.likelihood import chi_squared_of_many, predict_channels
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import stacked
from curlfit.output import figures as draw
from curlfit.output.frames import optional
from curlfit.output.text import decimals
from curlfit.output.ticks import unit_for
from curlfit.throws.throw import CHANNELS

_STEPS = 500  # of a slider
_HALF = 0.5  # half the range of a slider, relative to the value or its typical size
_SIGMAS = 5.0  # standard errors that half a range contains at least
# m, rad, m/s
_HALF_RANGES = {"x0": 0.5, "y0": 0.5, "phi0": 0.5, "v0": 0.5, "heading": 0.05}
_DPI = 110


@dataclass(frozen=True)
class Curves:
    """A path and the residuals of the data.

    Attributes
    ----------
    t : evenly spaced times over the data, s.
    path : x, y, phi, speed and omega at these times (SI, rad), NaN where the law
        admits no motion.
    residuals : measured minus computed, by measured channel, at the times of the data.
    chi_squared : of the data, under the noise model and the loss of the fit.
    """

    t: Floats
    path: dict[str, Floats]
    residuals: dict[str, Floats]
    chi_squared: float


class CurveModel:
    """The curves of a fit, as a function of its parameters."""

    def __init__(self, fit: FitResult) -> None:
        self.fit, self._model = fit, fit.model
        self._problem, origin = problem_of(fit)
        self._offset, self._place = (
            origin.offset(len(fit.parameters)),
            origin.place[:, None],
        )
        observed = fit.observed["t"]
        self._rows = len(observed)
        # As many times as padded rows: the program for the data also
        # computes the curves.
        count = len(self._problem.times)
        self._t = np.linspace(observed[0], observed[-1], count)
        none = np.zeros_like(self._problem.weight)
        self._path = self._problem._replace(events=None)
        self._evenly = self._path._replace(times=self._t - origin.t, weight=none)
        if self._problem.spins is not None:  # those of other rows
            unmeasured = self._problem.spins._replace(interval=np.zeros(()))
            self._evenly = self._evenly._replace(spins=unmeasured)

    def at(self, values: Floats) -> Curves:
        """The curves at a parameter vector, in the order of the fit's parameters."""
        local = np.asarray(values, float) - self._offset
        path, rows = (
            np.asarray(predict_channels(self._model, local, problem)) + self._place
            for problem in (self._evenly, self._path)
        )
        (chi_squared,) = chi_squared_of_many(
            self._model, local[None], stacked([self._problem]), batch=1
        )
        computed = dict(zip(CHANNELS, rows[:, : self._rows], strict=True))
        return Curves(
            self._t,
            dict(zip(CHANNELS, path, strict=True)),
            {name: self.fit.observed[name] - computed[name] for name in self.fit.rms},
            float(chi_squared),
        )


class MovingFigure:
    """Path, residuals and spin of a fit, drawn once and then moved."""

    @draw.style()
    def __init__(self, fit: FitResult, curves: Curves) -> None:
        self.figure = draw.Picture(figsize=(draw.WIDTH, 4.8), dpi=_DPI)
        self._canvas = FigureCanvasAgg(self.figure)
        t = fit.observed["t"]
        self._some = draw.some_rows(len(t))
        (path,), panels, (spin,) = (
            draw.row(self.figure, top, height, count, left=0.709, right=0.142, gap=0.52)
            for top, height, count in (
                (0.144, 1.236, 1),
                (1.947, 1.03, len(fit.rms)),
                (3.544, 0.824, 1),
            )
        )
        path.plot(
            *(fit.observed[name][self._some] for name in ("y", "x")), **draw.DATA_STYLE
        )
        path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
        path.invert_yaxis()  # as seen from above, thrown to the right
        draw.plot_rate(spin, fit.observed, "omega")
        (self.path,) = path.plot([], [], color=draw.FIT_COLOR, lw=1.3)
        (self.spin,) = spin.plot([], [], color=draw.FIT_COLOR)
        self.residuals: dict[str, Any] = {}
        self._sizes: dict[str, float] = {}
        for axes, (name, rms) in zip(panels, fit.rms.items(), strict=True):
            self._sizes[name], unit = unit_for(max(rms, 1e-12), name)
            axes.axhline(0, **draw.ZERO_LINE)
            axes.set_xlabel("t (s)")
            axes.set_title(
                f"${draw.CHANNEL_LABEL[name]}$ residual ({unit})", loc="center"
            )
            style, some = draw.DATA_STYLE | {"color": "0.25"}, t[self._some]
            (self.residuals[name],) = axes.plot(some, some, **style)
        self.move(curves)

    def move(self, curves: Curves) -> None:
        """Set the curves."""
        self.path.set_data(curves.path["y"], curves.path["x"])
        self.spin.set_data(curves.t, curves.path["omega"])
        for name, line in self.residuals.items():
            line.set_ydata(curves.residuals[name][self._some] / self._sizes[name])
        for line in (self.path, self.spin, *self.residuals.values()):
            line.axes.relim()
            line.axes.autoscale_view()

    def png(self) -> bytes:
        """The figure in its current state."""
        file = BytesIO()
        self._canvas.print_png(file)
        return file.getvalue()


class Explorer:
    """The display of `explore`.

    Attributes
    ----------
    sliders : by name of the parameter; moving one, or setting its `value`,
        moves the curves.
    curves : as shown, see `curlfit.exploration.explore.Curves`.
    widget : the whole display, for layouts of one's own.
    """

    def __init__(self, fit: FitResult) -> None:
        widgets = optional("ipywidgets", "notebook")
        self._model = CurveModel(fit)
        self.fit, self.curves = fit, self._model.at(fit.values)
        self._drawn = MovingFigure(fit, self.curves)
        wide = {"width": "24em"}
        self.sliders: dict[str, Any] = {}
        for name, item in fit.parameters.items():
            low, high = slider_range(name, item)
            step = (high - low) / _STEPS
            self.sliders[name] = widgets.FloatSlider(
                value=item.value,
                min=low,
                max=high,
                step=step,
                description=name,
                layout=wide,
                readout_format=f".{max(decimals(step) - 1, 0)}f",
                tooltip=f"{item.meaning}: {item.verdict}",
            )
        self._text = widgets.HTML()
        self._image = widgets.Image(format="png")
        self._reset = widgets.Button(
            description="Reset", tooltip="Back to the values of the fit"
        )
        self._reset.on_click(lambda _: self.reset())
        for slider in self.sliders.values():
            slider.observe(self._moved, names="value")
        left = widgets.VBox([*self.sliders.values(), self._reset, self._text])
        self.widget = widgets.HBox([left, self._image])
        self._show()

    @property
    def values(self) -> Floats:
        """The parameter vector as set by the sliders."""
        return np.array([slider.value for slider in self.sliders.values()])

    def reset(self) -> None:
        """Return to the values of the fit."""
        for slider, value in zip(self.sliders.values(), self.fit.values, strict=True):
            slider.value = value

    def _moved(self, _: Any = None) -> None:
        self.curves = self._model.at(self.values)
        self._drawn.move(self.curves)
        self._show()

    def _show(self) -> None:
        self._text.value = describe(self.curves, self.fit)
        self._image.value = self._drawn.png()

    def __repr__(self) -> str:
        return f"Explorer of a fit of the {self.fit.law} law to {self.fit.data['file']}"

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self.widget._repr_mimebundle_(**options)


def explore(fit: FitResult) -> Explorer:
    """Sliders for all parameters of a fit, in a notebook: path, residuals and spin
    follow immediately, and chi squared is that of the data under the noise model and
    the loss of the fit.

    Parameters
    ----------
    fit : fit of one throw, new or loaded; of a joint fit, one of its `throws`.

    Raises
    ------
    InputError : ipywidgets is not installed.

    Examples
    --------
    >>> explorer = curlfit.explore(fit)
    >>> explorer.sliders["mu2_xi"].value = 0.05
    >>> explorer.curves.chi_squared > fit.chi_squared
    True
    >>> explorer.reset()
    """
    return Explorer(fit)


def describe(curves: Curves, fit: FitResult) -> str:
    """Chi squared of the curves and of the fit."""
    if not math.isfinite(curves.chi_squared):
        return "The law admits no motion at these values."
    return (
        f"chi squared {curves.chi_squared:.6g} of {fit.n_observations} values; "
        f"of the fit {fit.chi_squared:.6g}"
    )


def slider_range(name: str, item: Estimate) -> tuple[float, float]:
    """Ends of a slider: around the value, within its bounds."""
    half = _HALF_RANGES.get(name, _HALF * max(abs(item.value), item.typical))
    half = max(half, _SIGMAS * (item.stderr or 0.0))
    low, high = max(item.value - half, item.lower), min(item.value + half, item.upper)
    return min(low, item.value), max(high, item.value)
