"""Figure of fits to a table of friction."""

from __future__ import annotations

import numpy as np

from curlfit.friction_tables.result import FrictionFits
from curlfit.output import figures as draw

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
    figure, axes = draw.panels(3.4, 1, 1)
    seen, sigma = result.observed, result.observed.get("sigma")
    style = draw.DATA_STYLE | {"markersize": 4.0, "zorder": 5}
    if sigma is None:
        axes.plot(seen["speed"], seen["mu"], **style, label="data")
    else:
        axes.errorbar(
            seen["speed"], seen["mu"], sigma, **style, elinewidth=0.8, label="data"
        )
    curves: list[tuple[list[str], dict[str, np.ndarray]]] = []
    for one in result.fits:
        alike = (
            names
            for names, curve in curves
            if np.abs(curve["mu"] - one.curve["mu"]).max() < _SAME
        )
        if names := next(alike, None):
            names.append(one.law)
        else:
            curves.append(([one.law], one.curve))
    shown = curves[:_MOST]
    for (names, curve), style in zip(shown, draw.line_styles(len(shown)), strict=True):
        more = f" and {len(names) - 2} more" if len(names) > 2 else ""
        label = draw.literal(", ".join(names[:2]) + more)
        axes.plot(curve["speed"], curve["mu"], **style, label=label)
    axes.set(xlabel="speed (m/s)", ylabel="coefficient of friction", ylim=(0, None))
    draw.title(axes, f"{draw.file_name(result.data['file'])}: friction against speed")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper")
    return figure
