"""The figure of an exploration, with moving curves."""

from __future__ import annotations

from io import BytesIO
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg

from curlfit.exploration.curves import Curves
from curlfit.inference.fit.result import FitResult
from curlfit.output import figures as draw
from curlfit.output.ticks import unit_for

_DPI = 110


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
        path.plot(*(fit.observed[name][self._some] for name in ("y", "x")), **draw.DATA_STYLE)
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
            axes.set_title(f"${draw.CHANNEL_LABEL[name]}$ residual ({unit})", loc="center")
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
