"""Answers of the video tracker curling-stone-tracker: what is read, joined, left out
and refused.

`cases/16_curling_stone_tracker.json` is a throw of an independent simulation as the
tracker writes it, from the places and with the noise of `cases/00_truth.csv`: released
36 ft before the centre of the sheet at 3.4 s of the video, and out of sight between.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import invoke
from sample_files import T, X, Y, has_note, note_on, tracked, video

import curlfit
from curlfit import DataError, InputError, Throw, load_throw
from curlfit.settings.choices import Reading
from curlfit.sheet import FOOT, LINES
from curlfit.throws.load import parts_of
from curlfit.throws.readers import curling_stone_tracker, json_values

CASES = Path(__file__).parent / "cases"
CASE = CASES / "16_curling_stone_tracker.json"
SENT = json.loads(CASE.read_text())
EARLY, AT_REST, LATE = range(3)
IN_SIGHT = np.r_[0:12, 138:181]  # rows of the truth


@pytest.fixture
def read(write) -> Callable[..., Throw]:
    """A function that reads a changed answer: a function of it, or its stones."""

    def changed(change: Callable[[list[dict]], Any] = len, **choices: Any) -> Throw:
        answer = copy.deepcopy(SENT)
        change(answer["state"]["stones"])
        return load_throw(write(json.dumps(answer), "video.json"), **choices)

    return changed


# What is read


@pytest.mark.parametrize("format", [None, "curling-stone-tracker"])
def test_a_throw_in_two_pieces(format):
    throw = load_throw(CASE, format=format)
    truth = np.loadtxt(CASES / "00_truth.csv", delimiter=",", skiprows=1)[IN_SIGHT]
    np.testing.assert_allclose(throw.t, truth[:, 0] + 3.4, atol=1e-9)
    np.testing.assert_allclose(throw.x, truth[:, 1], atol=2e-6)
    release = LINES["centre"] - 36 * FOOT
    np.testing.assert_allclose(throw.y, truth[:, 2] + release, atol=2e-6)
    assert throw.seen == ("x", "y")


def test_what_is_said_of_it():
    throw = load_throw(CASE)
    assert str(note_on(throw, "tracked-stones")) == (
        "2 stones in the video: 1 yellow, 25.3 m in t = 3.4 .. 21.4 s; 2 green at "
        "rest, 181 rows; taken: 1"
    )
    joined = note_on(throw, "pieces-joined")
    assert str(joined) == (
        "the stone was seen in 2 pieces, which are joined: it was out of sight between "
        "t = 4.5 and 17.2 s"
    )
    assert joined.numbers["gaps"] == [{"since": 4.5, "until": 17.2}]
    assert note_on(throw, "histories-not-used").numbers == {
        "histories": ["velocity_history", "acceleration_history"]
    }
    assert "y is counted from the hack" in str(note_on(throw, "feet-from-the-centre"))
    assert throw.conventions is not None
    assert throw.conventions.axes == "from-centre"


def test_check_describes_it():
    output = invoke(["check", CASE]).stdout
    in_one_line = " ".join(output.split())
    begin = f"{CASE.name}: curling-stone-tracker, 55 rows, t = 3.4 .. 21.4"
    assert begin in in_one_line
    assert "position_history.y  y         ft    0.3048" in output


def test_a_fit_of_it_finds_what_the_track_determines():
    fit = curlfit.fit(load_throw(CASE), "front-back")
    (total,) = fit.combinations
    assert total.expression == "mu1_eta + mu2_eta"
    assert abs(total.value - 0.018) < total.stderr
    (product,) = fit.products
    assert product.expression == "(mu2_xi - mu1_xi)*omega0"
    assert abs(product.value - (0.050 - 0.005) * 1.5) < product.stderr


def test_a_throw_the_other_way_is_the_same_throw(read):
    def turned(stones: list[dict]) -> None:
        for stone in stones:
            positions = stone["position_history"]
            stone["position_history"] = [[-x, -y] for x, y in positions]

    throw = read(turned)
    original = load_throw(CASE)
    np.testing.assert_allclose(throw.observed, original.observed, atol=1e-12)
    assert note_on(throw, "feet-from-the-centre").numbers == {"toward": "-y"}


def test_axes_that_are_given_have_the_last_word(read):
    throw = read(axes="from-tee")
    assert throw.y[0] == pytest.approx(LINES["tee"] - 35.99738 * FOOT)
    assert not has_note(throw, "feet-from-the-centre")


@pytest.mark.parametrize("indent", [None, 2])
@pytest.mark.parametrize("sort_keys", [True, False])
@pytest.mark.parametrize("part", ["answer", "state"])
def test_layouts(write, indent, sort_keys, part):
    value = SENT if part == "answer" else SENT["state"]
    text = json.dumps(value, indent=indent, sort_keys=sort_keys)
    assert load_throw(write(text, "video.json")) == load_throw(CASE)


def test_first_rows_as_the_tracker_writes_them(read):
    """The first row twice, with the height of the stone above the ice."""

    def twice(stones: list[dict]) -> None:
        for history in stones[EARLY].values():
            if isinstance(history, list):
                history.insert(0, history[0])
        stones[EARLY]["position_history"][0] = [0.00558, -35.99738, 0.0]

    assert read(twice) == load_throw(CASE)


def test_rows_that_the_tracker_made_are_left_out(write):
    throw = load_throw(write(json.dumps(video()), "video.json"))
    in_sight = (T <= 2.5) | (T >= 6)
    np.testing.assert_allclose(throw.t, T[in_sight])
    np.testing.assert_allclose(throw.x, X[in_sight] + 1.0)
    np.testing.assert_allclose(throw.y, Y[in_sight] + 10.0)
    assert note_on(throw, "extrapolated-by-the-tracker").numbers == {"count": 2}


# Which stone


def test_a_stone_at_rest_is_no_throw(read):
    words = (
        r"stone 2 \(green at rest, 181 rows\) does not move; those that do are 1 \(y"
    )
    with pytest.raises(DataError, match=words):
        read(stone_index=2)
    with pytest.raises(InputError, match="no such stone; expected one of 1 yellow, 25"):
        read(stone_index=3)
    with pytest.raises(DataError, match="no stone moves: green at rest, 181 rows"):
        read(lambda stones: stones.__delitem__(slice(None, None, 2)))


def shifted(stone: dict, seconds: float = 0.0, feet: float = 0.0) -> None:
    """Move a stone of the file in time and along the sheet."""
    stone["time_history"] = [time + seconds for time in stone["time_history"]]
    positions = stone["position_history"]
    stone["position_history"] = [[x, y + feet] for x, y in positions]


@pytest.mark.parametrize(
    "change",
    [
        lambda stones: stones[LATE].update(color="green"),
        lambda stones: shifted(stones[LATE], seconds=-13),  # times overlap
        lambda stones: shifted(stones[LATE], feet=-70),  # behind the earlier piece
        lambda stones: shifted(stones[LATE], seconds=-5),  # nothing slides so far
        lambda stones: shifted(stones[LATE], seconds=40),  # and nothing takes so long
        lambda stones: stones[LATE]["position_history"].reverse(),  # comes back
    ],
)
def test_pieces_that_are_no_one_throw(read, change):
    throw = read(change)
    assert len(throw) == 12
    assert not has_note(throw, "pieces-joined")
    stones = note_on(throw, "tracked-stones")
    assert stones.numbers["count"] == 3
    assert "`--stone-index N` selects another" in str(stones)
    other = read(change, stone_index=2)
    assert len(other) == 43


def test_each_stone_that_moves_is_a_throw_of_a_batch(write):
    answer = copy.deepcopy(SENT)
    shifted(answer["state"]["stones"][LATE], seconds=40)
    parts = parts_of(write(json.dumps(answer), "video.json"), Reading())
    assert [part.stone_index for part in parts] == [1, 2]
    assert [len(part.throw) for part in parts if isinstance(part.throw, Throw)] == [
        12,
        43,
    ]


def test_two_throws_of_one_color_in_one_video(write):
    """Each of four pieces goes to its own throw, and each throw is found again where
    its stone was lost for a while."""
    stones = copy.deepcopy(SENT["state"]["stones"])
    again = copy.deepcopy([stones[EARLY], stones[LATE]])
    for stone in again:
        shifted(stone, seconds=30)
    lying = [[-2.585, 47.0]] * 40
    lost_and_found = tracked("yellow", 25 + 0.1 * np.arange(40), lying)
    file = write(
        json.dumps({"stones": [*again, lost_and_found, *stones]}), "video.json"
    )
    first = load_throw(file, stone_index=1)
    second = load_throw(file, stone_index=2)
    assert note_on(first, "pieces-joined").numbers["gaps"][0]["since"] == 4.5
    np.testing.assert_allclose(second.t, first.t[: len(second)] + 30)
    np.testing.assert_allclose(second.y, first.y[: len(second)])


class Filter:
    """A Kalman filter of constant acceleration along one axis, steps of 0.1 s: what
    the tracker makes of what it sees."""

    def __init__(self, place: float):
        step = 0.1
        self.state = np.array([place, 0.0, 0.0])
        self.covariance = np.diag([0.25, 10.0, 10.0])
        self.motion = np.array([[1, step, step**2 / 2], [0, 1, step], [0, 0, 1]])
        jerk = np.array([step**2 / 2, step, 1.0])
        self.noise = 0.1 * np.outer(jerk, jerk)

    def update(self, place: float) -> None:
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + 0.016**2)
        self.state = self.state + gain * (place - self.state[0])
        self.covariance = self.covariance - np.outer(gain, self.covariance[0])

    def predict(self) -> np.ndarray:
        self.state = self.motion @ self.state
        self.covariance = self.motion @ self.covariance @ self.motion.T + self.noise
        return self.state


def way_of(chance: np.random.Generator) -> np.ndarray:
    """t in s and x, y in ft of a throw that is let go 40 ft before the centre, from a
    draw that stops short to a stone thrown through the house; ten times a second."""
    release = chance.uniform(7.0, 11.0)
    friction = chance.uniform(0.23, 0.32)  # ft/s^2 at 3 ft/s
    power = chance.uniform(-0.5, 0.0)
    curl = chance.choice([-1, 1]) * chance.uniform(2, 6)
    aim = chance.uniform(-3, 3)
    y = np.empty(600)
    y[0] = -66.0
    speed = release
    for k in range(1, len(y)):
        if y[k - 1] > -40 and speed > 0:
            speed = max(speed - 0.1 * friction * max(speed / 3, 0.1) ** power, 0.0)
        y[k] = y[k - 1] + 0.1 * speed
    done = np.clip((y + 40) / 97, 0, None)
    return np.column_stack([0.1 * np.arange(len(y)), aim * done + curl * done**2, y])


def seen_at_the_ends(way: np.ndarray, chance: np.random.Generator) -> list[dict]:
    """A throw as the tracker writes it: seen behind the hog lines alone, with noise of
    2 cm, lost in one frame of fifty, and extrapolated for a second after that."""
    stones = []
    filters: list[Filter] = []
    last = -np.inf
    for time, *position in way:
        in_sight = 36 <= abs(position[1]) <= 63 and chance.random() > 0.02
        if in_sight:
            measured = np.add(position, 0.07 * chance.normal(size=2)).tolist()
            if time - last > 1.0:
                filters = [Filter(value) for value in measured]
                stones.append(tracked("red", [time], [measured]))
            else:
                for axis, value in zip(filters, measured, strict=True):
                    axis.update(value)
            last = time
        if time - last <= 1.0:
            states = [axis.predict() for axis in filters]
            stones[-1]["time_history"].append(float(time))
            stones[-1]["position_history"].append([float(s[0]) for s in states])
            stones[-1]["velocity_history"].append([float(s[1]) for s in states])
            stones[-1]["acceleration_history"].append([float(s[2]) for s in states])
    return stones


def test_throws_through_the_filter_of_a_tracker_are_whole(write):
    """Of 30 videos with two throws of one color each, every throw has its own pieces,
    and nothing that the filter made."""
    for seed in range(30):
        chance = np.random.default_rng(seed)
        ways = [way_of(chance), way_of(chance)]
        ways[1][:, 0] += chance.uniform(30, 60)
        ways = [way[np.searchsorted(way[:, 2], -63) :] for way in ways]
        stones = [stone for way in ways for stone in seen_at_the_ends(way, chance)]
        file = write(json.dumps({"stones": stones}), "video.json")
        for number, way in enumerate(ways, 1):
            throw = load_throw(file, stone_index=number, as_given=True)
            ends = np.abs(way[:, 2])
            visible = way[(ends >= 36) & (ends <= 63)]
            assert throw.t[0] == pytest.approx(visible[0, 0], abs=0.3), seed
            assert throw.t[-1] == pytest.approx(visible[-1, 0], abs=0.3), seed
            # a row has the place that the filter expects in the next one
            y = np.interp(throw.t + 0.1, way[:, 0], way[:, 2])
            off = throw.y - (LINES["centre"] + FOOT * y)
            assert np.median(np.abs(off)) < 0.05, seed
            assert note_on(throw, "pieces-joined").numbers["count"] == 2, seed


# Refusals


def put(key: str, value: Any, stone: int = EARLY) -> Callable[[list[dict]], None]:
    """A change of one value of a stone."""
    return lambda stones: stones[stone].update({key: value})


def history(key: str, row: int, value: Any) -> Callable[[list[dict]], None]:
    """A change of one row of a history of the first stone."""
    return lambda stones: stones[EARLY][key].__setitem__(row, value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda stones: stones.clear(), "the tracker found no stone in the video"),
        (
            lambda stones: stones.append(7),
            "entry 4 of its stones: 7 found; expected an",
        ),
        (lambda stones: stones.extend([7] * 500), "503 stones; expected at most 500"),
        (
            lambda stones: stones[LATE].pop("color"),
            "entry 3 of its stones: no color; expected one such as yellow",
        ),
        (put("color", ["red"]), "entry 1 of its stones: no color"),
        (
            lambda stones: stones[AT_REST].pop("time_history"),
            "entry 2 of its stones (green): no time_history; expected a list",
        ),
        (put("position_history", []), "(yellow): no position_history"),
        (put("velocity_history", 3), "(yellow): 'velocity_history' is no list"),
        (
            lambda stones: stones[LATE]["time_history"].pop(),
            "entry 3 of its stones (yellow): histories of unlike lengths: "
            "position_history 43, velocity_history 43",
        ),
        (
            history("time_history", 3, "4"),
            "time 4 is '4'; expected a number of seconds",
        ),
        (history("time_history", 3, float("nan")), "time 4 is nan; expected"),
        (history("time_history", 3, 3.55), "time 4 is 3.55 s, after 3.6 s; expected"),
        (
            history("position_history", 1, [0, None]),
            "position 2 is [0, None]; expected",
        ),
        (
            history("position_history", 1, [1]),
            "position 2 is [1]; expected x, y in feet",
        ),
        (
            history("position_history", 1, [0, True]),
            "position 2 is [0, True]; expected",
        ),
        (history("position_history", 1, [1e13, 0]), "position 2 is [1000"),
        (history("position_history", 1, 5), "position 2 is 5; expected x, y in feet"),
    ],
)
def test_refusals(read, change, words):
    with pytest.raises(DataError) as caught:
        read(change)
    assert "video.json: " in str(caught.value)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"position_history": 1}', "no stones found; expected an answer of curling"),
        ('{"state": [], "mosaic_detections": []}', "no stones found"),
        ('{"mosaic_detections": []}', "no stones found"),
        (CASE.read_text()[:5000], "line 1: not JSON; expected an answer of curling"),
        ('{\n"mosaic_detections":\n[,]}', "line 3: not JSON"),
        ('{"position_history": ' + "[" * 30_000, "not JSON that can be read"),
        ('{"position_history": ' + "9" * 9000 + "}", "not JSON that can be read"),
    ],
)
def test_what_is_no_answer(write, text, words):
    with pytest.raises(DataError) as caught:
        load_throw(write(text, "video.json"))
    assert words in str(caught.value)


def test_what_would_take_too_much_memory_is_refused(write, monkeypatch):
    monkeypatch.setattr(curling_stone_tracker, "MOST_NUMBERS", 300)
    with pytest.raises(
        DataError, match=r"entry 2 of .* \(green\): 181 times; expected"
    ):
        load_throw(CASE)
    monkeypatch.setattr(json_values.json, "loads", pytest.fail)
    monkeypatch.setattr(json_values, "_MOST_VALUES", 1000)
    with pytest.raises(DataError, match="more than 1,000 values; expected an answer"):
        load_throw(CASE)
    monkeypatch.setattr(json_values, "_MOST_PARTS", 100)
    with pytest.raises(DataError, match="more than 100 lists and objects; expected an"):
        load_throw(CASE)


def test_it_has_no_shots():
    with pytest.raises(
        InputError, match="is a curling-stone-tracker file and holds no"
    ):
        load_throw(CASE, shot=1)
