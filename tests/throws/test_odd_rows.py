"""Typing errors of simulated evenings; draws with constant deceleration, by hand."""

import numpy as np
import pytest

from curlfit.throws.readers.odd_rows import odd_values

HOG_TO_HOG = 21.945
HOG_TO_TEE = 28.346
GRAVITY = 9.81
FLOORS = {"hog_to_hog": 0.05, "hog_to_rest": 0.05, "rest": 0.025, "curl": 0.025}
USUAL = {"hog_to_hog": 0.0, "hog_to_rest": 0.0, "rest": 6.0, "curl": 1.5}
FLOORS["turns"] = 0.75
USUAL["turns"] = 19.0
EVENINGS = 100


def evening(seed, rows=16):
    """Columns of draws on two sheets whose friction varies by 2 %."""
    random = np.random.default_rng(seed)
    sheet = np.arange(rows) % 2
    friction = 0.0092 * (1 + 0.04 * sheet) * (1 + 0.02 * random.standard_normal(rows))
    rest = 0.6 * random.standard_normal(rows)
    length = HOG_TO_TEE + rest
    slowing = GRAVITY * friction
    speed = np.sqrt(2 * slowing * length)
    later = np.sqrt(speed**2 - 2 * slowing * HOG_TO_HOG)
    turns = random.uniform(2.5, 4.0, rows)
    columns = {
        "hog_to_hog": (speed - later) / slowing + 0.07 * random.standard_normal(rows),
        "hog_to_rest": later / slowing + 0.1 * random.standard_normal(rows),
        "rest": rest + 0.05 * random.standard_normal(rows),
        "curl": 0.35 * turns * (1 + 0.05 * random.standard_normal(rows)),
        "turns": 2 * np.pi * turns,
    }
    labels = [{"sheet": str(1 + number)} for number in sheet]
    return columns, labels, random


def digits_exchanged(value):
    """12.92 written as 21.92."""
    text = f"{value:05.2f}"
    return float(text[1] + text[0] + text[2:])


def digit_wrong(value):
    """12.92 written as 15.92 or 10.92."""
    text = f"{value:05.2f}"
    return float(text[0] + str((int(text[1]) + 3) % 10) + text[2:])


def test_right_rows_stay():
    wrong = sum(
        bool(odd_values(columns, FLOORS, USUAL, labels))
        for columns, labels, _ in map(evening, range(EVENINGS))
    )
    assert wrong <= 2


@pytest.mark.parametrize("rows", [12, 16, 24])
def test_mistakes_are_named_even_three_at_once(rows):
    named = 0
    right = 0
    for seed in range(EVENINGS):
        columns, labels, random = evening(seed, rows)
        first, second, third = random.choice(rows, 3, replace=False)
        columns["hog_to_hog"][first] = digits_exchanged(columns["hog_to_hog"][first])
        columns["hog_to_rest"][second] = digit_wrong(columns["hog_to_rest"][second])
        columns["curl"][third] /= 0.3048
        odd = odd_values(columns, FLOORS, USUAL, labels)
        mistakes = {
            (first, "hog_to_hog"),
            (second, "hog_to_rest"),
            (third, "curl"),
        }
        odd_cells = {(value.row, value.column) for value in odd}
        named += len(odd_cells & mistakes)
        right += bool({row for row, _ in odd_cells} - {first, second, third})
    assert named >= 0.95 * 3 * EVENINGS
    assert right <= 2


def test_what_is_off_is_counted_from_the_others():
    columns, labels, _ = evening(1)
    was = columns["hog_to_hog"][4]
    columns["hog_to_hog"][4] += 4.0
    (value,) = odd_values(columns, FLOORS, USUAL, labels)
    assert (value.row, value.column) == (4, "hog_to_hog")
    assert value.value == was + 4.0
    assert value.off == pytest.approx(4.0, abs=0.4)


def test_another_weight_is_no_mistake():
    """A takeout among draws: quicker, and it does not come to rest."""
    columns, labels, _ = evening(2)
    for name, value in (("hog_to_hog", 9.0), ("hog_to_rest", np.nan)):
        columns[name][3] = value
    columns["rest"][3] = np.nan
    columns["turns"][5] *= 1.7
    columns["curl"][5] *= 1.7
    assert odd_values(columns, FLOORS, USUAL, labels) == []


def test_too_few_rows_contradict_nobody():
    columns, labels, _ = evening(3, rows=3)
    columns["hog_to_hog"][1] = 50.0
    assert odd_values(columns, FLOORS, USUAL, labels) == []


def test_a_label_with_many_groups_is_no_term():
    """The time would grow with the square of the groups, 250 of 1,000 rows."""
    columns, labels, _ = evening(4, rows=60)
    players = [{**label, "player": str(k % 15)} for k, label in enumerate(labels)]
    columns["hog_to_hog"][7] += 4.0
    with_players = odd_values(columns, FLOORS, USUAL, players)
    assert with_players == odd_values(columns, FLOORS, USUAL, labels)
    assert [value.row for value in with_players] == [7]
