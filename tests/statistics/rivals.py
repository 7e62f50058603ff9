"""Whether laws recover themselves, and whether a comparison finds the law that
made the data.

    python tests/statistics/rivals.py recovery THROWS
    python tests/statistics/rivals.py confusion SETS

write the tables of these names of README.md beside this file. Throws are those of
`errors.py`; a set is one throw, or four of them of one law and one ice, with two senses
and two rates of spin.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
from errors import TIMES, Case, counts
from tables import LEVELS, Table, share

import curlfit
from curlfit.friction.registry import laws_under

LAWS = [law.name for law, _ in laws_under(None)]
SPINS = (0.7, -0.7, 1.8, -1.8)
SEED = 3


def recovery(throws: int) -> None:
    """Coverage of the coefficients of each law, fitted to its own throws."""
    table = Table(
        "law",
        *LEVELS,
        *(f"{level}, without weak ones" for level in LEVELS),
        "not converged",
    )
    for name in LAWS:
        cells = []
        for weak in (True, False):
            tallies, failed = counts(Case("", name, name, weak=weak), throws)
            *inside, of = tallies["coefficients"]
            levels = zip(inside, LEVELS.values(), strict=True)
            cells += [share(count, of, nominal) for count, (nominal, _) in levels]
        table.add(f"`{name}`", *cells, failed)
    table.put("recovery", f"{throws} throws a row.")


def thrown(name: str, random: np.random.Generator) -> list[curlfit.Throw]:
    """Four throws under a law whose coefficients are within 10 % of its defaults."""
    kind = curlfit.find_law(name)
    law = kind(
        **{
            coefficient.name: coefficient.default
            * (1 if coefficient.optional else random.uniform(0.9, 1.1))
            for coefficient in kind.coefficients()
        }
    )
    throws = []
    for spin in SPINS:
        start = curlfit.InitialState(v=random.uniform(1.9, 2.2), omega=spin)
        path = curlfit.simulate(law, curlfit.Stone(), start, TIMES).to_numpy()
        noise = random.standard_normal((3, len(TIMES)))
        throws.append(
            curlfit.Throw.from_arrays(
                TIMES,
                path.x + 0.005 * noise[0],
                path.y + 0.005 * noise[1],
                path.phi + 0.01 * noise[2],
                sigma={"x": 0.005, "y": 0.005, "phi": 0.01},
            )
        )
    return throws


def confusion(sets: int) -> None:
    """How often `compare` puts each law first, by the law that made the data."""
    for count in (1, 4):
        table = Table(
            "truth", "first", "within 6 of the first", "others that came first"
        )
        for name in LAWS:
            random = np.random.default_rng(SEED)
            first: Counter[str] = Counter()
            near = 0
            for _ in range(sets):
                throws = thrown(name, random)[:count]
                comparison = curlfit.compare(throws[0] if count == 1 else throws)
                first[comparison.best.law] += 1
                near += any(
                    candidate.law == name
                    and candidate.rank
                    and candidate.delta_bic <= 6
                    for candidate in comparison.candidates
                )
            rivals = ", ".join(
                f"`{law}` {n}" for law, n in first.most_common() if law != name
            )
            table.add(f"`{name}`", f"{first[name]} of {sets}", near, rivals)
        title = (
            "One throw"
            if count == 1
            else "Four throws, of two senses and two rates of spin"
        )
        table.put(f"confusion-{count}", f"{title}, {sets} sets a row.")


if __name__ == "__main__":
    {"recovery": recovery, "confusion": confusion}[sys.argv[1]](int(sys.argv[2]))
