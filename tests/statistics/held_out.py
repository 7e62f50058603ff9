"""Coverage of predictions: the first 12 s of synthetic throws are fitted, the rest
is predicted.

    python tests/statistics/held_out.py THROWS [CASE]

writes the tables of all cases, or of one, into README.md beside this file. What is
compared is the true path, so that no measuring noise is in the comparison, and each
throw gives one answer to each question, so that counts are binomial.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from tables import Table, correlated, reasons, share

import curlfit

UNTIL = 12.0
TIMES = (14.0, 17.0, 20.0)
NOISE_XY = 0.005
NOISE_PHI = 0.01
LEVELS = {"68 %": ("16", "84", 0.68, 0.99446), "95 %": ("2.5", "97.5", 0.95, 1.95996)}
ASKED = (
    *(f"{name} at {t:g} s" for t in TIMES for name in ("x", "y", "phi")),
    "rest_x",
    "rest_y",
    "time",
)


class Case(NamedTuple):
    """Which law the throws obey, which is fitted, and what the noise is like."""

    title: str
    truth: str
    fitted: str
    correlation: float = 0.0
    """of the noise from row to row"""


CASES = (
    Case("right law", "front-back", "front-back"),
    Case("`power` fitted by `coulomb`", "power", "coulomb"),
    Case("`stribeck` fitted by `coulomb`", "stribeck", "coulomb"),
    Case("`angular` fitted by `front-back`", "angular", "front-back"),
    Case("`semi-empirical` fitted by `front-back`", "semi-empirical", "front-back"),
    Case("`debris` fitted by `front-back`", "debris", "front-back"),
    Case(
        "right law, noise correlated by 0.9 from row to row",
        "front-back",
        "front-back",
        0.9,
    ),
    Case("`power+pivot` fitted by `front-back`", "power+pivot", "front-back"),
)


class Answer(NamedTuple):
    """Of one throw: whether the bands held the truth, by level and question."""

    both: dict[str, dict[str, bool]]
    parameters: dict[str, dict[str, bool]]
    found: bool
    """whether the law was taken to miss something"""
    off: dict[str, float]
    """size of the error of the prediction"""
    half: dict[str, float]
    """half the width of the 68 % interval"""


def answers(
    case: Case, throws: int, seed: int = 0, left: Counter[str] | None = None
) -> Iterator[Answer]:
    """One answer a throw. A throw that comes to rest before it can be asked, or whose
    fit does not converge, is thrown again; `left` counts these by reason."""
    left = Counter() if left is None else left
    random = np.random.default_rng(seed)
    stone = curlfit.Stone(R=0.065)
    answered = 0
    while answered < throws:
        law = curlfit.find_law(case.truth)
        scaled = {
            coefficient.name: coefficient.default * random.uniform(0.9, 1.1)
            for coefficient in law.coefficients()
            if not (coefficient.optional or coefficient.signed)
        }
        start = {
            "v0": random.uniform(2.0, 2.3),
            "omega0": random.uniform(0.6, 2.0),
            "heading": random.uniform(-0.03, 0.03),
        }
        true_law = curlfit.law_with(case.truth, scaled)
        t = np.append(np.arange(0.0, 30.0, 0.1), 300.0)
        path = curlfit.simulate(
            true_law,
            stone,
            curlfit.InitialState(
                heading=start["heading"], v=start["v0"], omega=start["omega0"]
            ),
            t,
        ).to_numpy()
        if not path.speed[200] > 0.05:
            left["all but at rest at 20 s"] += 1
            continue
        recorded = slice(0, 201)
        noise = [
            correlated(random.standard_normal(201), case.correlation) for _ in range(3)
        ]
        throw = curlfit.Throw.from_arrays(
            t[recorded],
            path.x[recorded] + NOISE_XY * noise[0],
            path.y[recorded] + NOISE_XY * noise[1],
            path.phi[recorded] + NOISE_PHI * noise[2],
        )
        fit = curlfit.fit(throw, case.fitted, stone=stone, until=UNTIL)
        if not fit.converged:
            left["not converged"] += 1
            continue
        answered += 1
        predicted = curlfit.predict(fit, line="data", draws=500, seed=answered)
        yield _judged(predicted, path)


def _judged(predicted: curlfit.Prediction, path: curlfit.Trajectory) -> Answer:
    series = predicted.series
    resting = path.t[np.flatnonzero(path.speed > 0)[-1]]
    truth = {}
    best = {}
    parameter_sd = {}
    quantiles: dict[str, dict[str, float]] = {}
    for t in TIMES:
        for name in ("x", "y", "phi"):
            key = f"{name} at {t:g} s"

            def at(column: str, t: float = t) -> float:
                return float(np.interp(t, series["t"], series[column]))

            truth[key] = float(getattr(path, name)[round(t / 0.1)])
            best[key] = at(name)
            parameter_sd[key] = at(f"{name}_parameter_sd")
            quantiles[key] = {
                level: at(f"{name}_{level}") for level in ("2.5", "16", "84", "97.5")
            }
    shift = {"rest_x": path.x[-1], "rest_y": path.y[-1] - 38.405, "time": None}
    for name, value in shift.items():
        quantity = predicted.quantities[name]
        # the time of rest is known to the rows' 0.1 s only; two more rows tell it
        truth[name] = _time_of_rest(path) if value is None else float(value)
        best[name] = quantity.value
        parameter_sd[name] = quantity.parameter_sd
        quantiles[name] = quantity.quantiles
    assert truth["time"] >= resting
    both_errors: dict[str, dict[str, bool]] = {}
    parameters: dict[str, dict[str, bool]] = {}
    for level, (low, high, _, sigmas) in LEVELS.items():
        both_errors[level] = {
            k: quantiles[k][low] <= truth[k] <= quantiles[k][high] for k in ASKED
        }
        parameters[level] = {
            k: abs(truth[k] - best[k]) <= sigmas * parameter_sd[k] for k in ASKED
        }
    off = {k: abs(truth[k] - best[k]) for k in ASKED}
    half = {k: (quantiles[k]["84"] - quantiles[k]["16"]) / 2 for k in ASKED}
    return Answer(both_errors, parameters, predicted.misfit.detected, off, half)


def _time_of_rest(path: curlfit.Trajectory) -> float:
    """From the last moving rows: near rest the way left goes as the square of
    the time left."""
    k = int(np.flatnonzero(path.speed > 0)[-1])
    left = [
        np.hypot(path.x[-1] - path.x[j], path.y[-1] - path.y[j]) for j in (k - 1, k)
    ]
    power = np.log(left[0] / left[1]) / np.log(path.speed[k - 1] / path.speed[k])
    return float(path.t[k] + left[1] / path.speed[k] * power / (power - 1))


def write(number: int, throws: int) -> None:
    """Run a case and put its table into README.md."""
    case = CASES[number - 1]
    left = Counter[str]()
    results = list(answers(case, throws, left=left))
    counted = f"{throws + left.total()} throws drawn, {throws} counted"
    if left:
        counted += f"; left out: {reasons(left.elements())}"
    table = Table(
        "",
        "68 %: both errors",
        "parameters alone",
        "95 %: both errors",
        "parameters alone",
        "median error",
        "median half-width at 68 %",
    )
    for name in ASKED:
        cells = []
        for level, (_, _, nominal, _) in LEVELS.items():
            for kind in ("both", "parameters"):
                inside = sum(getattr(answer, kind)[level][name] for answer in results)
                cells.append(share(inside, throws, nominal))
        cells += [
            f"{np.median([getattr(answer, kind)[name] for answer in results]):.2g}"
            for kind in ("off", "half")
        ]
        table.add(name.replace("_", " "), *cells)
    missing = f"The law was taken to miss something in {sum(a.found for a in results)}."
    title = f"{case.title[0].upper()}{case.title[1:]}"
    table.put(f"held-out {number}", f"### {title}\n\n{counted}. {missing}")


if __name__ == "__main__":
    throws, *chosen = map(int, sys.argv[1:])
    for place in chosen or range(1, len(CASES) + 1):
        write(place, throws)
