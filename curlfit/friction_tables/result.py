"""Laws fitted to a table of friction, as a record."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

from curlfit.findings import Finding
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.information.combinations import Combination
from curlfit.numerics.arrays import Floats
from curlfit.records import Arrays, Entry, Record, require_rows


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """One law.

    Attributes
    ----------
    sigma : standard error of mu that is estimated, from the residuals; of given
        ones their rms.
    rms : of the residuals.
    rank : number of coefficients, or combinations of them, that the table determines.
    bic : Schwarz's criterion, up to a constant that all laws have in common.
    fitted : friction at the speeds of the table.
    curve : speeds and friction between these, at the median spin.
    """

    law: str
    load: str
    converged: bool
    coefficients: dict[str, Estimate]
    combinations: tuple[Combination, ...]
    rank: int
    chi_squared: float
    sigma: float
    rms: float
    bic: float
    warnings: tuple[Finding, ...]
    fitted: Floats
    curve: Arrays


@dataclass(frozen=True)
class DataOfTable(Entry):
    """The table that was fitted.

    Attributes
    ----------
    file : its name.
    sigma : "given" or "estimated".
    """

    file: str
    sigma: str


@dataclass(frozen=True, eq=False, repr=False)
class FrictionFits(Record):
    """Laws fitted to a table of friction, the one with the least BIC first.

    Attributes
    ----------
    data : the table.
    observed : speed (m/s), omega (rad/s), mu and, where given, sigma.

    Examples
    --------
    >>> friction.fits[1].coefficients["c"].verdict
    'determined'
    """

    data: DataOfTable
    observed: Arrays
    fits: tuple[FrictionFit, ...]

    kind = "friction"

    def require_consistent(self) -> None:
        """Raise `ValueError` where the rows of the record differ in number."""
        rows = len(self.observed["mu"])
        require_rows("observed", self.observed, rows)
        for fit in self.fits:
            require_rows(fit.law, {"fitted": fit.fitted}, rows)


def load_friction(file: str | PathLike[str]) -> FrictionFits:
    """Read `friction.json`, or the one in a folder.

    Raises
    ------
    DataError : missing, or not such a record.

    Examples
    --------
    >>> friction.save("friction.json")
    >>> curlfit.load_friction("friction.json").fits[0].law
    'sutor'
    """
    return FrictionFits.read(file)
