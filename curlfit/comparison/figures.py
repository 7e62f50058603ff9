"""Figure of a comparison, from its record."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from curlfit.output.figures import (
    CHANNEL_LABEL,
    CHANNEL_MARKER,
    DATA_STYLE,
    WIDTH,
    ZERO_LINE,
    Picture,
    feet,
    file_name,
    fix_layout,
    letter,
    line_styles,
    note_stretch,
    some_rows,
    styled,
    title,
)
from curlfit.output.text import join_words

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from curlfit.comparison.result import Candidate, Comparison

    Floats = NDArray[np.float64]

_SAME = 0.0075  # fraction of an axis, about a line's width, within which curves coincide


@styled
def comparison_figure(comparison: Comparison) -> Figure:
    """All fitted paths over the data, their residuals of x, and the size of residuals by channel.

    Examples
    --------
    >>> curlfit.comparison_figure(comparison).savefig("compare.png")
    """
    shown = [item for item in comparison.candidates if item.fitted is not None]
    t, x, y = (np.array(comparison.observed[name], float) for name in ("t", "x", "y"))
    some = some_rows(len(t))
    curves = _curves(shown, x)
    figure = Picture(figsize=(WIDTH, 4.0 + 0.17 * len(shown)), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(1.0, 0.6 + 0.05 * len(shown)))
    path = figure.add_subplot(rows[0].subgridspec(1, 1)[0])
    lower = rows[1].subgridspec(1, 2, width_ratios=(1.3, 1.0))
    residual, dots = figure.add_subplot(lower[0]), figure.add_subplot(lower[1])

    path.plot(y[some], x[some], **DATA_STYLE, label="data")
    for place, (same, style) in enumerate(zip(curves, line_styles(len(curves)), strict=True)):
        fitted = {name: np.array(values) for name, values in (same[0].fitted or {}).items()}
        drawn: dict[str, Any] = {
            **style,
            "lw": 1.5 if same[0].follows else 0.9,
            "zorder": 3 + len(curves) - place,
        }
        path.plot(fitted["y"], fitted["x"], **drawn, label=_names_of(same))
        residual.plot(t, 1000 * (x - fitted["x"]), **drawn)
    path.set(xlabel="along the sheet, y (m)", ylabel="to the right, x (m)")
    title(path, f"{file_name(comparison.data['file'])}: {len(shown)} fits")
    path.margins(x=0.02, y=0.1)
    path.invert_yaxis()  # as seen from above, thrown to the right
    feet(path, "right")
    path.legend(loc="upper left", bbox_to_anchor=(1.1, 1.04), labelspacing=0.6)
    residual.axhline(0, **ZERO_LINE)
    residual.set(xlabel="t (s)", ylabel="residual of x (mm)")

    for (name, marker), filling in zip(
        CHANNEL_MARKER.items(), ("white", "0.15", "0.7"), strict=True
    ):
        values = [1000 * item.residual_size.get(name, np.nan) for item in shown]
        unit = "mrad" if name == "phi" else "mm"
        dots.plot(
            values, range(len(shown)), marker, color="0.15", markerfacecolor=filling,
            markersize=4.5, markeredgewidth=0.9, label=f"${CHANNEL_LABEL[name]}$ ({unit})",
        )  # fmt: skip
    dots.set_yticks(range(len(shown)), [item.label for item in shown])
    for tick, item in zip(dots.get_yticklabels(), shown, strict=True):
        tick.set_fontweight("bold" if item.follows else "normal")
    dots.set_ylim(len(shown) - 0.4, -0.6)
    dots.set_xscale("log")
    dots.set_axisbelow(True)
    size = "rms" if comparison.loss == "linear" else "bulk"
    dots.set_xlabel(f"{size} of the residuals\nbold: follows the path")
    dots.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for axes, mark in ((path, "a"), (residual, "b")):
        letter(axes, mark, 0.45)
    fix_layout(figure)  # which the note depends on
    note_stretch(path)
    return figure


def _curves(shown: list[Candidate], x: Floats) -> list[list[Candidate]]:
    """The candidates by curve: grouped where the figure would not distinguish them."""
    if not shown:
        return []
    paths = [np.array([item.fitted["x"], item.fitted["y"]]) for item in shown if item.fitted]
    all_of_them = np.array(paths)
    reach = _SAME * np.array([np.ptp(all_of_them[:, 0] - x), np.ptp(all_of_them[:, 1])])
    found: list[list[int]] = []
    for place, path in enumerate(paths):
        for same in found:
            if (np.abs(path - paths[same[0]]).max(axis=1) <= reach).all():
                same.append(place)
                break
        else:
            found.append([place])
    return [[shown[place] for place in same] for same in found]


def _names_of(same: list[Candidate]) -> str:
    """Ranks, laws and loads of candidates with one path, one line per law."""
    loads: dict[tuple[str, str], list[str]] = {}
    ranks: dict[tuple[str, str], list[str]] = {}
    for item in same:
        noise = "" if item.noise == "white" else f", {item.noise} noise"
        noise += ", law alone" if "discrepancy" in item.noise else ""
        law = item.law, (", any sign" if item.signs_free else "") + noise
        loads.setdefault(law, []).append(item.load)
        ranks.setdefault(law, []).extend([] if item.rank is None else [str(item.rank)])
    lines = []
    for law, names in loads.items():
        rank = f"{', '.join(ranks[law])}. " if ranks[law] else ""
        load = "" if names == ["-"] else f", {join_words(names)} load"
        lines.append(f"{rank}{law[0]}{load}{law[1]}")
    return "\n".join(lines) + (" (same path)" if len(same) > 1 else "")
