"""The record of a joint fit of several throws."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from curlfit.errors import DataError, InputError
from curlfit.findings import Finding
from curlfit.foreign import file_and_number, safe_name
from curlfit.friction import Law, find_law
from curlfit.inference.derived.derive import derive
from curlfit.inference.derived.quantiles import Quantiles
from curlfit.inference.derived.quantity import Derived
from curlfit.inference.fit.estimates import Estimate, NamedEstimates, Systematics
from curlfit.inference.fit.result import FitResult, load_fit
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.named_matrix import NamedMatrix
from curlfit.inference.model.parameters import START_NAMES
from curlfit.inference.sampling.chain import Chain, digest, load_chain
from curlfit.inference.together.effects import Effect, Means
from curlfit.loads import Load
from curlfit.numerics.arrays import Floats
from curlfit.records import (
    ADDED,
    UNSAVED,
    Entry,
    Names,
    plain,
    require,
    structured,
)
from curlfit.stone import Stone
from curlfit.throws.odd_row import OddRow
from curlfit.wording import p_text

_SIGNIFICANT = 0.01


@dataclass(frozen=True)
class Variation:
    """How a coefficient, or a combination of coefficients, varies from throw to throw.

    Attributes
    ----------
    expression : the coefficient or combination.
    each : estimate and standard error from each throw alone, None where it gives none.
    p_value : probability of differences at least as large if the throws agree, apart
        from groups and trends (chi squared).
    spread : standard deviation between throws beyond what the errors explain.
    mean, stderr : mean over such throws and its standard error, including the spread
        between them.
    shared_stderr : standard error of an estimate of equal values as one of this mean.
    significant : p_value below 0.01.
    quantiles : of the posterior of the spread; empty if it was not sampled.
    """

    expression: str
    each: tuple[tuple[float, float] | None, ...]
    p_value: float
    spread: float
    mean: float
    stderr: float
    shared_stderr: float | None = field(default=None, metadata=ADDED)
    quantiles: Quantiles = field(default_factory=dict, metadata=ADDED)
    written: ClassVar[tuple[str, ...]] = ("significant",)

    @property
    def significant(self) -> bool:
        """Whether the differences are unlikely to be due to chance."""
        return self.p_value < _SIGNIFICANT

    @property
    def p_text(self) -> str:
        """The p-value as text, such as "p < 0.001"."""
        return p_text(self.p_value)


@dataclass(frozen=True)
class StartOfThrow(Entry):
    """How a throw began.

    Attributes
    ----------
    labels : of the throw, such as its sheet.
    start : its initial state, by component.
    """

    labels: dict[str, str]
    start: Annotated[dict[str, float], Names(START_NAMES)]


@dataclass(frozen=True, eq=False)
class SeparateFits:
    """Separate fits of throws that a joint fit is of.

    Attributes
    ----------
    file : the table. throws : their number. stone : of most. notes : remarks on
        what was read.
    starts : how the last throw with some labels began; none where each throw has
        conditions of its own.
    duration : of the longest record, s.
    speeds, spins : lowest and highest speed (m/s), and spin (rad/s) of either sense.
    null_directions : of what they have in common.
    """

    file: str
    throws: int
    stone: Stone
    notes: tuple[Finding, ...]
    starts: tuple[StartOfThrow, ...] = field(default=(), metadata=ADDED)
    duration: float = field(default=0.0, metadata=ADDED)
    speeds: Floats = field(default_factory=lambda: np.zeros(0), metadata=ADDED)
    spins: Floats = field(default_factory=lambda: np.zeros(0), metadata=ADDED)
    null_directions: tuple[dict[str, float], ...] = field(default=(), metadata=ADDED)


@dataclass(frozen=True)
class DeterminedTogether(Entry):
    """What throws determine together, in short.

    Attributes
    ----------
    rank : number of directions in the space of the free parameters that they determine.
    parameters : number of free parameters, not counting what varies from throw to
        throw.
    """

    rank: int
    parameters: int


@dataclass(frozen=True)
class ThrowInBrief(Entry):
    """A throw of a joint fit in `joint.json`; the whole is in its own folder.

    Attributes
    ----------
    file, rows : its file, and number of rows of a path.
    rms, sigma, parameters : see `FitResult`.
    """

    file: str
    rows: int
    rms: dict[str, float]
    sigma: dict[str, float]
    parameters: dict[str, Estimate]

    @classmethod
    def of(cls, fit: FitResult) -> Self:
        """The throw of a fit."""
        return cls(fit.data.file, fit.data.rows, fit.rms, fit.sigma, fit.parameters)


@dataclass(frozen=True, eq=False, repr=False)
class JointResult(NamedEstimates):
    """Several throws fitted together.

    Attributes
    ----------
    law, load, share : what was fitted; names of the shared coefficients.
    converged, status, warnings : whether the fit may be used, and why it may mislead.
    odd_rows : those of stopwatch tables that contradict the others, which were left
        out unless they are many.
    means : how the mean depends on groups and trends, and throws vary about it; None if
        the coefficients are equal in all throws.
    coefficients : the shared ones, by name: those of the mean of the throws, or the
        equal ones. Where throws differ in one that is taken as equal, its standard
        error is that of an estimate of the mean over such throws, with one degree of
        freedom less than throws.
    combinations : what is determined where single shared coefficients are
        not; likewise.
    identifiability : how much the throws determine together.
    variation : of each determined shared coefficient or combination.
    groups, differences, trend : the mean of all throws and of each group, the
        differences of groups from the first one of the same label, and the change of
        the mean along a trend; of each quantity that varies, and of a draw to the tee.
    slopes : changes along a trend of each group that has a slope of its own
        (`trend_by`).
    slope_differences : by how much the slopes of groups differ from that of the first
        one of the same label; where all groups have one slope, from a second fit in
        which they do not.
    throws : a `FitResult` for each throw, with its own coefficients if these vary; its
        standard errors and its information are those of the joint fit, so that
        predictions from it use all throws.
    r_hat : largest of the spreads, if the posterior was sampled.
    chain : draws of the posterior, of what varies, of its groups, trends and spreads;
        saved as `chain.h5` beside the record.
    table : of separate fits, in place of the throws.
    systematics : errors of what is shared due to the conditions that the fit
        holds fixed.
    derived : quantities requested by `--derive` and `with_derived`.

    Examples
    --------
    >>> joint
    JointResult, converged (... steps): front-back law, uniform load, 2 throws together
    mu1_xi = ..., mu2_xi = ..., mu1_eta + mu2_eta = ...
    not identifiable: mu1_eta, mu2_eta
    1 warning, see curlfit.print_joint
    >>> len(joint.throws)
    2
    """

    kind: ClassVar[str] = "joint"

    law: str
    load: Load
    share: tuple[str, ...]
    converged: bool
    status: str
    warnings: tuple[Finding, ...]
    coefficients: dict[str, Estimate]
    combinations: tuple[Combination, ...]
    identifiability: DeterminedTogether
    variation: tuple[Variation, ...]
    odd_rows: tuple[OddRow, ...] = field(default=(), metadata=ADDED)
    means: Means | None = field(default=None, metadata=ADDED)
    groups: tuple[Effect, ...] = field(default=(), metadata=ADDED)
    differences: tuple[Effect, ...] = field(default=(), metadata=ADDED)
    trend: tuple[Effect, ...] = field(default=(), metadata=ADDED)
    slopes: tuple[Effect, ...] = field(default=(), metadata=ADDED)
    slope_differences: tuple[Effect, ...] = field(default=(), metadata=ADDED)
    throws: tuple[FitResult, ...] = field(default=(), metadata=UNSAVED)
    r_hat: float | None = field(default=None, metadata=ADDED)
    chain: Chain | None = field(default=None, metadata=UNSAVED)
    table: SeparateFits | None = field(default=None, metadata=ADDED)
    systematics: Systematics = field(default_factory=Systematics)
    derived: tuple[Derived, ...] = ()

    @property
    def _estimates(self) -> dict[str, Estimate]:
        """What is shared, by name."""
        return self.coefficients

    @property
    def count(self) -> int:
        """Number of throws."""
        return len(self.throws) if self.table is None else self.table.throws

    @property
    def stone(self) -> Stone:
        """The stone of the first throw."""
        return self.throws[0].stone if self.table is None else self.table.stone

    @property
    def varies(self) -> bool:
        """Whether what the throws determine varies about its mean."""
        return self.means is not None

    def derive(self, expression: str) -> Derived:
        """A quantity derived from what the throws share; see `FitResult.derive`.

        Raises
        ------
        InputError : it is not arithmetic of such names, or has no finite value.

        Examples
        --------
        >>> joint.derive("mu2_xi - mu1_xi").verdict
        'determined'
        """
        if not self.throws:
            raise InputError(
                "a fit of a table has no derived quantities; give them to the batch"
            )
        of_throw = self.throws[0].first_order
        shared = {
            name: estimate
            for name, estimate in of_throw.parameters.items()
            if name in self.coefficients
        }
        names = tuple(name for name in of_throw.names if name in shared)
        of_shared = of_throw._replace(
            parameters=shared,
            covariance=NamedMatrix(names, of_throw.covariance.among(names)),
            combinations=self.combinations,
            ridge=(),
            products=(),
        )
        return derive(of_shared, expression)

    def with_derived(self, expressions: Iterable[str]) -> JointResult:
        """The result with derived quantities."""
        return replace(self, derived=tuple(map(self.derive, expressions)))

    def to_json(self) -> dict[str, Any]:
        """The record as written to `joint.json`, with the single throws in brief."""
        in_brief = [ThrowInBrief.of(throw) for throw in self.throws]
        return super().to_json() | {"throws": plain(in_brief)}

    def summary(self) -> dict[str, Any]:
        """The record as it is written, since it has no series."""
        return self.to_json()

    @classmethod
    def _from_file(cls, entries: dict[str, Any], folder: Path) -> JointResult:
        if "variation" not in entries and "differences" in entries:
            # version 0.2 called the variation so, and knew no groups
            entries = entries | {"variation": entries["differences"]}
            del entries["differences"]
        joint = super()._from_file(entries, folder)
        files = [throw.file for throw in structured(entries, _FilesOfThrows).throws]
        throws = tuple(load_fit(folder / name) for name in folder_names(files))
        counts = {len(variation.each) for variation in joint.variation}
        if throws and counts - {len(throws)}:
            fault = "variation: expected an entry of each throw"
            raise DataError(fault, file=folder / "joint.json")
        file = folder / "chain.h5"
        chain = None
        if joint.r_hat is not None and file.is_file():
            chain = load_chain(file)
            if chain.subject != joint.subject:  # of an earlier fit
                chain = None
        return replace(joint, throws=throws, chain=chain)

    def save(self, file: str | PathLike[str]) -> None:
        """Write the record as JSON, and the draws beside it, each whole
        or not at all."""
        super().save(file)
        if self.chain is not None:
            self.chain.save(Path(file).with_name("chain.h5"))

    @property
    def subject(self) -> dict[str, str]:
        """What identifies its draws."""
        means = self.means
        return (
            {} if means is None else {"means": digest(means.estimate, means.covariance)}
        )

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        require(
            "share",
            set(self.share) <= self.coefficients.keys(),
            "names of coefficients",
        )
        if self.table and self.table.starts:
            require(
                "table",
                self.table.speeds.size * self.table.spins.size > 0,
                "speeds and spins",
            )
        throws_of_variations = {len(variation.each) for variation in self.variation}
        require("variation", len(throws_of_variations) <= 1, "equal lengths")

    def with_law(self, law: str | type[Law] | None) -> JointResult:
        """The result, whose law is that of a user's file; see `FitResult.with_law`."""
        if law is not None and self.table is not None:
            find_law(law)  # known from now on
        throws = tuple(throw.with_law(law) for throw in self.throws)
        return replace(self, throws=throws)


@dataclass(frozen=True)
class _FileOfThrow:
    file: str


@dataclass(frozen=True)
class _FilesOfThrows:
    """What of the throws in `joint.json` is read: the rest is in their own folders."""

    throws: tuple[_FileOfThrow, ...]


def folder_names(throws: Sequence[str]) -> list[str]:
    """The folders of throws beside `joint.json`: `evening-3` for row 3 of
    `evening.csv`; before names that are alike stands the folder of the file."""
    alike = Counter(map(folder_name, set(throws)))
    return [
        safe_name(f"{Path(throw).parent.name}-{name}") if alike[name] > 1 else name
        for throw, name in ((throw, folder_name(throw)) for throw in throws)
    ]


def folder_name(throw: str) -> str:
    """The folder of a throw beside `joint.json`: `evening-3` for row 3
    of `evening.csv`."""
    file, number = file_and_number(throw)
    return safe_name("-".join(filter(None, [Path(file).stem, number])))


def warnings_of(throws: Sequence[FitResult]) -> list[Finding]:
    """Warnings of single throws, each about those that have it; about all, if all
    have it."""
    files_by_warning: dict[Finding, list[str]] = {}
    for throw in throws:
        for warning in throw.warnings:
            files_by_warning.setdefault(warning, []).append(throw.data.file)
    return [
        warning if len(files) == len(throws) else warning.of(*files)
        for warning, files in files_by_warning.items()
    ]


def load_joint(file: str | PathLike[str]) -> JointResult:
    """Read a saved joint fit from its folder or `joint.json`, with the single
    throws beside it.

    Raises
    ------
    DataError : a file is missing, or is not a record that this version can read.

    Examples
    --------
    >>> curlfit.load_joint("joint").share == joint.share
    True
    """

    return JointResult.read(file)
