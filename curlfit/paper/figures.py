"""Figures of the recomputed claims, each of a `Reproduction`. Only units are
converted here."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from curlfit.output import figures as draw
from curlfit.output.figures import Style
from curlfit.output.panels import Interval, Row, RowValue, Series, plot, plot_rows
from curlfit.output.ticks import neat_axis
from curlfit.paper import printed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BLUE = draw.PALETTE[0]
_RED = draw.PALETTE[1]
_PINK = draw.PALETTE[3]
_CORRECT = draw.PALETTE[6]
_DERIVED = Style(_CORRECT, width=1.4)
_AS_PRINTED = Style(draw.REFERENCE_COLOR, "--", width=1.5)
_FAINT = Style("0.6", width=0.8)
_AXIS = Style("0.4", width=0.8)
_UNIT = Style("0.6", "--", width=1)
_SOLVED = Style(_BLUE, "none", marker="s", zorder=3)
_FITTED = Style(_CORRECT, "none", marker="o", zorder=3)
_SPLIT_NAME = r"$(\mu_{1\eta}, \mu_{2\eta})$"


def _note(
    axes: Axes,
    text: str,
    point: tuple[float, float],
    offset: tuple[float, float] = (-8, 9),
    **options: Any,
) -> None:
    """Text to the left of a point of the data, at an offset in points of print."""
    axes.annotate(
        text, point, offset, textcoords="offset points", ha="right", **options
    )


def _sign_change(axes: Axes, zero: float, name: str = "") -> None:
    """Mark the time, s, at which a curve changes its sign."""
    axes.plot(zero, 0, "o", color=_CORRECT, ms=5)
    _note(axes, f"{name}changes sign at {zero:.1f} s", (zero, 0))


@draw.style()
def eq_14_figure(studies: Any) -> draw.Picture:
    """Second derivatives of eq. 12 and eq. 14 as printed."""
    path = studies.path
    figure, (across, along) = draw.subplots(2.7, 1, 2)
    for axes, derivative, as_printed, name in (
        (across, path.ax, path.ax_printed, "x"),
        (along, path.ay, path.ay_printed, "y"),
    ):
        plot(
            axes,
            Series(path.t, 1000 * derivative, _DERIVED, "derivative of eq. 12"),
            Series(path.t, 1000 * as_printed, _AS_PRINTED, "eq. 14 as printed"),
        )
        axes.set(xlabel="t (s)", ylabel=rf"$d^2{name}/dt^2$ (mm/s$^2$)", xlim=(0, 20))
    across.axhline(0, **_FAINT.options())
    _sign_change(across, path.sign_change)
    across.set_title("across the sheet: a sign is wrong in print")
    title = f"along the sheet: the exponent is {path.y_form[1]:.3f}, not -0.013"
    along.set_title(title.replace("-", "\N{MINUS SIGN}"))
    across.legend(loc="lower left")
    return figure


@draw.style()
def isotropic_figure(studies: Any) -> draw.Picture:
    """Force across and along the motion against spin, under consistent load."""
    figure, (across, along) = draw.subplots(
        5.5, 2, 1, sharex=True, height_ratios=(1.35, 1.0)
    )
    rolling = 2 / 0.065  # 1/s, at which the ring turns as fast as the stone moves
    small = 1e-8  # below which the scale of the force is linear
    large = 3e-4
    colors = (_CORRECT, *draw.PALETTE[:5])
    for curve, color in zip(studies.isotropic.curves, colors, strict=True):
        label, omega, t_xi, t_eta, least = curve
        dotted = Style(color, ":", width=1)
        for axes, force in ((across, t_xi), (along, t_eta)):
            braking = np.where(least > 0, force, np.nan)
            plot(
                axes,
                Series(omega, force, dotted),
                Series(omega, braking, Style(color, width=1.4), label),
            )
    nothing = np.zeros(0)
    explained = r"dotted: $\mu<0$ somewhere on the ring"
    plot(across, Series(nothing, nothing, Style("0.6", ":", width=1), explained))
    across.set_yscale("symlog", linthresh=small, linscale=0.5)
    across.set(ylim=(-large, large), yticks=[-1e-4, -1e-6, 0, 1e-6, 1e-4])
    for side, sign, color, alpha in (
        ("right", 1, _BLUE, 0.06),
        ("left", -1, _RED, 0.07),
    ):
        across.axhspan(0, sign * large, color=color, alpha=alpha, lw=0)
        across.text(
            0.32, sign * 1.2e-4, f"deviates to the {side}", color=color, va="center"
        )
    across.set_ylabel(r"force to the right over weight, $T_\xi/mg$")
    across.set_title("Counter-clockwise stone at 2 m/s, consistent load")
    along.axhspan(0, 1, color="0.5", alpha=0.1, lw=0)
    along.text(0.32, 0.0072, "speeds up", color=draw.QUIET, va="center")
    along.set(
        ylabel=r"force along over weight, $T_\eta/mg$", xlabel=r"spin $\omega$ (1/s)"
    )
    along.set(xscale="log", xlim=(0.3, 200), ylim=(-0.021, 0.009))
    for axes in (across, along):
        axes.axvline(rolling, **_UNIT.options())
        axes.axhline(0, **_AXIS.options())
    along.text(
        0.96 * rolling, -0.0205, r"$\varepsilon = 1$", color=draw.QUIET, ha="right"
    )
    figure.legend(
        *across.get_legend_handles_labels(), loc="outside lower center", ncols=3
    )
    return figure


@draw.style()
def prop_5_figure(studies: Any) -> draw.Picture:
    """Direction of the force of eq. 12, and the bound of isotropic friction."""
    path = studies.path
    t = path.t
    figure, (moving, ice) = draw.subplots(2.8, 1, 2)
    moving.fill_between(t, 0, path.limit, color=_BLUE, alpha=0.15, lw=0)
    plot(
        moving,
        Series(t, path.limit, Style(_BLUE, width=1.5)),
        Series(t, path.ratio, _DERIVED),
    )
    _note(
        moving, r"required by eq. 12: $a_\xi/a_\eta$", (11, path.ratio[110]), (-6, 14)
    )
    words = (
        "range of isotropic friction:\nat most " r"$\varepsilon/\sqrt{1-\varepsilon^2}$"
    )
    moving.text(1.0, 0.010, words, color=_BLUE)
    moving.set(
        xlabel="t (s)",
        ylabel="force across over force along",
        xlim=(0, 20),
        ylim=(0, None),
    )
    moving.set_title("moving frame: Prop. 5 stands")
    ice.axhline(0, **_FAINT.options())
    ice.axhline(0.1, color=_PINK, lw=1.2)
    ice.text(0.3, 0.104, "0.1 of the proof", color=_PINK)
    as_printed = path.ax_printed / path.ay_printed
    plot(
        ice,
        Series(t, path.ax / path.ay, _DERIVED, "derivatives of eq. 12"),
        Series(t, as_printed, _AS_PRINTED, "eq. 14 as printed"),
    )
    ice.set(xlabel="t (s)", ylabel=r"$T_x/T_y$", xlim=(0, 20))
    ice.set_title(r"ice frame: the proof's $T_x \geq 0.1\,T_y$ does not hold")
    ice.legend(loc="upper left", bbox_to_anchor=(0, 0.93))
    return figure


@draw.style()
def eq_24_figure(studies: Any) -> draw.Picture:
    """The combinations of the radial law's coefficients in eq. 24."""
    ring = studies.ring
    figure, axes = draw.subplots(3.2, 1, 1, width=0.8 * draw.WIDTH)
    axes.axhspan(-0.05, 0, color=_RED, alpha=0.07, lw=0)
    axes.axhline(0, **_AXIS.options())
    names = (
        r"$l_1 = \mu_1 + \mu_2$",
        r"$l_2 = \mu_3 + \mu_4$",
        r"$l_3 = \mu_1 + 2\mu_3$",
    )
    for series, fitted, name, color in zip(
        ring.l, ring.fitted_l, names, (_CORRECT, _BLUE, _RED), strict=False
    ):
        plot(axes, Series(ring.t, series, Style(color, width=1.4)))
        axes.plot(20.6, fitted, "D", color=color, ms=5, clip_on=False)
        axes.text(0.4, series[0] - 0.0018, name, color=color, va="top")
    axes.text(20.9, 0.045, "fit of the trajectory", ha="right", color=draw.QUIET)
    if ring.l1_zero is not None:
        _sign_change(axes, ring.l1_zero, "$l_1$ ")
    axes.text(
        10,
        -0.0465,
        "no friction: some coefficient is negative",
        color=_RED,
        ha="center",
    )
    axes.set(
        xlabel="t (s)", ylabel="eq. 24, R = 0.065 m", xlim=(0, 21), ylim=(-0.05, 0.05)
    )
    axes.set_xticks(range(0, 21, 5))
    return figure


@draw.style()
def eq_28_figure(studies: Any) -> draw.Picture:
    """Eq. 28 by every method, and its posterior over R and rho."""
    methods = [row for row in studies.eq28.rows if "eq. 14" not in row.method]
    posterior = studies.eq28.posterior
    figure, panels = draw.subplots(6.2, 2, 3, height_ratios=(3.2, 1.0), sharex="col")
    limits = ((-0.0042, 0.0042), (0.0405, 0.0605), (0.0148, 0.0186))
    for column, (values, below) in enumerate(panels.T):
        value = printed.PRINTED[column]
        rounding = printed.HALF_DIGIT[column]
        color = draw.REFERENCE_COLOR
        rounded = Interval(value - rounding, value + rounding, color, 0.35)
        if column > 0:
            values.sharey(panels[0, 0])
            values.tick_params(axis="y", left=False, labelleft=False)
        plot_rows(values, [_method(row, column) for row in methods], rounded)
        values.set_title(f"printed: {value:g}", loc="center")
        below.axvspan(rounded.low, rounded.high, color=color, alpha=0.35, lw=0)
        for axes in (values, below):
            axes.axvline(value, color=color, lw=1)
        below.hist(
            posterior.mu[:, column], bins=40, color=draw.POSTERIOR_COLOR, density=True
        )
        for end in posterior.interval[column]:
            below.axvline(end, color=_CORRECT, lw=1, ls=":")
        below.set(yticks=[], xlim=limits[column])
    for axes in panels[:, 0]:
        axes.axvline(0, **_AXIS.options())
    posteriors = (
        r"posterior over R 0.0535..0.0545 m, $\rho$ 0.095..0.105 m (dotted: 95 %)"
    )
    solved = replace(_SOLVED, size=6).options()
    fitted = replace(_FITTED, size=6).options()
    handles = [
        Line2D([], [], label="eq. 27 solved at each t", **solved),
        Line2D([], [], label="fit of the trajectory", **fitted),
        Patch(
            color=draw.REFERENCE_COLOR, alpha=0.35, label="eq. 28 within its rounding"
        ),
        Patch(color=draw.POSTERIOR_COLOR, label=posteriors),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    figure.draw_without_rendering()  # the layout determines the ticks
    symbols = (r"$\mu_{1\xi}$", r"$\mu_{2\xi}$", r"$\mu_{1\eta}+\mu_{2\eta}$")
    for axes, symbol in zip(panels[1], symbols, strict=True):
        neat_axis(axes.xaxis, symbol)
    return figure


def _method(row: printed.Row, column: int) -> Row:
    """A column of eq. 28 by one method, in the style of its kind, named without the
    words that this style says."""
    style = _FITTED if "trajectory" in row.method else _SOLVED
    method = row.method.replace("eq. 27 at each t, ", "").replace("trajectory fit", "")
    method = method.removeprefix(", ")
    stone = rf"R {row.radius:g}, $\rho$ {row.rho:g}, $t \leq$ {row.window:g} s"
    name = f"{method}; {stone}" if method else stone
    return Row(name, [RowValue(row.mu[column], style)])


@draw.style()
def split_figure(studies: Any) -> draw.Picture:
    """Effect of exchanging mu1_eta and mu2_eta, and singular values of the fit."""
    ring = studies.ring
    figure, (change, spectrum) = draw.subplots(2.8, 1, 2)
    change.loglog(
        ring.split_epsilon,
        np.maximum(ring.split_uniform, 5e-17),
        "o-",
        color=_CORRECT,
        label="uniform load: rounding or less",
    )
    change.loglog(
        ring.split_epsilon,
        np.abs(ring.split_consistent),
        "s-",
        color=_RED,
        label=r"consistent load ($T_\eta$)",
    )
    change.axvline(1, **_UNIT.options())
    change.set(
        xlabel=r"$\varepsilon = R\omega/v$", ylabel="relative change of the force"
    )
    change.set_ylim(1e-17, 1)
    change.set_title(_SPLIT_NAME + " = (0.012, 0.006) exchanged")
    change.legend(loc="center left")
    values = np.array(studies.eq28.fit.identifiability.singular_values)
    order = np.arange(1, len(values) + 1)
    spectrum.semilogy(order[:-1], values[:-1], "o", color=_CORRECT)
    spectrum.semilogy(order[-1:], values[-1:], "o", color=_RED)
    spectrum.axhline(1, **_UNIT.options())
    spectrum.text(
        1, 0.3, "below 1 a direction is not determined", color=draw.QUIET, va="top"
    )
    _note(
        spectrum,
        _SPLIT_NAME + " along $(1, -1)$",
        (order[-1], values[-1]),
        (-10, 0),
        va="center",
        color=_RED,
    )
    spectrum.set(
        xlabel="direction in parameter space", ylabel="singular value", xticks=order
    )
    spectrum.set_title("singular values, path of eq. 12 (front-back law)")
    return figure


FIGURES = {
    "eq14": eq_14_figure,
    "isotropic": isotropic_figure,
    "prop5": prop_5_figure,
    "eq24": eq_24_figure,
    "eq28": eq_28_figure,
    "split": split_figure,
}
"""Figures of the page by file name."""
