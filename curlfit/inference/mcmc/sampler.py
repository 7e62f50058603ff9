"""The posterior by emcee: four ensembles, sampled until convergence, and a verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from os import PathLike
from pathlib import Path

from curlfit.errors import InputError
from curlfit.inference.fit.quantities import quantities_of
from curlfit.inference.fit.result import FitResult, require_fit
from curlfit.inference.mcmc.chain import Chain, load_chain
from curlfit.inference.mcmc.checkpoint import CheckpointWriter
from curlfit.inference.mcmc.run import Run
from curlfit.inference.mcmc.summary import summarised


def sample(
    fit: FitResult,
    *,
    seed: int = 0,
    effective: float = 4000.0,
    most_steps: int = 2_000,
    progress: Callable[[float, int, float], None] | None = None,
    checkpoint: str | PathLike[str] | None = None,
    resume: bool = False,
) -> tuple[FitResult, Chain]:
    """Sample the posterior about a fit until convergence.

    A parameter without a prior in the fit has a flat one within its bounds. The noise has the
    fit's sigmas, is independent or correlated by the fit's noise model, and is Gaussian or has the
    density of the fit's loss. Ctrl-C ends the run and keeps the steps so far.

    Parameters
    ----------
    fit : a fit, fresh or loaded.
    seed : of the random numbers; the same seed gives the same chain.
    effective : target for the effective sample size of every parameter.
    most_steps : number of steps at which to stop if that is not reached.
    progress : called at intervals with the effective sample size so far (smallest over
        parameters), the steps so far, and R-hat (largest).
    checkpoint : a `chain.h5` to which the chain so far is written atomically: after the first
        step, then every two seconds or less often where writing takes long, and when the run ends.
    resume : continue where the chain in `checkpoint` ended, if there is one. The chain is then
        that of a single run, bit for bit on the same machine with the same packages.

    Returns
    -------
    the fit with its `posterior` filled in, and the chain.

    Raises
    ------
    UnusableFitError : no walker found a point of finite posterior.
    InputError : the chain to be resumed is of other data, law, load, stone, bounds, seed or
        version, or the checkpoint cannot be written.

    Examples
    --------
    >>> sampled, chain = curlfit.sample(fit, effective=400)
    >>> sampled.posterior.converged
    True
    """
    require_fit(fit)
    run = Run(fit, seed)
    file = None if checkpoint is None else Path(checkpoint)
    if resume:
        if file is None:
            raise InputError("resume: expected a checkpoint to resume from")
        if file.exists():
            run.resume(load_chain(file), file)
    checkpoints = CheckpointWriter(file)
    ended, diagnosis = "stopped by the user", None
    try:
        run.begin()
        while True:
            if run.block_is_over:
                if run.ridge_proposals_fail:
                    run.start_over()
                    continue
                diagnosis = run.diagnosis()
                if progress is not None:
                    progress(diagnosis.least_effective, run.steps, diagnosis.worst_r_hat)
                if diagnosis.good(effective):
                    ended = "converged"
                    break
                if run.steps >= most_steps:
                    ended = f"not converged after {run.steps} steps"
                    break
            for _ in run.block():
                checkpoints.write_if_due(run)
    except KeyboardInterrupt:
        if run.steps < 4:
            raise
        diagnosis = None  # of earlier steps
    chain = run.chain()
    if file is not None:
        chain.save(file)
    sampled = summarised(fit, chain, ended, effective, diagnosis)
    sampled = replace(sampled, quantities=quantities_of(sampled, chain))
    sampled = sampled.with_derived((item.expression for item in fit.derived), chain)
    return sampled, replace(chain, fit=sampled)
