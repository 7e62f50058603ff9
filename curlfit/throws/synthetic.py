"""Synthetic throws: the path under a law with Gaussian noise, as arrays or as
a data file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from curlfit.environment import Environment
from curlfit.errors import InputError
from curlfit.foreign import counted, quoted
from curlfit.friction import Law, check_load, find_law, no_motion_because
from curlfit.numerics.arrays import Floats
from curlfit.stone import Stone
from curlfit.throws.reference import Reference
from curlfit.throws.throw import Throw

_SOURCE = "true value"
SIMULATED = f'# reference.source = "{_SOURCE}"'
"""The line that each table of a simulated throw has."""
_MOST_ROWS = 2_000_000


def law_with(
    law: str | type[Law],
    coefficients: Mapping[str, float],
    *,
    unbounded: bool = False,
    others: Mapping[str, float] | None = None,
) -> Law:
    """A law with some coefficients set and the rest at their defaults.

    Parameters
    ----------
    unbounded : allow negative coefficients, as in a fit.
    others : values in place of defaults, from a fit that may have had other bounds.

    Raises
    ------
    InputError : an unknown law or coefficient, a value that is not finite or outside
        its bounds, or values that do not describe friction.

    Examples
    --------
    >>> curlfit.law_with("coulomb", {"mu": 0.012}).mu
    0.012
    """
    kind = find_law(law)
    coefficient_by_name = {
        coefficient.name: coefficient for coefficient in kind.coefficients()
    }
    for name, value in coefficients.items():
        if name not in coefficient_by_name:
            raise InputError(
                f"law {kind.name} has no coefficient {quoted(name)}; "
                f"it has {', '.join(coefficient_by_name)}"
            )
        if not math.isfinite(value):
            raise InputError(f"{name} = {value}: expected a finite number")
        coefficient = coefficient_by_name[name]
        lowest = coefficient.unbounded().lower
        lower = lowest if unbounded else coefficient.lower
        if not lower <= value <= coefficient.upper:
            fault = (
                f"{name} = {value:g}: expected {coefficient.lower:g} .. "
                f"{coefficient.upper:g}, the bounds of law {kind.name}"
            )
            if lowest <= value < coefficient.lower:
                fault += "; `unbounded` lets it be negative"
            raise InputError(fault)
    law_of_values = kind(**{**(others or {}), **coefficients})
    fault_of_law = law_of_values.fault()
    if fault_of_law is not None:
        raise InputError(f"law {kind.name}: {fault_of_law}")
    return law_of_values


def synthetic_throw(
    law: Law,
    stone: Stone,
    *,
    load: str = "uniform",
    v0: float = 2.0,
    omega0: float = 1.0,
    heading: float = 0.0,
    x0: float = 0.0,
    y0: float = 0.0,
    phi0: float = 0.0,
    environment: Environment | None = None,
    until: float = 20.0,
    dt: float = 0.1,
    noise_xy: float = 0.0,
    noise_phi: float = 0.0,
    seed: int = 0,
) -> Throw:
    """A throw with independent Gaussian noise on x, y (m) and phi (rad).

    The true coefficients and conditions are the reference of the throw.

    Parameters
    ----------
    v0, omega0, heading, x0, y0, phi0 : initial state (m/s, rad/s, rad, m, m, rad).
    environment : slope of the ice, drag of the air, sweeping (times since the first
        row); none of them by default.
    until, dt : last time and time between rows, s.

    Raises
    ------
    InputError : an impossible value, or a law that admits no motion from this
        initial state.

    Examples
    --------
    >>> law = curlfit.law_with("front-back", {"mu2_xi": 0.055})
    >>> made = curlfit.synthetic_throw(
    ...     law, curlfit.Stone(), until=20, dt=5, noise_xy=0.005
    ... )
    >>> len(made), made.reference.values["mu2_xi"]
    (5, 0.055)
    """
    conditions = _conditions(environment)
    state = {
        "x0": x0,
        "y0": y0,
        "heading": heading,
        "v0": v0,
        "phi0": phi0,
        "omega0": omega0,
    }
    _require("positive", math.ulp(0.0), {"until": until, "dt": dt})
    _require(
        "non-negative", 0.0, {"v0": v0, "noise-xy": noise_xy, "noise-phi": noise_phi}
    )
    _require("finite", -math.inf, state | conditions)
    t = _times(until, dt)
    checked_load = check_load(load)
    noise = np.random.default_rng(seed).standard_normal((3, len(t)))
    sizes = np.array([[noise_xy], [noise_xy], [noise_phi]])
    path = _path(law, stone, list(state.values()), t, checked_load, environment)
    x, y, phi = path + sizes * noise
    values = {
        coefficient.name: float(getattr(law, coefficient.name))
        for coefficient in law.coefficients()
    }
    defaults = {"stone": stone.as_dict(), "load": checked_load}
    if not law.origin:  # a law of the package
        defaults["law"] = law.name
    return Throw(
        t,
        x,
        y,
        phi,
        name="synthetic throw",
        reference=Reference(_SOURCE, law.name, values | conditions),
        defaults=defaults,
    )


def _path(
    law: Law,
    stone: Stone,
    state: Sequence[float],
    t: Floats,
    load: Any,
    environment: Any,
) -> Floats:
    """x, y and phi under a law from an initial state, shape (3, n)."""
    from curlfit.dynamics.trajectory import InitialState, simulate

    start = InitialState(*state)
    path = simulate(law, stone, start, t, load=load, environment=environment).to_numpy()
    if not np.isfinite(path.x).all():
        raise InputError(
            f"law {law.name} with {load} load admits no motion from this start"
            + no_motion_because(load)
        )
    return np.stack([path.x, path.y, path.phi])


def _times(until: float, dt: float) -> Floats:
    """Times from 0 to the last one, `dt` apart."""
    rows = math.floor(until / dt + 1e-9) + 1
    if not 2 <= rows <= _MOST_ROWS:
        raise InputError(
            f"until = {until:g} s in steps of {dt:g} s makes {counted(rows, 'row')}"
        )
    return np.arange(rows, dtype=np.float64) * dt


def _require(kind: str, least: float, numbers: Mapping[str, float]) -> None:
    """Raise `InputError` for a number below `least`, or one that is not finite."""
    for name, value in numbers.items():
        if not (math.isfinite(value) and value >= least):
            raise InputError(f"{name} = {value:g}: expected a {kind} number")


def _conditions(environment: Environment | None) -> dict[str, float]:
    """Conditions that differ from level ice and still air, by name."""
    if environment is None:
        return {}
    usual = Environment()
    conditions = {}
    for name in ("slope_x", "slope_y", "drag", "wear", "sweep"):
        value = float(getattr(environment, name))
        if value != getattr(usual, name):
            conditions[name] = value
    return conditions


def write_table(throw: Throw) -> str:
    """A throw as text in curlfit's own format, with its defaults and reference
    in `#` lines."""
    settings: dict[str, Any] = dict(throw.defaults)
    if throw.reference is not None:
        settings["reference"] = {
            key: value for key, value in asdict(throw.reference).items() if value != ""
        }
    lines = [*_settings("", settings), "t,x,y,phi"]
    for time, *position in zip(throw.t, throw.x, throw.y, throw.phi, strict=True):
        cells = ["" if math.isnan(value) else f"{value:.9f}" for value in position]
        lines.append(",".join([f"{time:.9g}", *cells]))
    return "\n".join(lines).replace("-0.000000000", "0.000000000") + "\n"


def _settings(key: str, value: Any) -> Iterator[str]:
    """Settings as comments, in TOML."""
    if isinstance(value, Mapping):
        for name, entry in value.items():
            last = name if name.isidentifier() else f'"{name}"'
            yield from _settings(f"{key}.{last}" if key else last, entry)
    elif isinstance(value, str):
        yield f'# {key} = "{value}"'
    else:
        yield f"# {key} = {value:g}"
