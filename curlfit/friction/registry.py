"""Finding a law: by its name, as a class, or in a user's Python file."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from curlfit.errors import DataError, InputError, require_kind
from curlfit.foreign import quoted
from curlfit.friction.base import LAWS, TERMS, Law, LocalLaw, NetLaw
from curlfit.friction.checks import checked, first_line, last_line
from curlfit.friction.sums import sum_of
from curlfit.loads import Load


def find_law(name: str | type[Law], *, from_files: bool = True) -> type[Law]:
    """The law of that name, or a user's law in a file, as "FILE.py:CLASS"; a
    law is itself.

    A law that is not one of curlfit is tested when it is first used.

    `from_files` is False where the name comes from a data file, which must not
    execute code.

    Raises
    ------
    InputError : no such law; the message lists the laws. DataError : the file contains
        no usable law, or the law is not usable.

    Examples
    --------
    >>> curlfit.find_law("front-back").name
    'front-back'
    """
    if isinstance(name, type) and issubclass(name, Law):
        return checked(name)
    require_kind(name, str, "law", "the name of a law, or a law's class")
    assert isinstance(name, str)
    if name in LAWS:
        return checked(LAWS[name])
    if name in TERMS:
        raise InputError(
            f"{name} does not brake a stone; add it to a law of the ring, "
            f"as in power+{name}"
        )
    first_part, *other_parts = name.split("+")
    # The first part may be a file, whose name may have a plus of its own.
    if other_parts and all(part in TERMS or part in LAWS for part in other_parts):
        laws: list[Any] = [
            TERMS.get(part) or find_law(part, from_files=from_files)
            for part in (first_part, *other_parts)
        ]
        return checked(sum_of(*laws))
    if from_files:
        if name.endswith(".py"):
            return law_from_file(name)
        file, _, kind = name.rpartition(":")
        if file.endswith(".py"):
            return law_from_file(file, kind)
    message = (
        f"unknown law {quoted(name)}; the laws are {', '.join(sorted(LAWS))} "
        "(see `curlfit laws`)"
    )
    if from_files:
        message += "; a law of your own is FILE.py:CLASS"
    raise InputError(message)


def laws_under(
    laws: str | type[Law] | Sequence[str | type[Law]] | None,
    loads: Sequence[Load] = (Load.UNIFORM,),
) -> list[tuple[type[Law], Load]]:
    """Laws to be fitted, each under some loads.

    Where no law is named, all of curlfit's own except those that approximate another. A
    law without a ring has no load and is listed once. Raises `InputError` for an
    unknown name.
    """
    if not laws:
        laws = [law for law in LAWS.values() if law.shipped() and not law.approximates]
    elif isinstance(laws, str | type):
        laws = [laws]
    candidates = []
    for law in dict.fromkeys(find_law(law) for law in laws):
        for load in loads[:1] if issubclass(law, NetLaw) else loads:
            candidates.append((law, load))
    return candidates


def law_from_file(file: str, kind: str = "") -> type[Law]:
    """The law class `kind` of a Python file; the only law in it if `kind` is empty.

    The default of `name` is the class name.

    Raises
    ------
    DataError : the file cannot be read or run, has no such law, or the
        evaluation fails.
    """
    path = Path(file).resolve()
    if not path.is_file():
        raise DataError("no such file", file=file)
    law = _select_law(file, _module(path, path.stat().st_mtime_ns, file), kind)
    checked(law, file).origin = f"{path}:{law.__name__}"
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
        raise DataError(
            f"{error.msg}; expected Python", file=file, line=error.lineno
        ) from None
    except ModuleNotFoundError as error:
        fault = first_line(error)
        if path.with_name(f"{error.name}.py").is_file():
            fault += (
                f"; {error.name}.py beside it is not imported, since a folder may hold "
                "data of others: name the folder in PYTHONPATH"
            )
        raise DataError(fault, file=file, line=last_line(path, error)) from None
    except Exception as error:
        raise DataError(
            first_line(error), file=file, line=last_line(path, error)
        ) from None
    return module


def _select_law(file: str, module: ModuleType, kind: str) -> type[Law]:
    """The law class `kind` of a module, or the only one in it."""
    classes = {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, type)
        and issubclass(value, LocalLaw | NetLaw)
        and value.__module__ == module.__name__
    }
    available = "derive one from curlfit.LocalLaw"
    if classes:
        available = f"it has {', '.join(classes)}"
    if kind and kind not in classes:
        raise DataError(f"no law class {quoted(kind)} in it; {available}", file=file)
    if not kind and len(classes) != 1:
        raise DataError(
            f"expected one law class, or FILE.py:CLASS; {available}", file=file
        )
    return classes[kind or next(iter(classes))]
