"""Corner plot of the posterior: the parameters pair by pair."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.identifiability import Combination
from curlfit.inference.joint.result import JointResult
from curlfit.inference.mcmc.chain import Chain
from curlfit.inference.verdict import Verdict
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.ticks import neat_axis
from curlfit.wording import format_estimate

_LEFT, _RIGHT, _TOP, _BOTTOM = 0.8, 0.12, 0.42, 0.65  # inches around the panels
_GAP = 0.06  # between them
_SMALLEST = 0.95  # side of a panel
_BINS = 30
_SMOOTH = 1.0  # bins, standard deviation
_LEVELS = (0.95, 0.68)
_LEGEND = "dashed: 68 %; shaded: 68 and 95 % of the posterior"
_SHADES = ("#ecd2e0", draw.POSTERIOR_COLOR)
_MOST = 40_000  # samples used for the densities
_DOTS = 2000  # points drawn along a ridge, about
_ROOM = 8  # panels side by side, beyond which groups and trends are left to the report


class _Shown(NamedTuple):
    """One of what is drawn: its label, unit and verdict."""

    label: str
    unit: str
    verdict: Verdict = Verdict.DETERMINED


@draw.style()
def corner_figure(fit: FitResult | JointResult, chain: Chain) -> draw.Picture:
    """Corner plot of the posterior of the law's coefficients and the estimated
    conditions: regions that contain 68 and 95 % of the samples, with reference values
    marked. Of a joint fit, that of the mean of the throws, of what groups and trends
    change, and of the spreads between throws.

    Examples
    --------
    >>> curlfit.corner_figure(sampled, chain).savefig("corner.png")
    """
    if isinstance(fit, JointResult):
        shown, ridges, known, heading, said = _of_joint(fit, chain)
    else:
        shown, ridges, known, heading, said = _of_fit(fit)
    names = list(shown)
    samples = np.stack([chain.of({name: 1.0}) for name in names])
    samples = samples[:, draw.some_rows(samples.shape[1], _MOST)]
    extents = [
        _extent(*pair) for pair in zip(samples, map(known.get, names), strict=True)
    ]
    figure, grid = _panels(len(names))
    for (row, column), axes in grid.items():
        axes.grid(visible=False)
        axes.spines[:].set_visible(True)
        axes.set_xlim(extents[column])
        if row == column:
            _histogram(axes, shown[names[row]].verdict, samples[row])
            _mark(axes.axvline, known.get(names[row]))
            continue
        axes.set_ylim(extents[row])
        if item := ridges.get((row, column)):
            combination, words = item
            weights = [combination.weights[names[place]] for place in (column, row)]
            of_it = known.get(combination.expression)
            _ridge(axes, words, weights, samples[[column, row]], of_it)
            continue
        _density(axes, samples[[column, row]])
        _mark(axes.axhline, known.get(names[row]))
        _mark(axes.axvline, known.get(names[column]))
    for place, name in enumerate(names):
        _neat_axes(shown[name], grid[len(names) - 1, place], grid[place, 0], place > 0)
    for axes in figure.axes:
        axes.label_outer()
    _say_in_corner(figure, heading, said)
    return figure


def _of_fit(fit: FitResult) -> tuple[Any, ...]:
    """What is drawn by name, ridges by row and column, reference values,
    heading and words."""
    require_fit(fit)
    names = _names(fit)
    items = {name: fit.parameters[name] for name in names}
    return (
        {
            name: _Shown(draw.symbol_of(one), one.unit, one.verdict)
            for name, one in items.items()
        },
        _ridges(fit, names),
        {} if fit.reference is None else fit.reference.values,
        draw.heading_of(fit),
        _said(fit),
    )


def _of_joint(result: JointResult, chain: Chain) -> tuple[Any, ...]:
    """The same of throws that vary."""
    items = result.coefficients
    symbols = {name: draw.symbol_of(one) for name, one in items.items()}
    symbols |= {
        one.expression: f"${draw.weighted_sum(one.weights, items)}$"
        for one in result.combinations
    }
    units = {name: one.unit for name, one in items.items()}
    shown = {}
    for name in chain.names:
        change, _, varies = name.rpartition(": ")
        spread = name.removeprefix("spread of ")
        if len(chain.names) > _ROOM and change:
            continue
        label = symbols.get(varies, varies)
        if change:
            label = f"{draw.literal(change)}:\n{label}"
        if spread != name:
            label, varies = f"spread of\n{symbols.get(spread, spread)}", spread
        # its density leans to one side
        verdict = Verdict.WEAK if spread != name else Verdict.DETERMINED
        shown[name] = _Shown(label, units.get(varies, "1"), verdict)
    heading = f"{draw.law_and_load(result)}: {result.count} throws together"
    return shown, {}, {}, heading, [(draw.QUIET, [_LEGEND])]


def _panels(number: int) -> tuple[draw.Picture, dict[tuple[int, int], Any]]:
    """The figure, and its panels by row and column; those of a parameter
    share its axis."""
    count = max(number, 2)
    width = max(draw.WIDTH, _LEFT + _RIGHT + count * (_SMALLEST + _GAP) - _GAP)
    side = (width - _LEFT - _RIGHT + _GAP) / count
    height = _TOP + _BOTTOM + number * side - _GAP
    figure = draw.Picture(figsize=(width, height))
    gap = _GAP / (side - _GAP)
    places = figure.add_gridspec(
        number,
        count,
        wspace=gap,
        hspace=gap,
        left=_LEFT / width,
        right=1 - _RIGHT / width,
        bottom=_BOTTOM / height,
        top=1 - _TOP / height,
    )
    grid: dict[tuple[int, int], Any] = {}
    for row in range(number):
        for column in range(row + 1):
            across, up = (
                grid.get((column, column)),
                grid.get((row, 0)) if column < row else None,
            )
            grid[row, column] = figure.add_subplot(
                places[row, column], sharex=across, sharey=up
            )
    return figure, grid


def _names(fit: FitResult) -> list[str]:
    """Coefficients and conditions that are not fixed; if fewer than two, the
    initial state too."""
    start = ("v0", "omega0", "heading")
    wanted = [*fit.coefficients, *fit.conditions]
    free = [name for name in (*wanted, *start) if fit.parameters[name].verdict.is_free]
    found = [name for name in free if name in wanted]
    return found if len(found) > 1 else free


def _extent(values: Floats, mark: float | None) -> tuple[float, float]:
    """Axis limits that enclose the samples, and a reference value if it
    is near them."""
    low, high = map(float, np.quantile(values, [0.001, 0.999]))
    if mark is not None:
        reach = 3 * (high - low)
        low = mark if high - reach < mark < low else low
        high = mark if high < mark < low + reach else high
    margin = 0.06 * (high - low) or 1e-9
    return low - margin, high + margin


def _histogram(axes: Any, verdict: Verdict, values: Floats) -> None:
    """Histogram of one parameter with its median and 68 % interval."""
    counts, *_ = axes.hist(
        values,
        _BINS,
        range=axes.get_xlim(),
        histtype="stepfilled",
        fc=_SHADES[0],
        ec=draw.POSTERIOR_COLOR,
        lw=1,
    )
    quantiles = low, middle, high = np.quantile(values, [0.16, 0.5, 0.84]).tolist()
    axes.vlines(
        quantiles,
        0,
        1,
        transform=axes.get_xaxis_transform(),
        colors="black",
        linestyles=["--", "-", "--"],
        lw=0.7,
    )
    axes.set(ylim=(0, 1.1 * counts.max()), yticks=[])
    said = f"{low:.3g} .. {high:.3g}"
    if verdict == Verdict.NOT_IDENTIFIABLE:
        said = verdict
    elif verdict.is_known:
        said = " \N{PLUS-MINUS SIGN} ".join(format_estimate(middle, (high - low) / 2))
    text = axes.set_title(
        said.replace("-", "\N{MINUS SIGN}"), fontsize=7, pad=3, loc="center"
    )
    draw.shrink(text, axes.get_window_extent().width)


def _density(axes: Any, samples: Floats) -> None:
    """Smallest regions that contain 68 and 95 % of the samples."""
    limits = axes.get_xlim(), axes.get_ylim()
    counts, *edges = np.histogram2d(samples[0], samples[1], _BINS, limits)
    kernel = np.exp(
        -(np.subtract.outer(range(_BINS), range(_BINS)) ** 2) / (2 * _SMOOTH**2)
    )
    kernel /= kernel.sum(1, keepdims=True)
    density = np.pad(kernel @ counts @ kernel.T, 1)  # closes the contours
    falling = np.sort(density, axis=None)[::-1]
    share = np.cumsum(falling) / falling.sum()
    # rise
    levels = falling[[*np.searchsorted(share, _LEVELS), 0]] * (1 + 1e-6 * np.arange(3))
    middles = [
        np.append(edge, 2 * edge[-1] - edge[-2]) - np.diff(edge[:2]) / 2
        for edge in edges
    ]
    axes.contourf(*middles, density.T, levels=levels, colors=_SHADES)
    axes.contour(*middles, density.T, levels=levels[:2], colors="0.3", linewidths=0.5)


def _ridges(
    fit: FitResult, names: list[str]
) -> dict[tuple[int, int], tuple[Combination, str]]:
    """By row and column, the combination of pairs of which only that is determined, and
    its symbols."""
    found = {}
    for item in fit.combinations:
        if len(item.weights) == 2 and item.weights.keys() <= set(names):
            column, row = sorted(map(names.index, item.weights))
            found[row, column] = item, draw.weighted_sum(item.weights, fit.parameters)
    return found


def _ridge(
    axes: Any, said: str, weights: list[float], samples: Floats, value: float | None
) -> None:
    """Draw a pair of which only a combination is determined, as points along a line."""
    some = samples[:, :: max(1, samples.shape[1] // _DOTS)]
    axes.plot(
        *some, ".", color=draw.POSTERIOR_COLOR, markersize=1.5, mew=0, rasterized=True
    )
    x = 0.95 if weights[0] * weights[1] > 0 else 0.05
    said = f"only\n${said}$\nis determined"
    draw.shrink(
        draw.note(axes, x, 0.95, said, color="black", fontsize=7),
        0.52 * axes.get_window_extent().width,
    )
    if value is not None:
        across = np.array(axes.get_xlim())
        up = (value - weights[0] * across) / weights[1]
        axes.plot(across, up, color=draw.REFERENCE_COLOR, lw=1)


def _neat_axes(shown: _Shown, below: Any, beside: Any, has_row: bool) -> None:
    """Set the same few ticks in all panels of a parameter, and label the outermost."""
    label = shown.label, shown.unit
    neat_axis(below.xaxis, *label, neighbours=True)
    if has_row:
        neat_axis(beside.yaxis, *label, neighbours=True)
    box, inch = below.get_window_extent(), below.get_figure().dpi
    below.xaxis.set_label_coords(0.5, -0.24 * inch / box.height)
    beside.yaxis.set_label_coords(-0.42 * inch / box.width, 0.5)


def _mark(line: Callable[..., Any], value: float | None) -> None:
    """Mark a reference value, if there is one."""
    if value is not None:
        line(value, color=draw.REFERENCE_COLOR, lw=1)


def _say_in_corner(
    figure: draw.Picture, heading: str, said: list[tuple[str, list[str]]]
) -> None:
    """Write what was fitted, combinations and references into the corner
    free of panels."""
    width, height = figure.get_size_inches()
    text = figure.text(_LEFT / width, 1 - 0.06 / height, heading, va="top")
    draw.shrink(text, (width - _LEFT - _RIGHT) * figure.dpi)
    end, top = 1 - _RIGHT / width, 1 - _TOP / height
    room = end * figure.bbox.width - figure.axes[0].get_window_extent().x1
    for color, lines in said:
        text = figure.text(
            end,
            top,
            "\n".join(lines),
            color=color,
            ha="right",
            va="top",
            linespacing=1.5,
        )
        draw.shrink(text, room)
        top -= text.get_window_extent().height / figure.bbox.height + 0.1 / height


def _said(fit: FitResult) -> list[tuple[str, list[str]]]:
    """What stands in the corner: colours and lines."""
    lines = []
    for item in fit.combinations:
        value, stderr = format_estimate(item.value, item.stderr)
        combination = draw.weighted_sum(item.weights, fit.parameters)
        lines.append(rf"${combination} = {value} \pm {stderr}$")
    for direction in fit.null_directions:
        pair = (draw.symbol_of(fit.parameters[name]) for name in direction)
        lines.append(f"{', '.join(pair)}: not identifiable individually")
    said = [(draw.QUIET, [_LEGEND])]
    if lines:
        said.insert(0, ("black", lines))
    if fit.reference is not None:
        symbols = {name: item.symbol for name, item in fit.parameters.items()}
        known = fit.reference.values.items()
        values = [
            draw.in_symbols(f"{name} = {value:g}", symbols) for name, value in known
        ]
        said.append(
            (draw.REFERENCE_COLOR, [draw.literal(fit.reference.source), *values])
        )
    return said
