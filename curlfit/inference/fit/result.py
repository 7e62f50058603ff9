"""Results of a fit as frozen records.

All figures and reports are made from these alone, so a saved `fit.json` can be printed,
drawn and sampled again without the data file and without fitting.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, fields, replace
from os import PathLike
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from curlfit.errors import InputError, require_kind
from curlfit.findings import Finding
from curlfit.friction import Law, Parameter, check_load, find_law
from curlfit.inference.derived.derive import derive
from curlfit.inference.derived.first_order import FirstOrder
from curlfit.inference.derived.quantity import Derived
from curlfit.inference.fit.entries import (
    AnyNoise,
    ChannelName,
    DataOfFit,
    Determined,
    FittedEvent,
    FurtherMeasurement,
    GaussNewtonInformation,
    LossName,
    Outlier,
    RefitWithStone,
)
from curlfit.inference.fit.estimates import (
    Estimate,
    NamedEstimates,
    Posterior,
    RidgePoint,
    Systematics,
)
from curlfit.inference.information.combinations import Combination
from curlfit.inference.information.named_matrix import NamedMatrix
from curlfit.inference.information.verdict import Verdict
from curlfit.inference.model.conditions import CONDITIONS
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import START, START_NAMES, ParameterSet
from curlfit.inference.model.priors import parse_priors
from curlfit.inference.noise.independence import Independence
from curlfit.loads import Load
from curlfit.noises import WHITE
from curlfit.numerics.arrays import Floats
from curlfit.records import ADDED, SERIES, Names, require, require_rows
from curlfit.stone import Stone
from curlfit.throws.channels import CHANNELS
from curlfit.throws.reference import Reference
from curlfit.throws.throw import Throw, counts_from_hack


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class FitResult(NamedEstimates):
    """A fitted throw. `save` writes it, `load_fit` reads it.

    Attributes
    ----------
    law, load, stone : what was fitted.
    data : source and extent of the data.
    converged, status, warnings : whether the fit may be used, and why it may mislead.
    n_observations : finite values of all channels. rms : of the residuals by
        channel (SI, rad).
    sigma : estimated noise by channel, without the channels whose sigma was given; the
        smallest where it varies by row.
    lag1 : correlation of neighbouring residuals by channel.
    independence : by channel, how far the residuals are from independent noise, after
        subtraction of what the noise model predicts.
    parameters : by name, coefficients first, then x0 y0 heading v0 phi0 omega0.
    combinations : sums that are determined where single parameters are not.
    identifiability : how many directions the data determine, and those that they do
        not.
    covariance : of the free parameters away from their bounds, along the directions
        that the data determine.
    information : what the data say of all free parameters to first order.
    ridge : where chi squared is no quadratic, values of all parameters that fit about
        as well as the estimates: a `RidgePoint` each. Empty where it is one, and of
        fits of several throws.
    reference : published or true values of the same law, if the data file has them.
    reference_fits : fits repeated with other constants of the stone, where the
        reference gives them.
    observed : t, x, y, phi as measured, speed and omega if measured, and sigmas where
        they are given or vary by row.
    fitted : x, y, phi, speed, omega of the fit at the same times; empty if
        not requested.
    posterior : None until sampled.
    discrepancy : of a fit with the noise "discrepancy", the mean of the model
        discrepancy given the residuals: x, y, phi, speed, omega at the times of the
        rows, to be added to `fitted`. Empty without such noise.
    loss : how much large residuals count, see `curlfit.losses`.
    noise : how noise is correlated from row to row, see `curlfit.noises`.
    outliers : values far from the fit, the farthest first.
    remedies : further measurements that would help, see `curlfit.inference.fit.advice`.
    sampling : "none", "unfinished" (begun, or about to begin) or "ended".
    systematics : errors due to the conditions that the fit holds fixed, such
        as level ice.
    chi_squared, prior_chi_squared : of the data, and of the priors.
    events : measured times and positions at lines and at rest, each with its value in
        the fit.
    derived : quantities requested by `--derive` and `with_derived`.
    products : of parameters that are not determined, where they are determined along
        the ridge: "b*omega0". Empty without a ridge.
    quantities : of the path within the record, by name: "friction" (mean
        deceleration over g), "curl", "turns", "hog_to_hog" ..., as far as the record
        determines them.

    Examples
    --------
    >>> fit
    FitResult, converged (... steps): front-back law, uniform load, fitted to ...
    mu1_xi = 0.000417(27), mu2_xi = 0.055627(25), mu1_eta + mu2_eta = 0.017573(16)
    not identifiable: mu1_eta, mu2_eta
    mean deceleration / g 0.0087830(78), curl to the left 0.71242(50) m, turns ...
    1 warning, see curlfit.print_fit
    >>> fit["mu1_eta + mu2_eta"].interval(0.95)
    (0.0175..., 0.0176...)
    >>> fit.residuals["x"].shape
    (201,)
    >>> fit.to_frame().loc["mu2_xi", ["value", "stderr"]].round(6).tolist()
    [0.055627, 2.5e-05]
    """

    kind: ClassVar[str] = "fit"
    inner: ClassVar[Collection[str]] = (
        *("all_derived", "counts_from_hack", "first_order", "independence"),
        *("information", "lag1", "law_class", "model", "null_directions"),
        *("parameter_set", "prior_chi_squared", "products", "rank", "reference_fits"),
        *("remedies", "ridge", "sampling", "singular_values", "summary", "with_law"),
    )

    law: str
    load: Load
    stone: Stone
    data: DataOfFit
    converged: bool
    status: str
    warnings: tuple[Finding, ...]
    n_observations: int
    rms: dict[str, float]
    sigma: dict[str, float]
    lag1: dict[str, float]
    loss: LossName = "linear"
    noise: AnyNoise = WHITE
    independence: dict[ChannelName, Independence] = field(default_factory=dict)
    outliers: tuple[Outlier, ...] = ()
    events: tuple[FittedEvent, ...] = ()
    remedies: tuple[FurtherMeasurement, ...] = ()
    parameters: dict[str, Estimate]
    combinations: tuple[Combination, ...]
    identifiability: Determined
    covariance: NamedMatrix
    information: GaussNewtonInformation
    ridge: tuple[RidgePoint, ...] = field(default=(), metadata=ADDED | SERIES)
    reference: Reference | None
    reference_fits: tuple[RefitWithStone, ...] = ()
    systematics: Systematics = field(default_factory=Systematics)
    chi_squared: float = math.nan
    prior_chi_squared: float = 0.0
    derived: tuple[Derived, ...] = ()
    products: tuple[Derived, ...] = field(default=(), metadata=ADDED)
    quantities: dict[str, Derived] = field(default_factory=dict)
    sampling: Literal["none", "unfinished", "ended"] = "none"
    posterior: Posterior | None = None
    observed: dict[str, Floats] = field(metadata=SERIES)
    fitted: Annotated[dict[ChannelName, Floats], Names(CHANNELS)] = field(
        metadata=SERIES
    )
    discrepancy: Annotated[dict[ChannelName, Floats], Names(CHANNELS)] = field(
        default_factory=dict, metadata=SERIES
    )

    def require_consistent(self) -> None:
        """Raise `ValueError` where what was read contradicts itself."""
        parameters = self.parameters.keys()
        rows = len(self.observed.get("t", ()))
        of_null_directions = {
            name
            for direction in self.identifiability.null_directions
            for name in direction
        }
        of_combinations = {
            name for combination in self.combinations for name in combination.weights
        }
        names_by_entry: dict[str, Iterable[str]] = {
            "parameters": START_NAMES,
            "covariance": self.covariance.names,
            "information": self.information.names,
            "null_directions": of_null_directions,
            "combinations": of_combinations,
            "posterior": self.posterior.ess if self.posterior else (),
            "ridge": [point.held for point in self.ridge if point.held is not None],
        }
        for entry, names in names_by_entry.items():
            require(entry, set(names) <= parameters, "names of parameters")
        origins = self.data.sigma.items()
        estimated = {name for name, origin in origins if origin == "estimated"}
        require("data", self.rms.keys() <= self.data.sigma.keys(), "sigma of each")
        require("sigma", estimated <= self.sigma.keys(), "all that were estimated")
        for entry in ("observed", "fitted", "discrepancy"):
            require_rows(entry, getattr(self, entry), rows)
        for name, shifts in self.systematics.shifts.items():
            are_conditions = shifts.keys() <= self.systematics.widths.keys()
            require("systematics", are_conditions, f"{name}: names of conditions")
        series = {"t", *CHANNELS, *(f"sigma_{name}" for name in CHANNELS)}
        has_series = {"t", *self.rms} <= self.observed.keys() <= series
        require("observed", has_series, "t and channels")
        matrices = {"covariance": self.covariance, "information": self.information}
        for entry, record in matrices.items():
            count = len(record.names)
            require(entry, record.matrix.shape == (count, count), "a square matrix")
        complete = all(len(point.values) == len(parameters) for point in self.ridge)
        require("ridge", complete, "a value of each parameter")
        shape = (len(START), len(START)) if self.noise.sizes else (0,)
        require("noise", np.shape(self.noise.initial_state) == shape, "a covariance")
        has_gradient = len(self.information.gradient) == len(self.information.names)
        require("information", has_gradient, "a gradient")

    @property
    def law_class(self) -> type[Law]:
        """The class of the law.

        A record runs no code: a law that is not one of curlfit's must be known
        already, because it is defined in this process or was read from a file that
        the user named.

        Raises
        ------
        InputError : it is not known, or has other coefficients.
        """
        try:
            law = find_law(self.law, from_files=False)
        except InputError:
            raise InputError(
                f"{self.law} is not a law of curlfit, and a saved result does "
                "not run the file of its law; name it with --law FILE.py:CLASS "
                "(`find_law` in Python)"
            ) from None
        coefficients = [coefficient.name for coefficient in law.coefficients()]
        if coefficients != list(self.coefficients):
            raise InputError(
                f"the law {self.law} has the coefficients {', '.join(coefficients)}, "
                f"the saved result {', '.join(self.coefficients)}; "
                "expected the law that was fitted"
            )
        return law

    def with_law(self, law: str | type[Law] | None) -> FitResult:
        """The result, whose law is that of a user's file.

        Raises
        ------
        InputError : it is another law.
        """
        if law is not None:
            name = find_law(law).name
            if name != self.law:
                raise InputError(
                    f"--law {law}: {name} found, but the saved fit is of the "
                    f"law {self.law}; give the data to fit another"
                )
            self.law_class  # noqa: B018  (its coefficients are checked)
        return self

    @property
    def model(self) -> Model:
        """Law, load and the conditions among the parameters."""
        return Model(
            self.law_class, check_load(self.load), self.parameter_set.conditions
        )

    @property
    def rank(self) -> int:
        """Number of directions that the data determine."""
        return self.identifiability.rank

    @property
    def singular_values(self) -> tuple[float, ...]:
        """Singular values of the Jacobian in typical sizes, largest first."""
        return self.identifiability.singular_values

    @property
    def null_directions(self) -> tuple[dict[str, float], ...]:
        """Directions along which the residuals stay the same."""
        return self.identifiability.null_directions

    @property
    def values(self) -> Floats:
        """The fitted parameter vector."""
        return np.array([estimate.value for estimate in self.parameters.values()])

    @property
    def coefficients(self) -> dict[str, Estimate]:
        """The law's own parameters."""
        conditions_and_start = {parameter.name for parameter in (*CONDITIONS, *START)}
        return {
            name: estimate
            for name, estimate in self.parameters.items()
            if name not in conditions_and_start
        }

    @property
    def conditions(self) -> dict[str, Estimate]:
        """Conditions that are parameters of the fit."""
        return {name: self.parameters[name] for name in self.parameter_set.conditions}

    @property
    def start(self) -> dict[str, float]:
        """The initial state, by the names of its parameters."""
        return {name: self.parameters[name].value for name in START_NAMES}

    @property
    def parameter_set(self) -> ParameterSet:
        """Names, bounds and fixed values of the fit."""
        attributes = [attribute.name for attribute in fields(Parameter)]
        attributes.remove("name")
        parameters = []
        fixed = {}
        priors = {}
        for name, estimate in self.parameters.items():
            of_parameter = {key: getattr(estimate, key) for key in attributes}
            parameters.append(Parameter(name=name, **of_parameter))
            if estimate.verdict == Verdict.FIXED:
                fixed[name] = estimate.value
            if estimate.prior:
                priors[name] = estimate.prior
        return ParameterSet(tuple(parameters), fixed, parse_priors(priors))

    @property
    def throw(self) -> Throw:
        """The data that were fitted."""
        series = self.observed
        channels: dict[str, Any] = {name: series.get(name) for name in CHANNELS}
        sigma: dict[str, Any] = {}
        relative_sigma: dict[str, Any] = {}
        for name in CHANNELS:
            if f"sigma_{name}" in series:
                is_estimated = name in self.sigma
                of_channel = relative_sigma if is_estimated else sigma
                of_channel[name] = series[f"sigma_{name}"]
        assumed = {}
        if self.events:
            for name in START_NAMES:
                estimate = self.parameters[name]
                if estimate.verdict == Verdict.FIXED:
                    assumed[name] = estimate.value
        return Throw.from_arrays(
            series["t"],
            **channels,
            sigma=sigma,
            relative_sigma=relative_sigma,
            name=self.data.file,
            reference=self.reference,
            labels=self.data.labels,
            events=tuple(fitted.event for fitted in self.events),
            assumed=assumed,
            defaults={"as_given": True},  # it was checked when it was fitted
        )

    @property
    def counts_from_hack(self) -> bool:
        """Whether y of the data is measured from the hack, according to the notes
        of the reader."""
        return counts_from_hack(self.data.notes)

    @property
    def _estimates(self) -> dict[str, Estimate]:
        """The parameters by name."""
        return self.parameters

    @property
    def all_derived(self) -> tuple[Derived, ...]:
        """The products that are determined, and the derived quantities that were
        requested, each once."""
        requested = {quantity.expression for quantity in self.derived}
        other_products = [
            product for product in self.products if product.expression not in requested
        ]
        return (*other_products, *self.derived)

    @property
    def residuals(self) -> dict[str, Floats]:
        """Measured - fitted by measured channel (SI, rad), NaN where there is no value;
        at the times `observed["t"]`."""
        if not self.fitted:
            return {}
        return {name: self.observed[name] - self.fitted[name] for name in self.rms}

    @property
    def predicted(self) -> dict[str, Floats]:
        """The channels as the fit predicts them at the rows: the path of the law plus,
        where the noise has one, the mean of the model discrepancy."""
        return {
            name: series + self.discrepancy.get(name, 0.0)
            for name, series in self.fitted.items()
        }

    @property
    def fitted_law(self) -> Law:
        """The law with the fitted coefficients, as `curlfit.simulate` takes it."""
        return self.law_class.from_vector(
            [coefficient.value for coefficient in self.coefficients.values()]
        )

    @property
    def first_order(self) -> FirstOrder:
        """What the fit says about its parameters, to first order."""
        return FirstOrder(
            self.parameters,
            self.covariance,
            self.identifiability.null_directions,
            self.combinations,
            self.systematics.widths,
            self.systematics.shifts,
            self.stone.as_dict(),
            self.ridge,
            tuple(product.expression for product in self.products),
        )

    def derive(self, expression: str, chain: Any = None) -> Derived:
        """A quantity derived from the parameters, with first-order errors.

        Parameters
        ----------
        expression : arithmetic (+ - * / ** and parentheses; sqrt, exp, log, log10, sin,
            cos, tan, atan, abs, hypot, min, max) of parameters, determined
            combinations, the stone's R, rho, h and m, g and pi.
        chain : a posterior sample of this fit, for quantiles.

        Raises
        ------
        InputError : it is not arithmetic of such names, or has no finite value.

        Examples
        --------
        >>> gap = fit.derive("mu2_xi - mu1_xi")
        >>> round(gap.value, 4), gap.verdict
        (0.0552, 'determined')
        >>> fit.derive("mu1_eta / mu2_eta").verdict
        'not identifiable'
        """
        samples = None
        if chain is not None:
            if tuple(chain.names) != tuple(self.parameters):
                raise InputError("the chain is of another fit: its parameters differ")
            samples = dict(zip(chain.names, chain.flat.T, strict=True))
        return derive(self.first_order, expression, samples)

    def with_derived(self, expressions: Iterable[str], chain: Any = None) -> FitResult:
        """The result with derived quantities, see `derive`."""
        return replace(
            self, derived=tuple(self.derive(text, chain) for text in expressions)
        )


def require_fit(fit: object) -> None:
    """Raise `InputError` for what is not the fit of one throw."""
    require_kind(
        fit, FitResult, "fit", "a fit of one throw, as from curlfit.fit(throw)"
    )


def load_fit(file: str | PathLike[str]) -> FitResult:
    """Read a saved `fit.json`, or the one in a folder.

    Raises
    ------
    DataError : it is missing, is not a curlfit result, or has a schema this version
        cannot read.

    Examples
    --------
    >>> fit.save("fit.json")
    >>> curlfit.load_fit("fit.json")["mu2_xi"] == fit["mu2_xi"]
    True
    """
    return FitResult.read(file)
