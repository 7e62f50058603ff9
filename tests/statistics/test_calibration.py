"""What the script says of made-up answers; `calibration.py` makes the tables
of real ones."""

from __future__ import annotations

import re

import numpy as np
import pytest
from calibration import (
    BOXES,
    DRAWS,
    TRIALS,
    Answer,
    Outcome,
    Quantity,
    answer,
    counted,
    noise_table,
    ranks_table,
    small_table,
    summary,
)
from tables import HERE, reasons, share

import curlfit


def line_of(name, text):
    (row,) = [line for line in text.splitlines() if line.startswith(f"| {name} |")]
    return [cell.strip() for cell in row.strip("|").split("|")]


def good(rank=50, held=(True, True), pull=0.5):
    return Quantity(pull, held, "", rank, (True, True))


def test_laws_are_tried_in_their_own_bounds():
    for name, box in BOXES.items():
        coefficients = {
            coefficient.name: coefficient
            for coefficient in curlfit.LAWS[name].coefficients()
        }
        assert set(box) == {
            required
            for required, coefficient in coefficients.items()
            if not coefficient.optional
        }
        for symbol, (low, high) in box.items():
            assert (
                coefficients[symbol].lower <= low < high <= coefficients[symbol].upper
            )


def test_cells_are_marked_and_reasons_counted():
    assert [share(k, n, 0.95) for k, n in ((95, 100), (80, 100), (8, 10), (0, 0))] == [
        "95.0 %",
        "80.0 % (!)",
        "80.0 %",
        "",
    ]
    assert [reasons(causes) for causes in (["", "b", "a", "b"], ["", ""])] == [
        "b 2, a 1",
        "",
    ]


def test_ranks_say_what_left_and_why():
    bound, unseen = (
        Quantity(None, (), why, 50, (True, True))
        for why in ("at bound", "not identifiable")
    )
    answers = [
        Answer(1 if k % 2 else -1, {"white": Outcome({"mu": good(k), "k": good(k)})})
        for k in range(DRAWS + 1)
    ]
    answers += [Answer(1, {"white": Outcome({"mu": good(), "k": bound})})] * 10
    answers += [Answer(1, {"white": Outcome({"mu": good(), "k": unseen})})] * 2
    answers += [Answer(-1, {"white": Outcome({}, left="not converged")})] * 3
    answers += [
        Answer(-1, {"white": Outcome({}, left="the fit raised UnusableFitError")})
    ]
    unsampled = Outcome({"mu": good(), "k": good()}, sampler="not converged")
    answers += [Answer(-1, {"white": unsampled})] * 4
    text = ranks_table(TRIALS["ranks pressure"], answers)
    assert (
        "120 throws drawn (62 counter-clockwise, 58 clockwise). 116 counted; left "
        "out: not converged 3, the fit raised UnusableFitError 1. "
        "Consistent load." in text
    )
    assert (
        "No standard error of k in 12 of 116: at bound 10, not identifiable 2." in text
    )
    assert "No standard error of mu" not in text
    assert "Not in n of ranks, of 116: sampler not converged 4." in text
    assert line_of("mu", text)[1] == "112"
    assert (line_of("k", text)[1], line_of("k", text)[7]) == ("112", "104")
    assert line_of("k", text)[8:] == ["100.0 % (!)", "100.0 %"]


@pytest.mark.parametrize("sense", [1, -1])
def test_uneven_ranks_of_one_sense_are_seen(sense):
    """Skewed one way in one sense of spin, and the other way in the other, they
    add up to even."""
    random = np.random.default_rng(0)
    answers = []
    for k in range(200):
        mine = 1 if k % 2 else -1
        rank = int(random.integers(DRAWS + 1))
        if mine == sense:
            rank //= 2
        answers.append(Answer(mine, {"white": Outcome({"mu": good(rank)})}))
    text = ranks_table(TRIALS["ranks coulomb"], answers)
    _, _, _, left, right, *_ = line_of("mu", text)
    assert ("(!)" in left, "(!)" in right) == (sense == 1, sense == -1)
    assert re.search(
        r"\| coulomb \| uniform \| 200 \| 200 \| 0 \| \d of 7 \|",
        summary({"coulomb": answers}),
    )


def test_noise_says_pulls_and_warnings():
    answers = [
        Answer(
            1,
            {
                "white": Outcome({"v0": good(pull=pull)}, correlated=k < 7),
                "ar1": Outcome({"v0": good(pull=2 * pull)}, lasting=k < 2),
                "discrepancy": Outcome(
                    {"v0": good()} if k else {}, left="" if k else "not converged"
                ),
            },
        )
        for k, pull in enumerate(np.linspace(-1, 3, 9))
    ]
    text = noise_table(TRIALS["noise white"], answers)
    cells = line_of("v0", text)
    assert (cells[3], cells[6], cells[9]) == (
        "1.00 ± 1.37",
        "2.00 ± 2.74",
        "0.50 ± 0.00",
    )
    assert line_of("residuals correlated", text)[1:] == ["7 of 9", "0 of 9", "0 of 8"]
    assert line_of("correlation time too long", text)[1:] == [
        "0 of 9",
        "2 of 9",
        "0 of 8",
    ]
    assert "- discrepancy: 8 counted; left out: not converged 1." in text


def test_small_samples_count_both_intervals_and_outliers():
    quantity = Quantity(2.1, (False, True))
    answers = [
        Answer(1, {"white": Outcome({"mu": quantity}, outliers=int(k == 0))})
        for k in range(50)
    ]
    text = small_table(TRIALS["small coulomb 12"], answers)
    assert line_of("mu", text) == ["mu", "50", "0.0 % (!)", "100.0 %"]
    assert "An outlier was named by chance in 1 of 50." in text


def test_a_throw_depends_on_its_number_alone(monkeypatch):
    trial = TRIALS["small coulomb 12"]
    of_throw = answer(trial, 3)
    assert of_throw == answer(trial, 3) != answer(trial, 4)
    assert counted([of_throw])[0].quantities["mu"].held

    def refuse(*_, **__):
        raise curlfit.UnusableFitError("no")

    monkeypatch.setattr(curlfit, "fit", refuse)
    assert answer(trial, 3).outcomes["white"].left == "the fit raised UnusableFitError"


def test_the_readme_has_a_place_for_every_table():
    text = (HERE / "README.md").read_text()
    for name in ("ranks", *TRIALS):
        assert text.count(f"<!-- {name} -->\n") == 2, name
