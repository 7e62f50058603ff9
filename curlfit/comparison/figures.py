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
    shown = [item for item in comparison.candidates if item.fitted is not None]
    t, x, y = (np.array(comparison.observed[name], float) for name in ("t", "x", "y"))
    some, styles = draw.some_rows(len(t)), draw.line_styles(len(shown))
    lacking = comparison.lacking
    height = 4.0 + 0.2 * len(shown)
    added = 0.0 if lacking is None else 2.0
    figure = draw.Picture(figsize=(draw.WIDTH, height + added), layout="constrained")
    ratios = [height / 2, height / 2]
    if lacking is not None:
        ratios.append(added)
    rows = figure.add_gridspec(len(ratios), 1, height_ratios=ratios)
    path: Any = rows[0].subgridspec(1, 1).subplots()
    lower: Any = rows[1].subgridspec(1, 2, width_ratios=(1.3, 1.0)).subplots()
    residual, dots = lower

    path.plot(y[some], x[some], **draw.DATA_STYLE, label="data")
    for place, (item, style) in enumerate(zip(shown, styles, strict=True)):
        fitted = {
            name: np.array(values) for name, values in (item.fitted or {}).items()
        }
        style |= {"lw": 1.5 if item.follows else 0.9, "zorder": 3 + len(shown) - place}
        name = item.label if item.rank is None else f"{item.rank}. {item.label}"
        if NOISES[item.noise].has_discrepancy:
            name += ", law alone"
        path.plot(fitted["y"], fitted["x"], **style, label=name)
        residual.plot(t, 1000 * (x - fitted["x"]), **style)
    path.margins(x=0.02, y=0.1)
    draw.x_along_y(path)
    draw.title(path, f"{draw.file_name(comparison.data['file'])}: {len(shown)} fits")
    path.legend(loc="upper left", bbox_to_anchor=(1.1, 1.04), labelspacing=0.3)
    residual.axhline(0, **draw.ZERO_LINE)
    residual.set(xlabel="t (s)", ylabel="residual of x (mm)")
    _sizes(dots, shown, "bulk" if LOSSES[comparison.loss].is_robust else "rms")
    panels = [path, residual]
    if lacking is not None:
        by_label = {
            item.label: style for item, style in zip(shown, styles, strict=True)
        }
        below: Any = rows[2].subgridspec(1, len(COMPONENTS)).subplots()
        _lacking(below, lacking, by_label)
        panels.append(below[0])
    draw.letters(panels, 0.45)
    figure.draw_without_rendering()  # the note depends on the layout
    figure.set_layout_engine("none")
    draw.note_stretch(path)
    return figure


def _lacking(
    panels: Any, lacking: Lacking, styles: Mapping[str, dict[str, Any]]
) -> None:
    """What the path has beyond the first law against speed, and what
    others would add."""
    some = sorted(lacking.others, key=lacking.size)[:_MOST]
    for row, (axes, (name, unit)) in enumerate(
        zip(panels, COMPONENTS.items(), strict=True)
    ):
        lacks, error = lacking.lacks[row], lacking.stderr[row]
        for times, alpha in ((1.96, 0.3), (1.0, 0.5)):
            band = lacks - times * error, lacks + times * error
            axes.fill_between(lacking.speed, *band, color="0.6", alpha=alpha, lw=0)
        axes.plot(lacking.speed, lacks, color="0.25", lw=1)
        ends = axes.get_ylim()
        for label in some:
            axes.plot(
                lacking.speed, lacking.others[label][row], **styles[label] | {"lw": 0.9}
            )
        axes.set_ylim(ends)
        axes.axhline(0, **draw.ZERO_LINE)
        axes.set(xlabel="speed (m/s)", ylabel=f"{name} ({unit})")
    draw.title(
        panels[0], f"What the path has beyond {draw.literal(lacking.law)}", loc="left"
    )


def _figure_of_sets(comparison: Comparison) -> draw.Picture:
    """Chi squared per degree of freedom of each law on each data set: filled with the
    coefficients that all sets have in common, open with those of the set alone."""
    shown = [item for item in comparison.candidates if item.sets]
    count, rows = len(comparison.sets), np.arange(len(shown))
    figure = draw.Picture(
        figsize=(draw.WIDTH, 1.3 + 0.22 * len(shown)), layout="constrained"
    )
    panels: Any = figure.subplots(1, count, sharey=True, squeeze=False)[0]
    for number, (axes, one) in enumerate(zip(panels, comparison.sets, strict=True)):
        each = [item.sets[number] for item in shown]
        common = np.array([on.chi_squared / on.dof for on in each])
        own = np.array([on.own_chi_squared / on.own_dof for on in each])
        low = min(0.3, *own, *common)
        axes.axvspan(low / 1.5, FOLLOWS, color="0.92", lw=0)
        axes.hlines(rows, own, common, color="0.15", lw=1.0)
        axes.plot(own, rows, "o", color="0.15", markerfacecolor="white", label="alone")
        axes.plot(common, rows, "o", color="0.15", label="with common coefficients")
        high = max(20.0, *own, *common)
        axes.set(xscale="log", xlim=(low / 1.5, 1.5 * high))
        axes.set_xlabel("chi squared per\ndegree of freedom")
        draw.title(axes, draw.file_name(one.name))
    _name_rows(panels[0], shown)
    handles = panels[0].get_legend_handles_labels()
    figure.legend(
        *handles,
        loc="outside lower center",
        ncols=2,
        title="grey: within 1.5 times the noise; bold: follows all",
    )
    return figure


def _sizes(axes: Any, shown: list[Candidate], size: str) -> None:
    """Sizes of the residuals of each candidate, by row."""
    marks = {
        "x": ("o", "white", "mm"),
        "y": ("s", "0.15", "mm"),
        "phi": ("^", "0.7", "mrad"),
    }
    for name, (marker, filling, unit) in marks.items():
        values = [1000 * item.residual_size.get(name, np.nan) for item in shown]
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
    axes.set_yticks(range(len(shown)), [item.label for item in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    for tick, item in zip(axes.get_yticklabels(), shown, strict=True):
        tick.set_fontweight("bold" if item.follows else "normal")
