"""Evenings of draws by stopwatch and tape: what is said of sheets, trend and next draw.

    python tests/statistics/evenings.py [--evenings N] [--laws A,B] [--columns A,B]

Evenings of 12 to 24 draws on two sheets in turn are simulated by none of curlfit's code
(`simulator.py`), under four laws of which curlfit knows nothing, and fitted with what
it takes by itself. The sheets differ in friction, in curl, in both or in none; friction
has a trend; throws vary. Four sets of columns: hog to hog and rest; with curl and
turns; with hog to rest, too; and these with gaps, as people leave them. Counted is how
often intervals contain the difference of friction and of curl between draws to the tee
that turn by the same angle, the trend of friction, and where the next draw comes to
rest.

Beside them stands a plain regression of what was measured on sheet, time and turns: of
the friction that each draw has if its deceleration is constant, and of its curl. The
rows take their places in the table "evenings" of README.md beside this file.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.stats import t as student
from simulator import crossing, distance, moved
from tables import Table, put_merged, share

import curlfit
from curlfit.prediction.result import Call
from curlfit.throws.events import Event
from curlfit.throws.readers.record import USUAL_SPIN

# m from the hack
HOG = 10.059
FAR_HOG = 32.004
TEE = 38.405

HOG_TO_HOG = FAR_HOG - HOG
HOG_TO_TEE = TEE - HOG
GRAVITY = 9.81
EVERY = 7 / 60  # h between draws
SIGMA_TIME = 0.07
SIGMA_REST_TIME = 0.1
SIGMA_TAPE = 0.05
SIGMA_TURNS = 0.12
SPREAD_FRICTION = 0.02
SPREAD_CURL = 0.04
FRICTION_APART = 0.05
CURL_APART = 0.25
LEVELS = {"68 %": 0.68, "95 %": 0.95}


class Truth(NamedTuple):
    """A law, and which of its coefficients are in proportion to friction and curl."""

    law: str
    coefficients: dict[str, float]
    friction: tuple[str, ...]
    curl: str

    def at(self, friction: float, curl: float) -> dict[str, float]:
        """The coefficients where friction and curl are so many times as large."""
        scale = dict.fromkeys(self.friction, friction) | {self.curl: curl}
        return {
            name: value * scale.get(name, 1.0)
            for name, value in self.coefficients.items()
        }


TRUTHS = {
    "front-back": Truth(
        "front-back",
        {"mu1_xi": 0.004, "mu2_xi": 0.05, "mu1_eta": 0.009, "mu2_eta": 0.009},
        ("mu1_eta", "mu2_eta"),
        "mu2_xi",
    ),
    "power -0.2 + sideways": Truth(
        "power+sideways", {"c": 0.0085, "k": -0.2, "a": 0.006, "n": 0.0}, ("c",), "a"
    ),
    "power -0.5 + angular": Truth(
        "power-angular", {"c": 0.0078, "k": -0.5, "f0": 0.3}, ("c",), "f0"
    ),
    "coulomb + transverse": Truth(
        "power+transverse", {"c": 0.0092, "k": 0.0, "b": 0.05}, ("c",), "b"
    ),
}
COLUMNS = {
    "two": ("hog_to_hog", "rest"),
    "curl": ("hog_to_hog", "rest", "curl", "turns"),
    "three": ("hog_to_hog", "hog_to_rest", "rest", "curl", "turns"),
    "gaps": ("hog_to_hog", "hog_to_rest?", "rest", "curl?", "turns?"),
}
"""What is measured of each draw; "?" stands for a value that is missing in some."""
MISSING = 0.3


class Draw(NamedTuple):
    """A draw from the near hog line along the centre line, without errors."""

    hog_to_hog: float
    hog_to_rest: float
    rest: float
    """m past the tee"""
    curl: float
    """m, to the left"""
    turns: float
    """rad, counter-clockwise"""
    friction: float
    """mean deceleration over gravity"""


class Answer(NamedTuple):
    """Of one question: the truth, the estimate, and its intervals."""

    truth: float
    value: float
    intervals: dict[str, tuple[float, float]]

    @property
    def width(self) -> float:
        """Of the 95 % interval."""
        low, high = self.intervals["95 %"]
        return high - low


def thrown(law: str, coefficients: Mapping[str, float], v: float, w: float) -> Draw:
    """The draw with a speed in m/s and a spin in rad/s at the near hog line."""
    motion = moved(law, coefficients, v, w)
    x, y, turns = motion.at(np.array([motion.end]))[:, 0]
    hog = crossing(motion, HOG_TO_HOG) if y > HOG_TO_HOG else np.nan
    friction = v**2 / (2 * GRAVITY * y)
    return Draw(hog, motion.end - hog, y - HOG_TO_TEE, -x, turns, friction)


def weight_of(law: str, coefficients: Mapping[str, float], w: float) -> float:
    """The speed in m/s of a draw to the tee."""

    def beyond(v: float) -> float:
        return distance(moved(law, coefficients, v, w)) - HOG_TO_TEE

    return brentq(beyond, 1.6, 3.2, xtol=1e-3)


def draw_to_the_tee(law: str, coefficients: Mapping[str, float], turns: float) -> Draw:
    """The draw that rests at the tee and has turned by some rad."""
    v = 2.2
    w = turns / 25.0
    # distance goes nearly with v^2, the angle with the spin: to 1 mm and 1e-4 rad
    for _ in range(8):
        draw = thrown(law, coefficients, v, w)
        if abs(draw.rest) < 1e-3 and abs(draw.turns - turns) < 1e-4:
            break
        v *= np.sqrt(HOG_TO_TEE / (HOG_TO_TEE + draw.rest))
        w *= turns / draw.turns
    return draw


def friction_exponent(truth: Truth, ice: np.ndarray, turns: float) -> float:
    """Of the friction of the law in the mean friction of a draw to the tee: where
    friction rises as a stone slows down, that of a faster stone rises less."""
    factors = np.array([0.95, 1.05])
    less, more = (
        draw_to_the_tee(truth.law, truth.at(*ice * (factor, 1.0)), turns).friction
        for factor in factors
    )
    return float(np.log(more / less) / np.log(factors[1] / factors[0]))


def measured(
    draw: Draw, columns: tuple[str, ...], random: np.random.Generator
) -> dict[str, float]:
    """The draw by stopwatch, tape and eye, rounded as people write; with gaps."""
    sizes = {
        "hog_to_hog": (SIGMA_TIME, 0.01),
        "hog_to_rest": (SIGMA_REST_TIME, 0.01),
        "rest": (SIGMA_TAPE, 0.0254),
        "curl": (SIGMA_TAPE, 0.0254),
        "turns": (2 * np.pi * SIGMA_TURNS, 2 * np.pi / 4),
    }
    values = {}
    for column in columns:
        if column.endswith("?") and random.random() < MISSING:
            continue
        name = column.rstrip("?")
        sigma, step = sizes[name]
        value = getattr(draw, name) + sigma * random.standard_normal()
        values[name] = round(value / step) * step
    return values


def as_throw(values: Mapping[str, float], labels: dict[str, str]) -> curlfit.Throw:
    """What curlfit makes of a row of a table."""
    events = {
        "hog_to_hog": ("hog_to_hog", "time", SIGMA_TIME, FAR_HOG, HOG),
        "hog_to_rest": ("hog_to_rest", "time", SIGMA_REST_TIME, None, FAR_HOG),
        "rest": ("rest", "y", SIGMA_TAPE, None, None),
        "curl": ("curl", "x", SIGMA_TAPE, None, HOG),
        "turns": ("turns", "phi", 2 * np.pi * SIGMA_TURNS, None, HOG),
    }
    measurements = []
    for name, value in values.items():
        key, quantity, sigma, at, since = events[name]
        value = {"rest": TEE + value, "curl": -value}.get(name, value)
        measurements.append(Event(key, quantity, value, sigma, at, since))
    spin = 0.0
    if "turns" not in values and "curl" in values:
        spin = np.sign(values["curl"]) * USUAL_SPIN
    return curlfit.Throw.from_events(
        measurements, assumed={"omega0": spin}, labels=labels
    )


def regression(
    rows: list[dict[str, float]], sheets: np.ndarray, hours: np.ndarray
) -> dict[str, tuple[float, float, float]]:
    """Estimate, error and degrees of freedom by ordinary least squares, by question;
    without those that too few values answer."""
    terms = [np.ones(len(rows)), sheets - sheets.mean(), hours - hours.mean()]
    length = HOG_TO_TEE + np.array([row["rest"] for row in rows])
    time = np.array([row["hog_to_hog"] for row in rows])
    slowed = 1 - np.sqrt(1 - HOG_TO_HOG / length)
    friction = 2 * length * slowed**2 / (GRAVITY * time**2)
    answers = {}
    columns = {"friction": (friction / friction.mean(), terms)}
    curl = np.abs([row.get("curl", np.nan) for row in rows])
    turns = np.abs([row.get("turns", np.nan) for row in rows])
    is_known = np.isfinite(curl + turns)
    if is_known.any():
        known_terms = [term[is_known] for term in (*terms, turns)]
        columns["curl"] = (curl[is_known], known_terms)
    for name, (values, design) in columns.items():
        matrix = np.column_stack(design)
        freedom = len(values) - matrix.shape[1]
        if freedom < 1 or np.linalg.matrix_rank(matrix) < matrix.shape[1]:
            continue
        inverse = np.linalg.inv(matrix.T @ matrix)
        solution = inverse @ matrix.T @ values
        variance = ((values - matrix @ solution) ** 2).sum() / freedom
        errors = np.sqrt(variance * np.diagonal(inverse))
        answers[f"{name} of the sheets"] = (solution[1], errors[1], freedom)
        answers[f"{name} per hour"] = (solution[2], errors[2], freedom)
    return answers


class Evening:
    """Draws on two sheets in turn, as they are written down.

    Attributes
    ----------
    rows : the measured values of each draw, by column.
    law : by which curlfit fits a table with these columns.
    sheets, hours : of each draw, 1 or 2 and h since the first.
    apart : how far the sheets differ in friction and in curl, over their means.
    rising : the trend of friction, over its mean, per hour.
    sense : in which the last draw on sheet 2 turned of which that is written.
    """

    def __init__(self, truth: Truth, columns: tuple[str, ...], seed: int) -> None:
        random = np.random.default_rng([seed, len(columns), *truth.law.encode()])
        self.truth = truth
        self.law = "power+deflection" if {"curl", "curl?"} & {*columns} else "power"
        self.random = random
        draws = int(random.integers(12, 25))
        kind = ((0, 0), (1, 0), (0, 1), (1, 1))[seed % 4]
        side = random.choice([-1, 1], 2)
        self.apart = np.array(kind) * side * (FRICTION_APART, CURL_APART)
        self.rising = random.uniform(-0.02, 0.02)
        self.ice = random.uniform(0.9, 1.1, 2)
        self.middle = (draws - 1) / 2 * EVERY
        self.sheets = np.arange(draws) % 2 + 1
        self.hours = EVERY * np.arange(draws)
        usual = weight_of(truth.law, truth.at(*self.ice), 1.2)
        self.rows = []
        self.sense = 1.0
        for sheet, hour in zip(self.sheets.tolist(), self.hours.tolist(), strict=True):
            coefficients = self.law_of_a_draw(sheet, hour)
            w = random.choice([-1, 1]) * random.uniform(0.9, 1.5)
            v = usual * np.sqrt(self.means(sheet, hour)[0] / self.ice[0])
            draw = thrown(
                truth.law, coefficients, v * (1 + 0.01 * random.standard_normal()), w
            )
            row = measured(draw, columns, random)
            if sheet == 2 and row.keys() & {"curl", "turns"}:
                self.sense = np.sign(w)
            self.rows.append(row)

    def means(self, sheet: int, hour: float) -> np.ndarray:
        """Friction and curl of a sheet at a time, over those of the law."""
        about = self.apart * (sheet - 1.5) + (self.rising * (hour - self.middle), 0.0)
        return self.ice * (1 + about)

    def law_of_a_draw(self, sheet: int, hour: float) -> dict[str, float]:
        """Coefficients of the next draw, which varies about its sheet's mean."""
        deviation = self.random.standard_normal(2) * (SPREAD_FRICTION, SPREAD_CURL)
        return self.truth.at(*self.means(sheet, hour) * (1 + deviation))

    def labels(self, draw: int) -> dict[str, str]:
        """Of a draw."""
        return {"sheet": f"{self.sheets[draw]}", "hour": f"{self.hours[draw]:.6f}"}


def answers_of(
    truth: Truth, columns: tuple[str, ...], seed: int
) -> tuple[dict[str, Answer], dict[str, float]]:
    """The answers of one evening, and the widths of those by regression; none where
    the fit is not usable."""
    evening = Evening(truth, columns, seed)
    rows = evening.rows
    draws = len(rows)
    throws = [as_throw(row, evening.labels(draw)) for draw, row in enumerate(rows)]
    joint = curlfit.fit_together(
        throws, evening.law, by="sheet", trend="hour", systematics={"all": 0.0}
    )
    if not joint.converged:
        return {}, {}
    answers = {}
    by_regression = regression(rows, evening.sheets, evening.hours)
    friction = next(
        group_mean for group_mean in joint.groups if group_mean.parameter == "friction"
    ).value
    turn = joint.means.angle
    first, second = (
        draw_to_the_tee(
            truth.law, truth.at(*evening.means(sheet, evening.middle)), turn
        )
        for sheet in (1, 2)
    )
    exponent = friction_exponent(truth, evening.ice, turn)
    truths = {
        "friction of the sheets": exponent * evening.apart[0],
        "friction per hour": exponent * evening.rising,
        "curl of the sheets": abs(second.curl) - abs(first.curl),
        "curl per hour": 0.0,
    }
    for name, effects in (
        ("of the sheets", joint.differences),
        ("per hour", joint.trend),
    ):
        for effect in effects:
            question = f"{effect.parameter} {name}"
            if effect.parameter not in ("friction", "curl"):
                continue
            unit = friction if effect.parameter == "friction" else 1.0
            spans = {}
            for level, size in LEVELS.items():
                low, high = effect.interval(size)
                spans[level] = (low / unit, high / unit)
            answers[question] = Answer(truths[question], effect.value / unit, spans)
    coefficients = evening.law_of_a_draw(2, draws * EVERY)
    answers |= next_draw(truth, joint, coefficients, draws, evening.sense * turn, seed)
    widths = {
        name: 2 * error * float(student.ppf(0.975, freedom))
        for name, (_, error, freedom) in by_regression.items()
    }
    return answers, widths


def next_draw(
    truth: Truth,
    joint: curlfit.JointResult,
    own: Mapping[str, float],
    draws: int,
    turn: float,
    seed: int,
) -> dict[str, Answer]:
    """Where the draw after the evening comes to rest, thrown on sheet 2 with the hog to
    hog time of a draw to the tee that turns as usual."""
    draw = draw_to_the_tee(truth.law, own, turn)
    labels = {"sheet": "2", "hour": f"{draws * EVERY:.6f}"}
    call = Call(labels, hog_to_hog=draw.hog_to_hog)
    predicted = curlfit.predict(joint, call=call, seed=seed)
    answers = {}
    coordinates = {"rest_y": draw.rest}
    if "curl" in {group_mean.parameter for group_mean in joint.groups}:
        coordinates["rest_x"] = -draw.curl
    for name, coordinate in coordinates.items():
        quantity = predicted.quantities[name]
        spans = {
            "68 %": (quantity.quantiles["16"], quantity.quantiles["84"]),
            "95 %": (quantity.quantiles["2.5"], quantity.quantiles["97.5"]),
        }
        way = "along" if name == "rest_y" else "across"
        answers[f"next draw, {way}"] = Answer(coordinate, quantity.value, spans)
    return answers


def rows_of(truth: str, columns: str, evenings: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table: of each question of some evenings."""
    tried = [
        answers_of(TRUTHS[truth], COLUMNS[columns], seed) for seed in range(evenings)
    ]
    usable = [evening for evening in tried if evening[0]]
    yield (truth, columns, "usable", f"{len(usable)} of {len(tried)}", "", "", "", "")
    for question in {name: None for answers, _ in usable for name in answers}:
        mine = [answers[question] for answers, _ in usable if question in answers]
        counts = []
        for level, size in LEVELS.items():
            inside = sum(
                answer.intervals[level][0] <= answer.truth <= answer.intervals[level][1]
                for answer in mine
            )
            counts.append(share(inside, len(mine), size))
        scatter = np.sqrt(
            np.mean([(answer.value - answer.truth) ** 2 for answer in mine])
        )
        width_pairs = [
            (answers[question].width, widths[question])
            for answers, widths in usable
            if question in answers and question in widths
        ]
        ratio = ""
        if width_pairs:
            width, of_regression = np.median(width_pairs, axis=0)
            ratio = f"{width / of_regression:.2f}"
        yield (
            truth,
            columns,
            question,
            f"{len(mine)}",
            *counts,
            f"{scatter:.2g}",
            ratio,
        )


def main() -> None:
    """Run what is asked for, and write its table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evenings", type=int, default=100)
    parser.add_argument("--laws", default=",".join(TRUTHS))
    parser.add_argument("--columns", default=",".join(COLUMNS))
    asked = parser.parse_args()
    table = Table(
        "the law of the evening",
        "columns",
        "question",
        "evenings",
        "inside 68 %",
        "inside 95 %",
        "true scatter",
        "width over that of a regression",
    )
    for truth, columns in itertools.product(
        asked.laws.split(","), asked.columns.split(",")
    ):
        for cells in rows_of(truth, columns, asked.evenings):
            table.add(*cells)
    put_merged("evenings", table, itertools.product(TRUTHS, COLUMNS))


if __name__ == "__main__":
    main()
