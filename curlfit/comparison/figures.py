"""Figure of a comparison, from its record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

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
from curlfit.output import figures as draw

_MOST = 4  # other laws drawn


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
    shown = [
        candidate for candidate in comparison.candidates if candidate.fitted is not None
    ]
    styles = draw.line_styles(len(shown))
    lacking = comparison.lacking
    height = 4.0 + 0.2 * len(shown)
    heights = [height / 2, height / 2]
    if lacking is not None:
        heights.append(2.0)
    figure = draw.Picture(figsize=(draw.WIDTH, sum(heights)), layout="constrained")
    rows = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    path: Any = rows[0].subgridspec(1, 1).subplots()
    below_path: Any = rows[1].subgridspec(1, 2, width_ratios=(1.3, 1.0)).subplots()
    residual, sizes = below_path
    lettered = [path, residual]

    t = np.array(comparison.observed["t"], float)
    x = np.array(comparison.observed["x"], float)
    y = np.array(comparison.observed["y"], float)
    some = draw.some_rows(len(t))
    path.plot(y[some], x[some], **draw.DATA_STYLE, label="data")
    for number, (candidate, style) in enumerate(zip(shown, styles, strict=True)):
        fitted = {
            name: np.array(values) for name, values in (candidate.fitted or {}).items()
        }
        style["lw"] = 1.5 if candidate.follows else 0.9
        style["zorder"] = 3 + len(shown) - number  # the best above all others
        label = candidate.label
        if candidate.rank is not None:
            label = f"{candidate.rank}. {label}"
        if NOISES[candidate.noise].has_discrepancy:
            label += ", law alone"
        path.plot(fitted["y"], fitted["x"], **style, label=label)
        residual.plot(t, 1000 * (x - fitted["x"]), **style)
    path.margins(x=0.02, y=0.1)
    draw.x_along_y(path)
    draw.title(path, f"{draw.file_name(comparison.data.file)}: {len(shown)} fits")
    path.legend(loc="upper left", bbox_to_anchor=(1.1, 1.04), labelspacing=0.3)
    residual.axhline(0, **draw.ZERO_LINE)
    residual.set(xlabel="t (s)", ylabel="residual of x (mm)")
    _sizes(sizes, shown, "bulk" if LOSSES[comparison.loss].is_robust else "rms")
    if lacking is not None:
        style_by_label = {
            candidate.label: style
            for candidate, style in zip(shown, styles, strict=True)
        }
        panels: Any = rows[2].subgridspec(1, len(COMPONENTS)).subplots()
        _lacking(panels, lacking, style_by_label)
        lettered.append(panels[0])
    draw.letters(lettered, 0.45)
    figure.draw_without_rendering()  # the note depends on the layout
    figure.set_layout_engine("none")
    draw.note_stretch(path)
    return figure


def _lacking(
    panels: Any, lacking: Lacking, style_by_label: Mapping[str, dict[str, Any]]
) -> None:
    """What the path has beyond the first law against speed, and what
    others would add."""
    nearest = sorted(lacking.others, key=lacking.size)[:_MOST]
    for row, (name, unit) in enumerate(COMPONENTS.items()):
        axes = panels[row]
        lacks = lacking.lacks[row]
        error = lacking.stderr[row]
        for times, alpha in ((1.96, 0.3), (1.0, 0.5)):  # 95 % and 68 %
            axes.fill_between(
                lacking.speed,
                lacks - times * error,
                lacks + times * error,
                color="0.6",
                alpha=alpha,
                lw=0,
            )
        axes.plot(lacking.speed, lacks, color="0.25", lw=1)
        limits = axes.get_ylim()
        for label in nearest:
            style = style_by_label[label] | {"lw": 0.9}
            axes.plot(lacking.speed, lacking.others[label][row], **style)
        axes.set_ylim(limits)
        axes.axhline(0, **draw.ZERO_LINE)
        axes.set(xlabel="speed (m/s)", ylabel=f"{name} ({unit})")
    draw.title(
        panels[0], f"What the path has beyond {draw.literal(lacking.law)}", loc="left"
    )


def _figure_of_sets(comparison: Comparison) -> draw.Picture:
    """Chi squared per degree of freedom of each law on each data set: filled with the
    coefficients that all sets have in common, open with those of the set alone."""
    shown = [candidate for candidate in comparison.candidates if candidate.sets]
    rows = np.arange(len(shown))
    height = 1.3 + 0.22 * len(shown)
    figure = draw.Picture(figsize=(draw.WIDTH, height), layout="constrained")
    panels: Any = figure.subplots(1, len(comparison.sets), sharey=True, squeeze=False)
    first = panels[0, 0]
    for number, data_set in enumerate(comparison.sets):
        axes = panels[0, number]
        fits = [candidate.sets[number] for candidate in shown]
        common = np.array([fit.chi_squared / fit.dof for fit in fits])
        alone = np.array([fit.own_chi_squared / fit.own_dof for fit in fits])
        low = min(0.3, *alone, *common)
        high = max(20.0, *alone, *common)
        axes.axvspan(low / 1.5, FOLLOWS, color="0.92", lw=0)
        axes.hlines(rows, alone, common, color="0.15", lw=1.0)
        axes.plot(
            alone, rows, "o", color="0.15", markerfacecolor="white", label="alone"
        )
        axes.plot(common, rows, "o", color="0.15", label="with common coefficients")
        axes.set(xscale="log", xlim=(low / 1.5, 1.5 * high))
        axes.set_xlabel("chi squared per\ndegree of freedom")
        draw.title(axes, draw.file_name(data_set.name))
    _name_rows(first, shown)
    figure.legend(
        *first.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=2,
        title="grey: within 1.5 times the noise; bold: follows all",
    )
    return figure


def _sizes(axes: Any, shown: list[Candidate], size: str) -> None:
    """Sizes of the residuals of each candidate, by row."""
    for name, marker, filling, unit in (
        ("x", "o", "white", "mm"),
        ("y", "s", "0.15", "mm"),
        ("phi", "^", "0.7", "mrad"),
    ):
        values = [
            1000 * candidate.residual_size.get(name, np.nan) for candidate in shown
        ]
        axes.plot(
            values,
            range(len(shown)),
            marker,
            color="0.15",
            markerfacecolor=filling,
            markersize=4.5,
            markeredgewidth=0.9,
            label=f"${draw.CHANNEL_LABEL[name]}$ ({unit})",
        )
    _name_rows(axes, shown)
    axes.set_xscale("log")
    axes.set_xlabel(f"{size} of the residuals\nbold: follows the path")
    axes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))


def _name_rows(axes: Any, shown: Sequence[Candidate]) -> None:
    """A row for each candidate, from above; those that follow are bold."""
    axes.set_yticks(range(len(shown)), [candidate.label for candidate in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    for tick, candidate in zip(axes.get_yticklabels(), shown, strict=True):
        tick.set_fontweight("bold" if candidate.follows else "normal")
