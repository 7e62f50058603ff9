"""The record of a design."""

from __future__ import annotations

import math
from dataclasses import dataclass
from os import PathLike
from typing import Any, ClassVar

from curlfit.findings import Finding
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.verdict import Verdict
from curlfit.loads import Load
from curlfit.optimal_design.throw_columns import (
    DISTANCE,
    LAST,
    OMEGA0,
    RATE,
    REST,
    ROWS,
    V0,
    stderr_column,
)
from curlfit.output.frames import frame_of
from curlfit.output.table import Table
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
    stderr : standard error by coefficient (None where it is not determined),
        combination, and difference of two coefficients.
    verdicts : by coefficient and difference, as in `FitResult`; "fixed" for one that
        is not free.
    combinations : determined combinations of coefficients that are not
        determined individually.
    rank, singular_values, null_directions : see `curlfit.inference.information`.
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
        condition (see `curlfit.inference.model.conditions`).
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
    quantities : coefficients and combinations determined by all candidates, as weights;
        the difference of two coefficients among them.
    rank, free : numbers of directions determined by all candidates, and of
        free coefficients.
    best : the optimal selection of `throws` candidates by criterion "D" and "A", and
        "C", least standard error of a difference, where the candidates determine it.
    curves : standard errors of the D-optimal throws, for figures: against "place",
        "angle" (factor on that noise alone), "rate" (Hz) and "throws" (number, the
        optimal ones for each); each has the abscissa, "at", and the errors by quantity.
    separation : the best throws for the difference of two coefficients under each load,
        if requested or if under uniform load only their sum is determined.
    notes : what the errors assume, and the load under which throws would separate two
        coefficients.
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
    load: Load
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
    notes: tuple[Finding, ...]
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
        errors = map(stderr_column, self.quantities)
        columns = (V0, OMEGA0, RATE, ROWS, LAST, REST, DISTANCE, *errors)
        return frame_of(Table(self.candidates, columns))

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        require("sigma", all(size > 0 for size in self.sigma.values()), "noise above 0")
        names = self.quantities.keys()
        for key, expected in (
            ("candidates", self.candidates),
            ("scenarios", self.scenarios),
            ("best", self.best.values()),
        ):
            complete = all(names <= errors.stderr.keys() for errors in expected)
            require(key, complete, f"the standard errors of {', '.join(names)}")
        count = len(self.candidates)
        chosen = [index for best in self.best.values() for index in best.throws]
        exist = all(0 <= index < count for index in chosen)
        require("best", exist, "indices of candidates")
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
class LoadScenario:
    """The throws with the least standard error of a difference under one load.

    Attributes
    ----------
    load : "uniform" or "consistent".
    throws : indices of these candidates, as many as planned; None where no throws
        determine the difference.
    stderr : standard error of the difference from these.
    """

    load: str
    throws: tuple[int, ...] | None
    stderr: float | None


@dataclass(frozen=True)
class Separation:
    """The throws that separate two coefficients best, under each load.

    Attributes
    ----------
    pair : the coefficients.
    ways : scenarios by load.
    """

    pair: tuple[str, str]
    ways: tuple[LoadScenario, ...]

    @property
    def difference(self) -> str:
        """Name of the difference of the coefficients."""
        return difference_of(self.pair)

    def scenario(self, load: str) -> LoadScenario:
        """The scenario of one load."""
        return next(scenario for scenario in self.ways if scenario.load == load)


def difference_of(pair: tuple[str, str]) -> str:
    """Name of the difference of two coefficients, such as "mu1_eta - mu2_eta"."""
    return " - ".join(pair)
