"""Joint fit of several throws: shared coefficients, own initial states and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from curlfit.inference.joint.solver import JointSolution, Layout, Progress, minimize_jointly
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.numerics.compiled import stacked, unstacked

# isort: split
import numpy as np

from curlfit.errors import InputError, UnusableFitError, require_kind
from curlfit.friction import Law, check_load, find_law, no_motion_because
from curlfit.inference.fit.prepared import PreparedThrow
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import Estimate, Systematics
from curlfit.inference.fit.rounds import Rounds
from curlfit.inference.fit.summary import IMPLAUSIBLE, summarize
from curlfit.inference.fit.systematics import (
    residual_changes,
    shifts,
    shifts_by_name,
    widths_of,
)
from curlfit.inference.identifiability import Identifiability, analyse, visible
from curlfit.inference.initial_values import smooth, start_values
from curlfit.inference.joint.heterogeneity import differences_of
from curlfit.inference.joint.result import Difference, JointResult
from curlfit.inference.least_squares import Indices
from curlfit.inference.likelihood import predict_many
from curlfit.inference.linearized_problem import LinearizedProblem, classify
from curlfit.inference.model import Model
from curlfit.inference.noise.models import check_loss, check_noise
from curlfit.inference.priors import Prior
from curlfit.inference.problem import problem_shape
from curlfit.stone import Stone
from curlfit.throws.throw import Throw, require_throw


def fit_together(
    throws: Sequence[Throw],
    law: str | type[Law] | None = None,
    *,
    share: str | Sequence[str] = "all",
    load: str = "uniform",
    stone: Stone | None = None,
    since: float | None = None,
    until: float | None = None,
    exclude: Sequence[tuple[float, float]] = (),
    swept: Sequence[float] | None = None,
    fix: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    unbounded: bool = False,
    free: Sequence[str] = (),
    priors: Mapping[str, str | Prior] | None = None,
    start: Mapping[str, float] | None = None,
    loss: str = "linear",
    noise: str = "white",
    systematics: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> JointResult:
    """Fit one law to several throws that share some or all of its coefficients.

    Parameters
    ----------
    throws : at least two; each has its own initial state, noise and, if its file says so, stone.
    law, load, stone, since, until, exclude, swept, fix, bounds, unbounded, free, priors, start,
    loss, noise, systematics : as in `fit`, for all throws. The prior of a shared parameter counts
        once. `swept` is by default what each throw itself states; one that states nothing was not
        swept.
    share : "all" coefficients, or the names of those that the throws share; each throw has its own
        values of the others. Conditions, such as the slope of the ice, are always shared.
    progress : called with the number of steps done and chi squared.

    Raises
    ------
    InputError : as in `fit`; fewer than two throws; a name that is not a coefficient.
    UnusableFitError : a throw has no finite path from the initial values found from its data.

    Examples
    --------
    >>> joint = curlfit.fit_together([throw, throw])
    >>> joint.converged, joint.share
    (True, ('mu1_xi', 'mu2_xi', 'mu1_eta', 'mu2_eta'))
    """
    require_kind(throws, Sequence, "throws", "a list of throws")
    for throw in throws:
        require_throw(throw)
    if law is None:
        law = throws[0].defaults.get("law", "front-back") if throws else "front-back"
    law = find_law(law)
    checked, loss = check_load(load), check_loss(loss)
    noise = check_noise(noise, loss)
    if len(throws) < 2:
        raise InputError(f"{len(throws)} throw to fit together; expected two or more")
    shared = _shared(law, share)
    any_swept = swept is not None or any(one.defaults.get("swept") for one in throws)
    prepared = [
        PreparedThrow.of(
            throw, law, stone, since=since, until=until, exclude=exclude, swept=swept, fix=fix,
            bounds=bounds, unbounded=unbounded, free=free, priors=priors, others_swept=any_swept,
        )
        for throw in throws
    ]  # fmt: skip
    shared = (*shared, *prepared[0].parameters.conditions)
    channels, rows = zip(*(problem_shape(one.throw) for one in prepared), strict=True)
    shape = max(channels), max(rows)
    model = Model(law, checked, prepared[0].parameters.conditions)
    rounds = Rounds(model, prepared, loss=loss, noise=noise, shape=shape)
    local = [one.local_parameters for one in prepared]
    layout, first = (
        Layout(sets, shared) for sets in (local, [one.first_parameters for one in prepared])
    )
    initial = []
    for one, parameters, problem in zip(prepared, local, unstacked(rounds.sketches), strict=True):
        alone = stacked([problem])
        ends = parameters.lower[None], parameters.upper[None]
        (values,) = start_values(model, alone, smooth(alone), *ends, batch=1)
        initial.append(one.with_start(values, start))
    best = layout.joined(np.stack(initial))
    solution = minimize_jointly(model, rounds.problems, first, best, progress)
    every = np.arange(len(prepared))
    while np.isfinite(solution.chi_squared) and rounds.revise(every, solution.each):
        best = solution.values
        solution = minimize_jointly(model, rounds.problems, layout, best, progress)
    for failure in rounds.failures.values():
        raise failure
    if not np.isfinite(solution.chi_squared):
        raise UnusableFitError(
            f"law {law.name} with {load} load gives no finite path for these throws"
            + no_motion_because(checked)
        )
    return _result(rounds, layout, shared, solution, widths_of(model, systematics))


def _information(linearized: LinearizedProblem, own: Indices, open_: Booleans) -> dict[str, Any]:
    """Information of all throws on some parameters, with the other open ones projected out."""
    others = open_.copy()
    others[own] = False
    basis, singular, _ = np.linalg.svd(
        linearized.jacobian[:, others] * linearized.typical[others], full_matrices=False
    )
    basis = basis[:, visible(singular)]
    jacobian = linearized.jacobian[:, own]
    jacobian = jacobian - basis @ (basis.T @ jacobian)
    return {
        "gradient": (-linearized.residual @ jacobian).tolist(),
        "matrix": (jacobian.T @ jacobian).tolist(),
    }


def _of_throw(known: Identifiability, joint: Any, names: Sequence[str]) -> dict[str, Any]:
    """Covariance and null directions of the parameters of a throw, which have other names in the
    joint vector."""
    own = dict(zip(map(str, joint), names, strict=True))
    rows = [row for row, name in enumerate(known.names) if name in own]
    directions = (
        {own[name]: weight for name, weight in item.items() if name in own}
        for item in known.null_directions
    )
    return {
        "covariance": {
            "names": [own[known.names[row]] for row in rows],
            "matrix": known.covariance[np.ix_(rows, rows)].tolist(),
        },
        "null_directions": tuple(filter(None, directions)),
    }


def _differs_by_spin(item: Difference, counter_clockwise: Booleans) -> bool:
    """Whether throws of the same sense of spin agree much better than all throws do."""
    known = np.array([one is not None for one in item.each])
    value, error = np.array([one for one in item.each if one is not None]).T
    sense = counter_clockwise[known]

    def chi_squared(rows: Booleans) -> float:
        if not rows.any():
            return 0.0
        mean = np.average(value[rows], weights=error[rows] ** -2)
        return float((((value[rows] - mean) / error[rows]) ** 2).sum())

    within = chi_squared(sense) + chi_squared(~sense)
    return within < chi_squared(np.ones_like(sense)) / 2


def _shared(law: type[Law], share: str | Sequence[str]) -> tuple[str, ...]:
    """Names of the shared coefficients. Raises `InputError` for one that the law does not have."""
    own = tuple(item.name for item in law.coefficients())
    shared = own if share == "all" else (share,) if isinstance(share, str) else tuple(share)
    for name in shared:
        if name not in own:
            raise InputError(
                f"share: law {law.name} has no coefficient {name!r}; it has {', '.join(own)}"
            )
    return shared


def _result(
    rounds: Rounds,
    layout: Layout,
    shared: tuple[str, ...],
    solution: JointSolution,
    widths: Mapping[str, float],
) -> JointResult:
    bounds, free, model = layout.bounds, layout.free, rounds.model
    matrix, right = solution.r_factor(layout)
    offset = layout.joined(np.stack([one.offset for one in rounds.throws]))
    linearized = LinearizedProblem(
        right, matrix, solution.values, bounds.lower, bounds.upper, bounds.typical, free
    )
    at_bound = linearized.at_bound()
    open_, slack = linearized.open(at_bound)
    names = np.array(layout.names)
    values = solution.values + offset
    known = analyse(
        matrix[:, open_], list(names[open_]), values[open_], bounds.typical[open_], slack
    )
    # Without the priors, whose rows are the last.
    of_data = analyse(
        matrix[: -len(names), open_] if layout.penalty is not None else matrix[:, open_],
        list(names[open_]), values[open_], bounds.typical[open_], slack,
    )  # fmt: skip
    shifted = _shifts(rounds, layout, solution, widths, open_, matrix[:, open_])
    systematic = shifts_by_name(known, shifted)
    single = [
        summarize(rounds.record(throw, one)) for throw, one in enumerate(unstacked(solution.each))
    ]
    index_of = {name: index for index, name in enumerate(known.names)}

    def estimate(item: Estimate, joint: int) -> Estimate:
        if item.verdict == "fixed":
            return item
        index = index_of.get(layout.names[joint], -1)
        stderr, verdict = classify(item.typical, bool(at_bound[joint]), known, index)
        reason = item.reason if verdict == item.verdict else ""
        if verdict == "determined":
            alone = classify(item.typical, bool(at_bound[joint]), of_data, index)
            verdict = verdict if alone[1] == "determined" else "prior"
        value = float(values[joint])
        return replace(item, value=value, stderr=stderr, verdict=verdict, reason=reason)

    decrement = linearized.newton_decrement(linearized.movable())
    reduced = solution.chi_squared / solution.each.residual.size
    converged = bool(solution.success and decrement < 0.01 * max(1.0, np.sqrt(reduced)))
    status = f"{'converged' if converged else 'not converged'} ({solution.steps} steps)"
    throws = []
    for throw, result in enumerate(single):
        estimates = {
            name: estimate(item, int(layout.index[throw, column]))
            for column, (name, item) in enumerate(result.parameters.items())
        }
        own_shifts = {
            name: systematic[joint]
            for name, joint in zip(estimates, names[layout.index[throw]], strict=True)
            if joint in systematic
        } | {item.expression: systematic[item.expression] for item in known.combinations}
        own = layout.index[throw][free[layout.index[throw]]]
        prior = rounds.throws[throw].local_parameters.penalty
        if prior is not None:  # including the priors of shared parameters
            own_prior = float(prior.chi_squared(solution.each.values[throw]))
            result = replace(result, prior_chi_squared=own_prior)
        if not result.status.startswith(IMPLAUSIBLE):
            # The search was for all throws together: chi squared of each has a slope at its end.
            same = converged and result.status.startswith("converged")
            result = replace(result, converged=converged, status=result.status if same else status)
        throws.append(
            replace(
                result,
                parameters=estimates,
                combinations=known.combinations,
                systematics=Systematics(dict(widths), own_shifts),
                **_of_throw(known, names[layout.index[throw]], tuple(estimates)),
                information=result.information | _information(linearized, own, open_),
            )
        )
    throws = [replace(one, quantities=quantities_of(one)) for one in throws]
    coefficients = {name: throws[0].parameters[name] for name in shared}
    absurd = [
        f"{item.data['file']}: {item.status}"
        for item in single
        if item.status.startswith(IMPLAUSIBLE)
    ]
    warnings = [
        f"{item.data['file']}: {warning}" for item in single for warning in item.warnings
        if "bound" not in warning
    ]  # fmt: skip
    differences = differences_of(solution, layout, coefficients, known.combinations, shared)
    for item in differences:
        if item.significant:
            warnings.insert(
                0,
                f"{item.expression} varies between throws by more than its errors ({item.p_text}); "
                f"the standard error of its mean over such throws is {item.stderr:.2g}, not that "
                "of the shared fit, and large residuals of single throws may be due to the common "
                "value rather than to their data",
            )
    # For a throw without a path the curl is at most one number, which the heading absorbs.
    paths = any(one.throw.has_path for one in rounds.throws)
    senses = np.array([one.parameters["omega0"].value > 0 for one in throws])
    differ = any(item.significant and _differs_by_spin(item, senses) for item in differences)
    if differ and paths and not model.has_slope:
        warnings.insert(
            0,
            "throws of opposite spins differ, as they do on ice that is not level; `--free "
            "slope_x` fits a common slope",
        )
    return JointResult(
        law=model.law.name,
        load=model.load,
        share=shared,
        converged=converged and not absurd,
        status=". ".join(absurd) or status,
        warnings=tuple(warnings),
        coefficients=coefficients,
        combinations=tuple(item for item in known.combinations if set(item.weights) <= set(shared)),
        rank=known.rank,
        parameters=int(open_.sum()),
        differences=differences,
        throws=tuple(throws),
        systematics=Systematics(
            dict(widths),
            {
                name: systematic[name]
                for name in (*shared, *(item.expression for item in known.combinations))
                if name in systematic
            },
        ),
    )


def _shifts(
    rounds: Rounds,
    layout: Layout,
    solution: JointSolution,
    widths: Mapping[str, float],
    open_: Booleans,
    factor: Floats,
) -> dict[str, Floats]:
    """Shifts of the open parameters due to conditions common to all throws."""
    model, problems, each = rounds.model, rounds.problems, solution.each
    batch = len(each.values)
    paths = predict_many(model, each.values, problems, batch)
    changes = residual_changes(model, problems, each.values, paths, widths, rounds.loss, batch)
    gradients = {}
    for name, change in changes.items():
        total = np.zeros(len(layout.names))
        np.add.at(total, layout.index, np.einsum("tcn,tcnp->tp", change, each.jacobian))
        gradients[name] = total[open_]
    return shifts(factor, gradients, layout.bounds.typical[open_])
