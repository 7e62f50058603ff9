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
    from curlfit.inference.mcmc.chain import Chain
    from curlfit.inference.model import Model
    from curlfit.inference.parameters import ParameterSet
    from curlfit.inference.problem import Problem
    from curlfit.throws.throw import Throw

_FORMS = {**Fitting.forms(), **Comparing.forms(), **Reading.forms(), "seed": SEED}
_KEYS = {FLAGS.get(name, name).removeprefix("--"): name for name in _FORMS} | {
    "swept": "swept"
}
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
        found = tomllib.loads("\n".join(lines))
    except RecursionError:
        raise DataError("lists or tables nested too deeply", file=file) from None
    except ValueError as error:
        raise DataError(f"not a TOML file: {error}", file=file) from None
    for key, value in found.items():
        if key not in _KEYS:
            raise DataError(
                f"unknown setting {quoted(key)}; the settings are {', '.join(_KEYS)}",
                file=file,
            )
        try:
            _FORMS[_KEYS[key]].checked(key, value)
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
    return {_KEYS[key]: value for key, value in found.items()}


@dataclass(frozen=True)
class ConfiguredThrow(Generic[Chosen]):
    """A throw with the choices for its fit."""

    throw: Throw
    chosen: Chosen
    seed: int | None = None

    @cached_property
    def cut(self) -> Throw:
        """The rows to be used, with the sigmas that are given."""
        throw = self.throw.with_sigma(dict(self.chosen.sigma))
        return throw.select_rows(**self.chosen.rows)

    @cached_property
    def parameters(self: ConfiguredThrow[ModelChoices]) -> ParameterSet:
        """The parameters of its fit."""
        return checked_parameters(self.chosen, self.cut)

    def fit(self) -> FitResult:
        """Run the fit."""
        from curlfit.inference.fit.fit import fit

        return fit(self.throw, **vars(self.chosen))

    def problem(
        self: ConfiguredThrow[ModelChoices],
    ) -> tuple[Model, ParameterSet, Problem]:
        """The initial problem of the fit, for programs compiled alongside it."""
        from curlfit.friction import find_law
        from curlfit.inference.fit.prepared import PreparedThrow
        from curlfit.inference.fit.rounds import Rounds
        from curlfit.inference.model import Model
        from curlfit.numerics.batches import unstacked

        chosen = self.chosen
        prepared = PreparedThrow.of(self.throw, chosen)
        model = Model(find_law(chosen.law), chosen.load, prepared.parameters.conditions)
        rounds = Rounds(model, [prepared], loss=chosen.loss, noise=chosen.noise)
        (problem,) = unstacked(rounds.problems)
        return model, prepared.local_parameters, problem


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
    """`prepare` for a throw that has already been read."""
    chosen = type(flags).of(throw.settings, configured, vars(flags))
    return ConfiguredThrow(
        throw, chosen, configured.get("seed", throw.defaults.get("seed"))
    )


def result_folder(data: Path, kind: str, reading: Reading) -> Path:
    """Default folder for the results of a data file, or of the throw that is
    chosen from it."""
    chosen = filter(None, (reading.worksheet, reading.shot, reading.stone_index))
    return Path(
        "-".join([*(safe_name(str(name)) for name in (data.stem, *chosen)), kind])
    )


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
    from curlfit.inference.joint.result import folder_names
    from curlfit.throws.load import load_throws

    configured = read_config(config)
    chosen = Reading.of(configured, vars(reading))
    throws = load_throws(*files, **vars(chosen))
    found: dict[str, ConfiguredThrow[Chosen]] = {}
    for name, throw in zip(
        folder_names([one.name for one in throws]), throws, strict=True
    ):
        if name in found:
            raise InputError(
                f"{found[name].throw.name}, {throw.name}: two files of the same name; "
                "results are stored by name"
            )
        found[name] = apply_settings(throw, configured, flags)
    return found


def checked_parameters(
    chosen: Modelling, throw: Throw | None = None, *, others_swept: bool = False
) -> ParameterSet:
    """The parameters of a fit of the rows to be used (of any throw, without one),
    before slow modules are loaded.

    Raises
    ------
    InputError : a choice that cannot be used.
    """
    from curlfit.friction import find_law
    from curlfit.inference.conditions import check_systematics
    from curlfit.inference.derived import check_derived
    from curlfit.inference.parameters import ParameterSet

    law, swept = find_law(chosen.law), chosen.swept is not None or others_swept
    parameters = (
        ParameterSet.build(law, swept=swept, **chosen.parameters)
        if throw is None
        else ParameterSet.for_throw(law, throw, swept=swept, **chosen.parameters)
    )
    parameters.require("--start", chosen.start)
    if isinstance(chosen, Fitting):
        check_systematics(chosen.systematics)
        check_derived(chosen.derive, parameters.names)
    return parameters


def checked(job: ConfiguredThrow[ModelChoices]) -> ConfiguredThrow[ModelChoices]:
    """The same throw. Raises `InputError` if it cannot be fitted, before slow
    modules are loaded."""
    from curlfit.throws.plausibility import require_plausible

    require_plausible(job.cut)
    _ = job.parameters
    return job


def kind_of(folder: Path) -> str:
    """Kind of the result in a folder, by the name of its JSON file.

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

    kind = kind_of(folder)
    if kind != "fit":
        what = {
            "joint": "a joint fit of several throws",
            "compare": "a comparison of laws",
        }
        throws = sorted(
            (folder if folder.is_dir() else folder.parent).glob("*/fit.json")
        )
        raise InputError(
            f"{folder}: {what.get(kind, f'a result of curlfit {kind}')}; "
            "expected the fit of one throw"
            + (f", such as {throws[0].parent}" if kind == "joint" and throws else "")
        )
    result = load_fit(folder).with_law(law)
    file = chain_beside(folder)
    if result.posterior is None or not file.is_file():
        return result, None

    from curlfit.inference.mcmc.chain import load_chain

    return result, load_chain(file, result)


def name_of(fit: Path) -> str:
    """The name of a saved fit, for results derived from it."""
    own = fit.resolve()
    folder = own.parent if own.suffix == ".json" else own
    return safe_name(folder.name.removesuffix("-fit"))
