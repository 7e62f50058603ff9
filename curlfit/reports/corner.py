"""Corner plot of the posterior: the parameters pair by pair."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.sampling.chain import Chain
from curlfit.inference.together.result import JointResult
from curlfit.numerics.arrays import Floats
from curlfit.output import figures as draw
from curlfit.output.ticks import neat_axis
from curlfit.wording import format_estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# inches: around the panels, between them, and the least side of a panel
_LEFT = 0.8
_RIGHT = 0.12
_TOP = 0.42
_BOTTOM = 0.65
_GAP = 0.06
_SMALLEST = 0.95
_BINS = 30
_SMOOTH = 1.0  # bins, standard deviation
_LEVELS = (0.95, 0.68)
_LEGEND = "dashed: 68 %; shaded: 68 and 95 % of the posterior"
_SHADES = ("#ecd2e0", draw.POSTERIOR_COLOR)
_MOST = 40_000  # samples used for the densities
_DOTS = 2000  # points drawn along a ridge, about
_SPREAD = "spread of "  # begins the name of a spread between throws in a chain
_ROOM = 8  # panels side by side, beyond which groups and trends are left to the report


class _Label(NamedTuple):
    """How a parameter is labelled: its symbol, unit and verdict."""

    text: str
    unit: str
    verdict: Verdict = Verdict.DETERMINED


class _Ridge(NamedTuple):
    """A combination of two parameters of which only it is determined: its weights by
    name, its symbols, and the value of a reference."""

    weights: Mapping[str, float]
    symbols: str
    reference: float | None


class _Lines(NamedTuple):
    """Lines of text of one colour in the corner."""

    color: str
    lines: list[str]


class _Content(NamedTuple):
    """What a corner plot shows."""

    labels: dict[str, _Label]
    """by name, in the order of the panels"""
    ridges: dict[tuple[int, int], _Ridge]
    """by row and column"""
    reference: Mapping[str, float]
    """published or true values by name"""
    heading: str
    corner: list[_Lines]


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
    content = _of_joint(fit, chain) if isinstance(fit, JointResult) else _of_fit(fit)
    names = list(content.labels)
    samples = np.stack([chain.of({name: 1.0}) for name in names])
    samples = samples[:, draw.some_rows(samples.shape[1], _MOST)]
    references = [content.reference.get(name) for name in names]
    limits = [
        _limits(values, reference)
        for values, reference in zip(samples, references, strict=True)
    ]
    figure, panels = _panels(len(names))
    for (row, column), axes in panels.items():
        axes.grid(visible=False)
        axes.spines[:].set_visible(True)
        axes.set_xlim(limits[column])
        if row == column:
            verdict = content.labels[names[row]].verdict
            _histogram(axes, verdict, samples[row])
            _mark(axes.axvline, references[row])
            continue
        axes.set_ylim(limits[row])
        pair = samples[[column, row]]
        ridge = content.ridges.get((row, column))
        if ridge is not None:
            slope = (ridge.weights[names[column]], ridge.weights[names[row]])
            _draw_ridge(axes, ridge, slope, pair)
            continue
        _density(axes, pair)
        _mark(axes.axhline, references[row])
        _mark(axes.axvline, references[column])
    last = len(names) - 1
    for index, name in enumerate(names):
        label = content.labels[name]
        _neat_axes(label, panels[last, index], panels[index, 0], index > 0)
    for axes in figure.axes:
        axes.label_outer()
    _write_corner(figure, content.heading, content.corner)
    return figure


def corner_of(result: FitResult | JointResult, chain: Chain) -> dict[str, draw.Picture]:
    """The corner plot of a fit and its chain, by name."""
    return {"corner": corner_figure(result, chain)}


def _of_fit(fit: FitResult) -> _Content:
    """Coefficients and conditions of a fit."""
    require_fit(fit)
    labels = {}
    for name in _names(fit):
        parameter = fit.parameters[name]
        symbol = draw.symbol_of(parameter)
        labels[name] = _Label(symbol, parameter.unit, parameter.verdict)
    return _Content(
        labels=labels,
        ridges=_ridges(fit, list(labels)),
        reference={} if fit.reference is None else fit.reference.values,
        heading=draw.heading_of(fit),
        corner=_corner_of_fit(fit),
    )


def _of_joint(result: JointResult, chain: Chain) -> _Content:
    """Means of throws that vary, what groups and trends change in them ("sheet 2:
    mu1_xi"), and the spreads between throws ("spread of mu1_xi")."""
    symbols = {}
    units = {}
    for name, coefficient in result.coefficients.items():
        symbols[name] = draw.symbol_of(coefficient)
        units[name] = coefficient.unit
    for combination in result.combinations:
        weights = combination.weights
        text = draw.weighted_sum(weights, result.coefficients)
        symbols[combination.expression] = f"${text}$"
    labels = {}
    for name in chain.names:
        change, _, expression = name.rpartition(": ")
        if change and len(chain.names) > _ROOM:
            continue
        text = symbols.get(expression, expression)
        # the density of a spread leans to one side
        verdict = Verdict.DETERMINED
        if change:
            text = f"{draw.literal(change)}:\n{text}"
        if name.startswith(_SPREAD):
            expression = name.removeprefix(_SPREAD)
            text = f"spread of\n{symbols.get(expression, expression)}"
            verdict = Verdict.WEAK
        labels[name] = _Label(text, units.get(expression, "1"), verdict)
    return _Content(
        labels=labels,
        ridges={},
        reference={},
        heading=f"{draw.law_and_load(result)}: {result.count} throws together",
        corner=[_Lines(draw.QUIET, [_LEGEND])],
    )


def _panels(number: int) -> tuple[draw.Picture, dict[tuple[int, int], Axes]]:
    """The figure, and its panels by row and column, of which those of a parameter share
    its axis.

    The panels are the lower triangle of a square, for 3 parameters

        0,0
        1,0   1,1
        2,0   2,1   2,2

    so that the upper right corner is free for text. Lengths are in inches, positions
    in the figure in fractions of its width and height.
    """
    count = max(number, 2)  # a single panel leaves room for the text
    width = max(draw.WIDTH, _LEFT + _RIGHT + count * (_SMALLEST + _GAP) - _GAP)
    side = (width - _LEFT - _RIGHT + _GAP) / count  # of a panel and a gap
    height = _TOP + _BOTTOM + number * side - _GAP
    figure = draw.Picture(figsize=(width, height))
    gap = _GAP / (side - _GAP)
    cells = figure.add_gridspec(
        number,
        count,
        wspace=gap,
        hspace=gap,
        left=_LEFT / width,
        right=1 - _RIGHT / width,
        bottom=_BOTTOM / height,
        top=1 - _TOP / height,
    )
    panels: dict[tuple[int, int], Axes] = {}
    for row in range(number):
        for column in range(row + 1):
            panels[row, column] = figure.add_subplot(
                cells[row, column],
                sharex=panels.get((column, column)),
                # on the diagonal the vertical axis counts samples
                sharey=panels.get((row, 0)) if column < row else None,
            )
    return figure, panels


def _names(fit: FitResult) -> list[str]:
    """Coefficients and conditions that are not fixed; if fewer than two, the
    initial state too."""
    free = [
        name
        for name in (*fit.coefficients, *fit.conditions)
        if fit.parameters[name].verdict.is_free
    ]
    if len(free) < 2:
        free += [
            name
            for name in ("v0", "omega0", "heading")
            if fit.parameters[name].verdict.is_free
        ]
    return free


def _limits(values: Floats, reference: float | None) -> tuple[float, float]:
    """Axis limits that enclose the samples, and a reference value if it
    is near them."""
    low, high = map(float, np.quantile(values, [0.001, 0.999]))
    if reference is not None:
        reach = 3 * (high - low)
        if high - reach < reference < low:
            low = reference
        if high < reference < low + reach:
            high = reference
    margin = 0.06 * (high - low) or 1e-9
    return low - margin, high + margin


def _histogram(axes: Axes, verdict: Verdict, values: Floats) -> None:
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
    low, median, high = np.quantile(values, [0.16, 0.5, 0.84]).tolist()
    axes.axvline(median, color="black", lw=0.7)
    for end in (low, high):
        axes.axvline(end, color="black", ls="--", lw=0.7)
    axes.set(ylim=(0, 1.1 * np.max(counts)), yticks=[])
    title = f"{low:.3g} .. {high:.3g}"
    if verdict == Verdict.NOT_IDENTIFIABLE:
        title = verdict
    elif verdict.is_known:
        value, error = format_estimate(median, (high - low) / 2)
        title = f"{value} \N{PLUS-MINUS SIGN} {error}"
    text = axes.set_title(
        title.replace("-", "\N{MINUS SIGN}"), fontsize=7, pad=3, loc="center"
    )
    draw.shrink(text, axes.get_window_extent().width)


def _density(axes: Axes, samples: Floats) -> None:
    """Smallest regions that contain 68 and 95 % of the samples, shape (2, samples).

    The samples are counted in bins, and the counts smoothed by a Gaussian. A region is
    where the density is above a level: that of the bin at which bins, summed from the
    densest, hold its share.
    """
    limits = (axes.get_xlim(), axes.get_ylim())
    counts, *edges = np.histogram2d(samples[0], samples[1], _BINS, limits)
    bins = np.arange(_BINS)
    kernel = np.exp(-((bins[:, None] - bins) ** 2) / (2 * _SMOOTH**2))
    kernel /= kernel.sum(1, keepdims=True)
    # a rim of zeros, a bin wide, closes the contours
    density = np.pad(kernel @ counts @ kernel.T, 1)
    falling = np.sort(density, axis=None)[::-1]
    share = np.cumsum(falling) / falling.sum()
    outer, inner = falling[np.searchsorted(share, _LEVELS)]
    # levels have to rise, even where bins are alike
    levels = np.array([outer, inner, falling[0]]) * (1 + 1e-6 * np.arange(3))
    across = _middles_with_rim(edges[0])
    up = _middles_with_rim(edges[1])
    axes.contourf(across, up, density.T, levels=levels, colors=_SHADES)
    axes.contour(across, up, density.T, levels=levels[:2], colors="0.3", linewidths=0.5)


def _middles_with_rim(edges: Floats) -> Floats:
    """Middles of equal bins and of one more at each end."""
    half = np.diff(edges[:2]) / 2
    return np.append(edges, 2 * edges[-1] - edges[-2]) - half


def _ridges(fit: FitResult, names: list[str]) -> dict[tuple[int, int], _Ridge]:
    """Ridges by row and column of the panel of their two parameters."""
    reference = {} if fit.reference is None else fit.reference.values
    ridges = {}
    for combination in fit.combinations:
        weights = combination.weights
        if len(weights) == 2 and weights.keys() <= set(names):
            column, row = sorted(map(names.index, weights))
            symbols = draw.weighted_sum(weights, fit.parameters)
            value = reference.get(combination.expression)
            ridges[row, column] = _Ridge(weights, symbols, value)
    return ridges


def _draw_ridge(
    axes: Axes, ridge: _Ridge, weights: tuple[float, float], samples: Floats
) -> None:
    """Draw a pair of which only a combination is determined, as points along a line;
    weights of the parameters across and up, samples of shape (2, samples)."""
    across, up = samples[:, :: max(1, samples.shape[1] // _DOTS)]
    axes.plot(
        across,
        up,
        ".",
        color=draw.POSTERIOR_COLOR,
        markersize=1.5,
        mew=0,
        rasterized=True,
    )
    # the corner that the line does not pass: it falls where both weights have one sign
    x = 0.95 if weights[0] * weights[1] > 0 else 0.05
    text = f"only\n${ridge.symbols}$\nis determined"
    note = draw.note(axes, x, 0.95, text, color="black", fontsize=7)
    draw.shrink(note, 0.52 * axes.get_window_extent().width)
    if ridge.reference is not None:
        ends = np.array(axes.get_xlim())
        line = (ridge.reference - weights[0] * ends) / weights[1]
        axes.plot(ends, line, color=draw.REFERENCE_COLOR, lw=1)


def _neat_axes(label: _Label, below: Axes, beside: Axes, has_row: bool) -> None:
    """Set the same few ticks in all panels of a parameter, and label the outermost: the
    lowest of its column and the leftmost of its row."""
    neat_axis(below.xaxis, label.text, label.unit, neighbours=True)
    if has_row:
        neat_axis(beside.yaxis, label.text, label.unit, neighbours=True)
    # labels of all panels in line, at fixed distances in inches
    size = below.get_window_extent()
    dpi = below.figure.dpi
    below.xaxis.set_label_coords(0.5, -0.24 * dpi / size.height)
    beside.yaxis.set_label_coords(-0.42 * dpi / size.width, 0.5)


def _mark(line: Callable[..., object], value: float | None) -> None:
    """Mark a reference value, if there is one."""
    if value is not None:
        line(value, color=draw.REFERENCE_COLOR, lw=1)


def _write_corner(figure: draw.Picture, heading: str, texts: list[_Lines]) -> None:
    """Write what was fitted, combinations and references into the corner
    free of panels."""
    width, height = figure.get_size_inches()
    text = figure.text(_LEFT / width, 1 - 0.06 / height, heading, va="top")
    draw.shrink(text, (width - _LEFT - _RIGHT) * figure.dpi)
    right = 1 - _RIGHT / width
    top = 1 - _TOP / height
    room = right * figure.bbox.width - figure.axes[0].get_window_extent().x1
    for color, lines in texts:
        text = figure.text(
            right,
            top,
            "\n".join(lines),
            color=color,
            ha="right",
            va="top",
            linespacing=1.5,
        )
        draw.shrink(text, room)
        top -= text.get_window_extent().height / figure.bbox.height + 0.1 / height


def _corner_of_fit(fit: FitResult) -> list[_Lines]:
    """Combinations, null directions, the legend and the reference of a fit."""
    estimates = []
    for combination in fit.combinations:
        value, stderr = format_estimate(combination.value, combination.stderr)
        symbols = draw.weighted_sum(combination.weights, fit.parameters)
        estimates.append(rf"${symbols} = {value} \pm {stderr}$")
    for direction in fit.identifiability.null_directions:
        symbols = ", ".join(draw.symbol_of(fit.parameters[name]) for name in direction)
        estimates.append(f"{symbols}: not identifiable individually")
    texts = []
    if estimates:
        texts.append(_Lines("black", estimates))
    texts.append(_Lines(draw.QUIET, [_LEGEND]))
    if fit.reference is not None:
        symbol_by_name = {
            name: parameter.symbol for name, parameter in fit.parameters.items()
        }
        published = [draw.literal(fit.reference.source)]
        for expression, number in fit.reference.values.items():
            text = draw.in_symbols(f"{expression} = {number:g}", symbol_by_name)
            published.append(text)
        texts.append(_Lines(draw.REFERENCE_COLOR, published))
    return texts
