"""Figure of a comparison, from its record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from curlfit.comparison.result import (
    COMPONENTS,
    FOLLOWS,
    Candidate,
    Comparison,
    Lacking,
)
from curlfit.losses import LOSSES
from curlfit.noises import NOISES
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.figures import Style
from curlfit.output.panels import (
    Band,
    Interval,
    Row,
    RowValue,
    Series,
    note_stretch,
    plot,
    plot_path,
    plot_residuals,
    plot_rows,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST = 4  # other laws drawn
_MILLI = 1e-3  # m in mm, rad in mrad
_MARK = Style("0.15", "none", marker="o", size=4.5, edge=0.9)


@draw.style()
def comparison_figure(comparison: Comparison) -> draw.Picture:
    """All fitted paths over the data, their residuals of x, and the size of
    residuals by channel.

    Of several data sets: chi squared per degree of freedom by law and set.

    Examples
    --------
    >>> curlfit.comparison_figure(comparison).savefig("compare.png")
    """
    if comparison.sets:
        return _figure_of_sets(comparison)
    fits = _fits(comparison)
    lacking = comparison.lacking
    height = 4.0 + 0.2 * len(fits)
    heights = [height / 2, height / 2]
    if lacking is not None:
        heights.append(2.0)
    figure = draw.Picture(figsize=(draw.WIDTH, sum(heights)), layout="constrained")
    rows = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    path: Any = rows[0].subgridspec(1, 1).subplots()
    below_path: Any = rows[1].subgridspec(1, 2, width_ratios=(1.3, 1.0)).subplots()
    residual, sizes = below_path
    lettered = [path, residual]

    _paths(path, comparison, fits)
    _residuals(residual, comparison, fits)
    plot_rows(sizes, _sizes(fits))
    sizes.set_xscale("log")
    size = "bulk" if LOSSES[comparison.loss].is_robust else "rms"
    sizes.set_xlabel(f"{size} of the residuals\nbold: follows the path")
    sizes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    if lacking is not None:
        style_by_label = {fit.candidate.label: fit.style for fit in fits}
        panels: Any = rows[2].subgridspec(1, len(COMPONENTS)).subplots()
        _lacking(panels, lacking, style_by_label)
        lettered.append(panels[0])
    draw.letters(lettered, 0.45)
    figure.draw_without_rendering()  # the note depends on the layout
    figure.set_layout_engine("none")
    note_stretch(path)
    return figure


@dataclass(frozen=True)
class _Fit:
    """The path of a candidate at the times of the data, in m, and how it is drawn."""

    candidate: Candidate
    x: Floats
    y: Floats
    style: Style


def _fits(comparison: Comparison) -> list[_Fit]:
    """The candidates that were fitted, the best first and drawn above all others."""
    path_by_candidate = [
        (candidate, candidate.fitted)
        for candidate in comparison.candidates
        if candidate.fitted is not None
    ]
    count = len(path_by_candidate)
    fits = []
    for number, style in enumerate(draw.line_styles(count)):
        candidate, path = path_by_candidate[number]
        width = 1.5 if candidate.follows else 0.9
        style = replace(style, width=width, zorder=3 + count - number)
        x = np.array(path["x"])
        y = np.array(path["y"])
        fits.append(_Fit(candidate, x, y, style))
    return fits


def _paths(axes: Axes, comparison: Comparison, fits: Sequence[_Fit]) -> None:
    """The path as measured and as each candidate fits it, seen from above."""
    observed = comparison.observed
    x = np.array(observed["x"], float)
    y = np.array(observed["y"], float)
    paths = [Series(y, x, draw.DATA, "data")]
    for fit in fits:
        label = fit.candidate.label
        if fit.candidate.rank is not None:
            label = f"{fit.candidate.rank}. {label}"
        if NOISES[fit.candidate.noise].has_discrepancy:
            label += ", law alone"
        paths.append(Series(fit.y, fit.x, fit.style, label))
    plot_path(axes, paths)
    draw.title(axes, f"{draw.file_name(comparison.data.file)}: {len(fits)} fits")
    axes.legend(loc="upper left", bbox_to_anchor=(1.1, 1.04), labelspacing=0.3)


def _residuals(axes: Axes, comparison: Comparison, fits: Sequence[_Fit]) -> None:
    """The residuals of x of each candidate over time."""
    t = np.array(comparison.observed["t"], float)
    x = np.array(comparison.observed["x"], float)
    residuals = [Series(t, (x - fit.x) / _MILLI, fit.style) for fit in fits]
    plot_residuals(axes, residuals, label="residual of x (mm)")


def _lacking(
    panels: Sequence[Axes], lacking: Lacking, style_by_label: Mapping[str, Style]
) -> None:
    """What the path has beyond the first law against speed, and what
    others would add."""
    nearest = sorted(lacking.others, key=lacking.size)[:_MOST]
    for row, (name, unit) in enumerate(COMPONENTS.items()):
        axes = panels[row]
        lacks = lacking.lacks[row]
        error = lacking.stderr[row]
        wide = 1.96 * error
        plot_residuals(
            axes,
            [Series(lacking.speed, lacks, Style("0.25", width=1))],
            [
                Band(lacking.speed, lacks - wide, lacks + wide, 0.3, "0.6"),
                Band(lacking.speed, lacks - error, lacks + error, 0.5, "0.6"),
            ],
            label=f"{name} ({unit})",
            over="speed (m/s)",
        )
        limits = axes.get_ylim()  # what others add may lie far beyond
        for label in nearest:
            style = replace(style_by_label[label], width=0.9)
            plot(axes, Series(lacking.speed, lacking.others[label][row], style))
        axes.set_ylim(limits)
    draw.title(
        panels[0], f"What the path has beyond {draw.literal(lacking.law)}", loc="left"
    )


def _figure_of_sets(comparison: Comparison) -> draw.Picture:
    """Chi squared per degree of freedom of each law on each data set: filled with the
    coefficients that all sets have in common, open with those of the set alone."""
    shown = [candidate for candidate in comparison.candidates if candidate.sets]
    height = 1.3 + 0.22 * len(shown)
    figure = draw.Picture(figsize=(draw.WIDTH, height), layout="constrained")
    panels: Any = figure.subplots(1, len(comparison.sets), sharey=True, squeeze=False)
    in_common = Style("0.15", "none", marker="o", size=6)
    alone = replace(in_common, fill="white")
    for number, data_set in enumerate(comparison.sets):
        axes = panels[0, number]
        low = 0.3
        high = 20.0
        rows = []
        for candidate in shown:
            fit = candidate.sets[number]
            values = (
                RowValue(fit.own_chi_squared / fit.own_dof, alone, label="alone"),
                RowValue(
                    fit.chi_squared / fit.dof,
                    in_common,
                    label="with common coefficients",
                ),
            )
            low = min(low, *(value.value for value in values))
            high = max(high, *(value.value for value in values))
            rows.append(
                Row(candidate.label, values, joined=True, bold=bool(candidate.follows))
            )
        follows = Interval(low / 1.5, FOLLOWS, "0.92", 1.0)
        plot_rows(axes, rows, follows)
        axes.set(xscale="log", xlim=(low / 1.5, 1.5 * high))
        axes.set_xlabel("chi squared per\ndegree of freedom")
        draw.title(axes, draw.file_name(data_set.name))
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=2,
        title="grey: within 1.5 times the noise; bold: follows all",
    )
    return figure


def _sizes(fits: Sequence[_Fit]) -> list[Row]:
    """Sizes of the residuals of each candidate by channel, in mm and mrad."""
    style_by_channel = {
        "x": replace(_MARK, fill="white"),
        "y": replace(_MARK, marker="s"),
        "phi": replace(_MARK, marker="^", fill="0.7"),
    }
    rows = []
    for fit in fits:
        values = []
        for channel, size in fit.candidate.residual_size.items():
            if channel in style_by_channel:
                unit = "mrad" if channel == "phi" else "mm"
                label = f"${draw.CHANNEL_LABEL[channel]}$ ({unit})"
                style = style_by_channel[channel]
                values.append(RowValue(size / _MILLI, style, label=label))
        follows = bool(fit.candidate.follows)
        rows.append(Row(fit.candidate.label, values, bold=follows))
    return rows
