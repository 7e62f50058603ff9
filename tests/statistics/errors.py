"""Coverage of the errors of estimates where ice, stone, noise or law are
not as assumed.

    python tests/statistics/errors.py THROWS [--only TEXT]

writes the table "errors" of README.md beside this file. A throw of 20 s at 10 Hz, 5 mm
on x and y and 10 mrad on phi, with coefficients within 20 % of their defaults and
either sense of spin, is drawn and fitted; sigma is estimated. Counted is how often
intervals by Student's t contain the true value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from tables import LEVELS, Table, asked, correlated, share

import curlfit
from curlfit.environment import Environment
from curlfit.inference.fit.fit import fit_throws
from curlfit.inference.model.conditions import WIDTHS

TIMES = np.linspace(0.0, 20.0, 201)
ASSUMED = {"R": 0.065, "rho": 0.1, "h": 0.057, "length_scale": 1.0, "time_scale": 1.0}
START = ("x0", "y0", "heading", "v0", "phi0", "omega0")


@dataclass(frozen=True)
class Case:
    """What throws obey, and how they are fitted."""

    title: str
    truth: str = "front-back"
    fitted: str = "front-back"
    memory: float = 0.0
    """correlation time of the noise, s"""
    drawn: tuple[str, ...] = ()
    """conditions drawn from their prior"""
    options: Mapping[str, Any] = field(default_factory=dict)
    systematic: bool = False
    """whether the systematic error is added to the standard error"""
    weak: bool = True
    """whether weakly determined estimates count"""


def prior(name: str) -> str:
    """The prior of a condition of its default width."""
    if name == "drag":
        return f"half-normal:{WIDTHS[name]}"
    return f"{ASSUMED.get(name, 0.0)}+-{WIDTHS[name]}"


CASES = (
    Case("independent noise, all as assumed"),
    *(
        Case(
            f"noise of correlation time {memory} s, `--noise ar1`",
            memory=memory,
            options={"noise": "ar1"},
        )
        for memory in (0.2, 1.0, 3.0)
    ),
    *(
        Case(
            f"`{name}` off by its prior, which the fit has",
            drawn=(name,),
            options={"priors": {name: prior(name)}},
        )
        for name in (
            "slope_x",
            "slope_y",
            "drag",
            "R",
            "rho",
            "length_scale",
            "time_scale",
            "wear",
        )
    ),
    Case(
        "`slope_x` off by its prior and held: both errors",
        drawn=("slope_x",),
        systematic=True,
        options={"systematics": {"all": 0.0, "slope_x": WIDTHS["slope_x"]}},
    ),
    Case(
        "`slope_x` off by its prior and held: standard error alone", drawn=("slope_x",)
    ),
    Case("right law, `--noise discrepancy`", options={"noise": "discrepancy"}),
    Case(
        "right law, noise of correlation time 0.3 s, `--noise discrepancy`",
        memory=0.3,
        options={"noise": "discrepancy"},
    ),
    *(
        Case(
            "`stribeck` fitted by `coulomb`, noise of correlation time 0.3 s, "
            f"`--noise {noise}`",
            "stribeck",
            "coulomb",
            0.3,
            options={"noise": noise},
        )
        for noise in ("ar1", "discrepancy")
    ),
    *(
        Case(
            f"`{truth}` fitted by `{fitted}`, `--noise {noise}`",
            truth,
            fitted,
            options={"noise": noise},
        )
        for truth, fitted in (
            ("power", "coulomb"),
            ("stribeck", "coulomb"),
            ("angular", "front-back"),
            ("semi-empirical", "front-back"),
        )
        for noise in ("white", "discrepancy")
    ),
)


def thrown(
    case: Case, random: np.random.Generator
) -> tuple[curlfit.Throw, dict[str, float]]:
    """A throw, and the true values of what is fitted."""
    law = curlfit.find_law(case.truth)
    values = {
        coefficient.name: coefficient.default
        * (1 if coefficient.optional else random.uniform(0.8, 1.2))
        for coefficient in law.coefficients()
    }
    true = {
        "v0": random.uniform(1.9, 2.2),
        "heading": random.uniform(-0.03, 0.03),
        "omega0": random.choice([-1, 1]) * random.uniform(0.6, 2.0),
    }
    true |= dict.fromkeys(("x0", "y0", "phi0"), 0.0)
    conditions = {
        name: ASSUMED.get(name, 0.0) + WIDTHS[name] * random.standard_normal()
        for name in case.drawn
    }
    if "drag" in conditions:
        conditions["drag"] = abs(conditions["drag"])
    stone = {name: conditions.get(name, ASSUMED[name]) for name in ("R", "rho", "h")}
    air_and_ice = {k: v for k, v in conditions.items() if k in vars(Environment())}
    path = curlfit.simulate(
        law(**values),
        curlfit.Stone(**stone),
        curlfit.InitialState(
            v=true["v0"], heading=true["heading"], omega=true["omega0"]
        ),
        TIMES,
        environment=Environment(**air_and_ice),
    ).to_numpy()
    scale = conditions.get("length_scale", 1.0)
    noise = random.standard_normal((3, len(TIMES)))
    if case.memory:
        noise = correlated(noise, math.exp(-(TIMES[1] - TIMES[0]) / case.memory))
    throw = curlfit.Throw.from_arrays(
        conditions.get("time_scale", 1.0) * TIMES,
        scale * path.x + 0.005 * noise[0],
        scale * path.y + 0.005 * noise[1],
        path.phi + 0.01 * noise[2],
    )
    return throw, true | conditions | (values if case.truth == case.fitted else {})


def counts(case: Case, throws: int, seed: int = 0) -> tuple[dict[str, list[int]], str]:
    """By group of parameters, intervals that contain the true value by level, and all;
    and what is left out."""
    random = np.random.default_rng(seed)
    data = [thrown(case, random) for _ in range(throws)]
    fits = fit_throws([throw for throw, _ in data], case.fitted, **case.options)
    tallies = {
        group: [0] * (1 + len(LEVELS)) for group in ("coefficients", "initial state")
    }
    failed = 0
    for (_, true), fit in zip(data, fits, strict=True):
        if isinstance(fit, Exception) or not fit.converged:
            failed += 1
            continue
        estimates = {
            name: fit.parameters[name] for name in true if name in fit.parameters
        }
        counted: dict[str, Any] = {
            name: estimate
            for name, estimate in estimates.items()
            if estimate.stderr and (case.weak or estimate.verdict != "weak")
        }
        truths = {name: true[name] for name in counted}
        for combination in fit.combinations:
            if set(combination.weights) <= true.keys():
                counted[combination.expression] = combination
                truths[combination.expression] = sum(
                    w * true[n] for n, w in combination.weights.items()
                )
        for name, quantity in counted.items():
            group = tallies["initial state" if name in START else "coefficients"]
            group[-1] += 1
            for column, (level, _) in enumerate(LEVELS.values()):
                low, high = quantity.interval(level)
                if case.systematic:
                    wider = math.hypot(
                        high - low,
                        2
                        * LEVELS[list(LEVELS)[column]][1]
                        * fit.systematics.errors[name],
                    )
                    low, high = (low + high - wider) / 2, (low + high + wider) / 2
                group[column] += low <= truths[name] <= high
    return tallies, f"{failed}" if failed else ""


def main() -> None:
    """Run the cases and write their table."""
    chosen = asked(__doc__)
    table = Table(
        "",
        *(
            f"{group}: {level}"
            for group in ("coefficients", "initial state")
            for level in LEVELS
        ),
        "not converged",
    )
    for case in CASES:
        if chosen.only not in case.title:
            continue
        tallies, failed = counts(case, chosen.throws)
        cells = [
            share(group[column], group[-1], nominal)
            for group in tallies.values()
            for column, (nominal, _) in enumerate(LEVELS.values())
        ]
        table.add(case.title, *cells, failed)
    if not chosen.only:
        table.put("errors", f"{chosen.throws} throws a row.")


if __name__ == "__main__":
    main()
