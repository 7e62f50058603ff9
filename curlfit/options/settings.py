"""Settings: defaults of the data file, overridden by the configuration file, then by the flags."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from curlfit.errors import DataError, InputError
from curlfit.foreign import SIZES, cut, is_size, quoted, safe_name
from curlfit.output.files import RECORDS

if TYPE_CHECKING:
    from curlfit.friction import Law, Load
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.mcmc.chain import Chain
    from curlfit.inference.model import Model
    from curlfit.inference.parameters import ParameterSet
    from curlfit.inference.problem import Problem
    from curlfit.stone import Stone
    from curlfit.throws.throw import Throw

READER_OPTIONS = (
    "format", "axes", "units", "reference", "stone_index", "shot", "handle", "as_given",
)  # fmt: skip
"""Settings of the readers."""
_MOST_BYTES = 64_000  # of a configuration file


def pairs(option: str, items: Sequence[str]) -> dict[str, float]:
    """`NAME=V[,NAME=V...]`, any number of times, as a dictionary."""
    found: dict[str, float] = {}
    for item in items:
        for part in item.split(","):
            name, equals, text = part.partition("=")
            if not equals or not name.strip():
                raise InputError(f"{option} {cut(item)}: expected NAME=VALUE")
            if name.strip() in found:
                raise InputError(f"{option}: {cut(name.strip())} is given twice")
            found[name.strip()] = number(option, name.strip(), text)
    return found


def texts(option: str, items: Sequence[str]) -> dict[str, str]:
    """`NAME=TEXT`, any number of times."""
    found: dict[str, str] = {}
    for item in items:
        name, equals, text = item.partition("=")
        if not equals or not name.strip() or not text.strip():
            raise InputError(f"{option} {cut(item)}: expected NAME=PRIOR")
        if name.strip() in found:
            raise InputError(f"{option}: {cut(name.strip())} is given twice")
        found[name.strip()] = text.strip()
    return found


def periods(option: str, items: Sequence[str]) -> list[list[float]]:
    """`A:B[,A:B...]`, any number of times, in s."""
    found = []
    for item in items:
        for part in item.split(","):
            low, colon, high = part.partition(":")
            try:
                pair = [float(low), float(high)]
            except ValueError:
                pair = []
            if not colon or not pair or not pair[0] < pair[1]:
                raise InputError(f"{option} {cut(part)}: expected A:B, times in s with A before B")
            found.append(pair)
    return found


def row_choices(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Selection of rows by settings, as arguments of `Throw.select_rows` and of `fit`."""
    return {
        "since": settings.get("since"),
        "until": settings.get("until"),
        "exclude": settings.get("exclude", ()),
    }


def swept_choice(text: str | None) -> list[float] | None:
    """`--sweep A:B` as a setting."""
    if text is None:
        return None
    found = periods("--sweep", [text])
    if len(found) != 1:
        raise InputError(f"--sweep {cut(text)}: expected one interval A:B")
    return found[0]


def names(items: Sequence[str]) -> list[str]:
    """`NAME[,NAME...]`, any number of times."""
    return [name.strip() for item in items for name in item.split(",") if name.strip()]


def intervals(option: str, items: Sequence[str]) -> dict[str, tuple[float, float]]:
    """`NAME=LO:HI`, any number of times; an empty end is infinite."""
    found = {}
    for item in items:
        name, equals, text = item.partition("=")
        low, colon, high = text.partition(":")
        if not equals or not colon:
            raise InputError(f"{option} {cut(item)}: expected NAME=LOW:HIGH")
        found[name.strip()] = (
            number(option, name, low) if low.strip() else -math.inf,
            number(option, name, high) if high.strip() else math.inf,
        )
    return found


def numbers(option: str, text: str) -> tuple[float, ...]:
    """Finite numbers separated by commas."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = (math.nan,)
    if not all(map(is_size, found)):
        raise InputError(f"{option} {cut(text.strip())}: expected numbers separated by commas")
    return found


def with_unit(option: str, quantity: str, text: str) -> float:
    """A number such as `5mm` in SI units; SI if it has no unit. `quantity` is "x", for instance."""
    size = re.match(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text)
    if size is None:
        raise InputError(
            f"{option} {cut(text.strip())}: expected a number, followed by its unit unless in SI"
        )
    from curlfit.throws.readers.columns import in_unit

    unit = text[size.end() :].strip()
    try:
        value = float(size[0]) * (in_unit(quantity, unit).factor if unit else 1.0)
    except InputError as error:
        raise InputError(f"{option} {cut(text.strip())}: {error}") from None
    if not is_size(value):
        raise InputError(f"{option} {cut(text.strip())}: expected {SIZES}")
    return value


def number(option: str, name: str, text: str) -> float:
    """A finite number from an option's text."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not is_size(value):
        raise InputError(
            f"{option} {cut(f'{name}={text.strip()}')}: expected a number after '=', {SIZES}"
        )
    return value


def read_config(file: Path | None) -> dict[str, Any]:
    """Settings from a TOML file; empty without a file."""
    if file is None:
        return {}
    from curlfit.throws.readers.settings import SETTINGS
    from curlfit.throws.readers.text import lines_of

    lines = lines_of(file, most_bytes=_MOST_BYTES, settings=True)
    try:
        found = tomllib.loads("\n".join(lines))
    except RecursionError:
        raise DataError("lists or tables nested too deeply", file=file) from None
    except ValueError as error:
        raise DataError(f"not a TOML file: {error}", file=file) from None
    for key in found:
        if key not in SETTINGS:
            raise DataError(
                f"unknown setting {quoted(key)}; the settings are {', '.join(SETTINGS)}", file=file
            )
    return found


def merge(*layers: Mapping[str, Any]) -> dict[str, Any]:
    """Later layers override earlier ones, tables entry by entry; None and {} are ignored."""
    result: dict[str, Any] = {}
    for layer in layers:
        for key, value in layer.items():
            if value is None:
                continue
            if isinstance(value, Mapping):
                result[key] = {**result.get(key, {}), **value}
            else:
                result[key] = value
    return result


def check_settings(settings: dict[str, Any], origin: str) -> dict[str, Any]:
    """The settings; raises `InputError` if one has a wrong type."""
    from curlfit.throws.readers.settings import check_types

    try:
        check_types(settings)
    except InputError as error:
        raise InputError(f"{origin}: {error}") from None
    return settings


class ConfiguredThrow(NamedTuple):
    """A throw with the settings for its fit."""

    throw: Throw
    settings: dict[str, Any]
    stone: Stone


def reader_arguments(configured: Mapping[str, Any], flags: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `load_throw` from the configuration and the flags."""
    settings = merge(configured, flags)
    return {key: settings[key] for key in READER_OPTIONS if key in settings}


def prepare(data: Path, config: Path | None, flags: Mapping[str, Any]) -> ConfiguredThrow:
    """The throw and its settings: its own, overridden by the configuration, then by the flags.

    Raises
    ------
    InputError : the data, a setting or a value cannot be used.
    """
    from curlfit.throws.readers import load_throw

    configured = check_settings(read_config(config), str(config))
    throw = load_throw(data, **reader_arguments(configured, flags))
    return apply_settings(throw, configured, flags)


def result_folder(data: Path, kind: str, shot: int | None, stone_index: int | None) -> Path:
    """Default folder for the results of a data file, or of the throw that is chosen from it."""
    chosen = [str(number) for number in (shot, stone_index) if number is not None]
    return Path("-".join([safe_name(data.stem), *chosen, kind]))


def prepare_all(
    files: Sequence[Path], config: Path | None, flags: Mapping[str, Any]
) -> dict[str, ConfiguredThrow]:
    """The throws of files and their settings, by file name; from a table of stopwatch times, those
    of all rows unless one is selected.

    Raises
    ------
    InputError : as `prepare`; two files have the same name.
    """
    from curlfit.errors import CurlfitError
    from curlfit.inference.joint.result import folder_name
    from curlfit.throws.readers import holds_timed_rows, load_throws

    names = [folder_name(file.name) for file in files]
    if len(set(names)) < len(names):
        names = [safe_name(f"{file.resolve().parent.name}-{file.stem}") for file in files]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InputError(
                f"{files[names.index(name)]}, {files[index]}: two files of the same name; results "
                "are stored by name"
            )
    found = {}
    for file, name in zip(files, names, strict=True):
        if not holds_timed_rows(file, flags.get("format")):
            found[name] = prepare(file, config, flags)
            continue
        configured = check_settings(read_config(config), str(config))
        parts = load_throws(file, **reader_arguments(configured, flags))
        for part in parts:
            if isinstance(part.throw, CurlfitError):
                raise part.throw
            found[folder_name(part.throw.name)] = apply_settings(part.throw, configured, flags)
    return found


def apply_settings(
    throw: Throw, configured: Mapping[str, Any], flags: Mapping[str, Any]
) -> ConfiguredThrow:
    """`prepare` for a throw that has already been read."""
    from curlfit.stone import Stone

    settings = merge(check_settings(throw.defaults, throw.name), configured, flags)
    stone = Stone().with_values(settings.get("stone", {}))
    return ConfiguredThrow(throw.with_sigma(settings.get("sigma", {})), settings, stone)


def fit_flags(
    reader_options: Mapping[str, Any],
    *,
    law: str | None,
    load: str | None,
    since: float | None,
    until: float | None,
    exclude: list[str] | None,
    swept: str | None,
    stone: list[str] | None,
    sigma: list[str] | None,
    fix: list[str] | None,
    bound: list[str] | None,
    start: list[str] | None,
    unbounded: bool,
    free: list[str] | None,
    prior: list[str] | None,
    **others: Any,
) -> dict[str, Any]:
    """The flags of a fit as settings."""
    return {
        **reader_options,
        "law": law,
        "load": load,
        "since": since,
        "until": until,
        "exclude": periods("--exclude", exclude or ()) or None,
        "swept": swept_choice(swept),
        "stone": pairs("--stone", stone or ()),
        "sigma": pairs("--sigma", sigma or ()),
        "fix": pairs("--fix", fix or ()),
        "bound": intervals("--bound", bound or ()),
        "start": pairs("--start", start or ()),
        "unbounded": unbounded or None,
        "free": names(free or ()) or None,
        "prior": texts("--prior", prior or ()),
        **others,
    }


def parameter_choices(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of the parameters, as arguments of `fit`."""
    return {
        "fix": settings.get("fix"),
        "bounds": settings.get("bound"),
        "unbounded": bool(settings.get("unbounded", False)),
        "free": tuple(settings.get("free", ())),
        "priors": settings.get("prior", {}),
        "swept": settings.get("swept"),
    }


def for_parameter_set(choices: Mapping[str, Any]) -> dict[str, Any]:
    """The choices as arguments of `ParameterSet.for_throw`."""
    return {**choices, "swept": choices["swept"] is not None}


class FitRequest(NamedTuple):
    """A requested fit; `cut` is the throw with only the rows to be used."""

    throw: Throw
    cut: Throw
    settings: dict[str, Any]
    law: type[Law]
    load: Load
    loss: str
    noise: str
    stone: Stone
    choices: dict[str, Any]
    parameters: ParameterSet

    def fit(self) -> FitResult:
        """Run the fit."""
        from curlfit.inference.fit.fit import fit

        found = fit(
            self.throw, self.law, load=self.load, stone=self.stone,
            start=self.settings.get("start"), loss=self.loss, noise=self.noise,
            systematics=self.settings.get("systematic"), **row_choices(self.settings),
            **self.choices,
        )  # fmt: skip
        return self.with_derived(found)

    def problem(self) -> tuple[Model, ParameterSet, Problem]:
        """The initial problem of the fit, for programs compiled alongside it."""
        from curlfit.inference.fit.prepared import PreparedThrow
        from curlfit.inference.fit.rounds import Rounds
        from curlfit.inference.model import Model
        from curlfit.numerics.compiled import unstacked

        prepared = PreparedThrow.of(
            self.throw, self.law, self.stone, **row_choices(self.settings), **self.choices
        )
        model = Model(self.law, self.load, prepared.parameters.conditions)
        rounds = Rounds(model, [prepared], loss=self.loss, noise=self.noise)
        (problem,) = unstacked(rounds.problems)
        return model, prepared.local_parameters, problem

    def with_derived(self, fit: FitResult) -> FitResult:
        """The fit with the derived quantities requested in the settings."""
        wanted = self.settings.get("derive")
        return fit if wanted is None else fit.with_derived(wanted)


def request_fit(data: Path, config: Path | None, flags: Mapping[str, Any]) -> FitRequest:
    """The requested fit, with its input checked before slow modules are loaded.

    Raises
    ------
    InputError : the data, a setting or a value cannot be used.
    """
    from curlfit.friction import check_load, find_law
    from curlfit.inference.conditions import check_systematics
    from curlfit.inference.derived import check_derived
    from curlfit.inference.noise.models import check_loss, check_noise
    from curlfit.inference.parameters import ParameterSet
    from curlfit.throws.plausibility import require_plausible

    throw, settings, stone = prepare(data, config, flags)
    law = find_law(settings.get("law", "front-back"))
    load = check_load(settings.get("load", "uniform"))
    loss = check_loss(settings.get("loss", "linear"))
    noise = check_noise(settings.get("noise", "white"), loss)
    check_systematics(settings.get("systematic", {}))
    choices = parameter_choices(settings)
    cut = throw.select_rows(**row_choices(settings))
    require_plausible(cut)
    parameters = ParameterSet.for_throw(law, cut, **for_parameter_set(choices))
    parameters.require("--start", settings.get("start", {}))
    check_derived(settings.get("derive", ()), parameters.names)
    return FitRequest(throw, cut, settings, law, load, loss, noise, stone, choices, parameters)


def kind_of(folder: Path) -> str:
    """Kind of the result in a folder, by the name of its JSON file.

    Raises
    ------
    InputError : the folder contains no result.
    """
    for kind in RECORDS:
        if folder.name == f"{kind}.json" or (folder / f"{kind}.json").is_file():
            return kind
    if folder.is_dir():
        names = ", ".join(f"{kind}.json" for kind in RECORDS)
        raise InputError(f"{folder}: no saved result; expected a folder with one of {names}")
    return "fit"


def chain_beside(folder: Path) -> Path:
    """The `chain.h5` in the folder of a fit, or beside its file."""
    return (folder if folder.is_dir() else folder.parent) / "chain.h5"


def load_fit_and_chain(folder: Path) -> tuple[FitResult, Chain | None]:
    """A saved fit, and its chain if sampling was completed."""
    from curlfit.inference.fit.result import load_fit

    kind = kind_of(folder)
    if kind != "fit":
        what = {"joint": "a joint fit of several throws", "compare": "a comparison of laws"}
        throws = sorted((folder if folder.is_dir() else folder.parent).glob("*/fit.json"))
        raise InputError(
            f"{folder}: {what.get(kind, f'a result of curlfit {kind}')}; expected the fit of one "
            "throw" + (f", such as {throws[0].parent}" if kind == "joint" and throws else "")
        )
    result = load_fit(folder)
    file = chain_beside(folder)
    if result.posterior is None or not file.is_file():
        return result, None

    from curlfit.inference.mcmc.chain import load_chain

    return result, load_chain(file)


def name_of(fit: Path) -> str:
    """The name of a saved fit, for results derived from it."""
    own = fit.resolve()
    folder = own.parent if own.suffix == ".json" else own
    return safe_name(folder.name.removesuffix("-fit"))
