"""User-defined laws from Python files."""

from __future__ import annotations

import traceback
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from curlfit.errors import DataError, warn_once
from curlfit.friction.base import Law, LocalLaw, Motion, NetLaw, RingPoint
from curlfit.stone import Stone


def law_from_file(file: str, kind: str = "") -> type[Law]:
    """The law class `kind` of a Python file; the only law in it if `kind` is empty.

    The default of `name` is the class name. The law is evaluated at a few points of the ring, so
    that errors are reported here and not from inside a compiled program.

    Raises
    ------
    DataError : the file cannot be read or run, has no such law, or the evaluation fails.
    """
    path = Path(file).resolve()
    if not path.is_file():
        raise DataError("no such file", file=file)
    law = _select_law(file, _module(path, path.stat().st_mtime_ns, file), kind)
    if not law.origin:
        _validate(file, path, law)
        try:
            law.register(law.name or law.__name__)
        except TypeError as error:
            raise DataError(str(error), file=file) from None
        law.origin = f"{path}:{law.__name__}"
    return law


@cache
def _module(path: Path, _modified: int, file: str) -> ModuleType:
    """The module of a file, executed once for each modification of the file."""
    spec = spec_from_file_location(f"curlfit_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise DataError("this is not a Python file", file=file)
    module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise DataError(f"{error.msg}; expected Python", file=file, line=error.lineno) from None
    except Exception as error:
        raise _user_error(file, path, error) from None
    return module


def _select_law(file: str, module: ModuleType, kind: str) -> type[Law]:
    classes = {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, type)
        and issubclass(value, LocalLaw | NetLaw)
        and value.__module__ == module.__name__
    }
    available = f"it has {', '.join(classes)}" if classes else "derive one from curlfit.LocalLaw"
    if kind and kind not in classes:
        raise DataError(f"no law class {kind!r} in it; {available}", file=file)
    if not kind and len(classes) != 1:
        raise DataError(f"expected one law class, or FILE.py:CLASS; {available}", file=file)
    return classes[kind or next(iter(classes))]


_STATES = [
    Motion(speed=2.0, omega=1.0, turned=0.0, time=0.0),
    Motion(speed=2.0, omega=-1.0, turned=-0.5, time=1.0),
    Motion(speed=0.3, omega=2.0, turned=6.0, time=10.0),
    Motion(speed=0.02, omega=1.0, turned=9.0, time=20.0),
]
"""Motions at which a law is evaluated."""

_ROUNDING = 1e-12  # m/s, of a power per unit load

_USE_JAX = (
    "a law is compiled, which numpy, math and `if` cannot be; expected functions of jax.numpy "
    "(`import jax.numpy as jnp`, jnp.sqrt for np.sqrt) and jnp.where(condition, a, b) for `if`"
)


def _validate(file: str, path: Path, law: type[Law]) -> None:
    """Evaluate the law with its defaults, both on numbers and traced."""
    import jax  # only for user-defined laws

    untraced = (
        jax.errors.ConcretizationTypeError,
        jax.errors.TracerArrayConversionError,
        jax.errors.TracerIntegerConversionError,
    )
    local = issubclass(law, LocalLaw)
    components = ("to the right", "forward") if local else ("to the right", "forward", "angular")
    stone = Stone()
    defaults = np.array([item.default for item in law.coefficients()])

    def evaluate(values: Any, argument: Any) -> Any:
        friction = law.from_vector(values)
        if isinstance(friction, LocalLaw):
            return friction.traction(argument)
        assert isinstance(friction, NetLaw)
        return friction.accelerations(argument, stone)

    for state in _STATES:
        point = _ring_points(state, stone)
        argument = point if local else state
        try:
            jax.eval_shape(evaluate, defaults, argument)
            result = evaluate(defaults, argument)
        except untraced as error:
            raise DataError(_USE_JAX, file=file, line=_line(path, error)) from None
        except Exception as error:
            raise _user_error(file, path, error) from None
        if not (isinstance(result, tuple) and len(result) == len(components)):
            found = (
                f"{len(result)} values"
                if isinstance(result, tuple)
                else f"a value of type {type(result).__name__}"
            )
            raise DataError(
                f"{law.__name__} gives {found}; expected {len(components)}: "
                f"({', '.join(components)})",
                file=file,
            )
        conditions = f"with its defaults, at {state.speed:g} m/s and {state.omega:g} rad/s"
        if not all(np.isfinite(np.asarray(part, float)).all() for part in result):
            raise DataError(f"{law.__name__} {conditions}, gives {result!r}", file=file)
        if local:
            power = result[0] * point.slide_xi + result[1] * point.slide_eta
        else:
            power = state.speed * result[1] + stone.rho**2 * state.omega * result[2]
        if np.sum(power) > _ROUNDING:
            raise DataError(
                f"{law.__name__} {conditions}, drives the stone; expected a force against the "
                + ("sliding, as -mu * point.e_xi, -mu * point.e_eta" if local else "motion"),
                file=file,
            )
        if np.max(power) > _ROUNDING:
            warn_once(
                f"{file}: {law.__name__} {conditions}, drives some points of the ring; "
                "friction opposes sliding at each of them"
            )


def _ring_points(state: Motion, stone: Stone) -> RingPoint:
    """Equally spaced points of the ring."""
    alpha = np.linspace(-np.pi, np.pi, 24, endpoint=False) + np.pi / 24
    xi, eta = np.cos(alpha), np.sin(alpha)
    spin = stone.R * state.omega
    slide_xi, slide_eta = -spin * eta, state.speed + spin * xi  # eq. 16
    speed = np.hypot(slide_xi, slide_eta)
    return RingPoint(
        xi=xi, eta=eta, angle=alpha, front=1.0 * (eta > 0), slide_xi=slide_xi, slide_eta=slide_eta,
        speed=speed, e_xi=slide_xi / speed, e_eta=slide_eta / speed, load=np.ones_like(alpha),
        turned=state.turned, time=state.time,
    )  # fmt: skip


def _line(path: Path, error: Exception) -> int | None:
    """Number of the last line of the user's file in a traceback."""
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename) == path
    ]
    return lines[-1] if lines else None


def _user_error(file: str, path: Path, error: Exception) -> DataError:
    """An error raised by the user's code."""
    text = str(error).strip().splitlines()
    return DataError(
        f"{type(error).__name__}{': ' + text[0] if text else ''}",
        file=file,
        line=_line(path, error),
    )
