"""Estimates of a result: of a parameter, of systematic errors, of a posterior;
items by name."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

import numpy as np

from curlfit.friction import Parameter
from curlfit.inference.derived.quantiles import Quantiles
from curlfit.inference.derived.quantity import Derived
from curlfit.inference.fit.estimate_columns import (
    HIGH,
    LOW,
    STDERR,
    SYSTEMATIC,
    UNIT,
    VALUE,
    VERDICT,
    EstimateRow,
)
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.intervals import WithInterval
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.conditions import CALIBRATION, is_calibration
from curlfit.output.display import Displayed
from curlfit.output.frames import frame
from curlfit.records import ADDED, Record

_OF_PARAMETER = [attribute.name for attribute in fields(Parameter)][1:]
"""Attributes of a parameter, besides its name, that its estimate has too."""


@dataclass(frozen=True)
class Estimate(WithInterval):
    """The estimate of one parameter.

    Attributes
    ----------
    stderr : standard error; None where the data do not determine the parameter, where
        it is at a bound, or where it was fixed.
    verdict : what the data say of it, one of `Verdict`.
    reason : of a weak parameter: its standard error is more than half its typical size,
        or values that fit nearly as well; of one that is not identifiable these values,
        where they lie on a curve; of a parameter that rests on priors: that the data
        alone do not determine it. Otherwise empty.
    dof : degrees of freedom of the standard error; None without one, or where
        sigma was given.
    prior : its prior, in the notation of `curlfit.inference.model.priors`; empty
        without one.
    """

    value: float
    stderr: float | None
    verdict: Verdict
    unit: str
    symbol: str = field(repr=False)
    meaning: str = field(repr=False)
    lower: float = field(repr=False)
    upper: float = field(repr=False)
    typical: float = field(repr=False)
    reason: str = ""
    dof: float | None = None
    prior: str = ""

    @classmethod
    def of(
        cls,
        parameter: Parameter,
        value: float,
        verdict: Verdict,
        *,
        stderr: float | None = None,
        **attributes: Any,
    ) -> Self:
        """The estimate of a parameter, with further attributes of its own."""
        of_parameter = {name: getattr(parameter, name) for name in _OF_PARAMETER}
        return cls(
            value=value, verdict=verdict, stderr=stderr, **of_parameter, **attributes
        )

    def interval(self, level: float = 0.95) -> tuple[float, float] | None:
        """Confidence interval by Student's t, within the bounds; None where there is no
        standard error."""
        interval = super().interval(level)
        if interval is None:
            return None
        low, high = interval
        return max(low, self.lower), min(high, self.upper)


@dataclass(frozen=True)
class RidgePoint:
    """Values of the parameters that fit about as well as the estimates, where chi
    squared is no quadratic (`curlfit.inference.fit.ridge`).

    Attributes
    ----------
    held : the parameter that was held while the others were refitted; None of another
        solution.
    rise : of chi squared, with what the priors add to it, from that of the estimates.
    values : of all parameters, in their order.
    slopes : R factor of the derivatives of the residuals over their sigma by the
        parameters there: what is known at this point.
    """

    held: str | None
    rise: float
    values: tuple[float, ...]
    slopes: tuple[tuple[float, ...], ...] = field(default=(), metadata=ADDED)


@dataclass(frozen=True, repr=False)
class Posterior(Displayed):
    """Summary of a posterior sample; the sample itself is in `chain.h5`.

    Attributes
    ----------
    samples : number kept, over all walkers, after the first `discarded` steps.
    steps, walkers, ensembles : of the run; the walkers are divided among the ensembles.
    ess, ess_tail : bulk and tail effective sample sizes by parameter; the latter is the
        smaller of those of the quantiles 5 % and 95 %.
    r_hat : rank-normalised, by parameter: the larger of that of the halves of the
        ensembles and that of their distances from the median (Vehtari et al. 2021).
    acceptance : fraction of proposals accepted.
    quantiles : by parameter and by determined combination, keys "2.5", "16", "50",
        "84", "97.5".
    mean, sd : the same.
    correlation : between parameters.
    converged, status : whether the targets were met, and the same in words.

    Examples
    --------
    >>> sampled.posterior.converged
    True
    >>> sorted(sampled.posterior.quantiles["mu2_xi"], key=float)
    ['2.5', '16', '50', '84', '97.5']
    """

    kind: ClassVar[str] = "posterior"

    samples: int
    steps: int
    discarded: int
    walkers: int
    ensembles: int
    seed: int
    acceptance: float
    ess: dict[str, float]
    ess_tail: dict[str, float] = field(
        default_factory=dict, kw_only=True, metadata=ADDED
    )
    r_hat: dict[str, float]
    quantiles: dict[str, Quantiles]
    mean: dict[str, float]
    sd: dict[str, float]
    correlation: dict[str, dict[str, float]]
    converged: bool
    status: str


@dataclass(frozen=True)
class Systematics:
    """Effects of the conditions that a fit holds fixed
    (`curlfit.inference.fit.systematics`).

    Attributes
    ----------
    widths : standard uncertainty of each of these conditions, SI.
    shifts : by determined parameter or combination and by condition: true value minus
        estimate where the condition is one width above its assumed value.
    """

    widths: dict[str, float] = field(default_factory=dict)
    shifts: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def errors(self) -> dict[str, float]:
        """Systematic error of each parameter or combination: the shifts added
        in quadrature."""
        return {
            name: math.hypot(*shifts.values())
            for name, shifts in self.shifts.items()
            if shifts
        }

    @property
    def of_calibration(self) -> dict[str, float]:
        """The part of each error that the map from pixels to metres contributes."""
        return {
            name: math.hypot(
                *(shift for name, shift in shifts.items() if is_calibration(name))
            )
            for name, shifts in self.shifts.items()
        }

    @property
    def settings(self) -> dict[str, float]:
        """The widths as `fit` takes them, with one for the calibration."""
        return {
            CALIBRATION if is_calibration(name) else name: width
            for name, width in self.widths.items()
        }


class NamedEstimates(Record):
    """A result whose estimates are items by name, and rows of a table."""

    combinations: tuple[Combination, ...]
    systematics: Systematics
    derived: tuple[Derived, ...]

    @property
    def all_derived(self) -> tuple[Derived, ...]:
        """Derived quantities, with those that the fit derives of itself first."""
        return self.derived

    @property
    def _estimates(self) -> dict[str, Estimate]:
        """The parameters by name."""
        raise NotImplementedError

    def _items(self) -> dict[str, Estimate | Combination | Derived]:
        combinations = {
            combination.expression: combination for combination in self.combinations
        }
        items: dict[str, Estimate | Combination | Derived] = {
            **self._estimates,
            **combinations,
        }
        named = set(items)
        for derived in self.all_derived:
            # A combination that was requested as a derived quantity is not repeated.
            if derived.expression not in named:
                items[derived.expression] = derived
        return items

    def __getitem__(self, name: str) -> Estimate | Combination | Derived:
        """A parameter, a determined combination or a derived quantity. Raises KeyError
        for any other name."""
        items = self._items()
        if name not in items:
            raise KeyError(f"no {name!r}; the names are {', '.join(items)}")
        return items[name]

    def __contains__(self, name: object) -> bool:
        return name in self._items()

    __iter__ = None
    """not a sequence, though it has items"""

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._items())

    def to_frame(self) -> Any:
        """Parameters and determined combinations as a pandas DataFrame, one row each.

        Columns are value, stderr, systematic (error due to conditions that the fit
        holds fixed), low and high (95 % interval), verdict and unit. What is not
        identifiable has no value.

        Raises
        ------
        InputError : pandas is not installed.
        """
        errors = self.systematics.errors
        rows = [
            EstimateRow.of(name, estimate, errors.get(name))
            for name, estimate in self._items().items()
        ]
        columns: dict[str, Any] = {}
        for column in (
            VALUE,
            STDERR,
            SYSTEMATIC,
            LOW.but(key="low"),
            HIGH.but(key="high"),
        ):
            # numbers, also where all are missing
            columns[column.name] = np.array([column.get(row) for row in rows], float)
        for column in (VERDICT, UNIT):
            columns[column.name] = [column.get(row) for row in rows]
        return frame(columns, [row.name for row in rows])
