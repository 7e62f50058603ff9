"""Times between lines and resting positions, against constant deceleration in
closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import codes_of, finding_of
from independent_motion import Reference, front_back
from scipy.optimize import least_squares

import curlfit
from curlfit import LAWS, InitialState, Stone, simulate
from curlfit.errors import InputError
from curlfit.inference.fit.systematics import residual_changes
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.model.likelihood import predict_channels, predict_many
from curlfit.inference.model.model import Model
from curlfit.inference.model.problem import build_problem
from curlfit.inference.model.request import Request
from curlfit.inference.solve.least_squares import Tasks, solve
from curlfit.numerics.batches import stacked
from curlfit.prediction.report import describe_rest
from curlfit.settings.choices import Fitting
from curlfit.throws.events import MOST_EVENTS, Event
from curlfit.throws.throw import Throw

G = 9.81
# m from the hack (World Curling, rule R1)
BACK = 1.829
HOG = 10.059
FAR = 32.004
TEE = 38.405
MODEL = Model(LAWS["coulomb"], "uniform")
EVENTS = (
    Event("back_to_hog", "time", 3.6, 0.1, HOG, BACK),
    Event("hog_to_hog", "time", 14.0, 0.1, FAR, HOG),
    Event("hog_to_tee", "time", 22.0, 0.1, TEE, HOG),
    Event("hog_to_rest", "time", 10.0, 0.1, None, FAR),
    Event("rest", "y", TEE + 0.3, 0.05),
    Event("curl", "x", 1.0, 0.05, since=HOG),
    Event("drift", "x", 0.3, 0.05, FAR),
    Event("speed", "speed", 2.3, 0.02, HOG),
    Event("spin", "omega", 0.0, 0.05, HOG),
)
SIGMA = {event.name: event.sigma for event in EVENTS}


def motion(mu, heading, v, y=HOG):
    """Times at lines and places at rest under a deceleration mu g on a straight
    line from y."""
    a = mu * G
    c = np.cos(heading)

    def time(line):
        return (v - np.sqrt(np.maximum(v**2 - 2 * a * (line - y) / c, 0))) / a

    rest = v / a
    length = v**2 / (2 * a)
    tangent = np.tan(heading)
    return {
        "back_to_hog": time(HOG),
        "hog_to_hog": time(FAR) - time(HOG),
        "hog_to_tee": time(TEE) - time(HOG),
        "hog_to_rest": rest - time(FAR),
        "rest": y + length * c,
        "curl": length * np.sin(heading) - (HOG - y) * tangent,
        "drift": (FAR - y) * tangent,
        "speed": np.sqrt(v**2 - 2 * a * (HOG - y) / c),
        "spin": 0.0,
    }


def from_back(mu, heading, v):
    """All of them in the order of `EVENTS`, from the back line."""
    return np.array([*motion(mu, heading, v, BACK).values()])


def record(**values):
    """Events of a record from the near hog line."""
    events_by_name = {event.name: event for event in EVENTS}
    return tuple(
        replace(events_by_name[name], value=value) for name, value in values.items()
    )


def residual_of(values, *parameters):
    """The peer's residuals of the numbers of a record."""
    expected = motion(*parameters)
    return [(expected[name] - value) / SIGMA[name] for name, value in values.items()]


def vector(mu, heading, v, omega=0.0):
    return np.array([mu, 0.0, BACK, heading, v, 0.0, omega])


@pytest.fixture(scope="module")
def problem():
    throw = Throw.from_events(EVENTS)
    return build_problem(throw, Stone(), {})


def predicted(problem, values):
    return np.asarray(predict_channels(MODEL, values, problem))[-1, : len(EVENTS)]


@pytest.mark.parametrize(
    ("mu", "heading", "v"), [(0.0092, 0.0, 2.6), (0.0077, 0.04, 2.5), (0.02, -0.1, 4.2)]
)
def test_events_of_constant_deceleration(problem, mu, heading, v):
    np.testing.assert_allclose(
        predicted(problem, vector(mu, heading, v)), from_back(mu, heading, v), atol=1e-8
    )


def test_a_spinning_stone_crosses_lines_where_its_path_does(problem):
    start = InitialState(y=BACK, v=2.7, omega=4.0, heading=0.02)
    t = np.arange(0, 40, 0.002)
    path = simulate(LAWS["coulomb"](mu=0.0095), Stone(), start, t).to_numpy()
    crossed = np.interp([HOG, FAR, TEE], path.y, t)
    rest = np.argmax((path.vx == 0) & (path.vy == 0))
    x = np.interp([HOG, FAR], path.y, path.x)
    speed, omega = (np.interp(HOG, path.y, rate) for rate in (path.speed, path.omega))
    prediction = predicted(problem, vector(0.0095, 0.02, 2.7, omega=4.0))
    expected = [
        crossed[0],
        crossed[1] - crossed[0],
        crossed[2] - crossed[0],
        t[rest] - crossed[1],
        path.y[-1],
        path.x[-1] - x[0],
        x[1],
        speed,
        omega,
    ]
    # the grid's chords are 1e-5 s from the curve, its last row up to 2 ms from rest
    assert (
        np.abs(prediction - expected) < 1e-5 * np.array([1, 1, 9, 300, 1, 1, 1, 1, 1])
    ).all()


def slopes(problem, values):
    """Residuals and Jacobians of fits that begin at some parameter vectors and may
    move nothing."""
    parameters = Request.of(
        Throw.from_events(EVENTS), Fitting.of(law="coulomb")
    ).parameters
    tasks = Tasks.of([(parameters, problem, value) for value in values])
    solution = solve(MODEL, tasks._replace(lower=tasks.start, upper=tasks.start))
    np.testing.assert_array_equal(solution.values, values)
    return tuple(
        part[:, -1, : len(EVENTS)] for part in (solution.residual, solution.jacobian)
    )


@pytest.mark.parametrize(
    "values",
    [
        (0.0092, 0.03, 2.6, 0.9),
        (0.0092, 0.03, 2.52, -2.0),
        (0.03, 0.0, 2.6, 0.9),
        (0.0092, 0.03, np.sqrt(2 * 0.0092 * G * (TEE - BACK)), 0.0),
    ],
    ids=["past the tee", "short of the tee", "short of the hog line", "on the tee"],
)
def test_derivatives_are_those_of_differences(problem, values):
    at = vector(*values)
    jacobian = slopes(problem, at[None])[1][0]
    sigma = np.array([event.sigma for event in EVENTS])
    for column, step in ((0, 1e-7), (3, 1e-6), (4, 1e-6), (6, 1e-5)):
        ends = [at + sign * step * np.eye(7)[column] for sign in (1, -1)]
        slope = np.subtract(*(predicted(problem, end) for end in ends)) / (2 * step)
        np.testing.assert_allclose(
            jacobian[:, column] * sigma,
            slope,
            rtol=2e-4,
            atol=2e-4 * max(1, abs(slope).max()),
        )


def test_chi_squared_has_no_corner_where_the_stone_stops(problem):
    mu = 0.009

    def chi_squared(length):
        """And its derivative by the speed, and that speed."""
        v = np.sqrt(2 * mu * G * length)
        residual, jacobian = slopes(
            problem, np.stack([vector(mu, 0.0, speed) for speed in v])
        )
        return (residual**2).sum(1), 2 * (residual * jacobian[..., 4]).sum(1), v

    # from a stop 1 m short of the far hog line to one 1 m past the tee: no jump
    value, slope, v = chi_squared(np.linspace(FAR - BACK - 1, TEE - BACK + 1, 320))
    assert np.isfinite(value).all()
    risen = np.concatenate([[0], np.cumsum(np.diff(v) * (slope[1:] + slope[:-1]) / 2)])
    np.testing.assert_allclose(value - value[0], risen, atol=0.01 * np.ptp(value))
    # nor a corner: across the lines, and across the edge before them, the slope is one
    for line in (FAR, TEE):
        for past in (0.0, 0.02):
            _, slope, _ = chi_squared(line + past - BACK + 1e-6 * np.linspace(-1, 1, 8))
            assert np.ptp(slope) < 1e-3 * abs(slope).max()


def test_three_numbers_determine_one_friction_coefficient(tmp_path):
    values = {"hog_to_hog": 14.2, "rest": TEE + 0.6, "curl": -1.22}
    result = curlfit.fit(Throw.from_events(record(**values)), "coulomb")
    assert result.converged
    assert (result.identifiability.rank, result.n_observations) == (3, 3)
    peer = least_squares(
        lambda p: residual_of(values, *p),
        [0.008, 0.0, 2.1],
        xtol=1e-14,
        x_scale=[0.01, 1, 1],
    )
    stderr = np.sqrt(np.diag(np.linalg.inv(peer.jac.T @ peer.jac)))
    for name, value, error in zip(("mu", "heading", "v0"), peer.x, stderr, strict=True):
        estimate = result.parameters[name]
        assert estimate.verdict == "determined"
        assert estimate.value == pytest.approx(value, rel=1e-6)
        assert estimate.stderr == pytest.approx(error, rel=1e-4)
    fixed = {
        name
        for name, parameter in result.parameters.items()
        if parameter.verdict == "fixed"
    }
    assert fixed == {"x0", "y0", "phi0", "omega0"}
    # nothing is left over, and the curves cover the motion from the line to rest
    assert max(abs(event["fitted"] - event["value"]) for event in result.events) < 1e-6
    assert len(result.fitted["y"]) == 200
    assert result.fitted["y"][[0, -1]] == pytest.approx([HOG, TEE + 0.6])
    result.save(tmp_path / "fit.json")
    again = curlfit.load_fit(tmp_path)
    assert (again.events, again.throw.events) == (result.events, result.throw.events)
    assert again.throw.assumed["y0"] == HOG


def test_a_rough_path_tells_no_exponent():
    throw = Throw.from_events(record(speed=2.1, rest=TEE))
    request = Request.of(throw, Fitting.of(law="power"))
    start = ThrowStack(Model.of(request), [request]).starts()[1][0, 0]
    assert start[1] == LAWS["power"].coefficients()[1].default
    # c v^k over the path, in closed form for k = -1/2: v^2.5 = 2.5 c g s
    assert start[0] == pytest.approx(2.1**2.5 / (2.5 * G * (TEE - HOG)), rel=0.2)


def test_a_table_of_curl_against_spin_gives_the_law(write):
    truth = {"mu2_xi - mu1_xi": 0.046, "mu1_eta + mu2_eta": 0.018}
    peer = Reference(front_back(0.004, 0.05, 0.009, 0.009), R=0.065, nodes=40)
    random = np.random.default_rng(5)
    rows = ["speed_km_h,spin_rpm,curl_cm,rest,turns,sigma_speed"]
    states = []
    for v, omega in zip(
        np.linspace(1.8, 2.3, 12), np.tile([0.6, -1.0, 2.0, -3.0], 3), strict=True
    ):
        end = peer.path(InitialState(y=HOG, v=v, omega=omega), np.array([0.0, 100.0]))[
            :, -1
        ]
        noise = random.normal(0, [0.02, 0.05, 0.05, 0.05, 0.6])
        measured = np.array([v, omega, *end]) + noise
        written = measured * [3.6, 30 / np.pi, 100, 1, 0.5 / np.pi] - [0, 0, 0, TEE, 0]
        rows.append("{:.4f},{:+.4f},{:+.3f},{:.5f},{:+.4f},0.02".format(*written))
        states.append((v, omega))
    throws = curlfit.load_throws(write("\n".join(rows)))
    assert {throw.defaults["law"] for throw in throws} == {"power+deflection"}
    joint = curlfit.fit_together(throws, "front-back", share="all")
    assert joint.converged
    for name, value in truth.items():
        estimate = joint.derive(name)
        assert estimate.stderr < 0.1 * value
        assert abs(estimate.value - value) < 3 * estimate.stderr
    # twelve resting places tell each speed better than its own measurement does
    off = [
        (fit.parameters[name].value - true) / fit.parameters[name].stderr
        for fit, pair in zip(joint.throws, states, strict=True)
        for name, true in zip(("v0", "omega0"), pair, strict=True)
    ]
    assert 0.6 < np.std(off) < 1.4
    assert all(fit.parameters["omega0"].stderr < 0.051 for fit in joint.throws)


@pytest.mark.parametrize(
    "loss", ["linear", pytest.param("student", marks=pytest.mark.slow)]
)
def test_fitted_values_are_those_of_the_motion_under_every_loss(loss):
    events = record(hog_to_hog=14.2, hog_to_rest=12.5, rest=TEE + 0.6, curl=1.0)
    result = curlfit.fit(Throw.from_events(events), "coulomb", loss=loss)
    expected = motion(
        *(result.parameters[name].value for name in ("mu", "heading", "v0"))
    )
    for event in result.events:
        assert event["fitted"] == pytest.approx(expected[event["name"]], abs=1e-6)
    missed = str(finding_of(result, "events-missed"))
    assert (
        f"hog_to_rest by {abs(12.5 - expected['hog_to_rest']) / 0.1:.2g} sigma"
        in missed
    )
    assert missed.endswith("`--law power` lets the friction change with the speed")


def test_systematic_errors_of_lengths_and_times(problem):
    mu = 0.0092
    v = 2.6
    width = 1e-3
    small = 1e-6
    at = vector(mu, 0.0, v)[None]
    problems = stacked([problem])
    path = predict_many(MODEL, at, problems, 1)
    widths = {"length_scale": width, "time_scale": width}
    effects = residual_changes(MODEL, problems, at, path, widths, 1)
    changes = {
        name: change[0, -1, : len(EVENTS)] * [event.sigma for event in EVENTS] / width
        for name, change in effects.items()
    }
    # where lengths are measured too long, the stone is faster and is slowed
    # as much more
    values = from_back(mu, 0.0, v)
    longer = from_back(mu * (1 + small), 0.0, v * (1 + small))
    expected = (longer - values) / small
    expected[7] -= values[7]  # a speed is not measured by these lengths
    np.testing.assert_allclose(changes["length_scale"], expected, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(changes["time_scale"][:4], values[:4], rtol=1e-6)
    np.testing.assert_allclose(changes["time_scale"][4:], 0, atol=1e-6)


@pytest.mark.parametrize(
    ("event", "words"),
    [
        (
            ("a", "heat", 1.0, 0.1),
            "'heat' found, expected one of time, x, y, phi, speed, omega",
        ),
        (("a", "speed", 1.0, 0.1), "expected `at` and no `since`"),
        (("a", "omega", 1.0, 0.1, 10.0, 9.0), "expected `at` and no `since`"),
        (("a", "y", 1.0, 0.1, HOG), "y is measured at rest"),
        (("a", "time", np.nan, 0.1), "expected a finite number"),
        (("a", "time", 1.0, 0.0), "expected a positive number"),
    ],
)
def test_events_that_cannot_be(event, words):
    with pytest.raises(InputError, match=words):
        Event(*event)


def test_what_a_throw_of_events_alone_is_not_asked_for():
    throw = Throw.from_events(record(hog_to_hog=14.2, rest=TEE))
    with pytest.raises(InputError, match="there are no rows to choose"):
        curlfit.fit(throw, "coulomb", until=10)
    with pytest.raises(InputError, match="laws cannot be ranked"):
        curlfit.compare(throw)
    with pytest.raises(InputError, match="no event is timed at a line"):
        Throw.from_events(record(rest=TEE))
    many = tuple(
        Event(f"e{k}", "time", 1.0 + k, 0.1, HOG + k) for k in range(MOST_EVENTS + 1)
    )
    with pytest.raises(
        InputError, match="10 events at 10 lines; expected at most 9 at 6"
    ):
        curlfit.fit(Throw.from_events(many), "coulomb")
    assert throw.with_sigma({"time": 0.2}).events[0].sigma == 0.2
    t = np.linspace(0.0, 10.0, 30)
    path = Throw.from_arrays(t, 0 * t, 2 * t - 0.04 * t**2, 0.1 * t, events=EVENTS[:1])
    with pytest.raises(InputError, match="timed events beside its path"):
        curlfit.fit(path, "coulomb", noise="ar1")


@pytest.fixture(scope="module")
def curled():
    turns = Event("turns", "phi", 20.6, 0.6, since=HOG)
    times = record(hog_to_hog=13.43, hog_to_rest=12.9, rest=38.755, curl=-1.0)
    return Throw.from_events([*times, turns])


def test_a_law_that_cannot_curl_names_the_measured_curl(curled):
    fit = curlfit.fit(curled, "coulomb")
    finding = finding_of(fit, "law-cannot-curl")
    words = (
        "the coulomb law cannot curl a stone: the measured curl of 1.00 m "
        "to the left is in "
    )
    assert str(finding).startswith(words + "the heading; ")
    assert abs(fit["heading"].value + 1.0 / 28.7) < 1e-3  # the chord of the curl


@pytest.mark.slow
def test_a_prediction_by_a_law_that_cannot_curl_says_so(curled):
    fit = curlfit.fit(curled, "coulomb")
    finding = finding_of(fit, "law-cannot-curl")
    prediction = curlfit.predict(fit, start={"v0": 2.2}, draws=100)
    assert finding in prediction.warnings
    assert describe_rest(prediction)[1] == "It does not curl."


def test_a_path_that_curls_names_its_curl_and_a_straight_one_none():
    t = np.linspace(0, 20, 201)
    x = -0.9 * (t / 20) ** 3
    y = 10.059 + 2.2 * t - 0.05 * t**2
    warnings = curlfit.fit(Throw.from_arrays(t, x, y, t), "coulomb").warnings
    (finding,) = [warning for warning in warnings if warning.code == "law-cannot-curl"]
    assert "the measured curl of 0." in str(finding)
    assert finding.numbers["where"] == ["in the heading", "in the residuals"]
    straight = Throw.from_arrays(t, 0.01 * np.sin(5 * t), y, t)
    assert "law-cannot-curl" not in codes_of(curlfit.fit(straight, "coulomb"))
