"""A spin that was measured to rest, under laws whose spin ends there with a jump.

The two logs are of simulators other than curlfit, whose spin falls to zero over the
last rows.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

import curlfit
from curlfit import LAWS
from curlfit.inference.fit.other_rests import (
    optima_with_other_rests,
    starts_with_other_rests,
)
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.model.likelihood import chi_squared_of_many
from curlfit.inference.solve.least_squares import Tasks, minimize_many
from curlfit.inference.together.fit import solved_together
from curlfit.inference.together.request import JointRequest
from curlfit.numerics.batches import stacked, unstacked
from curlfit.throws.channels import CHANNELS

LOGS = Path(__file__).parent / "spin_to_rest"
AXES = {1: "x-along", 2: None}
LAW = "semi-empirical"
STARTS = 10


def load(log):
    axes = AXES[log]
    return curlfit.load_throw(
        LOGS / f"log_{log}.csv", **({"axes": axes} if axes else {})
    )


@pytest.fixture(scope="module", params=AXES)
def log(request):
    return request.param


@pytest.fixture(scope="module")
def fit(log):
    return curlfit.fit(load(log), LAW, details=False)


def closed_form(values, t, measured, interval=0.1):
    """x, y, phi and spin of the rows under the semi-empirical law, and the time of
    rest: speed and spin in closed form, the path by Simpson's rule. Within half an
    interval of the rest, the spin nearest to the measured one."""
    a, c, p, q, r, x0, y0, heading, v0, phi0, omega0 = values
    k = 1 / (1 - p)
    rest = v0 ** (1 - p) * k / c
    loss = q * v0**r * rest

    def left(time):
        return np.maximum(1 - time / rest, 0.0)

    def spin(time):
        lost = (1 - left(time) ** (1 + k * r)) / (1 + k * r)
        return np.where(time < rest, omega0 - loss * lost, 0.0)

    def angle(time):
        now = np.minimum(time, rest)
        remaining = (1 - left(time) ** (2 + k * r)) / (2 + k * r) * rest
        return phi0 + omega0 * now - loss * (now - remaining) / (1 + k * r)

    dense = 1 - (1 - np.linspace(0, 1, 4001)) ** 2  # toward rest
    bend = a * rest / v0 * (1 - (1 - dense) ** (1 - k)) / (1 - k)
    course = heading - bend
    speed = v0 * (1 - dense) ** k
    rates = np.nan_to_num(speed * np.array([np.sin(course), np.cos(course)]))
    moved = cumulative_simpson(rates, x=dense * rest, initial=0)
    x, y = np.array([[x0], [y0]]) + CubicSpline(dense * rest, moved, axis=1)(
        np.minimum(t, rest)
    )
    rows = spin(t)
    for row in np.flatnonzero(np.abs(rest - t) < interval / 2):
        part = min(2 - 4 * abs(rest - t[row]) / interval, 1)
        certain = 1 - part**4 * (5 - 4 * part)
        lower = certain * rows[row]
        upper = lower + (1 - certain) * spin(t[row] - interval / 2)
        rows[row] = min(max(measured[row], lower), upper)
    return np.array([x, y, angle(t), rows]), rest


def rest_of(values):
    """Time of rest in s."""
    return closed_form(values, np.zeros(1), np.zeros(1))[1]


def test_the_modelled_rows_are_those_of_the_closed_form(fit):
    t = fit.observed["t"]
    expected, rest = closed_form(fit.values, t, fit.observed["omega"])
    assert 0 < (t > rest).sum() < 30
    fitted = np.array([fit.fitted[name] for name in ("x", "y", "phi", "omega")])
    assert np.abs(fitted - expected).max() < 1e-4


def test_chi_squared_is_continuous_where_the_rest_passes_rows(fit):
    """The initial speed moves the rest by a second, over ten rows. Of steps half as
    long the largest changes of the spin's chi squared are half as large; with the spin
    at the time of the row, a jump stays."""
    problem = problem_of(fit)
    weight = np.zeros_like(problem.weight)
    weight[CHANNELS.index("omega")] = problem.weight[CHANNELS.index("omega")]
    problem = problem._replace(weight=weight)
    speeds = fit["v0"].value + np.linspace(-0.03, 0.03, 1025)
    values = np.tile(fit.values, (len(speeds), 1))
    values[:, fit.parameter_set.index("v0")] = speeds

    def largest_changes(problem):
        many = stacked([problem] * len(speeds))
        chi_squared = chi_squared_of_many(fit.model, values, many)
        return [np.abs(np.diff(chi_squared[::step])).max() for step in (2, 1)]

    coarse, fine = largest_changes(problem)
    assert fine < 0.6 * coarse
    sampled = problem.spins._replace(interval=np.asarray(0.0))
    coarse, fine = largest_changes(problem._replace(spins=sampled))
    assert fine > 0.8 * coarse > 20


def test_no_start_of_scipy_leads_lower(fit):
    """The optimum with curlfit's own sigmas, by scipy with the closed form."""
    assert fit.converged
    names = [name for name in ("x", "y", "phi", "omega") if name in fit.sigma]
    rows = [["x", "y", "phi", "omega"].index(name) for name in names]
    observed = np.array([fit.observed[name] for name in names])
    sigma = np.array([[fit.sigma[name]] for name in names])
    free = np.array(fit.parameter_set.free)
    lower = fit.parameter_set.lower[free]
    upper = fit.parameter_set.upper[free]
    typical = fit.parameter_set.typical[free]

    def residual(some):
        values = np.array(fit.values)
        values[free] = some
        path, _ = closed_form(values, fit.observed["t"], fit.observed["omega"])
        return np.nan_to_num((path[rows] - observed) / sigma, nan=1e6).ravel()

    chi_squared = (residual(fit.values[free]) ** 2).sum()
    random = np.random.default_rng(1)
    for size in np.geomspace(1e-3, 0.1, STARTS):
        start = fit.values[free] + size * typical * random.standard_normal(free.sum())
        inside = np.clip(start, lower + 1e-6 * typical, upper - 1e-6 * typical)
        best = least_squares(
            residual, inside, bounds=(lower, upper), x_scale=typical, max_nfev=100
        )
        assert chi_squared < 2 * best.cost + 0.1


OF_STONE = [name for name, law in LAWS.items() if issubclass(law, curlfit.NetLaw)]


@pytest.mark.slow
@pytest.mark.parametrize("law", OF_STONE)
def test_laws_of_the_whole_stone_converge(law, log):
    assert curlfit.fit(load(log), law, details=False).converged


def searched_again(fit):
    """The problem of a fit as one of many, its optimum from the values of the fit, and
    starts with the rest in other rows."""
    problem = problem_of(fit)
    parameters = fit.parameter_set
    tasks = Tasks.of([(parameters, problem, fit.values)])
    (best,) = unstacked(minimize_many(fit.model, tasks, 1))
    bounds = parameters.lower, parameters.upper
    starts = starts_with_other_rests(
        fit.model, best, problem, *bounds, parameters.typical
    )
    return tasks, best, starts


def test_from_a_minimum_in_another_row_the_search_goes_on():
    """Of the second log the spin falls to 0 over ten rows, and several have a minimum,
    in which the starts with the rest in other rows end; none is lower."""
    fit = curlfit.fit(load(2), LAW, details=False)
    tasks, best, starts = searched_again(fit)
    rests = [rest_of(start) for start in starts]
    rest = rest_of(fit.values)
    rows = np.array([-8, -4, -2, -1, 1, 2, 4, 8])
    assert np.abs((rests - rest) / 0.1 - rows).max() < 1.0
    optima = [
        unstacked(minimize_many(fit.model, tasks._replace(start=start[None]), 1))[0]
        for start in starts
    ]
    chi_squared = np.array([optimum.chi_squared for optimum in optima])
    assert (chi_squared > best.chi_squared - 1e-6).all()
    worse = [
        optimum for optimum in optima if optimum.chi_squared > best.chi_squared + 1
    ]
    assert worse


def test_throws_together_search_on_too_each_with_the_coefficients_of_all():
    """The second log with more noise, and its later part with other noise. From one
    start the second throw had its rest in a row where chi squared was 1.2 higher."""
    log = load(2)
    random = np.random.default_rng(6)
    sigma = {"x": 0.015, "y": 0.015, "phi": 0.03, "omega": 0.06}
    throws = []
    for first in (0, 100):
        noisy = {
            name: getattr(log, name)[first:]
            + noise * random.standard_normal(len(log) - first)
            for name, noise in sigma.items()
        }
        throws.append(curlfit.Throw.from_arrays(log.t[first:], **noisy))
    request = JointRequest.of(throws, {"law": LAW, "load": None}, share="all")
    together = solved_together(request.throws, request.shared, request.covariates, None)
    tasks = together.tasks
    values = np.array(together.solution.values)
    held = tasks._replace(
        lower=np.where(together.common, values, tasks.lower),
        upper=np.where(together.common, values, tasks.upper),
    )
    optima = dict(enumerate(unstacked(together.solution)))
    others_by_throw = optima_with_other_rests(together.stack, held, optima)
    for throw, optimum in optima.items():
        others = [float(other.chi_squared) for other in others_by_throw[throw]]
        assert min(others) > optimum.chi_squared - 1e-3


def test_a_spin_that_ends_without_a_jump_needs_no_other_starts():
    fit = curlfit.fit(load(1), "denny-1998", details=False)
    _, _, starts = searched_again(fit)
    assert not starts


@pytest.mark.slow
@pytest.mark.parametrize("law", ["semi-empirical", "denny-1998"])
def test_without_its_spin_a_log_is_fitted_too(law):
    """The path then knows no more of the spin than its sign, and searches wander along
    what is level."""
    log = load(1)
    throw = curlfit.Throw.from_arrays(log.t, log.x, log.y)
    fit = curlfit.fit(throw, law, details=False)
    assert fit.converged
    assert fit["omega0"].verdict == "not identifiable"


@pytest.mark.parametrize("phase", [0.05, 0.35, 0.65, 0.95])
def test_spins_sampled_up_to_the_jump_give_the_true_values(phase):
    """Of the law itself, whose spin jumps from 0.8 rad/s to 0 between two rows, at a
    phase of their interval. Were a row compared with the mean spin of its interval, the
    rest would be drawn to the edge of the interval, and p off by 15 standard errors."""
    truth = {"a": 0.005, "c": 0.085, "p": 0.0, "q": 0.025, "r": -0.3}
    sigma = {"x": 0.005, "y": 0.005, "omega": 0.01}
    rest = 23.6 + 0.1 * phase
    start = curlfit.InitialState(v=truth["c"] * rest, omega=1.5)
    t = np.arange(0, 26, 0.1)
    law = curlfit.law_with(LAW, truth)
    path = curlfit.simulate(law, curlfit.Stone(), start, t).to_numpy()
    random = np.random.default_rng(round(100 * phase))
    channels = {
        name: getattr(path, name) + size * random.standard_normal(len(t))
        for name, size in sigma.items()
    }
    throw = curlfit.Throw.from_arrays(t, **channels, sigma=sigma)
    fit = curlfit.fit(throw, LAW, details=False)
    assert fit.converged
    for name, value in truth.items():
        assert abs(fit[name].value - value) < 4 * fit[name].stderr
