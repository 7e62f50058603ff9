"""Figures of a throw as measured."""

from __future__ import annotations

from curlfit.output import figures as draw
from curlfit.output.panels import (
    Series,
    measured_rate,
    plot,
    plot_path,
    plot_rate,
)
from curlfit.throws.channels import UNITS
from curlfit.throws.throw import Throw


@draw.style()
def throw_figure(throw: Throw) -> draw.Picture:
    """Measured channels over time, one panel each."""
    channels = throw.seen
    height = 1.4 * len(channels) + 0.5
    figure, panels = draw.subplots(height, len(channels), 1, sharex=True, squeeze=False)
    for (axes,), name in zip(panels, channels, strict=True):
        plot(axes, Series(throw.t, getattr(throw, name), draw.DATA))
        axes.set_ylabel(f"${draw.CHANNEL_LABEL[name]}$ ({UNITS[name]})")
    panels[-1, 0].set_xlabel("t (s)")
    draw.title(panels[0, 0], draw.file_name(throw.name))
    return figure


@draw.style()
def motion_figures(throw: Throw) -> dict[str, draw.Picture]:
    """Path from above, speed and spin, as measured or from slopes of the data: half as
    wide as others, by what they show."""
    channels = {"t": throw.t} | {name: getattr(throw, name) for name in throw.seen}
    figures = {}
    if "x" in channels:
        figures["path"], axes = draw.subplots(2.1, 1, 1, width=draw.WIDTH / 2)
        plot_path(axes, [Series(channels["y"], channels["x"], draw.DATA)])
    if {"x", "speed"} & channels.keys():
        figures["speed"], axes = draw.subplots(2.1, 1, 1, width=draw.WIDTH / 2)
        plot_rate(axes, "speed", [measured_rate(channels, "speed")])
    if {"phi", "omega"} & channels.keys():
        figures["spin"], axes = draw.subplots(2.1, 1, 1, width=draw.WIDTH / 2)
        plot_rate(axes, "omega", [measured_rate(channels, "omega")])
    return figures
