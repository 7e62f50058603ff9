"""The record of a comparison."""

from __future__ import annotations

from dataclasses import dataclass, field
from os import PathLike
from typing import Any, ClassVar

import numpy as np

from curlfit.comparison.candidate_columns import IN_FRAME
from curlfit.findings import Finding
from curlfit.inference.fit.entries import AnyNoise, DataOfFit, LossName, NoiseName
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.verdict import Verdict
from curlfit.noises import NOISES, WHITE
from curlfit.numerics.arrays import Floats
from curlfit.output.frames import frame_of
from curlfit.output.table import Table
from curlfit.records import (
    ADDED,
    SERIES,
    UNSAVED,
    Entry,
    Matrix,
    Record,
    require,
    require_rows,
)
from curlfit.stone import Stone
from curlfit.throws.odd_row import OddRow

PLACE = ("x", "y", "phi")
FOLLOWS = 1.5**2
"""Chi squared per degree of freedom of a law that follows a data set: 1.5
times the noise."""


@dataclass(frozen=True)
class Coefficient(Entry):
    """A coefficient of a candidate; see `FitResult.parameters`."""

    value: float
    stderr: float | None
    verdict: Verdict
    unit: str


@dataclass(frozen=True)
class Sum(Entry):
    """What is determined where single coefficients are not."""

    expression: str
    value: float
    stderr: float | None


@dataclass(frozen=True)
class OnSet:
    """A law on one of several data sets.

    Attributes
    ----------
    chi_squared, dof : with the coefficients that all data sets have in common, and
        degrees of freedom: values less the parameters spent on
        them. own_chi_squared, own_dof : with the coefficients that are best for
        this set alone.
    follows, own_follows : whether chi squared is no more than expected, or than 1.5
        times the noise makes it.
    rank, determined : number of coefficients, or sums of them, that this set determines
        beside the others, and their names.
    largest : the largest residuals by name, (model - data)/sigma.
    own_delta_bic : BIC for this set alone, minus the smallest of all laws.
    """

    chi_squared: float
    dof: float
    own_chi_squared: float
    own_dof: float
    follows: bool
    own_follows: bool
    rank: int
    determined: tuple[str, ...]
    largest: tuple[tuple[str, float], ...]
    own_delta_bic: float = 0.0


@dataclass(frozen=True)
class SetOfData:
    """One of several data sets.

    Attributes
    ----------
    name, kind : of its file; "track", "throws" or "friction".
    throws, values : number of throws, and of measured values.
    effective : effective number of values, where residuals are correlated
        from row to row.
    sigma : estimated standard deviations by channel, SI; noise_of : the laws
        that leave them.
    """

    name: str
    kind: str
    throws: int
    values: int
    effective: float
    sigma: dict[str, float]
    noise_of: str


@dataclass(frozen=True)
class Candidate:
    """One law under one load and one noise model, as fitted.

    Attributes
    ----------
    law, load : the law's name, and the load on the contact ring ("-" for a law
        without a ring).
    isotropic : whether friction opposes sliding at every point of the ring (eq. 3-4).
    signs_free : whether coefficients may have either sign, contrary to the
        law's own bounds.
    status, converged : of the fit; without a fit, all that follows is None or empty.
    coefficients : by name.
    combinations : what is determined where single coefficients are not.
    noise, noise_model : the noise model's name, and its estimates.
    n_parameters : effective number (see `curlfit.comparison.criteria`), including the
        estimated ones of the noise.
    rms : by channel, m, m, rad. bulk : the scale of the bulk of the residuals (1.4826
        times their median size), under a robust loss.
    curl_explained : fraction of the path's curl that the law explains, at most 1; None
        where the path has no curl beyond its scatter.
    follows : whether each channel's residual is within a tenth of its departure from
        uniform straight motion, or within its noise, and not five times that of another
        law; None where correlated noise may explain the residual.
    log_likelihood : under the noise model and the loss.
    aicc, bic : information criteria, from likelihoods weighted by effective sample
        sizes (see `Comparison.effective`); the penalty of BIC is that of the effective
        sample size, the small-sample correction of AICc that of the number of values.
    log_evidence : of the likelihood averaged over the prior, up to a constant common
        to all; None where residuals are correlated from row to row, or if noise models
        are compared.
    elpd_loo, elpd_loo_se, p_loo : expected log predictive density of leave-one-out, its
        standard error, and its effective number of parameters (see
        `curlfit.comparison.criteria`); None where residuals are correlated from row to
        row, under a robust loss and for noise other than white.
    delta_aicc, delta_bic : aicc and bic minus the smallest of the ranked candidates.
        delta_evidence : log evidence minus the largest of these. delta_elpd,
            delta_elpd_se :
        elpd_loo minus the largest of these, and the standard error of that difference,
        from the differences by row.
    weight : posterior probability of the law from its evidence, with equal prior
        probabilities of the ranked candidates; None if not ranked.
    rank : by BIC among the candidates within their laws' bounds, from 1; None
        if not ranked.
    sides : to which sides the law can curl a slowing counter-clockwise stone on this
        path, within its bounds: a subset of ("left", "right").
    negative : coefficients fitted below zero, except those for which either sign is
        natural, such as exponents.
    at_bound, not_identifiable : names.
    warnings : of the fit.
    sets, p_together : on each of several data sets, and the probability of a larger
        rise of chi squared by common coefficients if the law is right; `follows` then
        says whether it follows all sets with these.
    """

    law: str
    load: str
    isotropic: bool
    signs_free: bool
    status: str
    converged: bool = False
    coefficients: dict[str, Coefficient] | None = None
    combinations: tuple[Sum, ...] = ()
    n_parameters: float | None = None
    rms: dict[str, float] | None = None
    bulk: dict[str, float] | None = None
    curl_explained: float | None = None
    follows: bool | None = False
    log_likelihood: float | None = None
    aicc: float | None = None
    bic: float | None = None
    delta_aicc: float | None = None
    delta_bic: float | None = None
    log_evidence: float | None = None
    delta_evidence: float | None = None
    elpd_loo: float | None = None
    elpd_loo_se: float | None = None
    p_loo: float | None = None
    delta_elpd: float | None = None
    delta_elpd_se: float | None = None
    weight: float | None = None
    rank: int | None = None
    sides: tuple[str, ...] = ()
    negative: tuple[str, ...] = ()
    at_bound: tuple[str, ...] = ()
    not_identifiable: tuple[str, ...] = ()
    warnings: tuple[Finding, ...] = ()
    fitted: dict[str, list[float]] | None = None
    noise: NoiseName = WHITE.kind
    noise_model: AnyNoise | None = None
    sets: tuple[OnSet, ...] = field(default=(), metadata=ADDED)
    p_together: float | None = field(default=None, metadata=ADDED)

    @property
    def label(self) -> str:
        """Law, load and noise in a few words."""
        load = "" if self.load == "-" else f", {self.load} load"
        sign = ", any sign" if self.signs_free else ""
        return f"{self.law}{load}{sign}{NOISES[self.noise].suffix}"

    @property
    def residual_size(self) -> dict[str, float]:
        """Size of the residuals by channel: of their bulk under a robust loss."""
        return self.bulk or self.rms or {}


COMPONENTS = {
    "across the path": "m/s\N{SUPERSCRIPT TWO}",
    "along the path": "m/s\N{SUPERSCRIPT TWO}",
    "in the spin": "rad/s\N{SUPERSCRIPT TWO}",
}
"""Of accelerations, to the right of the motion, along it, and angular."""


@dataclass(frozen=True, eq=False)
class Lacking:
    """Accelerations that a path has beyond a law, in the order of time.

    Attributes
    ----------
    law : label of the candidate.
    speed, omega : of the stone, m/s and rad/s, shape (n,).
    of_law : accelerations by the law there, to the right of the motion, along it, and
        angular, shape (3, n). lacks, stderr : what the path has beyond them, and its
        standard error.
    others : what other laws add to them, by label.
    """

    law: str
    speed: Floats = field(metadata=SERIES)
    omega: Floats = field(metadata=SERIES)
    of_law: Matrix = field(metadata=SERIES)
    lacks: Matrix = field(metadata=SERIES)
    stderr: Matrix = field(metadata=SERIES)
    others: dict[str, Matrix] = field(default_factory=dict, metadata=SERIES)

    def is_complete(self) -> bool:
        """Whether all series have the same length."""
        n = len(self.speed)
        accelerations = (self.of_law, self.lacks, self.stderr, *self.others.values())
        return len(self.omega) == n and all(
            series.shape == (3, n) for series in accelerations
        )

    def significance(self, other: str = "") -> Floats:
        """What is lacking over its standard error, or what another law would
        leave of it."""
        left = self.lacks - self.others[other] if other else self.lacks
        return left / np.maximum(self.stderr, np.finfo(float).tiny)

    def size(self, other: str = "") -> float:
        """Mean square of `significance`."""
        return float((self.significance(other) ** 2).mean())

    @property
    def nearest(self) -> str:
        """The other law that would leave the least; empty if none leaves
        less than half."""
        least = min(self.others, key=self.size, default="")
        return least if least and self.size(least) < self.size() / 2 else ""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Comparison(Record):
    """Candidates, best first: those ranked, then those fitted beyond their bounds,
    then failures.

    `data` describes what was fitted; `curl` is the path's lateral departure from a
    straight line in m (rms), and `side` the side to which it bends, seen along the
    motion. `observed` has t, x, y, phi. `loss` is how much large residuals counted,
    `noise` the noise models, separated by commas. `effective` is the effective sample
    size by channel where the residuals of the fit of greatest likelihood are correlated
    from row to row; otherwise empty.
    `lacking` is what the first law lacks, if the path shows it.
    `fits` are the full results in the order of the candidates, and empty when read from
    a file. Of several data sets, `sets` describes these, and there is no path;
    `odd_rows` are those of stopwatch tables that contradict the others, which were left
    out unless they are many.

    Examples
    --------
    >>> comparison.of("coulomb").follows
    False
    >>> comparison.to_frame()["law"].tolist()
    ['front-back', 'coulomb']
    """

    kind: ClassVar[str] = "compare"

    data: DataOfFit
    stone: Stone
    curl: float
    side: str | None
    loss: LossName = "linear"
    noise: str = "white"
    effective: dict[str, float] = field(default_factory=dict)
    candidates: tuple[Candidate, ...]
    observed: dict[str, list[float]]
    lacking: Lacking | None = field(default=None, metadata=ADDED)
    sets: tuple[SetOfData, ...] = field(default=(), metadata=ADDED)
    odd_rows: tuple[OddRow, ...] = field(default=(), metadata=ADDED)
    fits: tuple[FitResult | None, ...] = field(default=(), metadata=UNSAVED)

    @property
    def best(self) -> Candidate:
        """The first in rank."""
        return self.candidates[0]

    @property
    def noises(self) -> tuple[str, ...]:
        """Names of the noise models."""
        return tuple(self.noise.split(","))

    def of(
        self,
        law: str,
        load: str = "uniform",
        *,
        signs_free: bool = False,
        noise: str | None = None,
    ) -> Candidate:
        """The candidate of a law; with several noise models the best, unless one is
        named. Raises KeyError if there is none."""
        for candidate in self.candidates:
            if (
                candidate.law == law
                and candidate.load in (load, "-")
                and candidate.signs_free == signs_free
                and noise in (None, candidate.noise)
            ):
                return candidate
        raise KeyError(f"{law}, {load}" + (f", {noise}" if noise else ""))

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        require("candidates", bool(self.candidates), "one or more")
        require("observed", {"t", *PLACE} <= self.observed.keys(), "t, x, y and phi")
        require_rows("observed", self.observed, len(self.observed["t"]))
        if self.lacking is not None:
            require("lacking", self.lacking.is_complete(), "series of one length")
        for candidate in self.candidates:
            if candidate.sets:
                is_complete = len(candidate.sets) == len(self.sets)
                require("candidates", is_complete, "all data sets")
            if candidate.fitted is not None:
                is_complete = candidate.fitted.keys() == set(PLACE)
                require("candidates", is_complete, "fitted x, y and phi")
                require_rows("candidates", candidate.fitted, len(self.observed["t"]))

    def to_frame(self) -> Any:
        """The candidates as a pandas DataFrame, one row each, best first; sizes
        in m and rad.

        Raises
        ------
        InputError : pandas is not installed.
        """
        return frame_of(Table(self.candidates, IN_FRAME))


def load_comparison(file: str | PathLike[str]) -> Comparison:
    """Read a saved `compare.json`, or the one in a folder.

    Raises
    ------
    DataError : it is missing, or is not a record that this version can read.

    Examples
    --------
    >>> comparison.save("compare.json")
    >>> curlfit.load_comparison("compare.json").best.law
    'front-back'
    """
    return Comparison.read(file)
