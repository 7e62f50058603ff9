"""Accelerations by speed and spin: the table, and the C and JavaScript made of it."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import command
from independent_motion import G, Reference, front_back

from curlfit import LAWS, InitialState, LocalLaw, find_law, simulate
from curlfit.errors import InputError
from curlfit.export.accelerations import (
    FASTEST,
    SLOWEST,
    Moved,
    c_header,
    javascript_module,
    tabulate,
)
from curlfit.friction import LOADS
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.conditions import CONDITIONS

# none of those of `tabulate`
THROWS = ((2.35, -1.1, 0.2), (2.1, 2.0, -0.1), (1.0, 14.0, 0.0))
CM = 0.01
HERE = Path(__file__).parent
RINGS = [
    name for name, law in LAWS.items() if issubclass(law, LocalLaw) and name != "debris"
]


@pytest.fixture(scope="module")
def table(eq12_fit):
    return tabulate(eq12_fit)


@pytest.fixture(scope="module")
def ends(eq12_fit):
    """Where the law brings the throws to rest, and where they are after 10 s."""
    positions = []
    for v, omega, heading in THROWS:
        start = InitialState(x=0.3, y=1.0, v=v, omega=omega, heading=heading)
        times = np.array([0.0, 10.0, np.inf])
        path = simulate(eq12_fit.fitted_law, eq12_fit.stone, start, times).to_numpy()
        positions.append([[path.x[k], path.y[k], path.phi[k]] for k in (1, 2)])
    return np.array(positions)


def started(v, omega, heading):
    return Moved(0.3, 1.0, v * math.sin(heading), v * math.cos(heading), 0.0, omega)


def test_the_table_is_the_ring_s_force(eq12_fit, table):
    """By the dense sum over the ring of the tests, which shares no code
    with the model."""
    law = eq12_fit.fitted_law
    R = eq12_fit.stone.R
    ring = Reference(
        front_back(law.mu1_xi, law.mu2_xi, law.mu1_eta, law.mu2_eta),
        R=R,
        rho=eq12_fit.stone.rho,
    )
    random = np.random.default_rng(3)
    s = np.exp(random.uniform(np.log(SLOWEST), np.log(FASTEST), 60))
    theta = np.concatenate(
        [
            random.uniform(-np.pi / 2, np.pi / 2, 50),
            np.pi / 4 + np.array([0, 1e-3, -1e-3, 0.02]),
            -np.pi / 4 + np.array([0, 1e-4]),
            [0.0, np.pi / 2, -np.pi / 2, 1e-5],
        ]
    )
    largest = np.zeros(3)
    for v, u in zip(s * np.cos(theta), s * np.sin(theta), strict=True):
        a_xi, a_eta, moment = G * ring.force(v, u)
        true = np.array([a_xi, a_eta, moment * R / ring.rho**2])
        off = np.abs(np.array(table.accelerations(v, u / R)) - true)
        largest = np.maximum(largest, off)
    assert (largest < 3 * np.array(table.interpolation)).all()
    assert max(table.interpolation[:2]) < 1e-4 * G
    assert table.accelerations(0.0, 0.0) == (0.0, 0.0, 0.0)


def test_a_throw_comes_to_rest_where_the_law_brings_it(table, ends):
    assert table.resting_place < 1e-3
    for throw, (midway, end) in zip(THROWS, ends, strict=True):
        stone = started(*throw)
        for second in range(200):
            if second == 10:
                np.testing.assert_allclose(stone[:2], midway[:2], atol=1e-4)
            stone = table.step(stone, 1.0)
        assert (stone.vx, stone.vy, stone.omega) == (0.0, 0.0, 0.0)
        assert (
            math.hypot(stone.x - end[0], stone.y - end[1])
            < 2 * table.resting_place
            < CM
        )
        assert stone.phi == pytest.approx(end[2], abs=0.01)


def test_swept_ice_and_the_length_of_a_step(table):
    start = started(2.0, 1.0, 0.0)
    a, b = (table.step(start, 2.0, friction) for friction in (1.0, 0.5))
    short = start
    for _ in range(2000):
        short = table.step(short, 0.001)
    np.testing.assert_allclose(short, a, atol=1e-7)
    lost = [2.0 - math.hypot(stone.vx, stone.vy) for stone in (a, b)]
    assert lost[1] == pytest.approx(lost[0] / 2, rel=0.02)


COMPILERS = {
    "c": (("cc", "gcc"), ("-std=c99",)),
    "c++": (("c++", "g++"), ("-x", "c++", "-std=c++17")),
}


def compiled(language, folder, code):
    """The command that runs a program beside the exported header."""
    names, options = COMPILERS[language]
    compiler = next(filter(None, map(shutil.which, names)), None)
    if compiler is None:
        pytest.skip(f"no compiler of {language}")
    (folder / "run.c").write_text(code)
    strict = ["-O2", "-Wall", "-Wextra", "-Werror"]
    words = [compiler, *options, *strict, "run.c", "-o", "run", "-lm"]
    subprocess.run(words, cwd=folder, check=True)
    return [str(folder / "run")]


def compiled_as(language, folder, table):
    """The command that runs the exported stone."""
    if language == "c":
        (folder / "curlfit_stone.h").write_text(c_header(table))
        return compiled("c", folder, (HERE / "stone.c").read_text())
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node to run JavaScript")
    (folder / "curlfit_stone.mjs").write_text(javascript_module(table))
    shutil.copy(HERE / "stone.mjs", folder / "run.mjs")
    return [node, str(folder / "run.mjs")]


def ran(words, throw, *more):
    """The numbers that a program prints of a throw."""
    start = started(*throw)
    numbers = map(str, (start.vx, start.vy, start.omega, *more))
    done = subprocess.run(
        [*words, *numbers], capture_output=True, text=True, check=True
    )
    return np.array(done.stdout.split(), float)


@pytest.mark.parametrize("language", ["c", "js"])
def test_the_exported_stone_comes_to_rest_there_too(tmp_path, table, ends, language):
    words = compiled_as(language, tmp_path, table)
    for throw, (_, end) in zip(THROWS, ends, strict=True):
        for dt in (0.001, 1 / 60):
            printed = ran(words, throw, dt)
            np.testing.assert_allclose(
                printed[:3], table.accelerations(0.7, throw[1]), rtol=1e-9, atol=1e-12
            )
            assert (
                math.hypot(printed[3] - end[0], printed[4] - end[1])
                < 2 * table.resting_place
            )
            assert printed[6] == 0


def test_frames_as_in_digitalcurling_end_there_too(tmp_path, table, ends):
    """The page's own lines, in single precision, with the header as C++."""
    page = (Path(__file__).parents[2] / "notebooks" / "in_a_game.md").read_text()
    (code,) = re.findall(r"<!-- frame -->\n```cpp\n(.*?)```", page, re.S)
    (tmp_path / "curlfit_stone.h").write_text(c_header(table))
    program = (HERE / "frames.cpp").read_text()
    words = compiled("c++", tmp_path, program.replace("// FRAME", code))
    for throw, (_, end) in zip(THROWS, ends, strict=True):
        x, y, speed = ran(words, throw)
        assert math.hypot(x - end[0], y - end[1]) < CM
        assert speed == 0


def test_the_record_is_complete(table):
    """Interpolated from the JSON alone, as its description says."""
    record = json.loads(json.dumps(table.to_json()))
    rows, columns = record["coordinates"]["intervals"]
    angular = np.array(record["angular"])
    assert angular.shape == (rows + 3, columns + 3)
    R = record["stone"]["R"]
    v = 0.9
    k = 11
    # at a node: the angle whose p belongs to column k of the second half
    side_p = 4 * (columns // 2 + k) / columns - 3
    g = np.roots([1 / 15, 0, 0, 0, 0, 0, 14 / 15, -side_p])  # in cbrt(g)
    g = next(float(x.real) ** 3 for x in g if abs(x.imag) < 1e-9)
    omega = v * math.tan(math.pi / 4 * (1 + g)) / R
    at = table.accelerations(v, omega)
    assert angular[1, columns // 2 + k + 1] == pytest.approx(at[2], rel=1e-6)
    assert record["error"]["resting_place"] == table.resting_place


def of_law(fit, law, load="uniform"):
    """The fit, as it would be of another law."""
    estimate = fit.parameters["mu1_xi"]
    coefficients = {
        coefficient.name: replace(estimate, value=coefficient.default)
        for coefficient in find_law(law).coefficients()
    }
    initial_state = {
        name: parameter
        for name, parameter in fit.parameters.items()
        if name not in fit.coefficients
    }
    return replace(fit, law=law, load=load, parameters=coefficients | initial_state)


def with_conditions(fit, **values):
    estimate = fit.parameters["mu1_xi"]
    more = {
        condition.name: replace(
            estimate,
            value=values[condition.name],
            verdict=Verdict.FIXED,
            lower=condition.lower,
            upper=condition.upper,
        )
        for condition in CONDITIONS
        if condition.name in values
    }
    return replace(
        fit,
        parameters=fit.coefficients
        | more
        | {
            name: parameter
            for name, parameter in fit.parameters.items()
            if name not in fit.coefficients
        },
    )


def test_what_no_table_holds_is_refused(eq12_fit):
    for fit, message in (
        (of_law(eq12_fit, "debris"), "depends on the angle turned"),
        (of_law(eq12_fit, "semi-empirical"), "has no contact ring"),
        (
            with_conditions(eq12_fit, wear=0.02),
            r"changes along the throw \(wear = 0.02\)",
        ),
        (
            with_conditions(eq12_fit, wear_20=0.02),
            r"changes along the throw \(wear_20 = 0.02\)",
        ),
    ):
        with pytest.raises(InputError, match=message):
            tabulate(fit)


def test_slope_drag_and_sweeping_of_a_fit_are_named(eq12_fit, table, tmp_path):
    neutral = {"wear": 0.0, "slope_y": 0.0, "sweep": 1.0, "length_scale": 1.02}
    same = tabulate(with_conditions(eq12_fit, **neutral))
    np.testing.assert_array_equal(same.values, table.values)
    assert c_header(same) == c_header(table)
    fit = with_conditions(eq12_fit, slope_x=1.25e-4, drag=0.8, sweep=0.9)
    fit.save(tmp_path / "fit.json")
    forms = ("--to", "table", "--to", "c", "--to", "js")
    done = command("export", "fit.json", *forms, "--out", "game", cwd=tmp_path)
    record = json.loads((tmp_path / "game" / "accelerations.json").read_text())
    assert record["not_included"] == {"slope_x": 1.25e-4, "drag": 0.8, "sweep": 0.9}
    sentence = "Not included from the fit: slope_x = 0.000125, drag = 0.8, sweep = 0.9."
    for name in ("curlfit_stone.h", "curlfit_stone.mjs"):
        assert sentence in (tmp_path / "game" / name).read_text()
    assert sentence in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("law", RINGS)
def test_every_law_of_the_ring(eq12_fit, law, load):
    fit = of_law(eq12_fit, law, load)
    tabulated = tabulate(fit)
    assert tabulated.resting_place < CM
    start = InitialState(v=2.2, omega=1.7)
    end = simulate(
        fit.fitted_law, fit.stone, start, np.array([0.0, np.inf]), load=load
    ).to_numpy()
    stone = tabulated.step(Moved(0, 0, 0, 2.2, 0, 1.7), 100.0)
    assert math.hypot(stone.x - end.x[-1], stone.y - end.y[-1]) < CM
