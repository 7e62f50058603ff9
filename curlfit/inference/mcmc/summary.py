"""Summary of a chain as the posterior in the record of its fit."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from curlfit.errors import InputError
from curlfit.inference.derived import quantiles_of
from curlfit.inference.fit.result import FitResult, Posterior
from curlfit.inference.mcmc.chain import Chain, load_chain
from curlfit.inference.mcmc.convergence import Diagnosis


def unfinished_posterior(
    fit: FitResult, file: str | PathLike[str]
) -> tuple[FitResult, Chain] | None:
    """An unfinished sample left on disk: the fit with a posterior marked as unfinished, and the
    chain. None where `file` is missing, too short to be judged, or of another fit."""
    if not Path(file).is_file():
        return None
    chain = load_chain(file)
    try:
        chain = chain.with_fit(fit)
    except InputError:  # of the fit before this one
        return None
    if len(chain.values) < 4:
        return None
    return replace(summarised(fit, chain, "not finished"), sampling="unfinished"), chain


def summarised(
    fit: FitResult,
    chain: Chain,
    ended: str,
    effective: float | None = None,
    diagnosis: Diagnosis | None = None,
) -> FitResult:
    """The fit with the summary of a chain. `ended` says how the run ended, `effective` is the
    target for the effective sample size, and `diagnosis` that of the chain; None where they are
    not known."""
    free = fit.parameter_set.free
    names = fit.parameter_set.names_where(free)
    diagnosis = diagnosis or Diagnosis(chain.values[:, :, free], chain.ensembles)
    quantities = {name: chain.of({name: 1.0}) for name in names}
    correlation = np.atleast_2d(np.corrcoef(np.stack(list(quantities.values()))))
    quantities |= {item.expression: chain.of(item.weights) for item in fit.combinations}
    steps, walkers, _ = chain.values.shape
    status = ended
    if ended != "converged":
        wanted = "" if effective is None else f" of {effective:.0f} wanted"
        status += (
            f": {diagnosis.least_effective:.0f} effective samples{wanted}, "
            f"R-hat {diagnosis.worst_r_hat:.3f}"
        )
    if chain.state is not None and not chain.state.mostly_ridge:
        status += (
            "; its shape differs from the approximation by the fit, so most proposals were "
            "ensemble moves"
        )
    posterior = Posterior(
        samples=len(chain.flat),
        steps=steps,
        discarded=chain.discarded,
        walkers=walkers,
        ensembles=chain.ensembles,
        seed=chain.seed,
        acceptance=float(chain.accepted.mean() / max(steps - 1, 1)),
        ess=dict(zip(names, map(float, diagnosis.bulk), strict=True)),
        ess_tail=dict(zip(names, map(float, diagnosis.tail), strict=True)),
        r_hat=dict(zip(names, map(float, diagnosis.r_hat), strict=True)),
        quantiles={name: quantiles_of(values) for name, values in quantities.items()},
        mean={name: float(values.mean()) for name, values in quantities.items()},
        sd={name: float(values.std()) for name, values in quantities.items()},
        correlation={
            name: dict(zip(names, map(float, row), strict=True))
            for name, row in zip(names, correlation, strict=True)
        },
        converged=effective is not None and diagnosis.good(effective),
        status=status,
    )
    return fit.with_posterior(posterior)
