"""The posterior of a population of throws, against NUTS (numpyro).

    python tests/statistics/populations.py

writes its table into README.md beside this file. NUTS samples the coefficients of every
throw, whose log-likelihood is the quadratic about the optimum of this throw alone;
curlfit samples the spreads of the joint fit, and integrates the rest out. The priors
are the same: flat.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from evenings import COLUMNS, TRUTHS, Evening, as_throw
from numpyro.infer import MCMC, NUTS, init_to_value
from simulator import simulated
from tables import Table

import curlfit
from curlfit.inference.derived.quantiles import LEVELS
from curlfit.inference.fit.coefficient_rows import coefficient_rows
from curlfit.inference.together.effects import Covariates

WARM = 2000
DRAWS = 10_000
CHAINS = 4
TRUTH = TRUTHS["front-back"]


def stopwatch_records(number: int, seed: int) -> list[curlfit.Throw]:
    """The first draws of an evening with all its columns."""
    evening = Evening(TRUTH, COLUMNS["three"], seed)
    return [
        as_throw(row, evening.labels(draw))
        for draw, row in enumerate(evening.rows[:number])
    ]


def tracks(number: int, seed: int) -> list[curlfit.Throw]:
    """Tracks of 24 rows in 23 s of an evening's draws, with noise of 5 cm and 50 mrad
    (sigma given)."""
    evening = Evening(TRUTH, (), seed)
    noise = np.random.default_rng(seed)
    times = np.arange(24.0)
    throws = []
    for draw in range(number):
        coefficients = evening.law_of_a_draw(evening.sheets[draw], evening.hours[draw])
        v = noise.uniform(2.19, 2.29)
        w = 1.3
        path = simulated(TRUTH.law, coefficients, v, w, times)
        x, y, phi = path + 0.05 * noise.standard_normal(path.shape)
        throw = curlfit.Throw.from_arrays(times, x, y, phi, labels=evening.labels(draw))
        throws.append(throw.with_sigma({"x": 0.05, "y": 0.05, "phi": 0.05}))
    return throws


SETS = {
    "8 stopwatch records": stopwatch_records(8, 5),
    "6 tracks": tracks(6, 6),
}
FIXED = {"mu1_xi": 0.004, "mu1_eta": 0.009}


def flat(*shape: int) -> Any:
    """An improper density."""
    return dist.ImproperUniform(dist.constraints.real, (), shape)


def by_nuts(joint: curlfit.JointResult, throws: list[curlfit.Throw]) -> dict[str, Any]:
    """Draws of the mean, of the effect of the sheet and of the spreads."""
    means = joint.means
    assert means is not None
    alone = [
        curlfit.fit(throw, "front-back", fix=FIXED, details=False) for throw in throws
    ]
    rows = np.array([coefficient_rows(fit) for fit in alone])
    labels = [(throw.name, throw.labels) for throw in throws]
    covariate = Covariates.of(labels, ["sheet"], []).values[:, 0]
    directions = np.asarray(means.directions)
    k = len(means.spreads)
    size = len(means.names)
    scale = np.sqrt(np.diagonal(np.asarray(means.covariance)))[:size]
    free = scale > 0
    spread_scale = np.array(
        [
            max(
                variation.spread,
                0.1 * np.median([pair[1] for pair in variation.each if pair]),
            )
            for variation in joint.variation
            if variation.quantiles
        ]
    )

    def model() -> None:
        z = numpyro.sample("z", flat(int(free.sum())))
        mean = jnp.asarray(means.estimate[:size]).at[free].add(scale[free] * z)
        effect = spread_scale * numpyro.sample("e", flat(k))
        spread = spread_scale * jnp.abs(numpyro.sample("s", flat(k)))
        u = numpyro.sample("u", dist.Normal(0, 1).expand([len(rows), k]).to_event(2))
        coefficients = mean + (effect * covariate[:, None] + spread * u) @ directions.T
        left = (rows[..., :-1] @ coefficients[..., None])[..., 0] - rows[..., -1]
        numpyro.factor("throws", -0.5 * (left**2).sum())
        for name, values in (("mean", mean), ("effect", effect), ("spread", spread)):
            numpyro.deterministic(name, values)

    start = {
        "z": np.zeros(int(free.sum())),
        "e": np.zeros(k),
        "s": np.ones(k),
        "u": np.zeros((len(rows), k)),
    }
    kernel = NUTS(
        model,
        init_strategy=init_to_value(values=start),
        target_accept_prob=0.95,
        dense_mass=True,
    )
    run = MCMC(
        kernel,
        num_warmup=WARM,
        num_samples=DRAWS,
        num_chains=CHAINS,
        chain_method="sequential",
        progress_bar=False,
    )
    run.run(jax.random.PRNGKey(2))
    samples = run.get_samples(group_by_chain=True)
    return {name: np.asarray(samples[name]) for name in ("mean", "effect", "spread")}


def main() -> None:
    """Run both and write the table."""
    table = Table("", "", *(f"{level} %" for level in LEVELS))
    for title, throws in SETS.items():
        began = time.time()
        joint = curlfit.fit_together(
            throws,
            "front-back",
            by="sheet",
            fix=FIXED,
            systematics={"all": 0.0},
            seed=1,
        )
        mine = time.time() - began
        draws = by_nuts(joint, throws)
        assert joint.means is not None
        varying = [variation for variation in joint.variation if variation.quantiles]
        of_mean, of_effect, of_spread = (
            draws[name].reshape(CHAINS * DRAWS, -1)
            for name in ("mean", "effect", "spread")
        )
        for column, (name, spread) in enumerate(
            (variation.expression, variation.quantiles) for variation in varying
        ):
            weights = np.linalg.pinv(np.asarray(joint.means.directions))[column]
            for what, quantiles, sample in (
                ("mean", one_of(joint.groups, name, "").quantiles, of_mean @ weights),
                (
                    "sheet 2 - 1",
                    one_of(joint.differences, name, "sheet").quantiles,
                    of_effect[:, column],
                ),
                ("spread", spread, of_spread[:, column]),
            ):
                other = np.quantile(sample, [float(level) / 100 for level in LEVELS])
                width = other[3] - other[1]
                ours = np.array([quantiles[level] for level in LEVELS])
                table.add(
                    title, f"{what}, {name}", *(f"{value:.5g}" for value in other)
                )
                table.add(
                    "",
                    "off, 68 % widths",
                    *(f"{o:+.2f}" for o in (ours - other) / width),
                )
        print(
            f"{mine:.0f} s against {time.time() - began - mine:.0f} s", file=sys.stderr
        )
    table.put("populations")


def one_of(effects: tuple[Any, ...], name: str, by: str) -> Any:
    """The effect in a quantity, by a label."""
    return next(
        effect for effect in effects if (effect.parameter, effect.by) == (name, by)
    )


if __name__ == "__main__":
    main()
