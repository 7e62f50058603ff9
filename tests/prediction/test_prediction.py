"""Predictions: against an integration that shares no code, brute force, refits
and symmetry."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from conftest import command as curlfit_, invoke
from independent_motion import Reference, front_back
from matplotlib.patches import Ellipse
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

import curlfit
from curlfit import InputError, UnusableFitError, sheet
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.problem import LEVEL_AND_STILL
from curlfit.inference.noise.accelerations import COMPONENTS, SPEEDS
from curlfit.numerics import compiled
from curlfit.prediction.discrepancy import discrepancy_posterior
from curlfit.prediction.ensemble import simulate_ensemble
from curlfit.prediction.figures import prediction_figure
from curlfit.prediction.request import GUARD, TAKEOUT
from curlfit.prediction.result import DETECTION

STONE = curlfit.Stone(R=0.065)
TRUE = {"mu1_xi": 0.005, "mu2_xi": 0.05, "mu1_eta": 0.009, "mu2_eta": 0.009}
HOG = sheet.LINES["hog"]


def thrown(seed=3, until=20.0, law="front-back", noise=(0.005, 0.01), **start):
    true = curlfit.law_with(law, TRUE if law == "front-back" else {})
    return curlfit.synthetic_throw(
        true,
        STONE,
        noise_xy=noise[0],
        noise_phi=noise[1],
        seed=seed,
        until=until,
        **{"v0": 2.15, "omega0": 1.2, "heading": 0.02} | start,
    )


@pytest.fixture(scope="module", autouse=True)
def discrepancy_found_once():
    """That of a fit takes most of the time of a prediction, of which one fit
    has many here."""
    with pytest.MonkeyPatch.context() as patch:
        cached_posterior = lru_cache(discrepancy_posterior)
        patch.setattr(
            "curlfit.prediction.simulation.discrepancy_posterior", cached_posterior
        )
        yield


@pytest.fixture(scope="module")
def fit():
    return curlfit.fit(thrown())


@pytest.fixture(scope="module")
def carried(fit):
    return curlfit.predict(fit, draws=200)


def test_the_longest_programs_are_prepared_as_they_will_be_called(
    eq12_fit, monkeypatch
):
    prepared = {}
    monkeypatch.setattr(compiled, "_programs", {})
    monkeypatch.setattr(
        compiled._CompiledFunction,
        "prepare",
        lambda self, *args: prepared.update(
            {self.__name__: (self, self._call(args).key)}
        ),
    )
    curlfit.predict(eq12_fit, draws=100)
    assert set(prepared) == {"_motions"}
    assert set(prepared.values()) <= set(compiled._programs)


def begun(prediction):
    values = {name: quantity.value for name, quantity in prediction.start.items()}
    names = ("x0", "y0", "heading", "v0", "phi0", "omega0")
    return curlfit.InitialState(*(values[name] for name in names))


def path_by_simulation(fit, start, times, values=None):
    """Of a throw whose law has the fitted coefficients, or others."""
    law = fit.law_class.from_vector(fit.values[:4] if values is None else values)
    return curlfit.simulate(law, STONE, start, times).to_numpy()


# --- the sheet ------------------------------------------------------------------------


def test_the_sheet_is_that_of_the_rules():
    feet = {
        sheet.TEE_TO_TEE: 114,
        sheet.TEE_TO_HACK: 12,
        sheet.TEE_TO_HOG: 21,
        sheet.TEE_TO_BACK: 6,
        sheet.HOG_TO_HOG: 72,
        sheet.LENGTH: 150,
        sheet.WIDTH: 16 + 5 / 12,
        sheet.HOUSE: 6,
    }
    for metres, length in feet.items():
        assert metres == pytest.approx(length * 0.3048, abs=0.005)
    assert (
        pytest.approx([6 * 0.3048, 4 * 0.3048, 2 * 0.3048, 0.1524], abs=0.001)
        == sheet.CIRCLES
    )
    assert 2 * np.pi * sheet.STONE_RADIUS == pytest.approx(0.914, abs=0.005)
    assert pytest.approx(-(6 + 21) / 2 * 0.3048, abs=0.002) == GUARD


# --- the path and its numbers ---------------------------------------------------------


def almost_to_rest(fit, prediction, rows=1501):
    """Times and the independent path up to a twentieth of a second before rest:
    what is left is 0.1 mm. In it the heading turns so fast that the integrator may
    go on for ever."""
    t = np.linspace(0, prediction.quantities["time"].value - 0.05, rows)
    values = [coefficient.value for coefficient in fit.coefficients.values()]
    reference = Reference(
        front_back(*values), R=fit.stone.R, rho=fit.stone.rho, nodes=80
    )
    return t, reference.path(begun(prediction), t)


def test_path_and_lines_are_those_of_an_independent_integration(fit):
    prediction = curlfit.predict(
        fit, start={"v0": 2.4, "omega0": 1.5, "heading": 0.01}, draws=100
    )
    t, (x, y, phi) = almost_to_rest(fit, prediction)
    shown = prediction.series["t"] < t[-1]
    for name, values in {"x": x, "y": y, "phi": phi}.items():
        np.testing.assert_allclose(
            prediction.series[name][shown],
            CubicSpline(t, values)(prediction.series["t"][shown]),
            atol=2e-6,
            rtol=0,
            err_msg=name,
        )
    value = {name: quantity.value for name, quantity in prediction.quantities.items()}
    assert value["rest_x"] == pytest.approx(x[-1], abs=2e-4)
    assert value["rest_y"] == pytest.approx(y[-1] - sheet.TEE, abs=2e-4)
    assert value["turns"] == pytest.approx(phi[-1] / (2 * np.pi), abs=1e-3)
    # to the right of the line of delivery
    across = np.array([np.cos(0.01), -np.sin(0.01)])
    assert value["curl"] == pytest.approx(across @ [x[-1], y[-1] - HOG], abs=2e-4)
    along = CubicSpline(t, y)
    sideways = CubicSpline(t, x)
    times = {}
    speeds = {}
    for line in ("far-hog", "far-tee"):
        level = sheet.LINES[line]
        times[line] = brentq(lambda s, level=level: along(s) - level, 1.0, t[-1])
        speeds[line] = np.hypot(along(times[line], 1), sideways(times[line], 1))
    assert value["hog_to_hog"] == pytest.approx(times["far-hog"], abs=1e-4)
    assert value["hog_to_tee"] == pytest.approx(times["far-tee"], abs=1e-4)
    assert value["speed_at_far_hog"] == pytest.approx(speeds["far-hog"], abs=1e-4)
    assert value["speed_at_tee"] == pytest.approx(speeds["far-tee"], abs=1e-4)
    assert value["speed_at_hog"] == pytest.approx(2.4)
    assert value["hog_to_rest"] == pytest.approx(
        value["time"] - times["far-hog"], abs=1e-4
    )
    rest = value["time"]
    speed = path_by_simulation(
        fit, begun(prediction), [0.0, rest - 2e-3, rest + 2e-3]
    ).speed
    assert speed[1] > 0 == speed[2]


@pytest.fixture(scope="module")
def still():
    """A fit of a stone that does not turn: the halves brake by their mean mu."""
    throw = thrown(omega0=0.0, noise=(0.0, 0.0))
    held = {"omega0": 0.0, "mu1_xi": TRUE["mu1_xi"], "mu1_eta": 0.006}
    return curlfit.fit(throw, fix=held)


def test_a_stone_that_does_not_turn_rests_when_mechanics_say(still):
    """After v0/(mu g), v0^2/(2 mu g) away."""
    prediction = curlfit.predict(still, start={"v0": 2.2}, draws=100)
    slowing = (0.006 + still.coefficients["mu2_eta"].value) / 2 * 9.81
    assert prediction.quantities["time"].value == pytest.approx(2.2 / slowing, abs=1e-3)
    far = sheet.TEE + prediction.quantities["rest_y"].value - HOG
    assert far == pytest.approx(2.2**2 / (2 * slowing), abs=1e-6)


def test_a_mirrored_throw_has_a_mirrored_prediction(eq12_fit):
    start = {"v0": 2.1, "omega0": 1.4, "heading": 0.02, "x0": 0.3}
    mirrored = {
        name: value if name == "v0" else -value for name, value in start.items()
    }
    prediction, mirror_image = (
        curlfit.predict(eq12_fit, start=s, draws=300) for s in (start, mirrored)
    )
    assert prediction.misfit.detected
    for column, sign in (("x", -1), ("phi", -1), ("y", 1)):
        np.testing.assert_allclose(
            mirror_image.series[column], sign * prediction.series[column], atol=1e-9
        )
    # the deviation is turned by a heading that is seen from the fitted one, which
    # is not quite 0
    for column in ("x_model_sd", "y_model_sd", "phi_model_sd", "x_parameter_sd"):
        np.testing.assert_allclose(
            mirror_image.series[column],
            prediction.series[column],
            rtol=0.12,
            atol=1e-6,
            err_msg=column,
        )
    assert mirror_image.quantities["curl"].value == pytest.approx(
        -prediction.quantities["curl"].value
    )
    assert "opposite-turn" in {warning.code for warning in mirror_image.warnings}


def test_the_fitted_throw_is_laid_on_a_line(fit, carried):
    assert carried.of == "fitted"
    assert carried.series["y"][0] == pytest.approx(HOG)
    assert carried.series["x"][0] == 0.0
    n = np.searchsorted(carried.series["t"], 19.95)
    y_in_data = carried.series["y"][:n] - HOG + fit.parameters["y0"].value
    np.testing.assert_allclose(
        np.interp(fit.observed["t"][::10], carried.series["t"][:n], y_in_data)[:-1],
        fit.fitted["y"][::10][:-1],
        atol=1e-6,
    )
    kept = curlfit.predict(fit, line="data", draws=100)
    assert kept.series["y"][0] == pytest.approx(fit.parameters["y0"].value)


@pytest.mark.slow
def test_throws_of_a_stop_watch_lie_on_the_sheet(tmp_path):
    (tmp_path / "b.txt").write_text(
        "hog_to_hog = 13.45\nhog_to_rest = 12.22\nback_to_hog = 3.5\nrest = 0\n"
    )
    watched = curlfit.fit(curlfit.load_throw(tmp_path / "b.txt"))
    prediction = curlfit.predict(watched, draws=100)
    assert prediction.line == "data"
    assert prediction.quantities["hog_to_hog"].value == pytest.approx(13.45, abs=0.3)
    (finding,) = (
        warning
        for warning in prediction.warnings
        if warning.code == "discrepancy-by-prior"
    )
    components = [size["component"] for size in finding.numbers["sizes"]]
    assert components == ["across the path", "along the path", "in the spin"]


# --- aiming ---------------------------------------------------------------------------


def test_a_target_is_met_by_an_independent_integration(fit):
    target = (-0.8, 1.1)
    prediction = curlfit.predict(fit, target=target, start={"omega0": -2.0}, draws=100)
    x, y, _ = almost_to_rest(fit, prediction, rows=2)[1][:, -1]
    assert np.hypot(x - target[0], y - sheet.TEE - target[1]) < 1e-3
    assert (
        prediction.start["v0"]["origin"]
        == prediction.start["heading"]["origin"]
        == "found"
    )


@pytest.mark.parametrize("heading", [None, 0.03])
def test_a_takeout_passes_the_tee_at_its_speed(fit, heading):
    start = {} if heading is None else {"heading": heading}
    prediction = curlfit.predict(fit, weight="takeout", start=start, draws=100)
    assert prediction.quantities["speed_at_tee"].value == pytest.approx(
        TAKEOUT, abs=2e-4
    )
    if heading is None:
        across = np.interp(sheet.TEE, prediction.series["y"], prediction.series["x"])
        assert across == pytest.approx(0.0, abs=1e-3)
    assert prediction.chances["through the house"] == 1.0


def test_weights_rest_where_they_say(fit):
    for weight, y in (("draw", 0.0), ("guard", GUARD)):
        prediction = curlfit.predict(fit, weight=weight, draws=100)
        assert prediction.quantities["rest_x"].value == pytest.approx(0.0, abs=1e-6)
        assert prediction.quantities["rest_y"].value == pytest.approx(y, abs=1e-6)
    aside = curlfit.predict(fit, weight="draw", start={"heading": 0.0}, draws=100)
    assert aside.quantities["rest_y"].value == pytest.approx(0.0, abs=1e-6)
    assert aside.quantities["rest_x"].value == pytest.approx(
        aside.quantities["curl"].value
    )
    assert abs(aside.quantities["rest_x"].value) > 0.5


def test_the_place_follows_the_start_as_said(fit):
    base = curlfit.predict(fit, start={"v0": 2.1}, draws=100)
    for name, sensitivity in base.sensitivity.items():
        field = {"heading": "heading"}.get(name, name.removesuffix("0"))
        start = begun(base)
        start = replace(start, **{field: getattr(start, field) + sensitivity["by"]})
        moved = path_by_simulation(fit, start, [0.0, 300.0])
        for way, end, zero, key in (
            ("right", moved.x[-1], 0.0, "rest_x"),
            ("along", moved.y[-1], sheet.TEE, "rest_y"),
        ):
            change = end - zero - base.quantities[key].value
            assert change == pytest.approx(sensitivity[way], abs=1e-4), (name, way)


# --- errors of the parameters ---------------------------------------------------------


def test_bands_are_those_of_brute_force(fit):
    """Coefficients by numpy from the fit's covariance, each with its own path."""
    prediction = curlfit.predict(
        fit, start={"v0": 2.3, "omega0": 1.2, "heading": 0.0}, draws=1000
    )
    names = list(fit.coefficients)
    k = 200
    indices = [fit.covariance.names.index(name) for name in names]
    matrix = fit.covariance.matrix[np.ix_(indices, indices)]
    random = np.random.default_rng(5)
    t = 25.0  # some two seconds before rest
    positions = []
    for values in random.multivariate_normal(
        [fit.coefficients[n].value for n in names], matrix, k
    ):
        path = path_by_simulation(fit, begun(prediction), [0.0, t], values)
        positions.append([path.x[-1], path.y[-1], path.phi[-1]])
    row = int(np.argmin(np.abs(prediction.series["t"] - t)))
    for name, size in zip(("x", "y", "phi"), np.std(positions, axis=0), strict=True):
        sd = prediction.series[f"{name}_parameter_sd"][row]
        assert sd == pytest.approx(size, rel=4 / np.sqrt(2 * k)), name


@pytest.mark.slow
def test_chain_and_covariance_say_the_same(eq12_posterior):
    fit, chain = eq12_posterior
    by_chain = curlfit.predict(fit, chain)
    by_covariance = curlfit.predict(fit)
    assert (by_chain.draws["source"], by_covariance.draws["source"]) == (
        "chain",
        "covariance",
    )
    for name, quantity in by_chain.quantities.items():
        assert by_covariance.quantities[name].parameter_sd == pytest.approx(
            quantity.parameter_sd, rel=0.1
        )
    with pytest.raises(InputError, match="of another fit"):
        curlfit.predict(fit, replace(chain, names=chain.names[::-1]))


def test_the_split_that_is_not_known_does_not_widen_the_bands(fit):
    assert fit.identifiability.null_directions
    free = curlfit.predict(fit, weight="draw", draws=400)
    held = curlfit.predict(
        curlfit.fit(thrown(), fix={"mu1_eta": 0.009}), weight="draw", draws=400
    )
    for name in ("rest_x", "rest_y", "time"):
        assert free.quantities[name].parameter_sd == pytest.approx(
            held.quantities[name].parameter_sd, rel=0.1
        )
    (note,) = (note for note in free.notes if note.code == "null-without-effect")
    assert note.numbers["names"] == ["mu1_eta", "mu2_eta"]
    assert 0 <= note.numbers["moved"] < 1e-5
    assert str(note) == (
        "mu1_eta and mu2_eta are not determined individually, which has no effect "
        "here: over the allowed range the resting position moves by less than 0.01 mm"
    )


def test_what_is_not_known_and_matters_is_said_and_in_the_bands():
    """A stone that does not turn tells nothing of curl."""
    throw = thrown(omega0=0.0)
    straight = curlfit.fit(
        curlfit.Throw.from_arrays(throw.t, throw.x, throw.y),
        stone=STONE,
        fix={"omega0": 0.0, "mu1_xi": 0.005, "mu1_eta": 0.009},
        bounds={"mu2_xi": (0.02, 0.08)},
    )
    assert straight.identifiability.null_directions == ({"mu2_xi": 1.0},)
    # which it cannot be sure of along mu2_xi
    straight = replace(straight, converged=True)
    again = curlfit.predict(straight, draws=200)
    assert again.quantities["curl"].parameter_sd < 0.01
    turning = curlfit.predict(straight, start={"omega0": 1.2}, draws=200)
    (finding,) = (
        warning for warning in turning.warnings if warning.code == "null-moves-rest"
    )
    assert finding.numbers["moved"] > 0.1
    assert "mu2_xi is not determined, which affects this throw" in str(finding)
    assert turning.quantities["curl"].parameter_sd > 0.1


def test_a_new_throw_asks_for_a_spin_that_the_fit_does_not_know(fit):
    unknown = replace(
        fit,
        parameters=fit.parameters
        | {
            "omega0": replace(
                fit.parameters["omega0"], verdict=Verdict.NOT_IDENTIFIABLE
            )
        },
    )
    with pytest.raises(InputError, match="does not determine the spin"):
        curlfit.predict(unknown, start={"v0": 2.0})


# --- errors of the law ----------------------------------------------------------------


def game_throw(v0=2.2, omega0=1.5, seed=0, until=np.inf):
    """A throw as the simulator of DigitalCurling makes it (FCV1), every 0.12 s with
    noise, and where it comes to rest."""

    def rates(t, state):
        _, _, v, heading, _, omega = state
        slowing = 9.81 * (0.00200985 / (v + 0.06385782) + 0.00626286)
        turn = np.sign(omega) * 0.0082 * v**-0.8
        spin = -np.sign(omega) * 0.025 / max(v, 0.001)
        return [v * np.sin(heading), v * np.cos(heading), -slowing, -turn, omega, spin]

    def resting(t, state):
        return state[2] - 1e-3

    resting.terminal = True
    path = solve_ivp(
        rates,
        (0, 60),
        [0, 0, v0, 0, 0, omega0],
        events=resting,
        dense_output=True,
        rtol=1e-9,
        atol=1e-10,
    )
    t = np.arange(0, min(path.t[-1], until), 0.12)
    random = np.random.default_rng(seed)
    x, y, _, _, phi, _ = path.sol(t) + np.array(
        [[0.005], [0.005], [0], [0], [0.01], [0]]
    ) * random.standard_normal((6, len(t)))
    return curlfit.Throw.from_arrays(t, x, y, phi), path.y[:2, -1]


@pytest.fixture(scope="module")
def game_fit():
    result = curlfit.fit(game_throw()[0], stone=STONE, details=False)
    assert result.parameters["mu1_xi"].verdict == "at bound"
    return result


def path_of(fit, values=None):
    t = np.linspace(0, 1.1 * np.ptp(fit.observed["t"]), 331)
    values = fit.values[None] if values is None else values
    return simulate_ensemble(fit.model, values, fit.stone, LEVEL_AND_STILL, t)


def test_a_path_under_further_accelerations_is_that_of_mechanics(still):
    """Constant friction and constant accelerations beside it, by scipy."""
    t = np.linspace(0.0, 60.0, 601)
    law = simulate_ensemble(
        still.model, still.values[None], still.stone, LEVEL_AND_STILL, t
    )
    across = -0.01
    along = 0.02
    turning = 0.005
    acceleration = np.tile(
        np.array([across, along, turning])[:, None], (1, 1, len(t) - 1)
    )
    path = law.with_accelerations(acceleration)
    names = ("heading", "v0", "x0", "y0", "phi0")
    heading, v0, x0, y0, phi0 = (still.parameters[name].value for name in names)
    slowing = (0.006 + still.coefficients["mu2_eta"].value) / 2 * 9.81 - along
    rest = v0 / slowing

    def rates(t, state):
        v = v0 - slowing * t
        return [v * np.sin(state[2]), v * np.cos(state[2]), across / v]

    by_scipy = solve_ivp(
        rates, (0, 0.999 * rest), [x0, y0, heading], dense_output=True, rtol=1e-9
    )
    shown = t < 0.98 * rest
    expected = by_scipy.sol(t[shown])
    position = path.positions_at(t[shown])[0]
    np.testing.assert_allclose(position[0], expected[0], atol=2e-4)
    np.testing.assert_allclose(position[1], expected[1], atol=2e-4)
    np.testing.assert_allclose(
        position[2], phi0 + turning * t[shown] ** 2 / 2, atol=1e-6
    )
    assert path.time_of_rest[0] == pytest.approx(rest, abs=1e-6)
    nothing = law.with_accelerations(0.0 * acceleration)
    np.testing.assert_allclose(nothing.state[:, :3], law.state[:, :3], atol=1e-9)


@pytest.mark.slow
def test_the_coefficients_of_a_refit_are_not_changed_by_a_missing_acceleration(fit):
    """They are those of least squares by definition; the start follows
    the acceleration."""
    posterior = discrepancy_posterior(fit)
    missing = posterior.draw(2, np.random.default_rng(2))
    missing = missing._replace(
        acceleration=0.2 * missing.acceleration, change=0.2 * missing.change
    )
    paths = missing.applied_to(path_of(fit, fit.values + missing.change))
    sigma = {name: fit.sigma[name] for name in ("x", "y", "phi")}
    t = fit.observed["t"]
    coefficients = list(fit.coefficients)
    assert missing.change[:, : len(coefficients)] == pytest.approx(0.0, abs=1e-9)
    for values in paths.positions_at(t - t[0]):
        again = curlfit.fit(
            curlfit.Throw.from_arrays(t, *values, sigma=sigma), stone=STONE
        )
        for name, estimate in fit.parameters.items():
            if estimate.verdict == "determined":
                off = again.parameters[name].value - estimate.value
                assert abs(off) < 0.15 * estimate.stderr, name


def test_bands_of_a_law_at_its_bound_are_as_wide_as_its_errors():
    """Of a record that ends long before rest."""
    throw, rest = game_throw(seed=4, until=9.0)
    fit = curlfit.fit(throw, stone=STONE, details=False)
    prediction = curlfit.predict(fit, line="data", draws=400)
    for name, true in (("rest_x", rest[0]), ("rest_y", rest[1] - sheet.TEE)):
        quantity = prediction.quantities[name]
        half = (quantity.quantiles["84"] - quantity.quantiles["16"]) / 2
        assert quantity.quantiles["2.5"] < true < quantity.quantiles["97.5"]
        assert half < 2.0  # m; it was 47 m across


def test_a_missing_force_is_less_than_the_friction(game_fit):
    posterior = discrepancy_posterior(game_fit)
    discrepancy = posterior.summary
    speed = game_fit.fitted["speed"]
    friction = (speed[0] - speed[-1]) / np.ptp(game_fit.observed["t"])
    assert discrepancy.friction == pytest.approx(friction / 9.81, rel=0.01)
    slipping = np.mean(
        np.minimum(STONE.R * np.abs(game_fit.fitted["omega"]) / speed, 1)
    )
    moment = friction * STONE.R / STONE.rho**2 * slipping
    t = game_fit.observed["t"]
    path = [game_fit.fitted[name] for name in ("x", "y")]
    turning = np.gradient(np.unwrap(np.arctan2(*CubicSpline(t, path, axis=1)(t, 1))), t)
    bend = np.sqrt(np.mean((speed * turning)[speed > 0.05] ** 2))
    expected = {
        "across": max(bend, 0.05 * friction),
        "along": friction,
        "turning": moment,
    }
    largest = {
        "across": friction,
        "along": friction,
        "turning": friction * STONE.R / STONE.rho**2,
    }
    accelerations = posterior.draw(2000, np.random.default_rng(1)).acceleration
    observed_speeds = np.flatnonzero(speed.min() <= SPEEDS)
    for index, way in enumerate(COMPONENTS):
        assert discrepancy.ceilings[way] == pytest.approx(expected[way], rel=0.01)
        assert discrepancy.sizes[way] <= discrepancy.ceilings[way]
        size = accelerations[:, index].std(0)
        assert (size[observed_speeds] < 1.5 * discrepancy.ceilings[way]).all()
        assert (size < 1.5 * largest[way]).all()


def test_what_cannot_be_seen_has_the_size_of_the_prior():
    """An exponential one, 5 % above the friction, cut off there; turning shows in
    no row here."""
    throw = thrown()
    summary = discrepancy_posterior(
        curlfit.fit(
            curlfit.Throw.from_arrays(throw.t, throw.x, throw.y),
            stone=STONE,
            fix={"omega0": 1.2},
        )
    ).summary
    rate = np.log(20)
    moments = [quad(lambda s, k=k: s**k * np.exp(-rate * s), 0, 1)[0] for k in (0, 2)]
    size = np.sqrt(moments[1] / moments[0])
    assert summary.sizes["turning"] / summary.ceilings["turning"] == pytest.approx(
        size, rel=0.05
    )
    assert summary.excess["turning"] == pytest.approx(0.0, abs=0.1)


# --- held-out rows --------------------------------------------------------------------


def test_held_out_rows_of_the_right_law(fit):
    prediction = curlfit.held_out(thrown(), until=12.0, draws=200, stone=STONE)
    check = prediction.check
    assert (check.first, check.last) == (pytest.approx(12.1), pytest.approx(20.0))
    for name in ("x", "y", "phi"):
        channel = check.channels[name]
        assert channel["rows"] == 80
        assert channel["inside_95"] > 0.8
        assert abs(channel["end"]) < 4 * channel["end_sd"]


def test_held_out_rows_of_eq12_are_farther_off_than_its_parameters_say(eq12):
    prediction = curlfit.held_out(eq12, until=12.0, draws=200)
    (finding,) = (
        warning
        for warning in prediction.warnings
        if warning.code == "missing-acceleration"
    )
    shown = {size["component"]: size["size"] for size in finding.numbers["sizes"]}
    assert shown["along the path"] == prediction.misfit.sizes["along"]
    assert prediction.misfit.excess["along"] > DETECTION
    for name in ("y", "phi"):
        channel = prediction.check.channels[name]
        parameter_sd = np.interp(
            20.0, prediction.series["t"], prediction.series[f"{name}_parameter_sd"]
        )
        assert abs(channel["end"]) > 10 * parameter_sd
        assert abs(channel["end"]) < 3 * channel["end_sd"]


# --- what cannot be -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"start": {"speed": 2.0}}, "unknown 'speed'; expected some of x0, y0"),
        ({"start": {"v0": np.inf}}, "start.v0 = inf; expected a number"),
        ({"target": "tee"}, "target = 'tee'; expected 2 numbers"),
        (
            {"call": curlfit.Call({"sheet": "2"})},
            "sheet: the fit of one throw has no groups",
        ),
        (
            {"call": curlfit.Call(thrower=(0.15, 0.1))},
            "thrower-sd`: the fit of one throw predicts a stone that is released as",
        ),
        ({"check": 20.0}, "no rows after t = 20 s"),
        ({"check": 25.0}, "not the throw that was fitted"),
    ],
)
def test_what_python_alone_can_ask_is_refused(fit, asked, said):
    if "check" in asked:
        asked = {
            "check": thrown(
                v0=2.15 if asked["check"] == 20 else 3.0, until=asked["check"]
            )
        }
    with pytest.raises(InputError, match=said):
        curlfit.predict(fit, draws=100, **asked)


def test_a_fit_that_is_not_usable_foretells_nothing(fit):
    with pytest.raises(UnusableFitError, match="nothing can be predicted"):
        curlfit.predict(replace(fit, converged=False, status="not converged"))
    frozen = {
        name: replace(coefficient, value=0.0)
        for name, coefficient in fit.coefficients.items()
    }
    with pytest.raises(UnusableFitError, match="does not bring this stone to rest"):
        curlfit.predict(replace(fit, parameters=fit.parameters | frozen))


def test_extrapolation_is_said(fit):
    def warnings_of(**start):
        return curlfit.predict(fit, start=start, draws=100).warnings

    of_speed, of_spin = (
        warning
        for warning in warnings_of(v0=3.0, omega0=5.0)
        if warning.code == "above-fitted-range"
    )
    assert str(of_speed).startswith(
        "the initial speed of 3 m/s is above the fitted range, up to 2.15"
    )
    assert of_speed.numbers["limit"] == pytest.approx(fit.fitted["speed"].max())
    assert of_spin.numbers["quantity"] == "spin"
    assert of_spin.numbers["value"] == pytest.approx(5.0, rel=1e-12)
    slow = {
        warning.code: warning
        for warning in warnings_of(v0=2.1, omega0=0.1, heading=0.15)
    }
    assert slow["below-fitted-range"].numbers["value"] == pytest.approx(0.1)
    slowest = slow["end-below-fitted-range"].numbers["speed"]
    assert slowest == pytest.approx(fit.fitted["speed"].min())
    assert slow["touches-side"].numbers["where"] == "before"


# --- records, files and the command ---------------------------------------------------


def test_the_figure_shows_the_intervals_of_the_table(game_fit):
    prediction = curlfit.predict(game_fit, line="data", draws=200)
    assert len(prediction.measured["t"]) == len(game_fit.observed["t"])
    house = prediction_figure(prediction).axes[1]
    ellipses = [patch for patch in house.patches if type(patch) is Ellipse][:2]
    for ellipse, (low, high) in zip(
        ellipses, (("2.5", "97.5"), ("16", "84")), strict=True
    ):
        angle = np.radians(ellipse.angle)
        half = np.array([ellipse.width, ellipse.height]) / 2
        shadow = [
            np.hypot(half[0] * np.cos(angle), half[1] * np.sin(angle)),
            np.hypot(half[0] * np.sin(angle), half[1] * np.cos(angle)),
        ]
        for middle, size, name in zip(
            ellipse.center, shadow, ("rest_x", "rest_y"), strict=True
        ):
            shown = prediction.quantities[name].quantiles
            assert middle - size == pytest.approx(shown[low], abs=1e-9)
            assert middle + size == pytest.approx(shown[high], abs=1e-9)


def test_a_new_throw_has_the_rows_of_the_fitted_one_beside_it(fit):
    start = {"v0": 2.3, "heading": 0.02, "x0": 0.4}
    prediction = curlfit.predict(fit, start=start, draws=100)
    first = {name: fit.parameters[name].value for name in ("x0", "y0", "heading")}
    x = fit.observed["x"] - first["x0"]
    y = fit.observed["y"] - first["y0"]
    # distances from the start stay, and directions seen from it are turned
    # by the heading
    bearing = np.arctan2(x, y) + start["heading"] - first["heading"]
    position = (
        0.4 + np.hypot(x, y) * np.sin(bearing),
        HOG + np.hypot(x, y) * np.cos(bearing),
    )
    np.testing.assert_allclose(
        (prediction.measured["x"], prediction.measured["y"]), position, atol=1e-12
    )


def test_a_record_comes_back(carried, tmp_path):
    carried.save(tmp_path / "predict.json")
    again = curlfit.load_prediction(tmp_path)
    assert json.dumps(again.summary()) == json.dumps(carried.summary())
    assert (again.warnings, again.notes) == (carried.warnings, carried.notes)
    assert [note.code for note in again.notes] == [
        "null-without-effect",
        "undetected-acceleration",
        "start-assumed",
    ]
    for name, values in carried.series.items():
        np.testing.assert_array_equal(again.series[name], values)
    assert again.table() == carried.table()
    table = np.genfromtxt(
        io.StringIO(carried.table()),
        delimiter=",",
        names=True,
        skip_header=3,
        deletechars="",
        replace_space=" ",
    )
    np.testing.assert_allclose(table["y_97.5"], carried.series["y_97.5"], rtol=1e-7)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A throw and the fit of its first 12 s."""
    directory = tmp_path_factory.mktemp("predict")
    simulation = curlfit_(
        "simulate",
        "--v0",
        2.2,
        "--omega0",
        1.2,
        "--noise-xy",
        0.005,
        "--noise-phi",
        0.01,
        "--out",
        "a.csv",
        cwd=directory,
    )
    assert simulation.returncode == 0, simulation.stderr
    run = curlfit_(
        "fit",
        "a.csv",
        "--until",
        12,
        "--no-sample",
        "--no-figures",
        "-q",
        cwd=directory,
    )
    assert run.returncode == 0, run.stderr
    return directory


def test_the_command(folder):
    run = curlfit_("predict", "a-fit", "--to-tee", "--draws", 200, cwd=folder)
    assert (run.returncode, run.stderr) == (0, "")
    for words in (
        "another throw on this ice",
        "on the near hog line",
        "it comes to rest on the tee",
        "rad/s (fitted)",
        "Gaussian along determined directions",
        "It curls",
        "ft) to the left",
        "which has no effect here",
        "from throw to throw",
        "Written: a-predict/predict.json",
    ):
        assert words in " ".join(run.stdout.split()), words
    assert sorted(file.name for file in (folder / "a-predict").iterdir()) == [
        "predict.csv",
        "predict.json",
        "predict.png",
    ]
    record = json.loads((folder / "a-predict" / "predict.json").read_text())
    assert record["schema"] == 1
    assert record["goal"] == {"words": "to the tee", "x": 0.0, "y": 0.0, "speed": 0.0}
    shown = invoke(["show", str(folder / "a-predict")])
    assert shown.stdout == run.stdout[: run.stdout.index("Written:")]
    as_json = invoke(["show", str(folder / "a-predict"), "--json"])
    assert json.loads(as_json.stdout)["law"] == "front-back"
    (folder / "a-predict" / "predict.png").unlink()
    assert invoke(["plot", str(folder / "a-predict")]).exit_code == 0
    assert (folder / "a-predict" / "predict.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_compares_with_measured_rows(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "c").mkdir()
    (folder / "c" / "predict.png").touch()
    words = [
        "predict",
        "a-fit/fit.json",
        "--check",
        "a.csv",
        "--out",
        "c",
        "--draws",
        "100",
    ]
    quiet = invoke([*words, "-q", "--no-figures"])
    assert (quiet.exit_code, quiet.stdout) == (0, ""), quiet.exception
    assert not (folder / "c" / "predict.png").exists()  # it was of an earlier result
    text = invoke(["show", "c"]).stdout
    assert "within 68 %" in text
    assert "from t = 12.1 to 20 s" in " ".join(text.split())
    assert set(curlfit.load_prediction(folder / "c").check.channels) == {
        "x",
        "y",
        "phi",
    }


@pytest.mark.slow
def test_a_discrepancy_that_the_fit_has_as_noise_is_in_the_bands(fit):
    white = curlfit.predict(fit, draws=200)
    with_discrepancy = curlfit.predict(
        curlfit.fit(thrown(), noise="discrepancy"), draws=200
    )
    for name in ("rest_x", "rest_y"):
        quantity = with_discrepancy.quantities[name]
        expected = white.quantities[name]
        assert quantity.value == pytest.approx(expected.value, abs=1e-4)
        assert quantity.model_sd == pytest.approx(expected.model_sd, rel=1e-6)
    assert "law-without-discrepancy" in {note.code for note in with_discrepancy.notes}
