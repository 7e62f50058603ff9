"""What no curling stone does is refused, with the words that mend it, and
nothing else is."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import parts_in
from mistaken_files import (
    DEGREES,
    collided,
    exchanged,
    good,
    picked_up,
    pushed,
    scaled,
    wrapped,
)
from sample_files import SAMPLES, table

import curlfit
from curlfit import InputError, Throw, load_throw
from curlfit.findings import Level
from curlfit.throws.motion import motion_of, release
from curlfit.throws.plausibility import examine, require_plausible

GOOD = good()
FOOT = 0.3048


@pytest.fixture
def written(write):
    return lambda columns, head="": write(head + table(columns, digits=12))


def typed_flag(text, name):
    """Value of an option as a message has it."""
    return re.search(rf"`--{name} ([^`]+)`", text)[1]


def is_good(throw, mirrored=False):
    sign = -1 if mirrored else 1
    for name, factor in (("t", 1), ("x", sign), ("y", 1), ("phi", sign)):
        np.testing.assert_allclose(factor * getattr(throw, name), GOOD[name], atol=1e-9)


@pytest.mark.parametrize(("until", "rest"), [(20, 0.0), (22.9, 0.0), (22.9, 10.0)])
def test_the_curl_is_the_departure_from_the_first_direction(until, rest):
    """Eq. 12 begins along y: its curl is -x, however long it is filmed at rest."""
    t = np.append(np.arange(0, until + 0.05, 0.1), until + np.arange(0.1, rest, 0.1))
    moving = np.minimum(t, until)
    s = 1 - moving / 23
    x = -(0.004 * moving**2 - 0.185 * moving + 2.98 * (1 - s**1.43))
    noise = np.random.default_rng(1).normal(0, 0.003, (2, len(t)))
    position = (x + 25j * (1 - s**1.897)) * np.exp(0.1j) + noise[0] + 1j * noise[1]
    motion = motion_of(Throw.from_arrays(t, position.real, position.imag))
    assert motion.curl == pytest.approx(-x[-1], rel=0.08)


@pytest.mark.parametrize(
    ("made", "said", "flag"),
    [
        (scaled(t=1000), "a coefficient of friction of 8.", "t=ms"),
        (
            scaled(t=1 / 60),
            "moves at 122 m/s, and none is thrown at more than about 4",
            "t=min",
        ),
        (
            scaled(x=100, y=100),
            "moves at 203 m/s, and none is thrown at more than about 4",
            "length=cm",
        ),
        (scaled(x=1000, y=1000), "if lengths are in millimetres", "length=mm"),
        (scaled(x=1 / FOOT, y=1 / FOOT), "moves at 6.6", "length=ft"),
        (scaled(x=12 / FOOT, y=12 / FOOT), "if lengths are in inches", "length=in"),
        (scaled(x=100), "the path is 76.8 m long, and a sheet 45.7 m", "x=cm"),
        (
            scaled(t=1000, x=100, y=100),
            "if the time is in milliseconds and lengths are in centimetres",
            "t=ms,length=cm",
        ),
        (
            scaled(phi=DEGREES),
            "turns 137 times, at 43.2 rad/s; stones turn at most about 10 "
            "times; if angles are in degrees",
            "angle=deg",
        ),
        (scaled(t=30), "if t counts frames", "t=30fps"),
    ],
)
def test_wrong_units_are_refused_and_mended(written, made, said, flag):
    file = written(made(GOOD))
    throw = load_throw(file)
    with pytest.raises(InputError) as caught:
        require_plausible(throw)
    text = str(caught.value)
    assert text.startswith(f"{file}: ")
    assert said in text
    assert typed_flag(text, "units") == flag
    assert text.endswith("To accept the data as they are: `--as-given`")
    is_good(load_throw(file, units=flag))
    as_given = load_throw(file, as_given=True)
    assert [finding.level for finding in require_plausible(as_given)] == [Level.WARNING]
    arrays = made(GOOD)
    with pytest.raises(InputError) as caught:
        require_plausible(Throw.from_arrays(**arrays))
    assert f'`Throw.from_arrays(..., units="{flag}")`' in str(caught.value)
    is_good(Throw.from_arrays(**arrays, units=flag))


def test_a_wrapped_angle_in_arrays_is_refused(written):
    columns = wrapped(2 * np.pi, -np.pi)(GOOD)
    # unwrapped as it is read
    assert require_plausible(load_throw(written(columns))) == ()
    with pytest.raises(
        InputError, match="phi jumps by 360 degrees 2 times: it is wrapped"
    ):
        require_plausible(Throw.from_arrays(**columns))
    is_good(Throw.from_arrays(**columns, units="angle=rad"))
    degrees = wrapped(360, -180, DEGREES)(GOOD)
    with pytest.raises(InputError, match='units="angle=deg"'):
        require_plausible(Throw.from_arrays(**degrees))
    is_good(Throw.from_arrays(**degrees, units="angle=deg"))


@pytest.mark.parametrize(
    ("made", "said", "flag", "mirrored"),
    [
        (
            scaled(x=-1),
            "turns counter-clockwise and curls 0.72 m to the right",
            "x-left,counter-clockwise",
            False,
        ),
        (
            scaled(y=-1),
            "y points back at the thrower",
            "y-back,counter-clockwise",
            False,
        ),
        (
            scaled(phi=-1),
            "turns clockwise and curls 0.72 m to the left",
            "x-left,counter-clockwise",
            True,
        ),
        (
            exchanged,
            "x runs along the sheet and y across it",
            "x-along,y-right,counter-clockwise",
            False,
        ),
    ],
)
def test_mirrored_axes_are_told_by_the_side_of_the_curl(
    written, made, said, flag, mirrored
):
    file = written(made(GOOD))
    (finding,) = require_plausible(load_throw(file))
    assert said in str(finding)
    assert "stones on ice curl to the side to which they turn" in str(finding)
    assert typed_flag(str(finding), "axes") == flag
    mended = load_throw(file, axes=flag)
    is_good(mended, mirrored)
    assert require_plausible(mended) == ()
    # the other proposal: the same up to a mirror, in which friction is the same
    assert "if angles count the other way: `--axes clockwise`" in str(finding)
    assert not [
        f
        for f in examine(load_throw(file, axes="clockwise"))
        if f.code == "curls-the-wrong-way"
    ]


@pytest.mark.parametrize(
    ("made", "said", "flag", "within"),
    [
        (pushed, "a hand was still on the stone", "since", (0.0, 1.0)),
        (
            picked_up,
            "the velocity jumps by 0.47 m/s at t = 21.1 s",
            "until",
            (20.9, 21.1),
        ),
        (
            collided,
            "the velocity jumps by 0.78 m/s at t = 12 s, as in a collision",
            "until",
            (11.5, 12.0),
        ),
    ],
)
def test_what_friction_cannot_do_is_refused_and_cut_off(
    written, made, said, flag, within
):
    throw = load_throw(written(made(GOOD)))
    with pytest.raises(InputError) as caught:
        require_plausible(throw)
    assert said in str(caught.value)
    time = float(typed_flag(str(caught.value), flag))
    assert within[0] <= time <= within[1]
    assert require_plausible(throw.select_rows(**{flag: time})) == ()


def filmed(c, onset=0.0, rest=3.0, glide=3.0, spin=0.0):
    """A full film, whose time 0 is that of the release: rest, the push of a leg,
    the slide in the hand, in the last `onset` of which the hand turns the stone,
    then the throw."""
    dt = 0.04
    before = np.arange(-rest - glide - 0.5, -1e-9, dt)
    v0 = np.array([(c[axis][15] - c[axis][0]) / 1.5 for axis in "xy"])
    w0 = (c["phi"][15] - c["phi"][0]) / 1.5
    speed = np.clip((before + glide + 0.5) / 0.5, 0, 1)
    turning = np.clip((before + onset) / max(onset, 1e-9), 0, 1) * w0 + spin
    noise = 0.003 * np.random.default_rng(5).standard_normal((3, len(before)))
    back = {"x": speed * v0[0], "y": speed * v0[1], "phi": turning}
    early = {
        name: c[name][:4].mean()
        - 0.15 * (name == "y") * v0[1]
        - dt * np.cumsum(rate[::-1])[::-1]
        + noise[k]
        for k, (name, rate) in enumerate(back.items())
    }
    return {
        name: np.concatenate([({"t": before} | early)[name], c[name]]) for name in c
    }


@pytest.mark.parametrize("onset", [0.0, 0.15, 0.3])
@pytest.mark.parametrize(("rest", "glide"), [(3.0, 3.0), (0.0, 3.0), (2.0, 1.0)])
def test_the_release_is_where_the_stone_begins_to_turn(written, onset, rest, glide):
    throw = load_throw(written(filmed(GOOD, onset, rest, glide)))
    with pytest.raises(
        InputError, match="what is before the release, where it begins to turn"
    ):
        require_plausible(throw)
    time = float(typed_flag(str(examine(throw)[0]), "since"))
    assert -0.05 <= time <= 0.35, time  # not earlier, by a row at most
    assert require_plausible(throw.select_rows(since=time)) == ()
    columns = {name: getattr(throw, name) for name in ("t", "x", "y")}
    (finding,) = examine(load_throw(written(columns)))
    assert "the slide in the hand, which an angle would show" in str(finding)
    (finding,) = examine(throw.select_rows(since=-0.9 * glide))
    assert (finding.code, finding.level) == ("held", Level.REFUSAL)
    assert float(typed_flag(str(finding), "since")) == pytest.approx(time, abs=0.15)


def test_a_stone_that_turns_from_the_beginning_has_no_release():
    for throw in (
        GOOD,
        filmed(GOOD, spin=1.0, rest=0.0),
        GOOD | {"phi": 0.1 * GOOD["phi"]},
    ):
        assert release(Throw.from_arrays(**throw)) is None
    assert (
        release(Throw.from_arrays(**{k: v for k, v in GOOD.items() if k != "phi"}))
        is None
    )


@pytest.mark.parametrize(("filmed_at", "read_at"), [(60, 30), (120, 30), (240, 30)])
def test_the_wrong_number_of_frames_a_second_is_suspected(written, filmed_at, read_at):
    """Times are off by a factor, and friction by its square."""
    throw = load_throw(written(GOOD | {"t": GOOD["t"] * filmed_at / read_at}))
    (finding,) = examine(throw)
    assert f"if a film of {filmed_at} frames a second was read at {read_at}: " in str(
        finding
    )
    assert finding.is_refusal == (filmed_at > 60)
    flag = typed_flag(str(finding), "units")
    again = load_throw(
        written(GOOD | {"t": GOOD["t"] * filmed_at / read_at}), units=flag
    )
    is_good(again)
    assert examine(again) == ()


def jumped(size, row, every=1):
    """Rows of the good throw, from one of which on y is larger."""
    columns = {name: values[::every].copy() for name, values in GOOD.items()}
    columns["y"][row:] += size
    return columns


@pytest.mark.parametrize(
    ("made", "flag"),
    [
        (jumped(5, 6, every=18), "until"),
        (jumped(5, 4, every=18), "since"),
        (jumped(2, 9, every=10), "since"),
        (jumped(-0.7, 150), "until"),
    ],
)
def test_a_position_that_jumps_is_refused_and_cut_off(written, made, flag):
    throw = load_throw(written(made))
    with pytest.raises(
        InputError, match=r"the position jumps by about .* \(line \d+\)"
    ):
        require_plausible(throw)
    time = float(typed_flag(str(examine(throw)[0]), flag))
    moved = np.abs(np.diff(made["y"] - GOOD["y"][:: 200 // (len(made["y"]) - 1)]))
    jump = int(np.argmax(moved)) + (flag == "since")
    assert abs(np.searchsorted(throw.t, time) - jump) <= 2
    assert examine(throw.select_rows(**{flag: time})) == ()


def test_some_rows_of_another_stone_are_no_jump():
    columns = jumped(3, 120)
    columns["y"][124:] -= 3
    assert "jump" not in [f.code for f in examine(Throw.from_arrays(**columns))]


@pytest.mark.parametrize("row", [0, 60, 200])
def test_a_time_far_from_the_others_is_named(written, row):
    wrong = GOOD["t"].copy()
    wrong[row] = 1e6 if row else -1e6
    file = written(GOOD | {"t": wrong})
    (part,) = parts_in(file)  # not two throws, one after another
    (finding,) = examine(part.throw)
    sentence = (
        f"the row t = {wrong[row]:g} s (line {row + 2}) is 1e+06 s from the others"
    )
    assert sentence in str(finding)
    flag = "until" if row else "since"
    time = float(typed_flag(str(finding), flag))
    assert examine(part.throw.select_rows(**{flag: time})) == ()


def test_a_second_throw_is_no_wrong_time(written):
    twice = {name: np.tile(values, 2) for name, values in GOOD.items()}
    assert len(parts_in(written(twice))) == 2


def test_a_value_beyond_any_sheet_is_named(written):
    wrong = GOOD["x"].copy()
    wrong[40] = 750
    throw = load_throw(written(GOOD | {"x": wrong}))
    (finding,) = examine(throw)
    assert "x = 750 m at t = 4 s (line 42) is 750 m from those beside it" in str(
        finding
    )
    low, high = map(float, typed_flag(str(finding), "exclude").split(":"))
    assert examine(throw.select_rows(exclude=[(low, high)])) == ()


def test_times_that_run_backwards_are_refused():
    reversed_ = {name: v[::-1] if name != "t" else v for name, v in GOOD.items()}
    with pytest.raises(InputError, match="times may run backwards"):
        require_plausible(Throw.from_arrays(**reversed_))


@pytest.mark.parametrize(
    ("column", "values", "said", "flag"),
    [
        (
            "speed",
            3.6 * np.hypot(*np.gradient([GOOD["x"], GOOD["y"]], 0.1, axis=1)),
            "the measured speed is 3.6",
            "speed=km/h",
        ),
        (
            "omega",
            DEGREES * np.gradient(GOOD["phi"], 0.1),
            "the measured spin is 5",
            "spin=deg/s",
        ),
    ],
)
def test_a_measured_rate_is_held_against_the_path(column, values, said, flag):
    smooth = np.convolve(np.pad(values, 7, "edge"), np.ones(15) / 15, "valid")
    throw = Throw.from_arrays(**GOOD, **{column: smooth})
    with pytest.raises(InputError) as caught:
        require_plausible(throw)
    assert said in str(caught.value)
    assert f'units="{flag}"' in str(caught.value)
    assert (
        require_plausible(Throw.from_arrays(**GOOD, **{column: smooth}, units=flag))
        == ()
    )


# What must not be refused


def sliding(
    v=2.0,
    friction=0.01,
    until=15.0,
    dt=0.1,
    noise=0.005,
    memory=0.0,
    outlying=0.0,
    turn=1.0,
    curl=1.0,
    heading=0.0,
    seed=0,
):
    """A throw of constant friction that curls as the square of the
    distance, with noise."""
    random = np.random.default_rng(seed)
    t = np.arange(0, until, dt)
    s = np.minimum(t, v / (9.81 * friction))
    along = v * s - 9.81 * friction * s**2 / 2
    left = np.sign(turn) * curl * (along / 28) ** 2
    x = along * np.sin(heading) - left * np.cos(heading)
    y = along * np.cos(heading) + left * np.sin(heading)
    errors = random.standard_normal((3, len(t)))
    if memory:
        carry = np.exp(-dt / memory)
        for k in range(1, len(t)):
            errors[:, k] = (
                carry * errors[:, k - 1] + np.sqrt(1 - carry**2) * errors[:, k]
            )
    x, y = x + noise * errors[0], y + noise * errors[1]
    off = random.random(len(t)) < outlying
    x, y = x + off * random.normal(0, 1, len(t)), y + off * random.normal(0, 1, len(t))
    return Throw.from_arrays(t, x, y, turn * s + 2 * noise * errors[2])


@pytest.mark.parametrize(
    "odd",
    [
        {"until": 2.0, "dt": 0.05},
        {"until": 1.0, "dt": 0.05, "noise": 0.01},
        {"until": 2.0, "dt": 1 / 30, "noise": 0.02},
        {"friction": 0.035, "until": 8.0},
        {"turn": 1e-9},
        {"turn": -1.4},
        {"heading": np.pi + 0.02},
        {"v": 0.5, "until": 8.0},
        {"v": 3.4, "until": 7.0},
        {"until": 40.0},
        {"until": 40.0, "noise": 0.03, "memory": 0.5},
        {"noise": 0.02, "memory": 1.0},
        {"noise": 0.03, "memory": 0.3},
        {"outlying": 0.1},
        {"outlying": 0.05, "dt": 0.2, "noise": 0.01},
        {"dt": 0.5, "noise": 0.02},
        {"dt": 1.25},
        {"noise": 0.1},
        {"dt": 1 / 120, "noise": 0.002},
        {
            "v": 0.5,
            "friction": 0.03,
            "until": 1.2,
            "dt": 0.02,
            "noise": 5e-4,
            "curl": 5.0,
        },
    ],
)
def test_odd_throws_of_stones_are_taken(odd):
    for seed in range(10):
        assert require_plausible(sliding(**odd, seed=seed)) == ()


def driven(rise=0.0, jump=0.0, at=7.0):
    """A throw at about 2 m/s whose speed grows evenly within 2 s, or jumps
    to the side."""
    t = np.arange(0, 15, 0.05)
    speed = 2 - 0.1 * t + (rise + 0.2) * np.clip((t - at) / 2, 0, 1)
    noise = 0.0005 * np.random.default_rng(1).standard_normal((2, len(t)))
    return Throw.from_arrays(
        t,
        jump * np.clip(t - at, 0, None) + noise[0],
        np.cumsum(speed) * 0.05 + noise[1],
    )


def with_rates(speed=1.0, spin=1.0):
    """A throw whose speed and spin were measured with wrong factors."""
    throw = sliding(noise=0.001, curl=0)
    v = speed * np.maximum(2 - 0.0981 * throw.t, 0)
    return replace(throw, speed=v, omega=spin * np.ones_like(v))


LONG = {"v": 2.3, "until": 23, "noise": 0.001}
AXES = [("curls-the-wrong-way", False)]
BRAKES = [("impossible-friction", True)]
UNLIKE = [("rate-unlike-path", False)]


@pytest.mark.parametrize(
    ("throw", "found"),
    [
        (sliding(friction=0.0016, noise=0.001), BRAKES),
        (sliding(friction=0.0027, noise=0.001), [("low-friction", False)]),
        (sliding(friction=0.0035, noise=0.001), []),
        (sliding(v=3, friction=0.13, until=2, dt=0.02), BRAKES),
        (sliding(v=3, friction=0.08, until=3, dt=0.02), []),
        (sliding(v=7, friction=0.02, until=3), [("impossible-speed", True)]),
        (sliding(v=5.2, friction=0.02, until=3), [("high-speed", False)]),
        (sliding(v=3.8, friction=0.02, until=3), []),
        (
            sliding(v=4, friction=0.0033, until=17, turn=0.5, curl=0),
            [("long-path", False)],
        ),
        (sliding(v=2.6, friction=0.0082, until=32, turn=0.5), []),
        (sliding(**LONG, curl=5.2), [("large-curl", False)]),
        (sliding(**LONG, curl=3.2), []),
        (sliding(turn=15), [("turns", True)]),
        (sliding(turn=10), [("turns", False)]),
        (sliding(turn=4.8), [("turns", False)]),
        (sliding(turn=3.2), []),
        (driven(rise=0.14), [("pushed-at-first", True)]),
        (driven(rise=0.08), []),
        (Throw.from_arrays(**jumped(0.65, 100)), [("jump", True)]),
        (Throw.from_arrays(**jumped(0.45, 100)), []),
        (driven(jump=0.29), [("collision", True)]),
        (driven(jump=0.23), []),
        (sliding(**LONG, curl=-0.3), AXES),
        (sliding(**LONG, curl=-0.16), []),
        (sliding(**LONG, curl=-1, turn=0.03), AXES),
        (sliding(**LONG, curl=-1, turn=0.016), []),
        (with_rates(speed=1.4), UNLIKE),
        (with_rates(speed=1.1), []),
        (with_rates(speed=0.7), UNLIKE),
        (with_rates(speed=0.9), []),
        (with_rates(spin=1.4), UNLIKE),
        (with_rates(spin=1.1), []),
    ],
)
def test_limits(throw, found):
    """Throws on either side of each limit, so near that a factor of 1.5 would
    exchange them."""
    assert [(finding.code, finding.is_refusal) for finding in examine(throw)] == found


def test_sweeping_is_no_push_and_no_collision():
    t = np.arange(0, 15, 0.1)
    deceleration = np.where((t > 5) & (t < 9), 0.06, 0.1)  # 40 % less friction
    speed = 2 - np.cumsum(deceleration) * 0.1
    y = np.cumsum(speed) * 0.1
    random = np.random.default_rng(2)
    throw = Throw.from_arrays(
        t, 0.005 * random.normal(size=150), y + 0.005 * random.normal(size=150)
    )
    assert require_plausible(throw) == ()


@pytest.mark.parametrize("name", sorted(set(SAMPLES) - {"log", "pixels", "friction"}))
def test_samples_of_every_format_are_plausible(name, tmp_path):
    (tmp_path / "data").write_text(SAMPLES[name], encoding="utf-8")
    assert not [
        finding
        for finding in examine(load_throw(tmp_path / "data"))
        if finding.is_refusal
    ]


def test_certified_throws_and_the_paper_s_are_plausible():
    for file in (Path(__file__).parents[1] / "certified").glob("*.csv"):
        hard = any(part in file.name for part in ("high_spin", "split"))
        assert bool(require_plausible(load_throw(file))) == hard, file
    data = Path(__file__).parents[2] / "data" / "jensen_shegelski_2004.csv"
    assert require_plausible(load_throw(data)) == ()


# After the fit

FEW = {name: values[::15] for name, values in GOOD.items()}
# too few to judge before
FEW["x"] = np.where(np.arange(len(FEW["x"])) % 6 == 0, FEW["x"], np.nan)


@pytest.mark.parametrize(
    ("made", "code"),
    [
        (scaled(t=1000), "fitted-friction"),
        (scaled(x=100, y=100), "fitted-speed"),
    ],
)
def test_an_absurd_fit_is_not_usable(written, made, code):
    file = written(made(FEW))
    assert examine(load_throw(file)) == ()
    fit = curlfit.fit(load_throw(file), "coulomb")
    assert not fit.converged
    finding = next(finding for finding in fit.warnings if finding.is_refusal)
    assert finding.code == code
    assert str(finding) in fit.status
    assert "`--units t=ms` or `--units length=cm`" in fit.status


def test_a_fit_that_misses_the_data_by_metres_is_not_usable():
    few = FEW | {"y": FEW["y"] + 5 * (np.arange(len(FEW["y"])) > 7)}
    throw = Throw.from_arrays(**few)
    assert examine(throw) == ()
    fit = curlfit.fit(throw, "coulomb", details=False)
    assert not fit.converged
    assert re.match(r"implausible: the fit misses the data by 1\.\d m in y", fit.status)
    accepted = replace(throw, defaults={"as_given": True})
    fit = curlfit.fit(accepted, "coulomb", details=False)
    assert fit.converged
    assert fit.warnings[0].code == "misfit"
    assert not fit.warnings[0].is_refusal


def test_a_robust_fit_may_leave_out_a_value_far_off():
    wrong = GOOD["y"].copy()
    wrong[100] += 20
    throw = Throw.from_arrays(**GOOD | {"y": wrong})
    linear, robust = (
        curlfit.fit(throw, "front-back", loss=loss, details=False)
        for loss in ("linear", "student")
    )
    assert (linear.converged, robust.converged) == (False, True)
    assert "`loss=student`" in linear.status
    assert "misfit" not in [warning.code for warning in robust.warnings]


def slid(v0, mu):
    """Constant friction until rest, 10 rows a second; the stone covers
    v0^2/(2 mu g)."""
    a = mu * 9.81
    t = np.arange(0, v0 / a, 0.1)
    return t, v0 * t - a * t**2 / 2


def test_a_takeout_without_a_back_line_is_no_matter_of_units():
    t, y = slid(3.0, 0.0074)
    assert y[-1] > 61.9
    (finding,) = require_plausible(Throw.from_arrays(t, 0 * y, y))
    assert finding.code == "long-path"
    assert not finding.is_refusal
    assert "the path is 62 m long, and a sheet 45.7 m, unless the ice goes on" in str(
        finding
    )
    # in feet a draw is too long and too fast
    t, y = slid(2.0, 0.0074)
    with pytest.raises(InputError, match="length=ft"):
        require_plausible(Throw.from_arrays(t, 0 * y, y / FOOT))
