"""Figures of the recomputed claims. Only units are converted here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from curlfit.output.figures import (
    PALETTE,
    POSTERIOR_COLOR,
    QUIET,
    REFERENCE_COLOR,
    WIDTH,
    Picture,
    styled,
)
from curlfit.output.ticks import neat_axis
from curlfit.paper.findings import (
    HALF_DIGIT,
    NAMES,
    PRINTED,
    SHOWN,
    Eq28Findings,
    IsotropicFindings,
    PathFindings,
    RingFindings,
)

if TYPE_CHECKING:
    from curlfit.paper.reproduce import Reproduction

_CORRECT = PALETTE[6]
_PRINTED = REFERENCE_COLOR
_COLORS = (_CORRECT, *PALETTE[:5])
_FAINT = "0.6"


def _figure(height: float, width: float = WIDTH) -> Figure:
    return Picture(figsize=(width, height), layout="constrained")


@styled
def eq_14_figure(path: PathFindings) -> Figure:
    """Second derivatives of eq. 12 and eq. 14 as printed."""
    figure = _figure(2.7)
    t = path.motion.t
    across, along = figure.subplots(1, 2)
    for axes, right, printed, name in (
        (across, path.ax, path.ax_printed, "x"),
        (along, path.ay, path.ay_printed, "y"),
    ):
        axes.plot(t, 1000 * right, color=_CORRECT, lw=1.4, label="derivative of eq. 12")
        axes.plot(t, 1000 * printed, color=_PRINTED, lw=1.5, ls="--", label="eq. 14 as printed")
        axes.set(xlabel="t (s)", ylabel=rf"$d^2{name}/dt^2$ (mm/s$^2$)", xlim=(0, 20))
    across.axhline(0, color=_FAINT, lw=0.8)
    across.plot(path.sign_change, 0, "o", color=_CORRECT, ms=5)
    across.annotate(
        f"changes sign at {path.sign_change:.1f} s", (path.sign_change, 0), (-8, 9),
        textcoords="offset points", ha="right",
    )  # fmt: skip
    across.set_title("across the sheet: a sign is wrong in print", loc="left")
    along.set_title(
        f"along the sheet: the exponent is {path.y_form[1]:.3f}, not -0.013".replace(
            "-", "\N{MINUS SIGN}"
        ),
        loc="left",
    )
    across.legend(loc="lower left")
    return figure


@styled
def isotropic_figure(isotropic: IsotropicFindings) -> Figure:
    """Force across and along the motion against spin, under consistent load."""
    figure = _figure(5.5)
    across, along = figure.subplots(2, 1, sharex=True, height_ratios=(1.35, 1.0))
    small, large = 1e-8, 3e-4
    for curve, color in zip(isotropic.curves, _COLORS, strict=True):
        whole = curve.least > 0
        for axes, series in ((across, curve.t_xi), (along, curve.t_eta)):
            axes.plot(curve.omega, series, color=color, lw=1, ls=":")
            axes.plot(curve.omega, np.where(whole, series, np.nan), color=color, lw=1.4)
        across.plot([], [], color=color, lw=1.4, label=_math(curve.label))
    across.plot([], [], color=_FAINT, lw=1, ls=":", label=r"dotted: $\mu<0$ somewhere on the ring")
    across.set_yscale("symlog", linthresh=small, linscale=0.5)
    across.set_ylim(-large, large)
    across.set_yticks([-1e-4, -1e-6, 0, 1e-6, 1e-4])
    across.axhspan(0, large, color=_COLORS[1], alpha=0.06, lw=0)
    across.axhspan(-large, 0, color=_COLORS[2], alpha=0.07, lw=0)
    across.text(0.32, 1.2e-4, "deviates to the right", color=_COLORS[1], va="center")
    across.text(0.32, -1.2e-4, "deviates to the left", color=_COLORS[2], va="center")
    across.set_ylabel(r"force to the right over weight, $T_\xi/mg$")
    across.set_title(
        "Counter-clockwise stone at 2 m/s, consistent load",
        loc="left",
    )  # fmt: skip
    along.axhspan(0, 1, color="0.5", alpha=0.1, lw=0)
    along.set_ylim(-0.021, 0.009)
    along.text(0.32, 0.0072, "speeds up", color=QUIET, va="center")
    along.set(ylabel=r"force along over weight, $T_\eta/mg$", xlabel=r"spin $\omega$ (1/s)")
    along.set_xscale("log")
    along.set_xlim(0.3, 200)
    for axes in (across, along):
        axes.axvline(2 / 0.065, color=_FAINT, lw=1, ls="--")
        axes.axhline(0, color="0.4", lw=0.8)
    along.text(2 / 0.065 * 0.96, -0.0205, r"$\varepsilon = 1$", color=QUIET, ha="right")
    figure.legend(
        *across.get_legend_handles_labels(), loc="outside lower center", ncols=3,
    )  # fmt: skip
    return figure


def _math(label: str) -> str:
    case, _, formula = label.rpartition("mu = ")
    formula, _, name = formula.partition(" (")
    formula = formula.replace("n0/n", r"\,n_0/n").replace(" |v|", r"\,|v|")
    return f"{case}$\\mu = {formula}$" + (f" ({name}" if name else "")


@styled
def prop_5_figure(path: PathFindings) -> Figure:
    """Direction of the force of eq. 12, and the bound of isotropic friction."""
    figure = _figure(2.8)
    t = path.motion.t
    moving, ice = figure.subplots(1, 2)
    moving.fill_between(t, 0, path.limit, color=_COLORS[1], alpha=0.15, lw=0)
    moving.plot(t, path.limit, color=_COLORS[1], lw=1.5)
    moving.plot(t, path.ratio, color=_CORRECT, lw=1.4)
    moving.annotate(
        r"required by eq. 12: $a_\xi/a_\eta$", (11, path.ratio[110]), (-6, 14),
        textcoords="offset points", ha="right",
    )  # fmt: skip
    moving.text(
        1.0, 0.010, "range of isotropic friction:\nat most "
        r"$\varepsilon/\sqrt{1-\varepsilon^2}$", color=_COLORS[1],
    )  # fmt: skip
    moving.set(xlabel="t (s)", ylabel="force across over force along", xlim=(0, 20), ylim=(0, None))
    moving.set_title("moving frame: Prop. 5 stands", loc="left")
    ice.axhline(0, color=_FAINT, lw=0.8)
    ice.axhline(0.1, color=_COLORS[4], lw=1.2)
    ice.text(0.3, 0.104, "0.1 of the proof", color=_COLORS[4])
    ice.plot(t, path.ax / path.ay, color=_CORRECT, lw=1.4, label="derivatives of eq. 12")
    ice.plot(
        t, path.ax_printed / path.ay_printed, color=_PRINTED, lw=1.5, ls="--",
        label="eq. 14 as printed",
    )  # fmt: skip
    ice.set(xlabel="t (s)", ylabel=r"$T_x/T_y$", xlim=(0, 20))
    ice.set_title(r"ice frame: the proof's $T_x \geq 0.1\,T_y$ does not hold", loc="left")
    ice.legend(loc="upper left", bbox_to_anchor=(0, 0.93))
    return figure


@styled
def eq_24_figure(ring: RingFindings) -> Figure:
    """The combinations of the radial law's coefficients in eq. 24."""
    figure = _figure(3.2, 0.8 * WIDTH)
    axes = figure.subplots()
    axes.axhspan(-0.05, 0, color=_COLORS[2], alpha=0.07, lw=0)
    axes.axhline(0, color="0.4", lw=0.8)
    for series, fitted, name, color in zip(
        (ring.l1, ring.l2, ring.l3), ring.radial_l,
        (r"$l_1 = \mu_1 + \mu_2$", r"$l_2 = \mu_3 + \mu_4$", r"$l_3 = \mu_1 + 2\mu_3$"),
        _COLORS[:3], strict=True,
    ):  # fmt: skip
        axes.plot(ring.t, series, color=color, lw=1.4)
        axes.plot(20.6, fitted, "D", color=color, ms=5, clip_on=False)
        axes.text(0.4, series[0] - 0.0018, name, color=color, va="top")
    axes.text(20.9, 0.045, "fit of the trajectory", ha="right", color=QUIET)
    if ring.l1_zero is not None:
        axes.plot(ring.l1_zero, 0, "o", color=_COLORS[0], ms=5)
        axes.annotate(
            f"$l_1$ changes sign at {ring.l1_zero:.1f} s", (ring.l1_zero, 0), (-8, 9),
            textcoords="offset points", ha="right",
        )  # fmt: skip
    axes.text(
        10, -0.0465, "no friction: some coefficient is negative",
        color=_COLORS[2], ha="center",
    )  # fmt: skip
    axes.set(xlabel="t (s)", ylabel="eq. 24, R = 0.065 m", xlim=(0, 21), ylim=(-0.05, 0.05))
    axes.set_xticks(range(0, 21, 5))
    return figure


@styled
def eq_28_figure(eq28: Eq28Findings) -> Figure:
    """Eq. 28 by every method, and its posterior over R and rho."""
    rows = [row for row in eq28.rows if "eq. 14" not in row.method]
    posterior = eq28.uncertainty
    figure = _figure(6.2)
    panels = figure.subplots(2, 3, height_ratios=(3.2, 1.0), sharex="col")
    limits = ((-0.0042, 0.0042), (0.0405, 0.0605), (0.0148, 0.0186))
    symbols = (r"$\mu_{1\xi}$", r"$\mu_{2\xi}$", r"$\mu_{1\eta}+\mu_{2\eta}$")
    heights = np.arange(len(rows))[::-1]
    for column in range(len(NAMES)):
        dots, below = panels[:, column]
        low, high = PRINTED[column] + HALF_DIGIT[column] * np.array([-1, 1])
        for axes in (dots, below):
            axes.axvspan(low, high, color=_PRINTED, alpha=0.35, lw=0)
            axes.axvline(PRINTED[column], color=_PRINTED, lw=1)
        for row, height in zip(rows, heights, strict=True):
            fitted = row.method.startswith("trajectory")
            dots.axhline(height, color="0.92", lw=0.8, zorder=0)
            dots.plot(row.mu[column], height, "o" if fitted else "s", ms=4, zorder=3,
                      color=_CORRECT if fitted else _COLORS[1])  # fmt: skip
        dots.set_title(f"printed: {PRINTED[column]:g}")
        dots.set_ylim(-0.7, len(rows) - 0.3)
        dots.set_yticks([])
        below.hist(posterior.mu[:, column], bins=40, color=POSTERIOR_COLOR, density=True)
        for end in posterior.interval[column]:
            below.axvline(end, color=_CORRECT, lw=1, ls=":")
        below.set_yticks([])
        below.set_xlim(*limits[column])
    for marker, color, label in (
        ("s", _COLORS[1], "eq. 27 solved at each t"), ("o", _CORRECT, "fit of the trajectory"),
    ):  # fmt: skip
        panels[0, 0].plot([], [], marker, color=color, ms=6, label=label)
    panels[0, 0].fill_between(
        [], [], color=_PRINTED, alpha=0.35, label="eq. 28 within its rounding"
    )
    panels[0, 0].fill_between(
        [], [], color=POSTERIOR_COLOR,
        label=r"posterior over R 0.0535..0.0545 m, $\rho$ 0.095..0.105 m (dotted: 95 %)",
    )  # fmt: skip
    handles = panels[0, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=2)
    first = panels[0, 0]
    first.axvline(0, color="0.4", lw=0.8)
    panels[1, 0].axvline(0, color="0.4", lw=0.8)
    first.set_yticks(heights, [_method_label(row) for row in rows])
    figure.draw_without_rendering()  # the layout determines the ticks
    for axes, symbol in zip(panels[1], symbols, strict=True):
        neat_axis(axes.xaxis, symbol)
    return figure


def _method_label(row: Any) -> str:
    method = row.method.replace("eq. 27 at each t, ", "").replace("trajectory fit", "")
    method = method.removeprefix(", ")
    stone = rf"R {row.radius:g}, $\rho$ {row.rho:g}, $t \leq$ {row.window:g} s"
    return f"{method}; {stone}" if method else stone


@styled
def split_figure(ring: RingFindings, eq28: Eq28Findings) -> Figure:
    """Effect of exchanging mu1_eta and mu2_eta, and singular values of the fit."""
    figure = _figure(2.8)
    change, spectrum = figure.subplots(1, 2)
    change.loglog(
        ring.split_epsilon, np.maximum(ring.split_uniform, 5e-17), "o-", color=_CORRECT,
        label="uniform load: rounding or less",
    )  # fmt: skip
    change.loglog(
        ring.split_epsilon, np.abs(ring.split_consistent), "s-", color=_COLORS[2],
        label=r"consistent load ($T_\eta$)",
    )  # fmt: skip
    change.axvline(1, color=_FAINT, lw=1, ls="--")
    change.set(xlabel=r"$\varepsilon = R\omega/v$", ylabel="relative change of the force",
               ylim=(1e-17, 1))  # fmt: skip
    change.set_title(r"$(\mu_{1\eta}, \mu_{2\eta})$ = (0.012, 0.006) exchanged", loc="left")
    change.legend(loc="center left")
    values = np.array(eq28.fit.singular_values)
    order = np.arange(1, len(values) + 1)
    spectrum.semilogy(order[:-1], values[:-1], "o", color=_CORRECT)
    spectrum.semilogy(order[-1:], values[-1:], "o", color=_COLORS[2])
    spectrum.axhline(1, color=_FAINT, lw=1, ls="--")
    spectrum.text(1, 0.3, "below 1 a direction is not determined", color=QUIET, va="top")
    spectrum.annotate(
        r"$(\mu_{1\eta}, \mu_{2\eta})$ along $(1, -1)$", (order[-1], values[-1]), (-10, 0),
        textcoords="offset points", ha="right", va="center", color=_COLORS[2],
    )  # fmt: skip
    spectrum.set(xlabel="direction in parameter space", ylabel="singular value")
    spectrum.set_xticks(order)
    spectrum.set_title("singular values, path of eq. 12 (front-back law)", loc="left")
    return figure


class Drawing(NamedTuple):
    """A figure, and the studies whose findings it shows."""

    draw: Any
    """a function of these findings"""
    studies: tuple[str, ...]

    def __call__(self, found: Reproduction) -> Figure:
        """The figure of a whole reproduction."""
        figure: Figure = self.draw(*(getattr(found, name) for name in self.studies))
        return figure


FIGURES = {
    name: Drawing(draw, SHOWN[name])
    for name, draw in {
        "eq14": eq_14_figure,
        "isotropic": isotropic_figure,
        "prop5": prop_5_figure,
        "eq24": eq_24_figure,
        "eq28": eq_28_figure,
        "split": split_figure,
    }.items()
}
"""Figures of the page by file name."""
