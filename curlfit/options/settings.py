"""Choices of a verb: those of the data file, overridden by a configuration,
then by flags."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar

from cyclopts import Group, Parameter

from curlfit.errors import DataError, InputError
from curlfit.foreign import quoted, safe_name
from curlfit.loads import Load
from curlfit.settings.choices import (
    FLAGS,
    LAW,
    LOAD,
    SEED,
    Choices,
    Comparing,
    Estimation,
    Fitting,
    Modelling,
    Named,
    Reading,
)
from curlfit.settings.forms import NUMBER, PATH, VALUES, option

if TYPE_CHECKING:
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.model.request import Request
    from curlfit.inference.sampling.chain import Chain
    from curlfit.throws.throw import Throw

_FORMS = {**Fitting.forms(), **Comparing.forms(), **Reading.forms(), "seed": SEED}
"""How the values of choices are written, by the names of choices."""
_CHOICE_BY_KEY = {FLAGS.get(name, name).removeprefix("--"): name for name in _FORMS}
_CHOICE_BY_KEY["swept"] = "swept"
"""Names of choices by the keys of a configuration, which are the flags without their
hyphens."""
Chosen = TypeVar("Chosen", bound=Estimation)
ModelChoices = TypeVar("ModelChoices", bound=Modelling)
LawOfFit = Annotated[
    Any,
    option(
        LAW, "FILE.py:CLASS", help="The law of the saved fit, if it is one of your own."
    ),
]
Config = Annotated[
    Path | None,
    option(
        PATH,
        "TOML",
        help="TOML file of settings, by the names of flags; flags override it.",
    ),
]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class LawValues(Choices):
    """A law with its coefficients, the load and the stone.

    Attributes
    ----------
    law : Friction law; `curlfit laws` lists them. [default: front-back]
    coefficients : A coefficient; the law's default if not set.
    load : `uniform` or `consistent` (eq. 8-9). [default: uniform]
    stone : The stone, as in `curlfit fit`.
    """

    law: Annotated[Any, option(LAW, "NAME")] = None
    coefficients: Annotated[Named, option(VALUES, "NAME=V")] = field(
        default_factory=dict
    )
    load: Annotated[Load | None, option(LOAD, "NAME")] = None
    stone: Annotated[Named, option(VALUES, "R=V,rho=V")] = field(default_factory=dict)


@Parameter(name="*", group=Group("Start", sort_key=0))
@dataclass(frozen=True, kw_only=True)
class Start(Choices):
    """The initial state of a throw; what is not given has the default of the verb.

    Attributes
    ----------
    v0 : Speed, m/s.
    omega0 : Spin, rad/s, counter-clockwise positive.
    heading : Direction, rad, from +y toward +x. [default: 0, along the sheet]
    x0 : Position, m right of the centre line. [default: 0]
    y0 : Position along the sheet, m. [default: that of the line]
    phi0 : Angle of the stone, rad. [default: 0]
    """

    v0: Annotated[float | None, option(NUMBER, "V")] = None
    omega0: Annotated[float | None, option(NUMBER, "W")] = None
    heading: Annotated[float | None, option(NUMBER, "A")] = None
    x0: Annotated[float | None, option(NUMBER, "X")] = None
    y0: Annotated[float | None, option(NUMBER, "Y")] = None
    phi0: Annotated[float | None, option(NUMBER, "A")] = None


def read_config(file: Path | None) -> dict[str, Any]:
    """Choices from a TOML file, by name; none without a file."""
    if file is None:
        return {}
    from curlfit.throws.readers.text import TextFile

    lines = TextFile.read(file, settings=True).lines
    try:
        value_by_key = tomllib.loads("\n".join(lines))
    except RecursionError:
        raise DataError("lists or tables nested too deeply", file=file) from None
    except ValueError as error:
        raise DataError(f"not a TOML file: {error}", file=file) from None
    value_by_choice = {}
    for key, value in value_by_key.items():
        if key not in _CHOICE_BY_KEY:
            keys = ", ".join(_CHOICE_BY_KEY)
            raise DataError(
                f"unknown setting {quoted(key)}; the settings are {keys}", file=file
            )
        choice = _CHOICE_BY_KEY[key]
        try:
            _FORMS[choice].checked(key, value)
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        value_by_choice[choice] = value
    return value_by_choice


@dataclass(frozen=True)
class ConfiguredThrow(Generic[Chosen]):
    """A throw with the choices for its fit, and the seed of its sampling, if its file
    or the configuration names one."""

    throw: Throw
    chosen: Chosen
    seed: int | None = None

    @cached_property
    def rows(self) -> Throw:
        """The rows that are used, with the sigmas that are given."""
        from curlfit.inference.model.request import rows_in_use

        return rows_in_use(self.throw, self.chosen)

    @cached_property
    def request(self: ConfiguredThrow[ModelChoices]) -> Request:
        """The request to fit the throw, made before slow modules are loaded. Raises
        `InputError` if it cannot be fitted."""
        from curlfit.inference.model.request import Request

        return Request.of(self.throw, self.chosen)


def prepare(
    data: Path, config: Path | None, reading: Reading, flags: Chosen
) -> ConfiguredThrow[Chosen]:
    """The throw and its choices: its own, overridden by the configuration, then
    by the flags.

    Raises
    ------
    InputError : the data, a setting or a value cannot be used.
    """
    from curlfit.throws.load import load_throw

    configured = read_config(config)
    throw = load_throw(data, **vars(Reading.of(configured, vars(reading))))
    return apply_settings(throw, configured, flags)


def apply_settings(
    throw: Throw, configured: Mapping[str, Any], flags: Chosen
) -> ConfiguredThrow[Chosen]:
    """A throw that has been read, and its choices: its own, overridden by those of a
    configuration, by name, then by the flags. Raises `InputError` for a value that
    cannot be used."""
    chosen = type(flags).of(throw.settings, configured, vars(flags))
    seed = configured.get("seed", throw.defaults.get("seed"))
    return ConfiguredThrow(throw, chosen, seed)


def result_folder(data: Path, kind: str, reading: Reading) -> Path:
    """Default folder for the results of a data file, or of the throw that is chosen
    from it, such as `evening-3-fit` for the kind "fit"."""
    chosen = filter(None, (reading.worksheet, reading.shot, reading.stone_index))
    names = [safe_name(str(name)) for name in (data.stem, *chosen)]
    return Path("-".join([*names, kind]))


def prepare_all(
    files: Sequence[Path], config: Path | None, reading: Reading, flags: Chosen
) -> dict[str, ConfiguredThrow[Chosen]]:
    """The throws of files and their choices, by file name; from a table of stopwatch
    times, those of all rows unless one is selected.

    Raises
    ------
    InputError : as `prepare`; two files have the same name; no throw
        determines friction.
    """
    from curlfit.inference.together.result import folder_names
    from curlfit.throws.load import load_throws

    configured = read_config(config)
    chosen = Reading.of(configured, vars(reading))
    throws = load_throws(*files, **vars(chosen))
    names = folder_names([throw.name for throw in throws])
    job_by_name: dict[str, ConfiguredThrow[Chosen]] = {}
    for name, throw in zip(names, throws, strict=True):
        if name in job_by_name:
            raise InputError(
                f"{job_by_name[name].throw.name}, {throw.name}: two files of the same "
                "name; results are stored by name"
            )
        job_by_name[name] = apply_settings(throw, configured, flags)
    return job_by_name


def kind_of(folder: Path) -> str:
    """Kind of the saved result in a folder or a file, by the name of its JSON file; a
    file of any other name is taken for a fit.

    Raises
    ------
    InputError : the folder contains no result.
    """
    from curlfit.output.kinds import KINDS

    for kind in KINDS:
        if folder.name == f"{kind}.json" or (folder / f"{kind}.json").is_file():
            return kind
    if folder.is_dir():
        names = ", ".join(f"{kind}.json" for kind in KINDS)
        raise InputError(
            f"{folder}: no saved result; expected a folder with one of {names}"
        )
    return "fit"


def chain_beside(folder: Path) -> Path:
    """The `chain.h5` in the folder of a fit, or beside its file."""
    return (folder if folder.is_dir() else folder.parent) / "chain.h5"


def load_fit_and_chain(
    folder: Path, law: str | None = None
) -> tuple[FitResult, Chain | None]:
    """A saved fit, whose law may be that of a user's file, and its chain if sampling
    was completed.

    Raises
    ------
    InputError : no fit of one throw is there, its chain is of another fit, or its
        law is another.
    """
    from curlfit.inference.fit.result import load_fit

    _require_fit_of_one_throw(folder)
    result = load_fit(folder).with_law(law)
    file = chain_beside(folder)
    if result.posterior is None or not file.is_file():
        return result, None

    from curlfit.inference.sampling.chain import load_chain

    return result, load_chain(file, result)


def _require_fit_of_one_throw(folder: Path) -> None:
    """Raise `InputError` where the saved result in a folder, or in a file, is none."""
    kind = kind_of(folder)
    if kind == "fit":
        return
    what = {
        "joint": "a joint fit of several throws",
        "compare": "a comparison of laws",
    }.get(kind, f"a result of curlfit {kind}")
    example = ""
    if kind == "joint":
        folder_of_throws = folder if folder.is_dir() else folder.parent
        throws = sorted(folder_of_throws.glob("*/fit.json"))
        if throws:
            example = f", such as {throws[0].parent}"
    raise InputError(f"{folder}: {what}; expected the fit of one throw{example}")


def name_of(fit: Path) -> str:
    """The name of a saved fit, by its folder or its file, for results that are derived
    from it."""
    path = fit.resolve()
    folder = path.parent if path.suffix == ".json" else path
    return safe_name(folder.name.removesuffix("-fit"))
