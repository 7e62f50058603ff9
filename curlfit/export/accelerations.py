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

SLOWEST = 1e-3
FASTEST = 8.0
"""Range of s, m/s; the accelerations are constant beyond it."""
REST = 1e-4
"""Value of s, m/s, below which a stone is taken to be at rest; it would slide a
further 0.1 um."""
_SIZES = ((16, 32), (32, 64), (64, 128))  # intervals of log s and of p
# for friction that depends on p alone
_SIZES_WITHOUT_SCALE = tuple((2, columns) for _, columns in _SIZES)
_SCALE_FREE = 1e-9  # relative change with s below which there is none
_IN_PLACE = 1e-14  # v/u below which a stone spins in place
_GOOD = 1e-3  # m, error of the resting positions that is small enough
_ACCEPTED = 1e-2  # m, largest error of the resting positions that is accepted
# speed (m/s) and spin (rad/s) of the throws whose resting positions are compared
_DRAWS = ((2.3, 1.3), (2.25, -1.5), (2.0, 3.0), (2.9, 0.5), (1.2, 12.0))
_LONGEST = 1000  # s, by when a stone is at rest
_TRIALS = 2000  # random motions at which the interpolation is tested
STEP = 0.05  # s, longest step of the integration
SHARE = 0.2  # of the remaining time to rest, the longest step
_CHANNELS = ("across", "along", "angular")


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
        i = min(int(row), n - 1)
        j = min(int(column), k - 1)
        # the first node of the table lies one interval before row and column 0
        patch = self.values[:, i : i + 4, j : j + 4]
        row_weights = catmull_rom(row - i)
        column_weights = catmull_rom(column - j)
        values: Floats = np.einsum("cij,i,j->c", patch, row_weights, column_weights)
        return values

    def step(self, stone: Moved, dt: float, friction: float = 1.0) -> Moved:
        """The stone after `dt` seconds, by the fourth-order Runge-Kutta method.

        Parameters
        ----------
        friction : factor on the friction, below 1 for a swept stone.
        """
        q = np.array(stone)
        R = self.stone.R
        left = dt
        while left > 0:
            moving = Moved(*q.tolist())
            s = math.hypot(moving.vx, moving.vy, R * moving.omega)
            if s < REST:
                return moving._replace(vx=0.0, vy=0.0, omega=0.0)
            first = self._rates(q, friction)
            loss = Moved(*first.tolist())
            size = math.hypot(loss.vx, loss.vy, R * loss.omega)
            h = min(left, STEP, SHARE * s / size) if size > 0 else left
            second = self._rates(q + h / 2 * first, friction)
            third = self._rates(q + h / 2 * second, friction)
            fourth = self._rates(q + h * third, friction)
            q = q + h * ((first + 2 * second + 2 * third + fourth) / 6)
            left -= h
        return Moved(*q.tolist())

    def _rates(self, q: Floats, friction: float) -> Floats:
        """Time derivative of the fields of `Moved`."""
        _, _, vx, vy, _, omega = q.tolist()
        v = math.hypot(vx, vy)
        across, along, angular = (friction * a for a in self.accelerations(v, omega))
        # unit vector along the motion; (ey, -ex) is to its right
        ex = vx / v if v > 0 else 0.0
        ey = vy / v if v > 0 else 0.0
        return np.array(
            Moved(
                x=vx,
                y=vy,
                vx=along * ex + across * ey,
                vy=along * ey - across * ex,
                phi=omega,
                omega=angular,
            )
        )

    def to_json(self) -> dict[str, Any]:
        """The table as a record, its values by name and rounded to seven digits."""
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
                "interpolation": dict(zip(_CHANNELS, self.interpolation, strict=True)),
                "resting_place": self.resting_place,
            },
            "not_included": self.not_included,
            **dict(zip(_CHANNELS, _rounded(self.values).tolist(), strict=True)),
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
    law = fit.fitted_law
    conditions_of_stone = {
        name: condition.value
        for name, condition in fit.conditions.items()
        if name in vars(fit.stone)
    }
    stone = fit.stone.with_values(conditions_of_stone)
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
    not_included = _not_included(fit)
    load = check_load(fit.load)

    @jax.jit
    def exact(v: Any, omega: Any) -> Any:
        return jnp.stack(accelerations(law, stone, load, v, omega))

    ends = [_resting_place(law, stone, load, *draw) for draw in _DRAWS]
    scale_free = _is_scale_free(exact, stone.R)
    for rows, columns in _SIZES_WITHOUT_SCALE if scale_free else _SIZES:
        values = _tabulated(exact, stone.R, rows, columns)
        if not np.isfinite(values).all():
            raise InputError(
                f"law {law.name} with {fit.load} load admits no motion at some speeds "
                "and spins; no table can be made"
            )
        table = AccelerationTable(
            law=law.name,
            load=fit.load,
            coefficients={name: c.value for name, c in fit.coefficients.items()},
            stone=stone,
            values=values,
            interpolation=(0.0, 0.0, 0.0),
            resting_place=0.0,
            not_included=not_included,
        )
        distance = max(
            _distance(table, draw, end) for draw, end in zip(_DRAWS, ends, strict=True)
        )
        if distance < _GOOD:
            break
    if not distance < _ACCEPTED:
        raise InputError(
            f"no table of law {law.name} brings stones to rest within 1 cm of where "
            f"the law does; the best is off by {distance:.2g} m"
        )
    return replace(
        table,
        interpolation=_interpolation_errors(table, exact),
        resting_place=distance,
    )


def _interpolation_errors(
    table: AccelerationTable, exact: Any
) -> tuple[float, float, float]:
    """Largest errors of a table at random motions."""
    random = np.random.default_rng(0)
    s = np.exp(random.uniform(np.log(SLOWEST), np.log(FASTEST / 2), _TRIALS))
    theta = random.uniform(-np.pi / 2, np.pi / 2, _TRIALS)
    v = s * np.cos(theta)
    omega = s * np.sin(theta) / table.stone.R
    true = np.asarray(exact(v, omega))
    by_table = [table.accelerations(*motion) for motion in zip(v, omega, strict=True)]
    across, along, angular = np.abs(np.transpose(by_table) - true).max(1).tolist()
    return across, along, angular


def _not_included(fit: FitResult) -> dict[str, float]:
    """The fit's slope, air drag and sweeping; raises `InputError` for friction that
    changes along the throw. The scales of lengths and times are of the record, not
    of the motion."""
    neutral = vars(Environment())
    effects = {
        name: condition.value
        for name, condition in fit.conditions.items()
        if name in neutral and condition.value != neutral[name]
    }
    wear = {name: value for name, value in effects.items() if name.startswith("wear")}
    if wear:
        raise InputError(
            f"the friction of this fit changes along the throw ({_listed(wear)}); "
            "a table by speed and spin does not hold it"
        )
    return effects


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.4g}" for name, value in values.items())


def _is_scale_free(exact: Any, R: float) -> bool:
    """Whether the accelerations depend on R omega/v alone."""
    s = np.geomspace(SLOWEST, FASTEST, 50)
    values = np.asarray(exact(0.8 * s, 0.6 * s / R))
    return bool(np.ptp(values, axis=1).max() < _SCALE_FREE * np.abs(values).max())


def _tabulated(exact: Any, R: float, n: int, k: int) -> Floats:
    """Values at the nodes, and one node beyond either end, rounded to seven digits."""
    s = SLOWEST * (FASTEST / SLOWEST) ** (np.arange(n + 1) / n)
    # p + 1 with the sign of theta
    signed = np.arange(k + 1) / k * 4 - 2
    side = np.where(signed >= 0, 1.0, -1.0)
    g = np.array([_unwarped(p) for p in np.abs(signed) - 1])
    theta = side * np.pi / 4 * (1 + g)
    v = s[:, None] * np.cos(theta)
    u = s[:, None] * np.sin(theta)
    v = np.where(v > _IN_PLACE * np.abs(u), v, 0.0)
    inner = np.asarray(exact(v, u / R))
    return _rounded(_extended(_extended(inner, 1), 2))


def _unwarped(p: float) -> float:
    """g as a function of p, the inverse of `warped`."""
    return float(brentq(lambda g: warped(g) - p, -1.0, 1.0, xtol=1e-15))


def _extended(values: Floats, axis: int) -> Floats:
    """Values with one more at either end of an axis, by quadratic extrapolation."""
    along = np.moveaxis(values, axis, 0)
    before = 3 * along[0] - 3 * along[1] + along[2]
    after = 3 * along[-1] - 3 * along[-2] + along[-3]
    ends = (np.expand_dims(before, axis), np.expand_dims(after, axis))
    return np.concatenate([ends[0], values, ends[1]], axis)


def _rounded(values: Floats) -> Floats:
    """Values with seven digits, as they are written."""
    digits = [float(f"{value:.7g}") for value in values.ravel()]
    return np.reshape(digits, values.shape)


def _resting_place(law: Law, stone: Stone, load: Any, v: float, omega: float) -> Floats:
    path = simulate(
        law, stone, InitialState(v=v, omega=omega), np.array([0.0, np.inf]), load=load
    )
    return np.array([path.x[-1], path.y[-1], path.phi[-1]])


def _distance(
    table: AccelerationTable, draw: tuple[float, float], end: Floats
) -> float:
    """Distance in m from the resting position of a throw to that by the table."""
    speed, spin = draw
    stone = Moved(x=0.0, y=0.0, vx=0.0, vy=speed, phi=0.0, omega=spin)
    for _ in range(_LONGEST):
        stone = table.step(stone, 1.0)
        if stone.vx == stone.vy == stone.omega == 0:
            break
    return math.hypot(stone.x - end[0], stone.y - end[1])


def c_header(table: AccelerationTable) -> str:
    """The table with its interpolation and a time step, in C99 that is
    also valid C++."""
    return _filled("curlfit_stone.h.in", table, "{", "}")


def javascript_module(table: AccelerationTable) -> str:
    """The table with its interpolation and a time step, as a JavaScript module."""
    return _filled("curlfit_stone.mjs.in", table, "[", "]")


def not_included(table: AccelerationTable) -> str:
    """A sentence on conditions of the fit that the table does not include; empty
    without any."""
    if not table.not_included:
        return ""
    return f"Not included from the fit: {_listed(table.not_included)}."


def _filled(template: str, table: AccelerationTable, left: str, right: str) -> str:
    """A template with the table, whose arrays stand between some brackets."""
    n, k = table.shape
    across, along, angular = table.interpolation
    coefficients = [
        f"{name} = {value:.6g}" for name, value in table.coefficients.items()
    ]
    values = {
        "law": table.law,
        "load": table.load,
        "version": __version__,
        "coefficients": ", ".join(coefficients),
        "rho": repr(table.stone.rho),
        "h": repr(table.stone.h),
        "R": repr(table.stone.R),
        "error_across": f"{across:.1g}",
        "error_along": f"{along:.1g}",
        "error_angular": f"{angular:.1g}",
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
    head = _template("head.in").substitute(values) + not_included(table)
    # "*/" would end the comment
    head = head.rstrip().replace("*/", "* /")
    return _template(template).substitute(values, head=head)


def _template(name: str) -> Template:
    return Template(Path(__file__).with_name(name).read_text(encoding="utf-8"))


def _wrapped(row: list[float], left: str, right: str) -> str:
    """Numbers with seven digits, eight per line."""
    texts = [f"{value:.7g}" for value in row]
    lines = [", ".join(texts[first : first + 8]) for first in range(0, len(texts), 8)]
    return left + ",\n ".join(lines) + right
