"""The record of a design."""

from __future__ import annotations

import math
from dataclasses import dataclass
from os import PathLike
from typing import Any, ClassVar

from curlfit.inference.fit.result import LoadName
from curlfit.inference.identifiability import Combination
from curlfit.inference.verdict import Verdict
from curlfit.output.frames import frame
from curlfit.records import Record, require, require_rows
from curlfit.stone import Stone


@dataclass(frozen=True)
class Candidate:
    """A planned throw and the errors expected from it alone.

    Attributes
    ----------
    v0, omega0 : initial speed (m/s) and spin (rad/s).
    rate : rows per second, Hz.
    rows, last, rest : number of rows, time of the last row and of rest (s).
    distance : from the start to rest (m).
    stderr : standard error by quantity, None where this throw alone does not
        determine it.
    """

    v0: float
    omega0: float
    rate: float
    rows: int
    last: float
    rest: float
    distance: float
    stderr: dict[str, float | None]


@dataclass(frozen=True)
class ExpectedErrors:
    """Errors expected from several throws together.

    Attributes
    ----------
    throws : indices of the candidates, repeated for repeated throws.
    stderr : standard error by coefficient (None where it is not determined)
        and combination.
    verdicts : by coefficient, as in `FitResult`; "fixed" for one that is not free.
    combinations : determined combinations of coefficients that are not
        determined individually.
    rank, singular_values, null_directions : see `curlfit.inference.identifiability`.
    """

    throws: tuple[int, ...]
    stderr: dict[str, float | None]
    verdicts: dict[str, Verdict]
    combinations: tuple[Combination, ...]
    rank: int
    singular_values: tuple[float, ...]
    null_directions: tuple[dict[str, float], ...]


@dataclass(frozen=True)
class Scenario:
    """Errors of the best throws, thrown in equal shares with one or both senses of
    spin, and in one or both directions of the sheet.

    Attributes
    ----------
    name : such as "both spins".
    stderr : standard error by quantity.
    shifts : by quantity and by condition that a fit holds fixed, for one width of the
        condition (see `curlfit.inference.conditions`).
    """

    name: str
    stderr: dict[str, float | None]
    shifts: dict[str, dict[str, float]]

    @property
    def systematic(self) -> dict[str, float]:
        """Systematic error by quantity: the shifts in quadrature."""
        return {
            name: math.hypot(*shifts.values()) for name, shifts in self.shifts.items()
        }


@dataclass(frozen=True, eq=False, repr=False)
class Design(Record):
    """The expected errors of planned throws.

    Attributes
    ----------
    law, load, stone, coefficients : assumed values; coefficients by name.
    symbols, units, typical : of the coefficients, by name.
    sigma : noise by measured channel (SI).
    until : end of the records in s; the time of rest if None.
    throws : number of throws.
    candidates : the throws from which these are selected.
    quantities : coefficients and combinations determined by all candidates, as weights.
    rank, free : numbers of directions determined by all candidates, and of
        free coefficients.
    best : the optimal selection of `throws` candidates by criterion "D" and "A".
    curves : standard errors of the D-optimal throws, for figures: against "place",
        "angle" (factor on that noise alone), "rate" (Hz) and "throws" (number, the
        optimal ones for each); each has the abscissa, "at", and the errors by quantity.
    separation : separability of two coefficients, if requested or if only their sum is
        determined.
    notes : caveats, as sentences.
    command : that made it; empty if it was made in Python.
    discrepancy : size of the accelerations that the law may lack, relative to
        the friction.
    scenarios : systematic errors of the D-optimal throws, as planned and in
        other scenarios.

    Examples
    --------
    >>> plan.best["D"].verdicts["mu1_eta"]
    'not identifiable'
    >>> plan.to_frame()[["v0", "omega0"]].shape
    (4, 2)
    """

    kind: ClassVar[str] = "design"

    law: str
    load: LoadName
    stone: Stone
    coefficients: dict[str, float]
    symbols: dict[str, str]
    units: dict[str, str]
    typical: dict[str, float]
    sigma: dict[str, float]
    until: float | None
    throws: int
    candidates: tuple[Candidate, ...]
    quantities: dict[str, dict[str, float]]
    rank: int
    free: int
    best: dict[str, ExpectedErrors]
    curves: dict[str, dict[str, list[float | None]]]
    separation: Separation | None
    notes: tuple[str, ...]
    scenarios: tuple[Scenario, ...] = ()
    discrepancy: float = 0.0
    command: str = ""

    @property
    def rate(self) -> float:
        """Rows per second of every throw, Hz."""
        return self.candidates[0].rate

    def to_frame(self) -> Any:
        """The candidates as a pandas DataFrame, one per row: the throw, and the
        standard error of each quantity from it alone, NaN where it does not determine
        the quantity.

        Raises
        ------
        InputError : pandas is not installed.
        """
        names = ("v0", "omega0", "rate", "rows", "last", "rest", "distance")
        columns = {
            name: [getattr(one, name) for one in self.candidates] for name in names
        }
        for name in self.quantities:
            errors = [one.stderr[name] for one in self.candidates]
            columns[f"{name} stderr"] = [math.nan if e is None else e for e in errors]
        return frame(columns)

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        names = self.quantities.keys()
        for place, all_ in (
            ("candidates", self.candidates),
            ("scenarios", self.scenarios),
            ("best", self.best.values()),
        ):
            known = all(names <= one.stderr.keys() for one in all_)
            require(place, known, f"the standard errors of {', '.join(names)}")
        count = len(self.candidates)
        known = all(0 <= i < count for one in self.best.values() for i in one.throws)
        require("best", known, "indices of candidates")
        for curve in self.curves.values():
            require("curves", {"at", *names} <= curve.keys(), "all standard errors")
            require_rows("curves", curve, len(curve["at"]))


def load_design(file: str | PathLike[str]) -> Design:
    """Read a saved `design.json`, or the one in a folder.

    Raises
    ------
    DataError : missing, not a file of curlfit, or of a schema that this version
        cannot read.

    Examples
    --------
    >>> plan.save("design.json")
    >>> curlfit.load_design("design.json").rank
    3
    """
    return Design.read(file)


@dataclass(frozen=True)
class Proof:
    """Effect of the difference of two coefficients on force and moment under
    uniform load.

    Attributes
    ----------
    states : number of random speeds and spins.
    by_difference, by_sum : largest derivative, over these, of T_xi/(m g),
        T_eta/(m g) and M/(m g R) when one coefficient grows and the other falls,
        and when both grow.
    throws : number of throws, of various speeds and spins, taken together.
    singular_values : of the R factor of their information on the coefficients, largest
        first, scaled by typical sizes, noise as planned.
    hidden : whether the effect of the difference is zero to rounding error in both.
    because : explanation, where known.
    """

    states: int
    by_difference: tuple[float, ...]
    by_sum: tuple[float, ...]
    throws: int
    singular_values: tuple[float, ...]
    hidden: bool
    because: str


@dataclass(frozen=True)
class LoadScenario:
    """Expected errors of the difference of two coefficients under one load.

    Attributes
    ----------
    load : "uniform" or "consistent".
    each : standard error of the difference from each candidate alone, None
        if undetermined.
    throws : indices of the optimal candidates, as many as planned; None
        if undetermined.
    stderr : standard error of the difference from these.
    steady : relative change of the sum of both coefficients between these throws that
        has the same effect as the required error; None if no change does.
    """

    load: str
    each: tuple[float | None, ...]
    throws: tuple[int, ...] | None
    stderr: float | None
    steady: float | None


@dataclass(frozen=True)
class StoneChange:
    """A change of the stone, and the standard error of the difference with it.

    Attributes
    ----------
    name, value : the changed property and its value (m).
    all : from the optimal throws, all with the changed stone; None if undetermined.
    half : from the same number of ordinary throws, half with the original stone and
        half with the changed one.
    steady : relative change of the sum of both coefficients between the halves that has
        the same effect as the required error of the difference.
    """

    name: str
    value: float
    all: float | None
    half: float | None
    steady: float | None


@dataclass(frozen=True)
class Separation:
    """What it takes to separate two coefficients.

    Attributes
    ----------
    pair : the coefficients.
    size, of : the reference of relative errors: the assumed "difference", or the "mean"
        of both where they are equal.
    wanted : required relative error.
    proof : for the uniform load.
    ways : scenarios by load.
    ordinary : index of the candidate closest to an ordinary throw.
    changes : of the stone, under the consistent load.
    """

    pair: tuple[str, str]
    size: float
    of: str
    wanted: float
    proof: Proof
    ways: tuple[LoadScenario, ...]
    ordinary: int
    changes: tuple[StoneChange, ...]

    def scenario(self, load: str) -> LoadScenario:
        """The scenario of one load."""
        return next(scenario for scenario in self.ways if scenario.load == load)

    def noise_factor(self, stderr: float) -> float:
        """Factor on all noise that gives the required error; errors are
        proportional to noise."""
        return self.wanted * self.size / stderr

    def throws_needed(self, stderr: float, throws: int) -> float:
        """Number of throws that gives the required error, if `throws` of them
        give `stderr`."""
        return throws / self.noise_factor(stderr) ** 2
