"""Profile likelihoods as frozen records."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

from curlfit.errors import InputError
from curlfit.findings import Finding
from curlfit.inference.derived.quantiles import Quantiles
from curlfit.inference.fit.entries import Extent, LossName
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.intervals import student_quantile
from curlfit.inference.model.parameters import ParameterSet
from curlfit.loads import Load
from curlfit.numerics.arrays import Floats
from curlfit.output.frames import frame
from curlfit.records import SERIES, Entry, Matrix, Pairs, Record, require, require_rows

_MIN_POINTS = 5  # of a parameter
_MAX_POINTS = 2001

LevelName = Literal["68 %", "95 %"]


class Level(NamedTuple):
    """A level of confidence and its thresholds of delta chi squared.

    These are the quantiles of Wilks (1938) where sigma was given; where it was
    estimated, those of Student's t and Fisher's F (Bates and Watts 1988, sect. 6.1).
    """

    name: LevelName
    delta_chi2: float
    """for one parameter: 1 or 3.84 where sigma was given"""
    delta_chi2_pair: float
    """for two parameters together: 2.30 or 5.99 where sigma was given"""
    sigmas: float
    """half the width of the covariance's interval, in standard errors"""
    quantiles: tuple[str, str]
    """of a posterior"""


def levels_of(dof: float | None) -> tuple[Level, ...]:
    """68 % and 95 % for standard errors of `dof` degrees of freedom; None where
    sigma was given."""
    one_sigma = math.erf(math.sqrt(0.5))  # 68.27 %
    return (
        _level("68 %", one_sigma, dof, ("16", "84")),
        _level("95 %", 0.95, dof, ("2.5", "97.5")),
    )


def _level(
    name: LevelName, probability: float, dof: float | None, quantiles: tuple[str, str]
) -> Level:
    """The level of a probability, with its thresholds."""
    sigmas = student_quantile(probability, dof)
    log_beyond = math.log(1 - probability)
    if dof is None:  # the quantile of chi squared with 2 degrees of freedom
        delta_chi2_pair = -2 * log_beyond
    else:  # twice the quantile of F with 2 and dof degrees of freedom
        delta_chi2_pair = dof * math.expm1(-2 * log_beyond / dof)
    return Level(name, sigmas**2, delta_chi2_pair, sigmas, quantiles)


def levels_for(
    names: Sequence[str], parameters: Mapping[str, Estimate]
) -> tuple[Level, ...]:
    """The levels for some parameters of a fit, by the fewest degrees of freedom of
    their standard errors, or of all parameters where these have none."""
    dof_by_name = {
        name: estimate.dof for name, estimate in parameters.items() if estimate.dof
    }
    dofs = [dof_by_name[name] for name in names if name in dof_by_name]
    return levels_of(min(dofs or dof_by_name.values(), default=None))


Limit = Literal["data", "others", "bound", "range"]


class ProfileVerdict(StrEnum):
    """What a profile says of its parameter."""

    LIMITED = "limited"
    """the data set limits"""
    HARDLY = "hardly"
    """delta chi squared is below 1 within the free part, which is most of the
    interval: weakly determined"""
    FLAT = "flat"
    """delta chi squared is zero there, to rounding: not identifiable"""
    NARROW = "narrow"
    """the given range is too narrow for a verdict"""

    def __repr__(self) -> str:
        return repr(self.value)

    @property
    def is_valley(self) -> bool:
        """Whether chi squared hardly rises along the profile."""
        return self in (ProfileVerdict.FLAT, ProfileVerdict.HARDLY)


@dataclass(frozen=True)
class Interval:
    """A confidence interval of a parameter.

    Attributes
    ----------
    level : "68 %" or "95 %".
    low, high : its ends.
    low_by, high_by : what limits it: "data" (chi squared), "others" (chi squared beyond
        a value where other parameters reach their bounds), "bound" (the parameter's
        own), "range" (nothing up to the end of the range).
    """

    level: LevelName
    low: float
    high: float
    low_by: Limit
    high_by: Limit

    @property
    def limits(self) -> tuple[float | None, float | None]:
        """Its ends, None where chi squared does not limit it."""
        by_data = ("data", "others")
        low = self.low if self.low_by in by_data else None
        high = self.high if self.high_by in by_data else None
        return low, high


@dataclass(frozen=True, eq=False)
class PosteriorDensity(Entry):
    """Density of a parameter in a posterior sample.

    Attributes
    ----------
    at : values of the parameter, by bin of the chain.
    height : -2 log of the marginal density there, shifted onto the profile.
    error : its standard deviation, by the finite sample.
    """

    at: Floats
    height: Floats
    error: Floats


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Profile(Record):
    """The minimum of chi squared at fixed values of one parameter, all others
    fitted again.

    Attributes
    ----------
    name : of the parameter. best : its value in the fit.
    law, load, loss, data : of the fit, and how much of which file it is of.
    parameters : of the fit, by name.
    chi_squared : of the fit, of `n_observations` values and its priors. Under a
        robust loss it is minus twice the logarithm of the likelihood of that loss,
        and of the priors.
    at : values of the parameter, increasing, shape (n,), denser where the
        profile is steep.
    delta : chi squared there minus that of the fit; NaN where the law admits no motion.
    others : by name, the other free parameters there.
    intervals : at its `levels`, 68 % and 95 %.
    free : (low, high), the part of the range in which no other parameter
        reaches a bound.
    stops : the names of those that reach one, beyond either end of it.
    rise : the largest delta chi squared within that part.
    verdict : what the profile says of the parameter, one of `ProfileVerdict`.
    combinations : those of the fit that contain the parameter.
    posterior : its density in the posterior sample; None without a chain.
    quantiles : of the posterior by level, keys "2.5", "16", "50", "84", "97.5"; empty
        without one.
    warnings : for the reader.
    command : that made it; empty if it was made in Python.

    Examples
    --------
    >>> profile
    Profile, mu1_xi limited by the data: ...
    mu1_xi: 0.000390 .. 0.000443 (68 %), 0.000364 .. 0.000469 (95 %)
    ...
    >>> profile.to_frame().columns[:2].tolist()
    ['mu1_xi', 'delta_chi2']
    """

    kind: ClassVar[str] = "profile"
    marks: ClassVar[dict[str, str]] = {"kind": "one"}

    name: str
    best: float
    law: str
    load: Load
    loss: LossName
    data: Extent
    parameters: dict[str, Estimate]
    chi_squared: float
    n_observations: int
    at: Floats = field(metadata=SERIES)
    delta: Floats = field(metadata=SERIES)
    others: dict[str, Floats] = field(metadata=SERIES)
    intervals: tuple[Interval, ...]
    free: tuple[float, float]
    stops: tuple[tuple[str, ...], tuple[str, ...]]
    rise: float
    verdict: ProfileVerdict
    combinations: tuple[Combination, ...]
    posterior: PosteriorDensity | None = field(metadata=SERIES)
    quantiles: Quantiles
    warnings: tuple[Finding, ...]
    command: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the profiled parameters."""
        return (self.name,)

    @property
    def each(self) -> tuple[Profile, ...]:
        """The profiles of single parameters."""
        return (self,)

    @property
    def estimate(self) -> Estimate:
        """The estimate of the parameter in the fit."""
        return self.parameters[self.name]

    @property
    def levels(self) -> tuple[Level, ...]:
        """Levels of its intervals."""
        return levels_for([self.name], self.parameters)

    @property
    def departure(self) -> dict[str, float]:
        """By level, the largest difference of a limit from that of the covariance.

        In standard errors, for limits set by chi squared; empty where the fit has none.
        """
        value = self.estimate.value
        stderr = self.estimate.stderr
        departures: dict[str, float] = {}
        if not stderr:
            return departures
        for interval, level in zip(self.intervals, self.levels, strict=True):
            low, high = interval.limits
            differences = []
            if low is not None:
                differences.append(abs((low - value) / stderr + level.sigmas))
            if high is not None:
                differences.append(abs((high - value) / stderr - level.sigmas))
            if differences:
                departures[level.name] = max(differences)
        return departures

    def to_frame(self) -> Any:
        """The profile as a pandas DataFrame: the parameter, `delta_chi2`
        and all others.

        Raises
        ------
        InputError : pandas is not installed.
        """
        return frame({self.name: self.at, "delta_chi2": self.delta} | self.others)

    def quieter(self, rise: float) -> float:
        """Factor by which the noise would have to be smaller for a delta chi
        squared of `rise`.

        Chi squared is proportional to the inverse square of sigma.
        """
        return math.sqrt(rise / self.rise) if self.rise > 0 else math.inf

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        require("name", self.name in self.parameters, "the name of a parameter")
        require_rows("others", {"delta": self.delta, **self.others}, len(self.at))
        if self.posterior is not None:
            density = self.posterior
            series = {"height": density.height, "error": density.error}
            require_rows("posterior", series, len(density.at))

    @classmethod
    def _from_file(cls, entries: dict[str, Any], folder: Path) -> Any:
        pair = entries.get("kind") == PairProfile.marks["kind"]
        return (PairProfile if pair else Profile).from_json(entries)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PairProfile(Record):
    """The minimum of chi squared at fixed values of two parameters, all others
    fitted again.

    The points follow the valley: in each row the first parameter is fixed, and the
    second varies about its value in the profile of the first.

    Attributes
    ----------
    names : of both parameters.
    each : the profile of each alone. That of the first is chi squared along the bottom
        of the valley, with the second in its `others`.
    first, second : values of both, shape (n, m). Points beyond a bound of the
        second lie on it.
    delta : chi squared there minus that of the fit; NaN where the law admits no motion.
    across : standard error of the second with the first fixed, at the best fit; None
        where the data do not determine it.
    extent : by level, the extent of its region in each parameter.
    covariance : of both, shape (2, 2); None where one of them has no standard error.
    ellipse : the largest difference of `delta` from the quadratic form of the
        covariance within its 95 % ellipse; None without one.
    samples : of the posterior, shape (samples, 2); empty without a chain.
    warnings : for the reader.
    command : that made it; empty if it was made in Python.

    Examples
    --------
    >>> pair = curlfit.profile(fit, ["mu1_xi", "mu2_xi"], points=9)
    >>> pair.names, pair.delta.shape == pair.first.shape
    (('mu1_xi', 'mu2_xi'), True)
    """

    kind: ClassVar[str] = "profile"
    marks: ClassVar[dict[str, str]] = {"kind": "two"}

    names: tuple[str, str]
    each: tuple[Profile, Profile]
    first: Matrix = field(metadata=SERIES)
    second: Matrix = field(metadata=SERIES)
    delta: Matrix = field(metadata=SERIES)
    across: float | None
    extent: dict[str, tuple[Interval, Interval]]
    covariance: Matrix | None
    ellipse: float | None
    samples: Pairs = field(metadata=SERIES)
    warnings: tuple[Finding, ...]
    command: str = ""

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Parameters of the fit, by name."""
        return self.each[0].parameters

    @property
    def levels(self) -> tuple[Level, ...]:
        """Levels of its regions."""
        return levels_for(self.names, self.parameters)

    @property
    def best(self) -> tuple[float, float]:
        """Values of both in the fit."""
        return self.each[0].best, self.each[1].best

    def to_frame(self) -> Any:
        """The points as a pandas DataFrame: both parameters and `delta_chi2`.

        Raises
        ------
        InputError : pandas is not installed.
        """
        first, second = self.names
        return frame(
            {
                first: self.first.ravel(),
                second: self.second.ravel(),
                "delta_chi2": self.delta.ravel(),
            }
        )

    @property
    def valley(self) -> Floats:
        """The second parameter along the profile of the first, at `each[0].at`."""
        return self.each[0].others[self.names[1]]

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        names = [profile.name for profile in self.each]
        require(
            "names",
            [*self.names] == names and names[0] != names[1],
            "those of the profiles",
        )
        require("each", self.names[1] in self.each[0].others, "the valley")
        shapes = {self.first.shape, self.second.shape, self.delta.shape}
        require(
            "delta", len(shapes) == 1 and self.delta.size > 1, "arrays of one shape"
        )
        require("samples", self.samples.shape[1] == 2, "pairs of values")


def load_profile(file: str | PathLike[str]) -> Profile | PairProfile:
    """Read a saved `profile.json`, or the one in a folder.

    Raises
    ------
    DataError : it is missing, is not a profile, or has a schema this version
        cannot read.

    Examples
    --------
    >>> profile.save("profile.json")
    >>> curlfit.load_profile("profile.json").verdict
    'limited'
    """
    profile: Profile | PairProfile = Profile.read(file)
    return profile


def require_usable(
    parameters: ParameterSet,
    names: Sequence[str],
    points: int | None,
    ranges: Mapping[str, tuple[float, float]],
    best: Mapping[str, float] | None = None,
) -> None:
    """Raise `InputError` where names, points or ranges are not valid for
    these parameters.

    `best` are the fitted values, if known; a range must contain them.
    """
    if not 1 <= len(names) <= 2:
        raise InputError(f"--param: {len(names)} names; expected one or two")
    parameters.require("--param", names)
    for name in names:
        if name in parameters.fixed:
            raise InputError(
                f"--param {name}: it is fixed at {parameters.fixed[name]:g}; "
                "expected one that is fitted"
            )
    if len(set(names)) < len(names):
        raise InputError(f"--param {names[0]} is given twice")
    if points is not None and not _MIN_POINTS <= points <= _MAX_POINTS:
        raise InputError(f"--points {points}: expected {_MIN_POINTS} to {_MAX_POINTS}")
    if len(parameters.fixed) + len(names) == len(parameters):
        raise InputError("no other parameter is left to fit; free one")
    for name, (low, high) in ranges.items():
        if name not in names:
            raise InputError(f"--range of {name}: expected one of {', '.join(names)}")
        parameter = parameters.parameters[parameters.index(name)]
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise InputError(
                f"--range {low:g},{high:g} of {name} is empty; expected LOW,HIGH"
            )
        if low < parameter.lower or high > parameter.upper:
            raise InputError(
                f"--range {low:g},{high:g} of {name} exceeds its bounds "
                f"{parameter.lower:g}:{parameter.upper:g}; --bound changes them"
            )
        if best is not None and not low <= best[name] <= high:
            raise InputError(
                f"--range {low:g},{high:g} of {name} excludes the best estimate, "
                f"{best[name]:.6g}"
            )
