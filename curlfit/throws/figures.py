"""Figures of a throw as measured."""

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


@draw.style()
def motion_figures(throw: Throw) -> dict[str, draw.Picture]:
    """Path from above, speed and spin, as measured or from slopes of the data: half as
    wide as others, by what they show."""
    rows = {"t": throw.t} | {name: getattr(throw, name) for name in throw.seen}
    needs = {"path": "x", "speed": "x", "spin": "phi"}
    measured = {"speed": "speed", "spin": "omega"}
    figures = {}
    for name, channel in needs.items():
        if not {channel, measured.get(name)} & rows.keys():
            continue
        figures[name], axes = draw.panels(2.1, 1, 1, width=draw.WIDTH / 2)
        if name == "path":
            axes.plot(rows["y"], rows["x"], **draw.DATA_STYLE)
            draw.x_along_y(axes)
        else:
            draw.plot_rate(axes, rows, measured[name])
    return figures
