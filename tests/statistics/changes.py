"""How often a fit says that its residuals change: of throws that changed, and of throws
that did not.

    python tests/statistics/changes.py THROWS [--only TEXT]

writes the table "changes" of README.md beside this file. A throw of 20 s at 10 Hz, 5 mm
on x and y and 10 mrad on phi, with coefficients within 20 % of their defaults and
either sense of spin, is drawn by scipy's integrator and fitted with independent noise
whose sigma is estimated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from simulator import moved, moved_with
from tables import Table, asked, correlated

import curlfit

SIGMA = np.array([[0.005], [0.005], [0.01]])
STEP = 0.1  # s
LONG = 30.0  # s; most stones then rest
NEAR = 1.0  # s, within which a change is found


@dataclass(frozen=True)
class Case:
    """What throws obey, and the law that is fitted."""

    title: str
    truth: str = "front-back"
    fitted: str = "front-back"
    noise: float = 1.0
    """over that of the others"""
    memory: float = 0.0
    """correlation time of the noise, s"""
    until: float = 20.0
    power: tuple[float, float] | None = None
    """range of the power of the speed by which the friction is multiplied"""
    slowest: float = 0.3
    """speed above which such a stone is seen, m/s"""
    bend: tuple[float, float] | None = None
    """range of the radial distortion of positions about the middle, 1/m^2"""
    swept: tuple[float, float] | None = None
    """range of the factor on the friction, from 2 to 6 s"""
    lasting: tuple[float, ...] | None = None
    """factors on the friction, one of which it has from some time on"""
    jump: float = 0.0
    """of the velocity to any side, m/s"""


WRONG = (
    ("power", "coulomb"),
    ("stribeck", "coulomb"),
    ("angular", "front-back"),
    ("semi-empirical", "front-back"),
    ("fcv1", "front-back"),
)
CASES = (
    Case("law and noise as assumed"),
    Case("the same, to rest", until=LONG),
    Case("the same, noise a tenth", noise=0.1),
    Case("`semi-empirical`", "semi-empirical", "semi-empirical"),
    Case("`power+transverse`", "power+transverse", "power+transverse"),
    *(
        Case(f"noise of correlation time {memory:g} s", memory=memory)
        for memory in (0.3, 1.0, 3.0)
    ),
    *(
        Case(f"`{truth}` fitted by `{fitted}`", truth, fitted)
        for truth, fitted in WRONG
    ),
    *(
        Case(f"`{truth}` fitted by `{fitted}`, noise a tenth", truth, fitted, noise=0.1)
        for truth, fitted in WRONG
    ),
    Case(
        "`semi-empirical` fitted by `front-back`, to rest",
        "semi-empirical",
        until=LONG,
    ),
    *(
        Case(f"`{truth}` fitted by `coulomb`, to rest", truth, "coulomb", until=LONG)
        for truth in ("power", "stribeck")
    ),
    Case("friction times v^-0.1 to v^-0.5", power=(-0.5, -0.1)),
    Case("the same, to 0.03 m/s", power=(-0.5, -0.1), slowest=0.03, until=LONG),
    Case(
        "the same, noise a tenth",
        power=(-0.5, -0.1),
        slowest=0.03,
        until=LONG,
        noise=0.1,
    ),
    Case("positions bent as by a lens, 1e-5 to 1e-4 /m^2", bend=(1e-5, 1e-4)),
    Case("the same, noise a tenth", bend=(1e-5, 1e-4), noise=0.1),
    Case("friction times 0.67 to 0.9 for 2 to 6 s", swept=(0.67, 0.9)),
    Case(
        "friction times 0.8, 0.87, 1.15 or 1.25 since", lasting=(0.8, 0.87, 1.15, 1.25)
    ),
    Case("velocity changes by 0.05 m/s", jump=0.05),
    Case("velocity changes by 0.2 m/s", jump=0.2),
)


def path_of(
    case: Case, times: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, list[float]]:
    """x, y, phi without noise, shape (3, n), and the times of the changes."""
    coefficients = {
        coefficient.name: coefficient.default
        * (1 if coefficient.optional else random.uniform(0.8, 1.2))
        for coefficient in curlfit.find_law(case.truth).coefficients()
    }
    v0 = random.uniform(1.9, 2.2)
    omega0 = random.choice([-1, 1]) * random.uniform(0.6, 2.0)
    power = random.uniform(*case.power) if case.power else 0.0
    factor = 1.0
    changes: list[float] = []
    if case.swept:
        factor = random.uniform(*case.swept)
        begin = random.uniform(2.0, 13.0)
        changes = [begin, begin + random.uniform(2.0, 6.0)]
    elif case.lasting:
        factor = random.choice(case.lasting)
        changes = [random.uniform(4.0, 15.0)]
    if case.power or changes:
        begin, end = (*changes, math.inf, math.inf)[:2]

        def multiplied(v: float, time: float) -> float:
            slowed = max(v, 1e-6) ** power  # an integrator may step beyond rest
            return slowed * (factor if begin <= time < end else 1.0)

        motion = moved_with(case.truth, coefficients, v0, omega0, times[-1], multiplied)
    else:
        motion = moved(case.truth, coefficients, v0, omega0, times[-1])
    path = motion.at(times)
    if case.bend:
        strength = random.choice([-1, 1]) * random.uniform(*case.bend)
        middle = np.array([[0.0], [path[1].mean()]])
        off = path[:2] - middle
        path[:2] = middle + off * (1 + strength * (off**2).sum(axis=0))
    if case.jump:
        changes = [random.uniform(3.0, 17.0)]
        direction = random.uniform(0.0, 2 * math.pi)
        since = np.maximum(times - changes[0], 0.0)
        path[0] += case.jump * math.cos(direction) * since
        path[1] += case.jump * math.sin(direction) * since
    return path, changes


def thrown(
    case: Case, random: np.random.Generator
) -> tuple[curlfit.Throw, list[float]]:
    """A throw, and the times at which it changes."""
    times = np.arange(0.0, case.until + STEP / 2, STEP)
    path, changes = path_of(case, times, random)
    noise = random.standard_normal(path.shape)
    if case.memory:
        noise = correlated(noise, math.exp(-STEP / case.memory))
    measured = path + case.noise * SIGMA * noise
    if case.power:
        fast = np.hypot(*np.gradient(path[:2], times, axis=1)) > case.slowest
        times = times[fast]
        measured = measured[:, fast]
    return curlfit.Throw.from_arrays(times, *measured), changes


def times_told(result: curlfit.FitResult) -> list[float]:
    """The times at which the residuals are said to change."""
    times = []
    for warning in result.warnings:
        if warning.code == "residuals-change":
            times += warning.numbers["times"]
    return times


def counts(case: Case, throws: int) -> tuple[int, int, int, int]:
    """Throws that were fitted, those with residuals that are not independent, those
    whose residuals are said to change, and those of which a change is near."""
    random = np.random.default_rng(sum(map(ord, case.title)))
    fitted = 0
    doubtful = 0
    warned = 0
    near = 0
    for _ in range(throws):
        throw, changes = thrown(case, random)
        try:
            result = curlfit.fit(throw, case.fitted, details=False)
        except curlfit.CurlfitError:
            continue  # a large jump is refused
        if not result.converged:
            continue
        fitted += 1
        doubtful += any(
            independence.doubtful for independence in result.independence.values()
        )
        times = times_told(result)
        warned += bool(times)
        near += any(abs(time - change) < NEAR for time in times for change in changes)
    return fitted, doubtful, warned, near


def main() -> None:
    """Run the cases and write their table."""
    chosen = asked(__doc__)
    table = Table("", "fitted", "not independent", "said to change", "within 1 s")
    for case in CASES:
        if chosen.only in case.title:
            fitted, doubtful, warned, near = counts(case, chosen.throws)
            changes = bool(case.swept or case.lasting or case.jump)
            table.add(case.title, fitted, doubtful, warned, near if changes else "")
    if not chosen.only:
        table.put("changes", f"{chosen.throws} throws a row.")


if __name__ == "__main__":
    main()
