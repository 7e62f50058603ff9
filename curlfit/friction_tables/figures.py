"""Figure of fits to a table of friction."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from curlfit.friction_tables.result import FrictionFit, FrictionFits
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.panels import Series, plot

_MOST = 8  # laws in the figure
_SAME = 1e-6  # difference of friction below which curves coincide


@draw.style()
def friction_figure(result: FrictionFits) -> draw.Picture:
    """Measured friction against speed, and the laws fitted to it; those of one
    curve together.

    Examples
    --------
    >>> curlfit.friction_figure(friction).savefig("friction.png")
    """
    figure, axes = draw.subplots(3.4, 1, 1)
    data = Series(
        result.observed["speed"],
        result.observed["mu"],
        replace(draw.DATA, size=4.0, width=0.8, zorder=5),
        "data",
        sigma=result.observed.get("sigma"),
    )
    plot(axes, data)
    curves = _distinct(result.fits)[:_MOST]
    for curve, style in zip(curves, draw.line_styles(len(curves)), strict=True):
        more = f" and {len(curve.laws) - 2} more" if len(curve.laws) > 2 else ""
        label = draw.literal(", ".join(curve.laws[:2]) + more)
        plot(axes, Series(curve.speed, curve.mu, style, label))
    axes.set(xlabel="speed (m/s)", ylabel="coefficient of friction", ylim=(0, None))
    draw.title(axes, f"{draw.file_name(result.data.file)}: friction against speed")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper")
    return figure


@dataclass(frozen=True)
class _Curve:
    """Friction against speed, and the laws that give it."""

    laws: list[str]
    speed: Floats
    mu: Floats


def _distinct(fits: Iterable[FrictionFit]) -> list[_Curve]:
    """The curves of fits, in their order; those that coincide are one."""
    curves: list[_Curve] = []
    for fit in fits:
        mu = fit.curve["mu"]
        for curve in curves:
            if np.abs(curve.mu - mu).max() < _SAME:
                curve.laws.append(fit.law)
                break
        else:
            curves.append(_Curve([fit.law], fit.curve["speed"], mu))
    return curves
