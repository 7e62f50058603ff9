"""What is done with each throw of a batch, and the columns of its table."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from glob import glob
from pathlib import Path
from typing import Any

from curlfit.errors import CurlfitError, InputError
from curlfit.friction import Law, NetLaw, check_load, find_law
from curlfit.inference.conditions import check_systematics
from curlfit.inference.noise.models import check_loss, check_noise
from curlfit.inference.parameters import ParameterSet
from curlfit.stone import Stone
from curlfit.throws.readers import check_reader_options, format_of
from curlfit.throws.readers.text import lines_of
from curlfit.throws.readers.timings import usual_law as law_of_timings
from curlfit.throws.throw import Throw, check_sigma

CHUNK = 128
"""Number of throws that are read and fitted together."""
QUANTILES = ("16", "50", "84")
"""Quantiles of the posterior, in percent."""
_SUFFIXES = (".csv", ".tsv", ".txt", ".jsonl", ".json")


@dataclass(frozen=True)
class BatchSettings:
    """What is done with each throw; `load` and the others as in `fit`.

    Attributes
    ----------
    stone : values (m, kg) that override those of the throw's own file.
    sigma : noise by channel, overriding that of the file.
    swept : whether a file states sweeping, so that the table has columns of `sweep`.
    how : how to read a file, as the arguments of `load_throw`.
    systematics : widths as in `fit`; None for a table without systematic errors.
    posterior : sample the posterior of each throw as well; hundreds of times slower.
    """

    law: str = "front-back"
    load: str = "uniform"
    since: float | None = None
    until: float | None = None
    exclude: Sequence[Sequence[float]] = ()
    stone: Mapping[str, float] = field(default_factory=dict)
    sigma: Mapping[str, float] = field(default_factory=dict)
    fix: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    unbounded: bool = False
    free: Sequence[str] = ()
    priors: Mapping[str, str] = field(default_factory=dict)
    systematics: Mapping[str, float] | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    loss: str = "linear"
    noise: str = "white"
    how: Mapping[str, Any] = field(default_factory=dict)
    posterior: bool = False
    seed: int = 0
    swept: bool = False

    def checked(self) -> type[Law]:
        """The law. Raises InputError if the settings are impossible for any throw."""
        law = find_law(self.law)
        check_load(self.load)
        Stone().with_values(dict(self.stone))
        check_sigma(self.sigma)
        check_reader_options(**self.how)
        check_noise(self.noise, check_loss(self.loss))
        check_systematics(self.systematics or {})
        self.parameters().require("--start", self.start)
        return law

    def parameters(self) -> ParameterSet:
        """Parameters of each throw's fit."""
        return ParameterSet.build(
            find_law(self.law), fix=dict(self.fix), bounds=dict(self.bounds),
            unbounded=self.unbounded, free=self.free, priors=self.priors, swept=self.swept,
        )  # fmt: skip

    def choices(self) -> dict[str, Any]:
        """The settings as arguments of `fit_throws`."""
        names = (
            "law", "load", "since", "until", "exclude", "fix", "bounds", "unbounded", "free",
            "priors", "systematics", "start", "loss", "noise",
        )  # fmt: skip
        return {name: getattr(self, name) for name in names}

    def stones(self, throws: Sequence[Throw]) -> list[Stone]:
        """The stone of each throw."""
        own = (Stone().with_values(throw.defaults.get("stone", {})) for throw in throws)
        return [stone.with_values(dict(self.stone)) for stone in own]

    def sums(self) -> dict[str, tuple[str, ...]]:
        """Free coefficients of which only the sum enters the motion, by the sum as written."""
        law = self.checked()
        if self.load != "uniform" and not issubclass(law, NetLaw):
            return {}
        return {" + ".join(names): names for names in law.sums if not set(names) & set(self.fix)}

    def to_json(self) -> dict[str, Any]:
        """The plan as plain values."""
        return asdict(self)


def columns(plan: BatchSettings) -> list[str]:
    """Columns of the table of results; those of text, which may contain commas, come last."""
    plan.checked()
    names = plan.parameters().names
    found = ["file", "shot", "stone_index", "status", "n_observations", "rms_x", "rms_y", "rms_phi"]
    quantiles = QUANTILES if plan.posterior else ()
    systematic = plan.systematics is not None
    for name in names:
        found += [name, f"{name}_stderr", f"{name}_verdict", *(f"{name}_{q}" for q in quantiles)]
        found += [f"{name}_systematic"] * systematic
    for name in plan.sums():
        found += [name, f"{name} stderr", *(f"{name} {q}" for q in quantiles)]
        found += [f"{name} systematic"] * systematic
    return [*found, "combinations", "warnings", "reason"]


def usual_law(file: str, format: str | None) -> str:
    """The law if none is given: for a stopwatch record, the one that its values determine."""
    try:
        if (format or format_of(file)) == "timings":
            return law_of_timings(Path(file), lines_of(Path(file)))
    except CurlfitError:
        pass  # reported with the file
    return "front-back"


def found_files(wanted: Sequence[str], besides: Collection[Path] = ()) -> list[Path]:
    """Data files from folders, patterns and names, each once, sorted, except those in `besides`.

    Raises
    ------
    InputError : a folder, pattern or name matches no file.
    """
    found: set[Path] = set()
    left_out = {file.resolve() for file in besides}
    for text in wanted:
        place = Path(text)
        if place.is_dir():
            here = {file for file in place.iterdir() if file.suffix.lower() in _SUFFIXES}
        else:
            here = {Path(name) for name in glob(text, recursive=True) if Path(name).is_file()}
        here = {file for file in here if file.resolve() not in left_out}
        if not here:
            what = f"no file that ends in {', '.join(_SUFFIXES)}" if place.is_dir() else "no file"
            raise InputError(f"{text}: {what} found")
        found |= here
    return sorted(found)
