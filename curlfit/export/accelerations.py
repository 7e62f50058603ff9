"""A table of the accelerations of a stone by speed and spin, for programs
without curlfit.

With u = R omega and s = sqrt(v^2 + u^2), the coordinates of the table are log s and
theta = atan2(u, v). Coulomb friction depends on theta alone, down to rest, where v and
u are singular coordinates; other laws depend on powers of s. At |theta| = pi/4, where
|R omega/v| = 1, a point of the ring stops sliding, and the accelerations have a kink of
the form d log d at a distance d. With g = 4 |theta|/pi - 1 they are smooth in p =
cbrt(g) (14 + g^2)/15, which has no kink of its own at theta = 0. Interpolation between
the nodes is by cubic polynomials (Catmull and Rom 1974), for which the table has an
additional node at either end.

As a C header and as a JavaScript module, without dependencies, it is written by the
templates `curlfit_stone.h.in` and `curlfit_stone.mjs.in` beside this file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from curlfit.dynamics.contact import accelerations
from curlfit.dynamics.law_structure import depends_on_turned_and_time
from curlfit.dynamics.trajectory import InitialState, simulate
from curlfit.environment import Environment
from curlfit.errors import InputError, UnusableFitError
from curlfit.friction import Law, NetLaw, check_load
from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Floats
from curlfit.numerics.jax_settings import require_jax
from curlfit.stone import Stone
from curlfit.version import __version__

SLOWEST, FASTEST = 1e-3, 8.0
"""Range of s, m/s; the accelerations are constant beyond it."""
REST = 1e-4
"""Value of s, m/s, below which a stone is taken to be at rest; it would slide a
further 0.1 um."""
_SIZES = ((16, 32), (32, 64), (64, 128))  # intervals of log s and of p
# for friction that depends on p alone
_SMALL = tuple((2, columns) for _, columns in _SIZES)
_SCALE_FREE = 1e-9  # relative change with s below which there is none
_SLOWER = 1e-14  # v/u below which a stone spins in place
_GOOD = 1e-3  # m, error of the resting positions that is small enough
_BEST = 1e-2  # m, largest error of the resting positions that is accepted
# draws: m/s, rad/s
_DRAWS = ((2.3, 1.3), (2.25, -1.5), (2.0, 3.0), (2.9, 0.5), (1.2, 12.0))
_TRIALS = 2000  # random motions at which the interpolation is tested
STEP, SHARE = 0.05, 0.2
"""Longest steps of the integration, in s and as a fraction of the remaining
time to rest."""


class Moved(NamedTuple):
    """A stone: position and velocity on the ice, angle and spin, in SI units."""

    x: float
    y: float
    vx: float
    vy: float
    phi: float
    omega: float


@dataclass(frozen=True)
class AccelerationTable:
    """Accelerations of a stone by speed and spin.

    Attributes
    ----------
    law, load, coefficients, stone : those that the table represents.
    values : to the right of the motion (m/s^2), along it (m/s^2), counter-clockwise
        (rad/s^2), shape (3, n + 3, k + 3): n intervals of log s, k of p, and an
        additional node at either end.
    interpolation : largest errors over random motions, in the units of the values.
    resting_place : largest distance in m, over some throws, from the resting
        position by the law.
    not_included : slope, air drag and sweeping of the fit, which the program that uses
        the table must add.
    """

    law: str
    load: str
    coefficients: dict[str, float]
    stone: Stone
    values: Floats
    interpolation: tuple[float, float, float]
    resting_place: float
    not_included: dict[str, float] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, int]:
        """Intervals of log s and of p."""
        return self.values.shape[1] - 3, self.values.shape[2] - 3

    def accelerations(self, v: float, omega: float) -> tuple[float, float, float]:
        """Across (to the right), along the motion (m/s^2) and angular (rad/s^2)."""
        n, k = self.shape
        u = self.stone.R * omega
        s = math.hypot(v, u)
        if s == 0:
            return 0.0, 0.0, 0.0
        row = n * math.log(s / SLOWEST) / math.log(FASTEST / SLOWEST)
        # p from -1 to 1 for each sign of theta, 0 at |theta| = pi/4
        theta = math.atan2(u, v)
        side = 1.0 if theta >= 0 else -1.0
        p = warped(side * theta / (math.pi / 4) - 1)
        column = k * (2 + side * (1 + p)) / 4
        return tuple(self._interpolated(row, float(column)).tolist())

    def _interpolated(self, row: float, column: float) -> Floats:
        n, k = self.shape
        row = min(max(row, 0.0), float(n))
        i, j = min(int(row), n - 1), min(int(column), k - 1)
        patch = self.values[:, i : i + 4, j : j + 4]
        found: Floats = np.einsum(
            "cij,i,j->c", patch, catmull_rom(row - i), catmull_rom(column - j)
        )
        return found

    def step(self, stone: Moved, dt: float, friction: float = 1.0) -> Moved:
        """The stone after `dt` seconds, by the fourth-order Runge-Kutta method.

        Parameters
        ----------
        friction : factor on the friction, below 1 for a swept stone.
        """
        q, R, left = np.array(stone), self.stone.R, dt
        while left > 0:
            s = math.hypot(q[2], q[3], R * q[5])
            if s < REST:
                q[[2, 3, 5]] = 0.0
                break
            first = self._rates(q, friction)
            size = math.hypot(first[2], first[3], R * first[5])
            h = min(left, STEP, SHARE * s / size) if size > 0 else left
            second = self._rates(q + h / 2 * first, friction)
            third = self._rates(q + h / 2 * second, friction)
            fourth = self._rates(q + h * third, friction)
            q = q + h * ((first + 2 * second + 2 * third + fourth) / 6)
            left -= h
        return Moved(*q.tolist())

    def _rates(self, q: Floats, friction: float) -> Floats:
        """Time derivative of the fields of `Moved`."""
        vx, vy, omega = q[[2, 3, 5]].tolist()
        v = math.hypot(vx, vy)
        across, along, angular = (friction * a for a in self.accelerations(v, omega))
        # unit vector along the motion; (ey, -ex) is to its right
        ex, ey = (vx / v, vy / v) if v > 0 else (0.0, 0.0)
        return np.array(
            [vx, vy, along * ex + across * ey, along * ey - across * ex, omega, angular]
        )

    def to_json(self) -> dict[str, Any]:
        """The table as a record, its values by name and rounded to seven digits."""
        names = ("across", "along", "angular")
        return {
            "curlfit": __version__,
            "law": self.law,
            "load": self.load,
            "coefficients": self.coefficients,
            "stone": self.stone.as_dict(),
            "coordinates": {
                "s": "sqrt(v^2 + (R omega)^2), m/s",
                "theta": "atan2(R omega, v), rad",
                "rows": (
                    "log(s / slowest) / log(fastest / slowest) * intervals[0]; "
                    "row -1 first"
                ),
                "columns": (
                    "(2 + side (1 + p)) / 4 * intervals[1], "
                    "side the sign of theta and g = 4 |theta| / pi - 1, "
                    "p = cbrt(g) (14 + g^2) / 15; column -1 first"
                ),
                "slowest": SLOWEST,
                "fastest": FASTEST,
                "intervals": list(self.shape),
                "interpolation": "Catmull-Rom",
            },
            "units": {
                "across": "m/s^2, to the right",
                "along": "m/s^2",
                "angular": "rad/s^2, counter-clockwise",
            },
            "error": {
                "interpolation": dict(zip(names, self.interpolation, strict=True)),
                "resting_place": self.resting_place,
            },
            "not_included": self.not_included,
            **{
                name: [[float(f"{v:.7g}") for v in row] for row in part.tolist()]
                for name, part in zip(names, self.values, strict=True)
            },
        }


def warped(g: Any) -> Any:
    """p as a function of g, both from -1 to 1."""
    return np.cbrt(g) * (14 + g * g) / 15


def catmull_rom(f: float) -> Floats:
    """Weights of four adjacent nodes at a fraction f of the interval between
    the middle two."""
    return np.array(
        [
            f * (-0.5 + f * (1.0 - 0.5 * f)),
            1.0 + f * f * (-2.5 + 1.5 * f),
            f * (0.5 + f * (2.0 - 1.5 * f)),
            f * f * (-0.5 + 0.5 * f),
        ]
    )


def tabulate(fit: FitResult) -> AccelerationTable:
    """The table of a fitted law: the smallest that brings stones to rest where
    the law does.

    Raises
    ------
    UnusableFitError : the fit did not converge.
    InputError : the friction depends on more than speed and spin, such as the distance
        along the throw (`wear`), or admits no motion.
    """
    if not fit.converged:
        raise UnusableFitError(f"no table can be made of this fit: {fit.status}")
    law, stone = fit.fitted_law, fit.stone
    given = {
        name: item.value for name, item in fit.conditions.items() if name in vars(stone)
    }
    stone = stone.with_values(given)
    if isinstance(law, NetLaw):
        raise InputError(
            f"law {law.name} has no contact ring: its accelerations are the formula "
            "that `curlfit laws` prints; no table is needed"
        )
    require_jax()
    if any(depends_on_turned_and_time(law, stone)):
        raise InputError(
            f"the friction of law {law.name} depends on the angle turned or on the "
            "time; a table by speed and spin does not hold it"
        )
    others = _not_included(fit)
    load = check_load(fit.load)
    exact = jax.jit(
        lambda v, omega: jnp.stack(accelerations(law, stone, load, v, omega))
    )
    random = np.random.default_rng(0)
    s = np.exp(random.uniform(np.log(SLOWEST), np.log(FASTEST / 2), _TRIALS))
    theta = random.uniform(-np.pi / 2, np.pi / 2, _TRIALS)
    trials = s * np.cos(theta), s * np.sin(theta) / stone.R
    true = np.asarray(exact(*trials))
    ends = [_resting_place(law, stone, load, *draw) for draw in _DRAWS]
    for size in _SMALL if _scale_free(exact, stone.R) else _SIZES:
        values = _tabulated(exact, stone.R, *size)
        if not np.isfinite(values).all():
            raise InputError(
                f"law {law.name} with {fit.load} load admits no motion at some speeds "
                "and spins; no table can be made"
            )
        coefficients = {name: item.value for name, item in fit.coefficients.items()}
        table = AccelerationTable(
            law.name,
            fit.load,
            coefficients,
            stone,
            values,
            (0.0, 0.0, 0.0),
            0.0,
            others,
        )
        off = max(
            _distance(table, draw, end) for draw, end in zip(_DRAWS, ends, strict=True)
        )
        if off < _GOOD:
            break
    if not off < _BEST:
        raise InputError(
            f"no table of law {law.name} brings stones to rest within 1 cm of where "
            f"the law does; the best is off by {off:.2g} m"
        )
    pairs = np.array(
        [table.accelerations(*pair) for pair in zip(*trials, strict=True)]
    ).T
    error = np.abs(pairs - true).max(1).tolist()
    return replace(
        table, interpolation=(error[0], error[1], error[2]), resting_place=off
    )


def _not_included(fit: FitResult) -> dict[str, float]:
    """The fit's slope, air drag and sweeping; raises `InputError` for friction that
    changes along the throw. The scales of lengths and times are of the record, not
    of the motion."""
    neutral = vars(Environment())
    found = {
        name: item.value
        for name, item in fit.conditions.items()
        if name in neutral and item.value != neutral[name]
    }
    wear = [
        f"{name} = {value:.4g}"
        for name, value in found.items()
        if name.startswith("wear")
    ]
    if wear:
        raise InputError(
            f"the friction of this fit changes along the throw ({', '.join(wear)}); "
            "a table by speed and spin does not hold it"
        )
    return found


def _scale_free(exact: Any, R: float) -> bool:
    """Whether the accelerations depend on R omega/v alone."""
    s = np.geomspace(SLOWEST, FASTEST, 50)
    found = np.asarray(exact(0.8 * s, 0.6 * s / R))
    return bool(np.ptp(found, axis=1).max() < _SCALE_FREE * np.abs(found).max())


def _tabulated(exact: Any, R: float, n: int, k: int) -> Floats:
    """Values at the nodes, and one node beyond either end by quadratic
    extrapolation."""
    s = SLOWEST * (FASTEST / SLOWEST) ** (np.arange(n + 1) / n)
    column = np.arange(k + 1) / k * 4 - 2
    side = np.where(column >= 0, 1.0, -1.0)
    p = np.abs(column) - 1
    g = np.array(
        [brentq(lambda g, p=p: warped(g) - p, -1.0, 1.0, xtol=1e-15) for p in p]
    )
    theta = side * np.pi / 4 * (1 + g)
    v, u = s[:, None] * np.cos(theta), s[:, None] * np.sin(theta)
    found = np.asarray(exact(np.where(v > _SLOWER * np.abs(u), v, 0.0), u / R))
    for axis in (1, 2):
        low, high = (
            np.moveaxis(found, axis, 0)[rows] for rows in ([0, 1, 2], [-1, -2, -3])
        )
        ends = [np.expand_dims(3 * a - 3 * b + c, axis) for a, b, c in (low, high)]
        found = np.concatenate([ends[0], found, ends[1]], axis)
    return np.array(
        [[[float(f"{x:.7g}") for x in row] for row in part] for part in found]
    )


def _resting_place(law: Law, stone: Stone, load: Any, v: float, omega: float) -> Floats:
    path = simulate(
        law, stone, InitialState(v=v, omega=omega), np.array([0.0, np.inf]), load=load
    )
    return np.array([path.x[-1], path.y[-1], path.phi[-1]])


def _distance(
    table: AccelerationTable, draw: tuple[float, float], end: Floats
) -> float:
    """Distance in m from the resting position of a throw to that by the table."""
    stone = Moved(0.0, 0.0, 0.0, draw[0], 0.0, draw[1])
    for _ in range(1000):
        stone = table.step(stone, 1.0)
        if stone.vx == stone.vy == stone.omega == 0:
            break
    return math.hypot(stone.x - end[0], stone.y - end[1])


def c_header(table: AccelerationTable) -> str:
    """The table with its interpolation and a time step, in C99 that is
    also valid C++."""
    return _filled("curlfit_stone.h.in", table, "{", "}")


def javascript_module(table: AccelerationTable) -> str:
    """The same as a JavaScript module."""
    return _filled("curlfit_stone.mjs.in", table, "[", "]")


def not_included(table: AccelerationTable) -> str:
    """A sentence on conditions of the fit that the table does not include; empty
    without any."""
    if not table.not_included:
        return ""
    named = ", ".join(
        f"{name} = {value:.4g}" for name, value in table.not_included.items()
    )
    return f"Not included from the fit: {named}."


def _filled(template: str, table: AccelerationTable, left: str, right: str) -> str:
    n, k = table.shape
    across, along, angular = (f"{size:.1g}" for size in table.interpolation)
    named = ", ".join(
        f"{name} = {value:.6g}" for name, value in table.coefficients.items()
    )
    values = {
        "law": table.law,
        "load": table.load,
        "version": __version__,
        "coefficients": named,
        "rho": f"{table.stone.rho!r}",
        "h": f"{table.stone.h!r}",
        "R": f"{table.stone.R!r}",
        "error_across": across,
        "error_along": along,
        "error_angular": angular,
        "resting_place": f"{table.resting_place:.1g}",
        "rows": str(n),
        "columns": str(k),
        "quarter": repr(math.pi / 4),
        "slowest": repr(SLOWEST),
        "rest": repr(REST),
        "span": repr(math.log(FASTEST / SLOWEST)),
        "step": repr(STEP),
        "share": repr(SHARE),
        "values": ",\n".join(
            left + ",\n".join(_wrapped(row, left, right) for row in part) + right
            for part in table.values.tolist()
        ),
    }
    head, text = (
        Template(Path(__file__).with_name(name).read_text(encoding="utf-8"))
        for name in ("head.in", template)
    )
    said = head.substitute(values) + not_included(table)
    # which would end the comment
    return text.substitute(values, head=said.rstrip().replace("*/", "* /"))


def _wrapped(row: list[float], left: str, right: str) -> str:
    """Numbers with seven digits, eight per line."""
    texts = [f"{value:.7g}" for value in row]
    lines = [", ".join(texts[first : first + 8]) for first in range(0, len(texts), 8)]
    return left + ",\n ".join(lines) + right
