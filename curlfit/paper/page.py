"""The Markdown page and the table of claims. Made from a `Reproduction` alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.table import Table
from rich.text import Text

from curlfit.output.display import Overview
from curlfit.paper.eq28 import R_RANGE, RHO_RANGE
from curlfit.paper.findings import PRINTED
from curlfit.paper.isotropic import CASES, EXPONENTS, SPEEDS, SPINS
from curlfit.paper.printed import EQ_28_STONE, SOLID_RHO

if TYPE_CHECKING:
    from curlfit.paper.claim import Claim
    from curlfit.paper.findings import Example
    from curlfit.paper.reproduce import Reproduction

_STYLE = {"holds": "green", "holds with a correction": "yellow", "does not hold": "bold red"}


def claims_table(claims: tuple[Claim, ...]) -> Table:
    """The claims as a table, readable at 80 columns or more."""
    table = Table(box=box.SIMPLE_HEAD, show_lines=False, pad_edge=False, padding=(0, 1, 1, 0))
    table.add_column("", no_wrap=True, style="bold")
    table.add_column("claim, and why", ratio=33, overflow="fold")
    table.add_column("printed", ratio=27, overflow="fold")
    table.add_column("computed", ratio=30, overflow="fold")
    table.add_column("verdict", width=12)
    table.expand = True
    for one in claims:
        what = Text(one.claim + "\n", style="bold").append(one.why, style="not bold dim")
        verdict = Text(one.verdict, style=_STYLE[one.verdict])
        table.add_row(one.id, what, Text(one.printed), Text(one.computed), verdict)
    return table


def verdicts(claims: tuple[Claim, ...]) -> str:
    """Number of claims by verdict, as a sentence."""
    count = Counter(claim.verdict for claim in claims)
    failed = count["does not hold"]
    return (
        f"Of {len(claims)} claims {count['holds']} hold, {count['holds with a correction']} hold "
        f"with a correction, {failed} {'does' if failed == 1 else 'do'} not hold."
    )


def overview(found: Reproduction) -> Overview:
    """The verdicts and the table of claims."""
    by_verdict: dict[str, list[str]] = {}
    for one in found.claims:
        by_verdict.setdefault(one.verdict, []).append(one.id)
    lines = [f"{verdict}: {', '.join(ids)}" for verdict, ids in by_verdict.items()]
    finding = verdicts(found.claims)
    return Overview(
        finding[:1].lower() + finding[1:].rstrip("."),
        "claims of Ivanov and Shuvalov (2012), recomputed",
        lines,
        [claims_table(found.claims)],
    )


def page(found: Reproduction, format: str = "png") -> str:
    """`claims.md`: the table of claims, and the results behind it with figures of a format."""
    text = "\n\n".join(
        [
            "# The claims of Ivanov and Shuvalov (2012), recomputed",
            "A. P. Ivanov, N. D. Shuvalov, \"Friction in curling game\". Every number under "
            "*computed* comes from the model at the time of the run, by `curlfit reproduce`. "
            "Axes: y along the sheet, x to the right of it; xi to the right of the motion, eta "
            "along it; positive spin is counter-clockwise; SI units.",
            verdicts(found.claims),
            _table([("", "claim", "printed", "computed", "verdict", "why")]
                   + [(f"`{c.id}`", c.claim, c.printed, c.computed, f"**{c.verdict}**", c.why)
                      for c in found.claims]),
            *_trajectory(found),
            *_isotropic(found),
            *_first_order(found),
            *_eq_28(found),
            *_split(found),
        ]
    )  # fmt: skip
    return text.replace(".png)", f".{format})") + "\n"


def _table(rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def _picture(name: str, words: str) -> str:
    return f"![{words}]({name}.png)"


def _trajectory(found: Reproduction) -> list[str]:
    path = found.path
    rows = [
        ("t (s)", "a_xi/a_eta", "most that isotropic friction gives", "T_x/T_y in the ice frame")
    ]
    for k in range(0, 201, 50):
        rows.append(
            (
                f"{path.motion.t[k]:g}",
                f"{path.ratio[k]:.4f}",
                f"{path.limit[k]:.4f}",
                f"{path.ax[k] / path.ay[k]:.4f}",
            )
        )
    return [
        "## The trajectory: eq. 12-17, Prop. 5",
        "Eq. 12 is differentiated by JAX; the coefficients and exponents of eq. 14 follow from "
        f"those derivatives, which agree with derivatives by hand to {path.by_hand:.0e}.",
        _picture("eq14", "Second derivatives of eq. 12 and eq. 14 as printed"),
        "Isotropic friction points, at each ring point, against the sliding there, so its sum "
        "cannot point further aside than the most oblique sliding direction on the ring, "
        "eps/sqrt(1 - eps^2) in the moving frame (R = 0.065 m). Eq. 12 needs more, at every "
        "t <= 20 s:",
        _table(rows),
        _picture("prop5", "Direction of the force that eq. 12 needs, and the limit"),
    ]


def _isotropic(found: Reproduction) -> list[str]:
    iso = found.isotropic
    rows: list[tuple[str, ...]] = [
        (
            "law",
            "states",
            "of these |eps| < 1",
            "left",
            "left with |eps| < 1",
            "left, n1 > 0, n2 < 0, speeding up, rotation slowing",
        )
    ]
    named = [("mu constant (Prop. 2)", iso.coulomb)]
    named += [(f"mu = c v^{k:g} (Prop. 3)", counts) for k, counts in iso.power.items()]
    named += [("mu(v) rising and falling, at random (Prop. 3)", iso.mixture)]
    for name, counts in iso.stribeck.items():
        named.append((f"eq. 11 ({name}), mu > 0 on the whole ring", counts))
        if name in iso.negative:
            named.append((f"eq. 11 ({name}), mu < 0 somewhere", iso.negative[name]))
    for label, counts in named:
        numbers = (counts.states, counts.slow, counts.left, counts.slow_left, counts.remark)
        rows.append((label, *map(str, numbers)))
    below = iso.negative["iii"]
    left_exponents = [k for k, counts in iso.power.items() if counts.left]
    right_exponents = [k for k, counts in iso.power.items() if not counts.left]
    return [
        "## Isotropic friction: Prop. 1-4",
        f"Grid: {len(SPEEDS)} speeds of {SPEEDS[0]:g} to {SPEEDS[-1]:g} m/s and {len(SPINS)} spins "
        f"of {SPINS[len(SPINS) // 2]:g} to {SPINS[-1]:g} 1/s of both senses for every set of "
        f"coefficients: mu = 0.002 to 0.2; c = 0.002 to 0.03 with exponents "
        f"{', '.join(f'{k:g}' for k in EXPONENTS)}; "
        f"{', '.join(str(len(sets)) for sets in CASES.values())} pairs (mu0, mu1) for cases (i), "
        "(ii), (iii). The random functions of v are a constant, a linear rise, a decay and a hump "
        "in random proportions, at random speeds and spins. R = 0.065 m, h = 0.057 m, load by "
        "eq. 8-9; states for which no load with n >= 0 exists are not counted. A clockwise stone "
        "counts as its mirror image.",
        _table(rows),
        _picture("isotropic", "Force across and along the motion against spin"),
        f"States with the largest force to the left: {_example(iso.power_example)}; "
        f"{_example(iso.mixture_example)}; {_example(iso.stribeck_example)}. Under the "
        "consistent load the sideways force has the sign of n2, which is that of -T_eta: a stone "
        "with isotropic mu(v) deviates to the left exactly when friction drives it forward. Of the "
        f"powers of the speed those with exponents up to {max(left_exponents):g} do so beyond "
        f"|eps| = 1, those from {min(right_exponents):g} on never.",
        "Case (iii) of Prop. 4 presumes mu > 0 where the ring slides. Where the line of eq. 11 is "
        f"followed below zero, {below.states - below.left} of {below.states} states deviate to the "
        f"right, and {below.speeds_up} speed up.",
    ]


def _example(one: Example) -> str:
    coefficients = ", ".join(f"{name} = {value:.3g}" for name, value in one.coefficients.items())
    return (
        f"{coefficients} at v = {one.v:.3g} m/s, omega = {one.omega:.3g} 1/s: T_xi/mg = "
        f"{one.t_xi:.1e}, T_eta/mg = {one.t_eta:+.1e}"
    )


def _first_order(found: Reproduction) -> list[str]:
    ring = found.ring
    rows: list[tuple[str, ...]] = [
        ("eps", "eq. 23: T_xi", "T_eta", "M", "eq. 27: T_xi", "T_eta", "M")
    ]
    for k, epsilon in enumerate(ring.radial.epsilon):
        gaps = (*ring.radial.gap[k], *ring.front_back.gap[k])
        rows.append((f"{epsilon:g}", *(f"{gap:.1e}" for gap in gaps)))
    along: list[tuple[str, ...]] = [("t (s)", "l1", "l2", "l3")]
    for k in range(0, 201, 50):
        along.append(
            (f"{ring.t[k]:g}", *(f"{line[k]:.4f}" for line in (ring.l1, ring.l2, ring.l3)))
        )
    along.append(("trajectory fit", *(f"{value:.4f}" for value in ring.radial_l)))
    return [
        "## Anisotropic friction: eq. 23, 24, 27",
        "Largest relative gap between the first-order forms and the ring integrals, uniform load, "
        "one coefficient at a time:",
        _table(rows),
        "Eq. 24 solved at each time (R = 0.065 m, rho = 0.1 m), and the radial law fitted to the "
        "whole path with coefficients of either sign:",
        _table(along),
        _picture("eq24", "Combinations l1, l2, l3 of the radial law over time"),
    ]


def _eq_28(found: Reproduction) -> list[str]:
    eq28 = found.eq28
    posterior = eq28.uncertainty
    rows: list[tuple[str, ...]] = [
        ("method", "R (m)", "rho (m)", "t <= (s)", "mu1_xi", "mu2_xi", "mu1_eta + mu2_eta")
    ]
    printed = (f"{value:g}" for value in PRINTED)
    rows.append(
        ("**printed, eq. 28**", f"{EQ_28_STONE.R:g}", f"{EQ_28_STONE.rho:g}", "20", *printed)
    )
    for row in eq28.rows:
        numbers = (f"{row.radius:g}", f"{row.rho:g}", f"{row.window:g}")
        rows.append((row.method, *numbers, *(f"{value:.5f}" for value in row.mu)))
    intervals: list[tuple[str, ...]] = [("", "mu1_xi", "mu2_xi", "mu1_eta + mu2_eta")]
    intervals.append(("printed", *(f"{value:g}" for value in PRINTED)))
    for label, ends in (
        ("95 %, coefficients >= 0", posterior.interval),
        ("95 %, either sign", posterior.free_interval),
    ):  # fmt: skip
        intervals.append((label, *(f"{low:.5f} .. {high:.5f}" for low, high in ends)))
    intervals.append(("standard error at one stone", *(f"{one:.6f}" for one in posterior.noise)))
    radii, gyration = (f"{limits[0]:g} .. {limits[1]:g} m" for limits in (R_RANGE, RHO_RANGE))
    return [
        "## Eq. 28",
        "*Mean* is the mean of eq. 27 solved at each time; *least squares* the constants that fit "
        "each line of eq. 27 by least squares; a *trajectory fit* is the full ring integrated and "
        "compared with eq. 12 every 0.1 s, with free initial state, channels weighted by their "
        "scatter; "
        "*even weights* weight 1 m as 1 rad; *from the origin* fixes x, y and phi at t = 0 to 0. "
        f"Coefficients may take either sign. rho = {SOLID_RHO:g} m is 0.145 m/sqrt(2), the solid "
        "cylinder of the 29 cm diameter that the paper gives.",
        _table(rows),
        _picture("eq28", "Eq. 28 computed by each method, and its posterior over R and rho"),
        f"**Posterior over the printed rounding.** R and rho are uniform over {radii} and "
        f"{gyration}. At each stone the posterior of all other parameters is Gaussian about its "
        "own fit; mean, covariance, chi-squared and volume are interpolated between fits at "
        f"5 x 5 Chebyshev nodes (error {posterior.check:.0e} standard errors), stones weighted by "
        "their marginal likelihood, and coefficients drawn for each. "
        f"Chi-squared differs by {posterior.preference:.2f} over the whole range: to first "
        "order in eps the coefficients absorb R and rho, which the trajectory does not determine. "
        f"{100 * posterior.positive:.0f} % of the draws have all coefficients positive; the first "
        f"interval keeps these ({posterior.effective:.0f} effective).",
        _table(intervals),
        "The residuals of eq. 12 are smooth, so the standard error is not meaningful; the width of "
        "mu1_xi and mu2_xi comes from R and rho. The interval of the sum hardly depends on the "
        "stone and overlaps the printed 0.018 only within its rounding (0.0175 .. 0.0185); the "
        "time window, which is not part of this posterior, changes it more (table above). "
        f"{100 * posterior.share:.1f} % of the draws round to all three printed numbers: "
        f"they lie near R = {posterior.nearest[0]:.4f} m, rho = {posterior.nearest[1]:.4f} m.",
    ]


def _split(found: Reproduction) -> list[str]:
    ring, fit = found.ring, found.eq28.fit
    rows = [("eps", "uniform load, any force", "consistent load, T_eta")]
    for epsilon, even, tilted in zip(
        ring.split_epsilon, ring.split_uniform, ring.split_consistent, strict=True
    ):
        rows.append((f"{epsilon:g}", f"{even:.0e}", f"{100 * tilted:+.2f} %"))
    return [
        "## The split that is not identifiable",
        f"The path determines {fit.rank} of {len(fit.singular_values)} parameters; along "
        "(mu1_eta, mu2_eta) = (1, -1) the singular value of the scaled Jacobian is "
        f"{fit.singular_values[-1]:.0e}, beside {fit.singular_values[-2]:.0f} for the next. "
        "Relative change of the ring forces when (mu1_eta, mu2_eta) = (0.012, 0.006) is exchanged:",
        _table(rows),
        _picture("split", "Change of the ring forces, and singular values of the fit"),
        "With the consistent load the front carries more (n2 > 0) and the exchange has an effect, "
        "but only on T_eta, which a different sum changes as well.",
    ]
