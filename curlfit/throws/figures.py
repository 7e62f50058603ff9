"""Figure of a throw as measured."""

from __future__ import annotations

from curlfit.output import figures as draw
from curlfit.throws.throw import UNITS, Throw


@draw.style()
def throw_figure(throw: Throw) -> draw.Picture:
    """Measured channels over time, one panel each."""
    channels = throw.seen
    height = 1.4 * len(channels) + 0.5
    figure, panels = draw.panels(height, len(channels), 1, sharex=True, squeeze=False)
    for (axes,), name in zip(panels, channels, strict=True):
        axes.plot(throw.t, getattr(throw, name), **draw.DATA_STYLE)
        axes.set_ylabel(f"${draw.CHANNEL_LABEL[name]}$ ({UNITS[name]})")
    panels[-1, 0].set_xlabel("t (s)")
    draw.title(panels[0, 0], draw.file_name(throw.name))
    return figure
