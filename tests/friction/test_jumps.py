"""Laws that jump or change quickly: those that declare it are integrated, the others
refused in words."""

from __future__ import annotations

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from independent_motion import Reference
from scipy.integrate import quad

import curlfit
from curlfit import InputError, LocalLaw, NetLaw, coefficient, find_law
from curlfit.dynamics.contact import accelerations
from curlfit.errors import DataError
from curlfit.friction import Edges
from curlfit.friction.sampled import Conditions, Sampled
from curlfit.stone import GRAVITY

STONE = curlfit.Stone()


def law_of(coulomb, **declared):
    """A law whose coefficient of friction is a function of law, point and
    array library."""

    def traction(self, point):
        mu = coulomb(self, point, jnp)
        return -mu * point.e_xi, -mu * point.e_eta

    return type(
        "Own",
        (LocalLaw,),
        {
            "__annotations__": dict.fromkeys(("a", "b", "c"), float),
            "__module__": __name__,
            "a": coefficient(0.006, ""),
            "b": coefficient(0.012, ""),
            "c": coefficient(0.5, "", upper=3, typical=0.3),
            "traction": traction,
            **declared,
        },
    )


ACROSS = Edges(front=(np.pi / 2,), back=(-np.pi / 2,))
EIGHTHS = np.pi / 4 * np.arange(1, 4)


def sides(law, p, xp):
    return xp.where(p.xi < 0, law.a, law.b)


def declare(*edges):
    """What a law declares that has these edges, whatever the angle turned."""
    return {"edges": lambda law, turned: Edges(*edges)}


UNEVEN = {
    "one angle": (
        lambda law, p, xp: xp.where(p.angle < 1, law.a, law.b),
        Edges(front=(1.0,)),
    ),
    "eight sectors": (
        lambda law, p, xp: law.a * (1 + 0.3 * (xp.floor(p.angle / (np.pi / 4)) % 2)),
        Edges(tuple(EIGHTHS), tuple(-EIGHTHS)),
    ),
    "two sides": (sides, ACROSS),
    "a kink": (lambda law, p, xp: law.a * abs(p.xi), ACROSS),
}


def sum_by_scipy(law, coulomb, v, omega, breaks):
    """Force and moment over m g, and over m g R."""
    u = STONE.R * omega

    class Point:
        def __init__(self, angle):
            self.angle = angle
            self.xi = np.cos(angle)
            self.eta = np.sin(angle)
            self.slide = -u * self.eta, v + u * self.xi
            self.speed = np.hypot(*self.slide)

    def density(angle, part):
        p = Point(angle)
        x, y = (-coulomb(law, p, np) * float(side) / p.speed for side in p.slide)
        return (x, y, p.xi * y - p.eta * x)[part] / (2 * np.pi)

    options = {"points": (*breaks, 0.0), "limit": 2000, "epsabs": 1e-12}
    return np.array(
        [quad(density, -np.pi, np.pi, (part,), **options)[0] for part in range(3)]
    )


def sum_of(law, v, omega):
    scale = GRAVITY * np.array([1, 1, STONE.R / STONE.rho**2])
    return np.array(accelerations(law, STONE, "uniform", v, omega)) / scale


MOTIONS = (2.0, 1.5), (1.0, -1.0), (0.97, 2.0)


@pytest.mark.parametrize("case", UNEVEN)
def test_friction_is_integrated_between_declared_edges(case, capsys):
    coulomb, edges = UNEVEN[case]
    law = find_law(law_of(coulomb, **declare(*edges)))()
    assert capsys.readouterr().err == ""
    for motion in MOTIONS:
        exact = sum_by_scipy(law, coulomb, *motion, edges.front + edges.back)
        np.testing.assert_allclose(sum_of(law, *motion), exact, rtol=2e-6, atol=1e-11)


def test_a_kink_passes_with_a_warning_of_its_error(capsys):
    coulomb, (front, back) = UNEVEN["a kink"]
    law = find_law(law_of(coulomb))()
    message = capsys.readouterr().err
    ranges = re.findall(r"between (\S+) and (\S+) rad \(error .*: (\S+)%\)", message)
    ((low, high, percent),) = np.array(ranges, float)
    assert "Warning" in message
    assert "Own: friction has a kink" in message
    assert any(low <= angle <= high for angle in (*front, *back))
    errors = []
    for motion in MOTIONS:
        exact = sum_by_scipy(law, coulomb, *motion, front + back)
        errors += list(abs(sum_of(law, *motion) - exact) / (law.a * 2 / np.pi))
    assert 0.7 * percent < 100 * max(errors) < percent


RANGE = r"between (-?[\d.]+) and (-?[\d.]+) rad"


@pytest.mark.parametrize("size", [0.01, 0.05, 0.2, 1.0])
def test_a_jump_that_is_not_declared_is_refused_with_its_place(size):
    random = np.random.default_rng(int(100 * size))
    for _ in range(3):
        first, second = np.sort(random.uniform(-np.pi, np.pi, 2))

        def band(law, p, xp, first=first, second=second):
            return law.a * (1 + size * ((p.angle > first) & (p.angle < second)))

        with pytest.raises(DataError, match=r"Own: friction jumps.*%.*edges") as error:
            find_law(law_of(band))
        ranges = np.array(re.findall(RANGE, str(error.value)), float)
        assert len(ranges) == 2
        for angle, (low, high) in zip((first, second), ranges, strict=True):
            assert low - 1e-4 <= angle <= high + 1e-4
            assert high - low < 0.01


def test_the_points_of_the_check_are_those_of_a_fit():
    """In one motion, by 20 points of each half, and by scipy."""

    class Lifted(LocalLaw):
        mu: float = coefficient(0.01, "")

        def traction(self, point):
            mu = self.mu * (1 + jnp.exp(-(((point.angle - 1) / 0.1) ** 2)))
            return -mu * point.e_xi, -mu * point.e_eta

    v = 2.0
    omega = 1.5
    motion = (np.array([value]) for value in (v, omega, 0.0, 0.0, 0.0, 0.0))
    conditions = Conditions(np.array([[0.01]]), *motion)
    sampled = Sampled(Lifted)
    coarse = sum_of(Lifted(), v, omega)
    np.testing.assert_allclose(sampled.net(conditions)[:, 0], coarse, rtol=1e-12)
    exact = sum_by_scipy(
        Lifted(),
        lambda law, p, xp: law.mu * (1 + xp.exp(-(((p.angle - 1) / 0.1) ** 2))),
        v,
        omega,
        (0.8, 1.0, 1.2),
    )
    np.testing.assert_allclose(sampled.net(conditions, 20)[:, 0], exact, rtol=1e-9)
    assert abs(coarse - exact).max() > 1e-5


def test_a_bump_too_narrow_for_the_points_is_refused():
    def bumps(width):
        return lambda law, p, xp: law.a * (1 + xp.exp(-(((p.angle - 1) / width) ** 2)))

    find_law(law_of(bumps(0.2)))
    with pytest.raises(DataError, match=r"narrow range, between (0\.9|1\.0)"):
        find_law(law_of(bumps(0.05)))


@pytest.mark.slow
def test_two_sides_are_recovered_from_a_path():
    def traction(ring, load):
        mu = np.where(ring.xi < 0, 0.006, 0.012)
        return -mu * ring.v_xi / ring.speed, -mu * ring.v_eta / ring.speed

    path = Reference(traction, R=STONE.R, edges=lambda turned: (-np.pi / 2, np.pi / 2))
    times = np.linspace(0, 20, 101)
    x, y, phi = path.path(curlfit.InitialState(v=2.0, omega=1.2), times)
    random = np.random.default_rng(1)
    throw = curlfit.Throw.from_arrays(
        times,
        *(part + 0.004 * random.normal(size=101) for part in (x, y)),
        phi + 0.01 * random.normal(size=101),
    )
    law = law_of(sides, **declare(*ACROSS))
    fit = curlfit.fit(throw, law, fix={"c": 0.5}, details=False)
    assert fit.law == "Own"
    assert find_law("Own") is law
    for name, true in ("a", 0.006), ("b", 0.012):
        assert abs(fit[name].value - true) < 2 * fit[name].stderr
        assert fit[name].stderr < 2e-5
    assert not fit.warnings


MOVING = {
    "coefficients": lambda law, p, xp: xp.where(p.angle < law.c, law.a, law.b),
    "angle turned": lambda law, p, xp: xp.where(
        xp.cos(p.angle - p.turned) < 0, law.a, law.b
    ),
    "motion": lambda law, p, xp: xp.where(p.speed < 1, law.a, law.b),
    "time": lambda law, p, xp: xp.where(p.angle < p.time / 10, law.a, law.b),
    "load": lambda law, p, xp: xp.where(p.load < 1, law.a, law.b),
    "many angles": lambda law, p, xp: law.a * (1 + (xp.floor(p.angle * 10) % 2)),
}
EDGES = r"declare these angles in `def edges\(self, turned\)`"
GRADUAL = r"make the change gradual, as \(1 \+ jnp\.tanh"


@pytest.mark.parametrize("what", MOVING)
def test_jumps_that_move_are_refused_with_what_to_do(what):
    message = f"Own: friction jumps.* rad .*%.*; {EDGES}.*{GRADUAL}"
    with pytest.raises(DataError, match=message):
        find_law(law_of(MOVING[what]))


def test_declared_edges_are_taken_and_checked():
    moving = MOVING["coefficients"]
    find_law(law_of(moving, edges=lambda law, turned: Edges(front=(law.c,))))
    with pytest.raises(DataError, match=EDGES):
        find_law(law_of(moving, **declare((0.5,))))

    def across(law, turned):
        angle = (turned + np.pi / 2) % np.pi
        return Edges(front=(angle,), back=(angle - np.pi,))

    find_law(law_of(MOVING["angle turned"], edges=across))
    with pytest.raises(DataError, match=r"range, between -1\.5\d+ and -1\.5\d+ rad \("):
        find_law(law_of(sides, **declare(ACROSS.front)))


def rippled(law, p, xp):
    return law.a * (1 + 0.1 * xp.cos(10 * p.time))


def test_a_quick_change_in_time_is_refused_until_it_is_declared():
    with pytest.raises(DataError, match=r"too quickly.*in `def quickness") as refusal:
        find_law(law_of(rippled))
    rate = float(re.search(r"; ([\d.]+) would do", str(refusal.value))[1])
    law = law_of(rippled, quickness=lambda law, time: rate + 0 * time)()
    t = np.linspace(0, 15, 16)
    path = curlfit.simulate(law, STONE, curlfit.InitialState(v=2.0, omega=0.0), t)
    # v' = -g mu(t), twice integrated
    fallen = GRAVITY * law.a * (t**2 / 2 + 0.1 * (1 - np.cos(10 * t)) / 100)
    np.testing.assert_allclose(path.y, 2.0 * t - fallen, atol=1e-4)


def test_jumps_in_time_and_angle_turned_are_refused():
    with pytest.raises(DataError, match=rf"at 5 s after release .* mm\); {GRADUAL}"):
        find_law(law_of(lambda law, p, xp: xp.where(p.time < 5, law.a, law.b)))
    with pytest.raises(DataError, match=r"at an angle turned of (3|3\.01) rad"):
        find_law(law_of(lambda law, p, xp: law.a * (1 + 0.2 * (p.turned > 3.0))))

    class Sudden(NetLaw):
        mu: float = coefficient(0.01, "")

        def accelerations(self, motion, stone):
            return (
                0.0,
                -self.mu * 9.81 * jnp.where(motion.time < 5, 1, 2),
                -0.01 * motion.omega,
            )

    with pytest.raises(DataError, match="5 s after release"):
        find_law(Sudden)


def test_a_class_that_cannot_be_compiled_is_refused_in_words(eq12):
    class Wrong(LocalLaw):
        mu: float = coefficient(0.01, "")

        def traction(self, point):
            return np.sqrt(self.mu), -self.mu * point.e_eta

    for use in (
        lambda: curlfit.fit(eq12, Wrong),
        lambda: curlfit.compare(eq12, ["coulomb", Wrong]),
        lambda: curlfit.simulate(Wrong(), STONE, curlfit.InitialState(), [0.0, 1.0]),
        lambda: curlfit.aim(Wrong(), STONE, (0.0, 28.0), omega0=1.0),
    ):
        with pytest.raises(
            DataError, match=r"test_jumps\.py, line \d+: a law is compiled"
        ):
            use()


def test_a_class_is_used_first_within_a_transformation():
    """A third of the ring, ahead, has the friction a: without spin the same
    on both sides."""
    law = law_of(
        lambda law, p, xp: xp.where(p.eta > 0.5, law.a, law.b),
        **declare((np.pi / 6, 5 * np.pi / 6)),
    )

    def rest(v):
        start = curlfit.InitialState(v=v, omega=0.0)
        return curlfit.simulate(law(), STONE, start, jnp.array([0.0, 40.0])).y[-1]

    speeds = np.array([1.5, 2.0])
    mu = (0.006 + 2 * 0.012) / 3
    np.testing.assert_allclose(
        jax.vmap(rest)(speeds), speeds**2 / (2 * mu * GRAVITY), rtol=1e-9
    )


@pytest.mark.parametrize(
    ("field", "message"),
    [
        (
            {"v": np.array([1.0, 2.0])},
            r"InitialState.v of shape \(2,\) found, expected a number",
        ),
        ({"x": [0.0, 1.0]}, r"InitialState.x of shape \(2,\) found.*jax\.vmap"),
        ({"v": -1.0}, r"InitialState.v = -1 m/s: expected a speed >= 0; `heading`"),
        ({"omega": np.nan}, r"InitialState.omega = nan: expected a finite number"),
        ({"v": "fast"}, r"InitialState.v: str 'fast' found, expected a number"),
    ],
)
def test_an_impossible_start_is_told(field, message):
    with pytest.raises(InputError, match=message):
        curlfit.simulate(
            curlfit.LAWS["coulomb"](), STONE, curlfit.InitialState(**field), [0.0, 1]
        )


def test_the_help_of_a_point_names_its_fields():
    from curlfit.friction import Motion, RingPoint

    for kind in RingPoint, Motion:
        for name in kind._fields:
            assert re.search(rf"^ *.*\b{name}\b.* : ", kind.__doc__, re.M)
