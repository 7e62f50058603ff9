"""Log evidence against nested sampling, and leave-one-out against importance
sampling of chains.

    python tests/statistics/samplers.py

writes the tables "evidence" and "leave-one-out" of README.md beside this file; the
extra `dev` brings dynesty (Speagle 2020) and arviz (Kumar et al. 2019). Each case is
one throw of 15 s at 10 Hz, 5 mm on x and y and 10 mrad on phi, whose sigmas are known.
Nested sampling is given the paths of the law alone: priors and densities of the noise
are written here with scipy.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm, truncnorm
from tables import Table

import curlfit
from curlfit.comparison.criteria import log_evidence, log_likelihood
from curlfit.comparison.leave_one_out import LeaveOneOut, leave_one_out
from curlfit.inference.fit.problems import problem_of
from curlfit.inference.model.likelihood import predict_channels

SIGMA = {"x": 0.005, "y": 0.005, "phi": 0.01}
REACH = 8.0  # standard errors of the initial state, within which it is integrated
LIVE = 400


@dataclass(frozen=True)
class Case:
    """A law fitted to a throw of another or the same, with values of coefficients."""

    title: str
    truth: str
    values: tuple[float, ...]
    fitted: str
    seed: int


CASES = (
    Case("`coulomb`", "coulomb", (0.009,), "coulomb", 3),
    Case(
        "`front-back`, a ridge",
        "front-back",
        (0.0018, 0.058, 0.009, 0.009),
        "front-back",
        3,
    ),
    Case(
        "`front-back`, a ridge and `mu1_xi` at its bound",
        "front-back",
        (0.0, 0.058, 0.009, 0.009),
        "front-back",
        7,
    ),
)


def fitted(case: Case) -> curlfit.FitResult:
    """The fit of a case."""
    law = curlfit.LAWS[case.truth](*case.values)
    throw = curlfit.synthetic_throw(
        law,
        curlfit.Stone(),
        v0=2.0,
        omega0=1.2,
        until=15.0,
        noise_xy=SIGMA["x"],
        noise_phi=SIGMA["phi"],
        seed=case.seed,
    )
    return curlfit.fit(throw.with_sigma(SIGMA), case.fitted, systematics={"all": 0.0})


def by_row(fit: curlfit.FitResult) -> Callable[[np.ndarray], np.ndarray]:
    """Log-likelihood of parameter vectors, shape (vectors, rows)."""
    problem = problem_of(fit)
    n = len(fit.observed["t"])
    measured = np.stack([fit.observed[name] for name in SIGMA])
    sigma = np.array(list(SIGMA.values()))[:, None]

    def found(vectors: np.ndarray) -> np.ndarray:
        paths = [
            predict_channels(fit.model, values, problem)[:3, :n] for values in vectors
        ]
        return norm.logpdf(measured, np.array(paths), sigma).sum(1)

    return found


def nested(fit: curlfit.FitResult, seed: int = 0) -> tuple[float, float, int]:
    """Log evidence by nested sampling, its error, and the number of
    likelihoods it took."""
    import dynesty

    law = {
        coefficient.name: coefficient for coefficient in fit.law_class.coefficients()
    }
    priors = []
    log_volume = 0.0
    for name, estimate in fit.parameters.items():
        if name in law:
            sd = 3 * max(law[name].typical, abs(law[name].default))
            priors.append(
                truncnorm(estimate.lower / sd, estimate.upper / sd, scale=sd).ppf
            )
        else:
            reach = REACH * estimate.stderr
            low = estimate.value - reach
            priors.append(lambda u, low=low, width=2 * reach: low + width * u)
            log_volume += np.log(2 * reach)
    likelihoods = by_row(fit)

    def transform(u: np.ndarray) -> np.ndarray:
        return np.array(
            [prior(coordinate) for prior, coordinate in zip(priors, u, strict=True)]
        )

    def likelihood(values: np.ndarray) -> float:
        total = float(likelihoods(values[None]).sum())
        return total if np.isfinite(total) else -1e300

    sampler = dynesty.NestedSampler(
        likelihood,
        transform,
        len(priors),
        nlive=LIVE,
        sample="rwalk",
        rstate=np.random.default_rng(seed),
    )
    sampler.run_nested(dlogz=0.1, print_progress=False)
    results: Any = sampler.results
    return (
        float(results.logz[-1] + log_volume),
        float(results.logzerr[-1]),
        int(sum(results.ncall)),
    )


def importance_sampled(
    fit: curlfit.FitResult, draws: int = 3000
) -> tuple[float, float]:
    """Log evidence of `front-back` and its error, from draws of the Gaussian about the
    optimum, of which mu1_eta - mu2_eta is drawn evenly along the ridge."""
    random = np.random.default_rng(0)
    size = len(fit.parameters)
    # mu1_eta + mu2_eta in the place of both
    to_all = np.delete(np.eye(size), 3, axis=1)
    to_all[[2, 3], 2] = 0.5
    information = to_all.T @ fit.information.matrix @ to_all
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(
        scale, scale
    )
    mean = covariance @ to_all.T @ fit.information.gradient
    proposal = multivariate_normal(mean, 1.2 * covariance)
    steps = proposal.rvs(draws, random_state=1)
    values = fit.values + steps @ to_all.T
    total = fit.values[2:4].sum() + steps[:, 2]
    difference = random.uniform(-total, total)
    values[:, 2:4] = np.stack([total + difference, total - difference], 1) / 2
    inside = (values[:, :4] >= 0).all(1)
    logs = by_row(fit)(values[inside]).sum(1) - proposal.logpdf(steps)[inside]
    # 2 mu_sum, the range of the difference, times the Jacobian, 1/2
    logs += np.log(total[inside])
    for column, coefficient in enumerate(fit.law_class.coefficients()):
        sd = 3 * max(coefficient.typical, abs(coefficient.default))
        prior = truncnorm(coefficient.lower / sd, coefficient.upper / sd, scale=sd)
        logs += prior.logpdf(values[inside, column])
    shares = np.exp(logs - logsumexp(logs))
    error = np.sqrt(max(float((shares**2).sum()) - 1 / draws, 0.0))
    return float(logsumexp(logs) - np.log(draws)), error


class Psis(NamedTuple):
    """Results of ArviZ, whose versions name them differently."""

    elpd: float
    p_loo: float
    left_out: Any
    stderr: float
    pareto_k: Any


def psis(fit: curlfit.FitResult, draws: int = 4000, seed: int = 0) -> Psis:
    """PSIS-LOO (Vehtari, Gelman and Gabry 2017) of draws from the chain."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz

        _, chain = curlfit.sample(fit, seed=seed, effective=2.0 * draws)
        some = chain.flat[:: max(len(chain.flat) // draws, 1)]
        logs = {"row": by_row(fit)(some)[None]}
        groups = {"posterior": {"first": some[None, :, 0]}, "log_likelihood": logs}
        old = arviz.__version__.startswith("0.")
        data = arviz.from_dict(**groups) if old else arviz.from_dict(groups)
        loo = arviz.loo(data, pointwise=True, reff=1.0)
        names = ("elpd_loo", "p_loo", "loo_i") if old else ("elpd", "p", "elpd_i")
        return Psis(*(getattr(loo, name) for name in names), loo.se, loo.pareto_k)


def closed_form(fit: curlfit.FitResult) -> LeaveOneOut:
    """That of curlfit."""
    loo = leave_one_out(fit)
    assert loo is not None
    return loo


def main() -> None:
    """Run the cases and write their tables."""
    evidence = Table(
        "", "curlfit", "dynesty", "difference", "likelihoods", "importance sampling"
    )
    loo = Table(
        "",
        "elpd_loo",
        "PSIS",
        "standard error",
        "PSIS",
        "p_loo",
        "PSIS",
        "largest Pareto k",
        "largest difference in a row",
    )
    for case in CASES:
        fit = fitted(case)
        by_curlfit = log_evidence(fit, sum(log_likelihood(fit).values()))
        by_dynesty, error, calls = nested(fit)
        drawn = ""
        if case.fitted == "front-back":
            drawn = "{:.2f} ± {:.2f}".format(*importance_sampled(fit))
        evidence.add(
            case.title,
            f"{by_curlfit:.2f}",
            f"{by_dynesty:.2f} ± {error:.2f}",
            f"{by_curlfit - by_dynesty:+.2f}",
            calls,
            drawn,
        )
        mine = closed_form(fit)
        sampled = psis(fit)
        off = np.abs(mine.left_out - np.asarray(sampled.left_out)).max()
        pairs = (
            (getattr(mine, name), getattr(sampled, name))
            for name in ("elpd", "stderr", "p_loo")
        )
        loo.add(
            case.title,
            *(f"{number:.2f}" for pair in pairs for number in pair),
            f"{float(sampled.pareto_k.max()):.2f}",
            f"{off:.3f}",
        )
    evidence.put("evidence")
    loo.put("leave-one-out")


if __name__ == "__main__":
    main()
