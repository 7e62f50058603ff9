"""Least-squares fits from data to result, of one throw or of many side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from curlfit.errors import CurlfitError
from curlfit.friction import Law, find_law
from curlfit.friction.family import LawFamily
from curlfit.inference.fit.advice import remedies, with_curl_warning, with_noise_advice
from curlfit.inference.fit.change_points import change_of, may_have_changed
from curlfit.inference.fit.entries import RefitWithStone
from curlfit.inference.fit.outcome import LeastSquaresFit
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult
from curlfit.inference.fit.search import fitted
from curlfit.inference.fit.summary import summarize, summarize_many
from curlfit.inference.fit.systematics import widths_of
from curlfit.inference.fit.throw_stack import ThrowStack
from curlfit.inference.model.model import Model
from curlfit.inference.model.problem import problem_shape
from curlfit.inference.model.request import Request
from curlfit.losses import LOSSES
from curlfit.noises import Noise
from curlfit.numerics.batches import BATCH, side_by_side
from curlfit.settings.choices import Fitting, takes
from curlfit.throws.reference import Reference
from curlfit.throws.throw import Throw, require_throw

_ROWS = 2 * BATCH * 256  # of throws that are fitted together, to limit memory


@takes(Fitting, "law")
def fit(
    throw: Throw,
    law: str | type[Law] | None = None,
    *,
    details: bool = True,
    **choices: Any,
) -> FitResult:
    """Fit a friction law and the initial state of the throw to a measured path by
    least squares.

    Parameters
    ----------
    throw : the data. Its own settings (such as `until`, `stone`, `law`) apply where an
        argument is not given.
    details : whether to compute also the quantities of the path, the fits with
        the stones of the throw's reference, and what would determine more
        parameters (`remedies`).
    {choices}

    Returns
    -------
    FitResult, whose `status` says in words whether the fit converged, and whose
    `warnings` say why it may mislead.

    Raises
    ------
    InputError : an unknown law, load, loss, noise or parameter name; too few rows; a
        stone that never moves.
    UnusableFitError : no initial values led to a finite fit.

    Examples
    --------
    >>> fit = curlfit.fit(throw, "front-back")
    >>> fit.converged, round(fit["mu2_xi"].value, 4)
    (True, 0.0556)
    >>> fit["mu1_eta"].verdict
    'not identifiable'
    """
    require_throw(throw)
    chosen = Fitting.of(throw.settings, law=law, **choices)
    return fit_request(Request.of(throw, chosen), details=details)


def fit_request(
    request: Request, *, details: bool = True, family: type[LawFamily] | None = None
) -> FitResult:
    """The fit that is requested.

    Parameters
    ----------
    details : as in `fit`.
    family : of laws that are fitted to the same throw, including this one: they are
        compiled as one program.

    Raises
    ------
    UnusableFitError : no initial values led to a finite fit.
    """
    result = _fit(request, details=details, family=family)
    return result.with_derived(request.derive) if request.derive else result


def _fit(
    request: Request, *, details: bool, family: type[LawFamily] | None
) -> FitResult:
    model = Model.of(request, family)
    outcome = _fitted_alone(ThrowStack(model, [request]))
    result = summarize(outcome, widths_of(model, request.systematics, [request]))
    if not result.converged:
        return result
    if may_have_changed(outcome, result):
        change = change_of(outcome)
        if change is not None:
            result = change.added_to(result)
        elif details and not result.events:
            result = with_noise_advice(result, refit)
    if not details:
        return result
    result = replace(with_curl_warning(result), quantities=quantities_of(result))
    if result.reference is not None:
        reference_fits = _reference_fits(outcome, result, result.reference)
        result = replace(result, reference_fits=reference_fits)
    not_determined = [
        name
        for name, estimate in result.parameters.items()
        if estimate.verdict.is_left_open
    ]
    if not_determined:
        measurements = remedies(outcome, not_determined, request.fixed_by_user)
        result = replace(result, remedies=measurements)
    return result


def refit(fit: FitResult, noise: Noise) -> FitResult:
    """Repeat a fit under another noise model, starting from its optimum."""
    request = Request(
        throw=fit.throw,
        law=fit.law_class,
        load=fit.load,
        stone=fit.stone,
        parameters=fit.parameter_set,
        loss=LOSSES[fit.loss],
        noise=noise,
        rows={name: fit.data[name] for name in ("since", "until", "exclude")},
        swept=fit.data.swept,
        start=fit.parameter_set.values_of(fit.values),
    )
    return summarize(_fitted_alone(ThrowStack(fit.model, [request])))


def _fitted_alone(stack: ThrowStack) -> LeastSquaresFit:
    """Fit the only throw of a stack."""
    (outcome,) = fitted(stack)
    if isinstance(outcome, CurlfitError):
        raise outcome
    return outcome


def _reference_fits(
    outcome: LeastSquaresFit, result: FitResult, reference: Reference
) -> tuple[RefitWithStone, ...]:
    """The values that the fit gives with other constants of the stone: those of the
    reference, and each constant of the fit shifted by its rounding; none where they are
    parameters of the fit."""
    stone = result.stone.as_dict()
    of_reference = {
        name: constant
        for name, constant in reference.stone.items()
        if constant != stone[name]
    }
    constants_in_question = {*reference.stone, *reference.rounding}
    if not of_reference or result.conditions.keys() & constants_in_question:
        return ()
    rounded = [
        {name: round(stone[name] + rounding, 9)}
        for name, rounding in reference.rounding.items()
    ]
    changes = [of_reference, *(change for change in rounded if change != of_reference)]
    start = result.parameter_set.values_of(result.values)
    reference_fits = []
    for change in changes:
        request = replace(
            outcome.request, stone=result.stone.with_values(change), start=start
        )
        fit = summarize(_fitted_alone(ThrowStack(outcome.model, [request])))
        values = {name: estimate.value for name, estimate in fit.coefficients.items()}
        for combination in fit.combinations:
            values[combination.expression] = combination.value
        reference_fits.append(RefitWithStone(change, values))
    return tuple(reference_fits)


def fit_throws(
    throws: Sequence[Throw],
    law: str | type[Law] = "front-back",
    *,
    curves: bool = True,
    systematics: Mapping[str, float] | None = None,
    **choices: Any,
) -> list[FitResult | CurlfitError]:
    """Fit each throw individually, many at a time; an error takes the place of a
    fit that fails.

    Throws go through the fits of `fit` side by side.

    Parameters
    ----------
    law, choices : as in `fit`, for all throws.
    curves : whether the fits contain the fitted curves, by which it is also checked
        whether the fitted motion is that of a stone; they always do under a robust loss
        or correlated noise. Quantities of the path are not computed in any case.
    systematics : as in `fit`, but none by default; they need the curves.

    Raises
    ------
    InputError : as in `fit`, for the arguments common to all throws.
    """
    chosen = Fitting.of(law=law, **choices)
    find_law(chosen.law)  # an unknown one is an error of all throws
    outcomes: dict[int, FitResult | CurlfitError] = {}
    # Throws of one group have arrays of one shape, and the same parameters.
    groups: dict[Any, dict[int, Request]] = {}
    for index, throw in enumerate(throws):
        try:
            request = Request.of(throw, Fitting.of(throw.settings, vars(chosen)))
        except CurlfitError as error:
            outcomes[index] = error
        else:
            shape = problem_shape(request.throw)
            group = groups.setdefault((shape, request.parameters.names), {})
            group[index] = request
    for ((_, rows), _), group in groups.items():
        batch = side_by_side(len(group))
        at_once = max(BATCH, _ROWS // rows)
        indices = list(group)
        for first in range(0, len(indices), at_once):
            part = indices[first : first + at_once]
            results = _fit_alike(
                [group[index] for index in part],
                curves=curves,
                systematics=systematics,
                batch=batch,
            )
            outcomes.update(zip(part, results, strict=True))
    return [outcomes[index] for index in range(len(throws))]


def _fit_alike(
    requests: Sequence[Request],
    *,
    curves: bool,
    systematics: Mapping[str, float] | None,
    batch: int,
) -> list[FitResult | CurlfitError]:
    """Fits of throws whose problems have one shape and the same parameters, `batch` of
    them side by side; the other arguments as in `fit_throws`."""
    first = requests[0]
    model = Model.of(first)
    outcomes = fitted(ThrowStack(model, requests, batch=batch))
    usable = [fit for fit in outcomes if isinstance(fit, LeastSquaresFit)]
    widths = {}
    if systematics is not None:
        widths = widths_of(model, systematics, requests)
    curves = curves or first.loss.is_robust or not first.noise.is_white
    records = iter(summarize_many(usable, batch, curves=curves, widths=widths))
    results: list[FitResult | CurlfitError] = []
    for outcome in outcomes:
        if isinstance(outcome, CurlfitError):
            results.append(outcome)
        else:
            results.append(with_curl_warning(next(records)))
    return results
