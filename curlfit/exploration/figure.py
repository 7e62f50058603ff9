"""The figure of an exploration, with moving curves."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from curlfit.exploration.curves import Curves
from curlfit.inference.fit.result import FitResult
from curlfit.output.figures import (
    CHANNEL_LABEL,
    DATA_STYLE,
    FIT_COLOR,
    WIDTH,
    ZERO_LINE,
    Picture,
    measured_slopes,
    some_rows,
    styled,
)
from curlfit.output.ticks import unit_for

_DPI = 110


class MovingFigure:
    """Path, residuals and spin of a fit, drawn once and then moved."""

    @styled
    def __init__(self, fit: FitResult, curves: Curves) -> None:
        self.figure = Picture(figsize=(WIDTH, 4.8), dpi=_DPI)
        self._canvas = FigureCanvasAgg(self.figure)
        t = fit.observed["t"]
        self._some = some_rows(len(t))
        # Fixed panels, with room for long tick labels.
        rows = self.figure.add_gridspec(
            3, 1, height_ratios=(1.2, 1, 0.8), left=0.1, right=0.98, top=0.97, bottom=0.09,
            hspace=0.55,
        )  # fmt: skip
        path, spin = self.figure.add_subplot(rows[0]), self.figure.add_subplot(rows[2])
        for axes, across, along, names in (
            (path, "y", "x", ("along the sheet, y (m)", "to the right, x (m)")),
            (spin, "t", "omega", ("t (s)", r"spin $\omega$ (rad/s)")),
        ):
            if along in fit.observed:
                data = (fit.observed[name][self._some] for name in (across, along))
                axes.plot(*data, **DATA_STYLE)
            axes.set(xlabel=names[0], ylabel=names[1])
        path.invert_yaxis()  # as seen from above, thrown to the right
        if "omega" not in fit.observed and np.isfinite(fit.observed["phi"]).any():
            at, (turning,), _ = measured_slopes(t, fit.observed["phi"])
            spin.plot(at, turning, **DATA_STYLE)
        (self.path,) = path.plot([], [], color=FIT_COLOR, lw=1.3)
        (self.spin,) = spin.plot([], [], color=FIT_COLOR)
        self.residuals: dict[str, Any] = {}
        self._sizes: dict[str, float] = {}
        panels = rows[1].subgridspec(1, len(fit.rms), wspace=0.3)
        for place, name in enumerate(fit.rms):
            axes = self.figure.add_subplot(panels[place])
            size, unit = unit_for(max(fit.rms[name], 1e-12), name)
            axes.axhline(0, **ZERO_LINE)
            axes.set(xlabel="t (s)")
            axes.set_title(f"${CHANNEL_LABEL[name]}$ residual ({unit})", fontsize=8)
            (self.residuals[name],) = axes.plot(
                t[self._some], t[self._some], **DATA_STYLE | {"color": "0.25"}
            )
            self._sizes[name] = size
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
