"""Figure of a throw as measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from curlfit.output.figures import (
    CHANNEL_LABEL,
    DATA_STYLE,
    WIDTH,
    Picture,
    file_name,
    styled,
    title,
)
from curlfit.throws.throw import UNITS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from curlfit.throws.throw import Throw

    Floats = NDArray[np.float64]


@styled
def throw_figure(throw: Throw) -> Figure:
    """Measured channels over time, one panel each."""
    channels = throw.seen
    figure = Picture(figsize=(WIDTH, 1.4 * len(channels) + 0.5), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(channels), 1, sharex=True))
    for axes, name in zip(panels, channels, strict=True):
        axes.plot(throw.t, getattr(throw, name), **DATA_STYLE)
        axes.set_ylabel(f"${CHANNEL_LABEL[name]}$ ({UNITS[name]})")
    panels[-1].set_xlabel("t (s)")
    title(panels[0], file_name(throw.name))
    return figure
