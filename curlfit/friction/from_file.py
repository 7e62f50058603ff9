"""A user's own law of friction, from a Python file."""

from __future__ import annotations

import traceback
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np

from curlfit.errors import DataError
from curlfit.friction.base import Law, LocalLaw, Motion, NetLaw, RingPoint


def law_from_file(file: str, kind: str = "") -> type[Law]:
    """The law class `kind` of a Python file; the only law in it where `kind` is empty.

    A class without a `name` is called by its class name. The law is tried on a few points of the
    ring, so that a mistake shows here and not inside a compiled program.

    Raises
    ------
    DataError : the file cannot be read or run, has no such law, or the law fails when tried.
    """
    path = Path(file).resolve()
    if not path.is_file():
        raise DataError("no such file", file=file)
    law = _chosen(file, _module(path, path.stat().st_mtime_ns, file), kind)
    if not law.origin:
        _try_out(file, path, law)
        try:
            law.enter(law.name or law.__name__)
        except TypeError as error:
            raise DataError(str(error), file=file) from None
        law.origin = f"{path}:{law.__name__}"
    return law


@cache
def _module(path: Path, _changed: int, file: str) -> ModuleType:
    """The module of a file, run once for each state of the file."""
    spec = spec_from_file_location(f"curlfit_user_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise DataError("this is not a Python file", file=file)
    module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise DataError(f"{error.msg}; expected Python", file=file, line=error.lineno) from None
    except Exception as error:
        raise _fault(file, path, error) from None
    return module


def _chosen(file: str, module: ModuleType, kind: str) -> type[Law]:
    found = {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, type)
        and issubclass(value, LocalLaw | NetLaw)
        and value.__module__ == module.__name__
    }
    listed = f"it has {', '.join(found)}" if found else "derive one from curlfit.LocalLaw"
    if kind and kind not in found:
        raise DataError(f"no law class {kind!r} in it; {listed}", file=file)
    if not kind and len(found) != 1:
        raise DataError(f"expected one law class, or FILE.py:CLASS; {listed}", file=file)
    return found[kind or next(iter(found))]


def _try_out(file: str, path: Path, law: type[Law]) -> None:
    """Evaluate the law with its defaults, on numbers and as it will be compiled."""
    import jax  # a user's law needs it here, and only here

    alpha = np.linspace(-3.0, 3.0, 6)
    one = np.ones_like(alpha)
    point = RingPoint(
        xi=np.cos(alpha),
        eta=np.sin(alpha),
        angle=alpha,
        front=1.0 * (alpha > 0),
        slide_xi=-0.1 * np.sin(alpha),
        slide_eta=2 + 0.1 * np.cos(alpha),
        speed=2 * one,
        e_xi=-0.05 * np.sin(alpha),
        e_eta=one,
        load=one,
        turned=0.5,
        time=1.0,
    )

    def called(point: RingPoint) -> object:
        friction = law()
        if isinstance(friction, LocalLaw):
            return friction.traction(point)
        assert isinstance(friction, NetLaw)
        from curlfit.stone import Stone

        motion = Motion(speed=point.speed[0], omega=1.0, turned=point.turned, time=point.time)
        return friction.accelerations(motion, Stone())

    expected = (2, "(to the right, forward)") if issubclass(law, LocalLaw) else (3, "three numbers")
    try:
        found = called(point)
        jax.eval_shape(called, point)
    except Exception as error:
        raise _fault(file, path, error) from None
    if not (isinstance(found, tuple) and len(found) == expected[0]):
        raise DataError(f"{law.__name__} gives {found!r}; expected {expected[1]}", file=file)
    if not all(np.isfinite(np.asarray(part, float)).all() for part in found):
        raise DataError(f"{law.__name__} with its defaults gives {found!r} at 2 m/s", file=file)


def _fault(file: str, path: Path, error: Exception) -> DataError:
    """An error raised by the user's code, with the last line of it that took part."""
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename) == path
    ]
    text = str(error).strip().splitlines()
    return DataError(
        f"{type(error).__name__}{': ' + text[0] if text else ''}",
        file=file,
        line=lines[-1] if lines else None,
    )
