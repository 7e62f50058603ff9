"""Coverage of joint fits of tracks: evenings of draws on two sheets, and the next draw.

    python tests/statistics/evenings_tracked.py EVENINGS

writes its table into README.md beside this file. Throws vary about the mean of their
sheet, and the ice slows with time. Each evening gives one answer to each question, so
that counts are binomial.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from tables import Table, share

import curlfit
from curlfit.prediction.result import Call
from curlfit.sheet import LINES, TEE

DRAWS = 16
EVERY = 7 / 60  # h between draws
MEAN = curlfit.law_with("front-back", {"mu1_xi": 0.004, "mu2_xi": 0.05})
SUM = MEAN.mu1_eta + MEAN.mu2_eta
APART = 0.05
RISING = 0.01
SPREAD = 0.012
OF_CURL = 0.02
STONE = curlfit.Stone(R=0.065)
WEIGHT = 13.4  # hog to hog of the draw that is predicted, s
SPIN = 1.3  # rad/s
LEVELS = {"68 %": 0.68, "95 %": 0.95}
GRID = np.append(np.linspace(0.0, 40.0, 401), 300.0)


class Answer(NamedTuple):
    """Of one evening, by question: the truth, the estimate, its error and its
    two intervals."""

    truth: float
    value: float
    error: float
    intervals: dict[str, tuple[float, float]]


def law_at(draw: int, sheet: int, random: np.random.Generator) -> curlfit.Law:
    """The law of a draw, with its own deviations from the mean of its sheet."""
    factor = (
        1
        + (sheet - 1.5) * APART
        + RISING * EVERY * draw
        + SPREAD * random.standard_normal()
    )
    curl = 1 + OF_CURL * random.standard_normal()
    half = SUM / 2 * factor
    return replace(MEAN, mu2_xi=MEAN.mu2_xi * curl, mu1_eta=half, mu2_eta=half)


def path_of(law: curlfit.Law, v: float, omega: float) -> curlfit.Trajectory:
    """The path of a draw from the near hog line along the centre line."""
    start = curlfit.InitialState(y=LINES["hog"], v=v, omega=omega)
    return curlfit.simulate(law, STONE, start, GRID).to_numpy()


def hog_to_hog(path: curlfit.Trajectory) -> float:
    """s, from the near line, where the path starts."""
    return float(np.interp(LINES["far-hog"], path.y[:-1], path.t[:-1]))


def tracked(path: curlfit.Trajectory, random: np.random.Generator) -> curlfit.Throw:
    """A track at 10 Hz."""
    rows = slice(0, 241)
    noise = random.standard_normal((3, 241)) * np.array([0.005, 0.005, 0.01])[:, None]
    channels = (getattr(path, name)[rows] for name in ("x", "y", "phi"))
    return curlfit.Throw.from_arrays(
        path.t[rows], *(a + b for a, b in zip(channels, noise, strict=True))
    )


def answers(evenings: int) -> Iterator[dict[str, Answer]]:
    """The answers of each evening by question."""
    for seed in range(evenings):
        random = np.random.default_rng(1000 + seed)
        throws = []
        for draw in range(DRAWS):
            sheet = draw % 2 + 1
            side = 1 if draw // 2 % 2 else -1
            law = law_at(draw, sheet, random)
            path = path_of(
                law, random.uniform(2.19, 2.29), side * random.uniform(1.0, 1.6)
            )
            throw = tracked(path, random)
            labels = {"sheet": f"{sheet}", "hour": f"{draw * EVERY:.6f}"}
            throws.append(replace(throw, labels=labels))
        joint = curlfit.fit_together(
            throws,
            "front-back",
            stone=STONE,
            by="sheet",
            trend="hour",
            systematics={"all": 0.0},
        )
        by_question = {}
        for name, effects, truth in (
            ("difference of the sheets", joint.differences, APART * SUM),
            ("trend per hour", joint.trend, RISING * SUM),
        ):
            (effect,) = (effect for effect in effects if "eta" in effect.parameter)
            spans = {level: effect.interval(size) for level, size in LEVELS.items()}
            by_question[f"{name}, mu1_eta + mu2_eta"] = Answer(
                truth, effect.value, effect.stderr, spans
            )
        labels = {"sheet": "2", "hour": f"{DRAWS * EVERY:.6f}"}
        law = law_at(DRAWS, 2, random)
        low = 1.8
        high = 3.0
        for _ in range(40):
            v = (low + high) / 2
            low, high = (
                (v, high) if hog_to_hog(path_of(law, v, SPIN)) > WEIGHT else (low, v)
            )
        end = path_of(law, v, SPIN)
        call = Call(labels, hog_to_hog=WEIGHT)
        predicted = curlfit.predict(joint, call=call, start={"omega0": SPIN}, seed=seed)
        for name, truth in (("rest_y", end.y[-1] - TEE), ("rest_x", end.x[-1])):
            quantity = predicted.quantities[name]
            spans = {
                "68 %": (quantity.quantiles["16"], quantity.quantiles["84"]),
                "95 %": (quantity.quantiles["2.5"], quantity.quantiles["97.5"]),
            }
            by_question[f"the next draw, {name} (m)"] = Answer(
                truth, quantity.value, quantity.sd, spans
            )
        yield by_question


def main() -> None:
    """Run what is asked for, and write its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("evenings", type=int)
    asked = parser.parse_args()
    evenings = list(answers(asked.evenings))
    table = Table(
        "",
        "inside 68 %",
        "inside 95 %",
        "rms pull",
        "median error stated",
        "true scatter",
    )
    for name in evenings[0]:
        by_evening = [evening[name] for evening in evenings]
        true = np.array([answer.truth for answer in by_evening])
        off = np.array([answer.value for answer in by_evening]) - true
        error = np.array([answer.error for answer in by_evening])
        counts = []
        for level, size in LEVELS.items():
            low, high = np.array([answer.intervals[level] for answer in by_evening]).T
            inside = int(((low <= true) & (true <= high)).sum())
            counts.append(share(inside, len(by_evening), size))
        numbers = (
            np.sqrt(np.mean((off / error) ** 2)),
            np.median(error),
            np.sqrt(np.mean(off**2)),
        )
        table.add(name, *counts, *(f"{number:.2g}" for number in numbers))
    table.put("evenings tracks", f"{len(evenings)} evenings.")


if __name__ == "__main__":
    main()
