"""How far a true law is behind the best of all laws, where noise is correlated
from row to row.

    python tests/statistics/laws.py THROWS

writes the table "laws" of README.md beside this file. Throws under `coulomb` are drawn
as in `errors.py`, fitted by all laws with independent and with AR(1) noise, and ranked
by BIC as by `curlfit compare`, once among the fits of one noise model and once among
all. Counted is how often the BIC of `coulomb` is at most 6 above the least: a
difference beyond is strong evidence (Kass and Raftery 1995).
"""

from __future__ import annotations

import sys
from itertools import chain

import numpy as np
from errors import Case, thrown
from tables import Table

import curlfit
from curlfit.comparison.criteria import criteria, effective_values, log_likelihood
from curlfit.friction.registry import laws_under
from curlfit.inference.fit.fit import fit_throws

TRUE = "coulomb"
MEMORIES = (0.3, 1.0, 0.0)
NOISES = ("white", "ar1")
STRONG = 6.0
SEED = 1


def delta_bic(fits: list[curlfit.FitResult]) -> dict[str, float]:
    """Of the fits of some laws to one throw, by law, above the least."""
    likelihoods = [log_likelihood(fit) for fit in fits]
    best = max(range(len(fits)), key=lambda index: sum(likelihoods[index].values()))
    effective = effective_values(fits[best])
    bic_by_law: dict[str, float] = {}
    for fit, likelihood in zip(fits, likelihoods, strict=True):
        bic = criteria(fit, likelihood, effective)["bic"]
        bic_by_law[fit.law] = min(bic, bic_by_law.get(fit.law, np.inf))
    return {law: bic - min(bic_by_law.values()) for law, bic in bic_by_law.items()}


def main() -> None:
    """Run the cases and write their table."""
    number = int(sys.argv[1])
    table = Table(
        "correlation time",
        "noise models",
        f"within {STRONG:g}",
        "first",
        "median",
        "95 %",
        "largest dBIC of the true law",
    )
    for memory in MEMORIES:
        random = np.random.default_rng(SEED)
        case = Case("", TRUE, TRUE, memory)
        throws = [thrown(case, random)[0] for _ in range(number)]
        fits = {}
        every = laws_under(None)
        for noise in NOISES:
            by_law = [fit_throws(throws, law, noise=noise) for law, _ in every]
            fits[noise] = list(zip(*by_law, strict=True))
        for noises in (("white",), ("ar1",), NOISES):
            behind = []
            for throw_fits in zip(*(fits[noise] for noise in noises), strict=True):
                usable = [
                    fit
                    for fit in chain(*throw_fits)
                    if not isinstance(fit, Exception) and fit.converged
                ]
                behind.append(delta_bic(usable)[TRUE])
            size = np.array(behind)
            table.add(
                f"{memory:g} s" if memory else "independent",
                " and ".join(noises),
                f"{(size <= STRONG).sum()} of {number}",
                f"{(size < 0.05).sum()}",
                *(
                    f"{quantile:.1f}"
                    for quantile in np.quantile(size, [0.5, 0.95, 1.0])
                ),
            )
    table.put("laws")


if __name__ == "__main__":
    main()
