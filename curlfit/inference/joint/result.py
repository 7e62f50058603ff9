"""The record of a joint fit of several throws."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from curlfit.foreign import safe_name
from curlfit.inference.derived import Derived, derive
from curlfit.inference.fit.result import (
    Estimate,
    FitResult,
    NamedEstimates,
    Systematics,
    load_fit,
)
from curlfit.inference.identifiability import Combination
from curlfit.output.files import known_fields, load_record, write_json
from curlfit.output.text import p_text

SCHEMA = 1

_SIGNIFICANT = 0.01


@dataclass(frozen=True)
class Difference:
    """How a coefficient, or a combination of coefficients, differs from throw to throw.

    Attributes
    ----------
    expression : the coefficient or combination.
    each : estimate and standard error from each throw alone, None where it gives none.
    p_value : probability of differences at least as large if the throws agree (chi squared).
    spread : standard deviation between throws beyond what the errors explain.
    mean, stderr : mean over such throws and its standard error, including the spread between them.
    shared_stderr : standard error of the shared estimate as one of this mean; None in old records.
    significant : p_value below 0.01.
    """

    expression: str
    each: tuple[tuple[float, float] | None, ...]
    p_value: float
    spread: float
    mean: float
    stderr: float
    shared_stderr: float | None = None

    @property
    def significant(self) -> bool:
        """Whether the differences are unlikely to be due to chance."""
        return self.p_value < _SIGNIFICANT

    @property
    def p_text(self) -> str:
        """The p-value as text, such as "p < 0.001"."""
        return p_text(self.p_value)


@dataclass(frozen=True, eq=False, repr=False)
class JointResult(NamedEstimates):
    """Several throws fitted together.

    Attributes
    ----------
    law, load, share : what was fitted; names of the shared coefficients.
    converged, status, warnings : whether the fit may be used, and why it may mislead.
    coefficients : the shared ones, by name. Where throws differ in one, its standard error is that
        of an estimate of the mean over such throws, with one degree of freedom less than throws.
    combinations : what is determined where single shared coefficients are not; likewise.
    rank, parameters : directions that the throws determine together, and number of free parameters.
    differences : of each determined shared coefficient or combination.
    throws : a `FitResult` for each throw; its standard errors and its information are those of the
        joint fit, so that predictions from it use all throws.
    systematics : errors of what is shared due to the conditions that the fit holds fixed.
    derived : quantities requested by `--derive` and `with_derived`.

    Examples
    --------
    >>> joint
    JointResult, converged (... steps): front-back law, uniform load, 2 throws together
    mu1_xi = ..., mu2_xi = ..., mu1_eta + mu2_eta = ...
    not identifiable: mu1_eta, mu2_eta
    2 warnings, see curlfit.print_joint
    >>> len(joint.throws)
    2
    """

    _report: ClassVar[str] = "curlfit.inference.overview"
    _printer: ClassVar[str] = "curlfit.print_joint"

    law: str
    load: str
    share: tuple[str, ...]
    converged: bool
    status: str
    warnings: tuple[str, ...]
    coefficients: dict[str, Estimate]
    combinations: tuple[Combination, ...]
    rank: int
    parameters: int
    differences: tuple[Difference, ...]
    throws: tuple[FitResult, ...]
    systematics: Systematics = field(default_factory=Systematics)
    derived: tuple[Derived, ...] = ()

    @property
    def _estimates(self) -> dict[str, Estimate]:
        """What is shared, by name."""
        return self.coefficients

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
        known = self.throws[0].first_order
        shared = {
            name: item for name, item in known.parameters.items() if name in self.coefficients
        }
        inside = [row for row, name in enumerate(known.names) if name in shared]
        matrix = np.array(known.covariance["matrix"])[np.ix_(inside, inside)]
        own = known._replace(
            parameters=shared,
            covariance={"names": [known.names[row] for row in inside], "matrix": matrix},
            combinations=self.combinations,
        )
        return derive(own, expression)

    def with_derived(self, expressions: Iterable[str]) -> JointResult:
        """The result with derived quantities."""
        return replace(self, derived=tuple(map(self.derive, expressions)))

    def to_json(self) -> dict[str, Any]:
        """The record as written to `joint.json`, without the single throws."""
        return {
            "schema": SCHEMA,
            "law": self.law,
            "load": self.load,
            "share": list(self.share),
            "converged": self.converged,
            "status": self.status,
            "warnings": list(self.warnings),
            "coefficients": {name: asdict(item) for name, item in self.coefficients.items()},
            "combinations": [asdict(item) for item in self.combinations],
            "identifiability": {"rank": self.rank, "parameters": self.parameters},
            "differences": [
                asdict(item) | {"significant": item.significant} for item in self.differences
            ],
            "systematics": asdict(self.systematics),
            "derived": [asdict(item) for item in self.derived],
            "throws": [
                {
                    "file": item.data["file"],
                    "rows": item.data["rows"],
                    "rms": item.rms,
                    "sigma": item.sigma,
                    "parameters": {name: asdict(one) for name, one in item.parameters.items()},
                }
                for item in self.throws
            ],
        }

    def save(self, file: str | PathLike[str]) -> None:
        """Write the record as JSON, whole or not at all."""
        write_json(self.to_json(), Path(file))


def folder_name(throw: str) -> str:
    """The folder of a throw beside `joint.json`: `evening-3` for row 3 of `evening.csv`."""
    row = re.fullmatch(r"(.*) row (\d+)", throw)
    return safe_name(Path(throw).stem if row is None else f"{Path(row[1]).stem}-{row[2]}")


def load_joint(file: str | PathLike[str]) -> JointResult:
    """Read a saved joint fit from its folder or `joint.json`, with the single throws beside it.

    Raises
    ------
    DataError : a file is missing, or is not a record that this version can read.

    Examples
    --------
    >>> curlfit.load_joint("joint").share == joint.share
    True
    """

    def build(found: dict[str, Any], path: Path) -> JointResult:
        return JointResult(
            law=found["law"],
            load=found["load"],
            share=tuple(found["share"]),
            converged=found["converged"],
            status=found["status"],
            warnings=tuple(found["warnings"]),
            coefficients={
                name: Estimate.from_json(item) for name, item in found["coefficients"].items()
            },
            combinations=tuple(
                Combination(**known_fields(Combination, item)) for item in found["combinations"]
            ),
            rank=found["identifiability"]["rank"],
            parameters=found["identifiability"]["parameters"],
            differences=tuple(
                Difference(
                    **known_fields(Difference, item)
                    | {"each": tuple(None if one is None else tuple(one) for one in item["each"])}
                )
                for item in found["differences"]
            ),
            throws=tuple(
                load_fit(path.parent / folder_name(item["file"])) for item in found["throws"]
            ),
            systematics=Systematics(**known_fields(Systematics, found.get("systematics", {}))),
            derived=tuple(
                Derived(**known_fields(Derived, item)) for item in found.get("derived", ())
            ),
        )

    return load_record(file, "joint", SCHEMA, build)
