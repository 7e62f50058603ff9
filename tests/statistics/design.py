"""Whether throws that are to decide between laws do so as often as the design promises.

    python tests/statistics/design.py SETS

writes the table of README.md beside this file: the plan of `curlfit.discriminate`
for each pair of laws, made SETS times with noise under each law and fitted
together with both.
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest
from tables import Table, marked

import curlfit
from curlfit.environment import Environment
from curlfit.optimal_design.discrimination import DECISIVE

SEED = 5
GRID: dict[str, Any] = {
    "v0": [1.8, 2.2],
    "omega0": [0.5, 1.0, 2.0],
    "rate": 2.0,
    "until": 18.0,
}
SLOPES = {"slope_x": 1e-4, "slope_y": 1e-4}


class Case(NamedTuple):
    """Two laws, the noise in x and y (m), twice as much in phi (rad), and
    conditions not known."""

    laws: tuple[str, str]
    noise: float
    widths: dict[str, float]


CASES = (
    Case(("front-back", "power+pivot"), 0.3, {}),
    Case(("power+sideways", "power+transverse"), 0.1, {}),
    Case(("power+transverse", "power+pivot"), 0.1, SLOPES),
)


def made(
    found: curlfit.Discrimination,
    law: curlfit.Law,
    widths: dict[str, float],
    random: np.random.Generator,
) -> list[curlfit.Throw]:
    """The chosen throws with noise, on ice whose conditions are off by their widths."""
    off = {name: width * random.standard_normal() for name, width in widths.items()}
    t = np.arange(int(found.until * found.rate) + 1) / found.rate
    throws = []
    for candidate in (found.candidates[index] for index in found.throws):
        start = curlfit.InitialState(v=candidate.v0, omega=candidate.omega0)
        environment = Environment(**off) if off else None
        path = curlfit.simulate(
            law, found.stone, start, t, environment=environment
        ).to_numpy()
        channels = {
            name: getattr(path, name) + size * random.standard_normal(len(t))
            for name, size in found.sigma.items()
        }
        throws.append(
            curlfit.Throw.from_arrays(
                t, **channels, sigma=found.sigma, defaults={"as_given": True}
            )
        )
    return throws


def bic(throws: list[curlfit.Throw], law: str, widths: dict[str, float]) -> float:
    """Of all throws together, with what conditions take by their priors."""
    choices: dict[str, Any] = {
        "priors": {name: f"0+-{width}" for name, width in widths.items()},
        "systematics": {"all": 0.0},
    }
    fit: Any
    if len(throws) == 1:
        fit = curlfit.fit(throws[0], law, details=False, **choices)
        fits = (fit,)
        estimates = fit.parameters
    else:
        fit = curlfit.fit_together(throws, law, share="all", **choices)
        fits = fit.throws
        estimates = fit.coefficients
    n = sum(throw_fit.n_observations for throw_fit in fits)
    priors = sum((estimates[name].value / width) ** 2 for name, width in widths.items())
    return float(
        sum(throw_fit.chi_squared for throw_fit in fits)
        + priors
        + fit.identifiability.rank * np.log(n)
    )


def add_lines(table: Table, case: Case, sets: int) -> None:
    """The promise and what came of it, for each law as the true one."""
    sigma = {"x": case.noise, "y": case.noise, "phi": 2 * case.noise}
    discrimination = curlfit.discriminate(
        case.laws, sigma=sigma, systematics={"all": 0.0, **case.widths}, **GRID
    )
    for pair in discrimination.pairs:
        random = np.random.default_rng(SEED)
        law = curlfit.law_with(pair.truth, discrimination.laws[pair.truth])
        odds = []
        for _ in range(sets):
            throws = made(discrimination, law, case.widths, random)
            true, rival = (
                bic(throws, name, case.widths) for name in (pair.truth, pair.rival)
            )
            odds.append((rival - true) / 2)
        cells: list[object] = [
            f"`{pair.truth}`",
            f"`{pair.rival}`",
            f"{case.noise:g} m",
            len(discrimination.throws),
            f"{pair.log_odds:.1f} ± {pair.sd:.1f}",
            f"{np.mean(odds):.1f} ± {np.std(odds):.1f}",
        ]
        for promised, least in ((pair.wins, 0.0), (pair.decides, DECISIVE)):
            count = sum(log_odds > least for log_odds in odds)
            p = binomtest(
                count, sets, min(promised, 1 - 1e-12), alternative="less"
            ).pvalue
            cells += [f"{100 * promised:.1f} %", marked(f"{count} of {sets}", p)]
        table.add(*cells)


def main() -> None:
    """Make the table."""
    table = Table(
        "true law",
        "rival",
        "noise",
        "throws",
        "log odds promised",
        "log odds found",
        "true law leads: promised",
        "found",
        "by 100 to 1: promised",
        "found",
    )
    for case in CASES:
        add_lines(table, case, int(sys.argv[1]))
    table.put("decisions")


if __name__ == "__main__":
    main()
