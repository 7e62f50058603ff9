"""The posterior of a population of throws, against NUTS (numpyro) on all parameters.

    python tests/statistics/populations.py

writes its table into README.md beside this file. NUTS samples the coefficients and the own
parameters of every throw under the likelihood of the paths themselves; curlfit integrates all but
the spreads out, to first order about each throw. The priors are the same: flat.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from evenings import GRID, STONE, law_at, path_of, timed
from numpyro.diagnostics import summary
from numpyro.infer import MCMC, NUTS, init_to_value
from tables import head, put, row

import curlfit
from curlfit.inference.derived import LEVELS
from curlfit.inference.fit.prepared import problem_of
from curlfit.inference.joint.effects import Covariates
from curlfit.inference.likelihood import log_likelihood

WARM, DRAWS, CHAINS = 300, 600, 2


def draws(number: int, seed: int) -> list[curlfit.Throw]:
    """Stopwatch records of two sheets in turn."""
    random, found = np.random.default_rng(seed), []
    for draw in range(number):
        sheet, side = draw % 2 + 1, 1 if draw // 2 % 2 else -1
        path = path_of(law_at(draw, sheet, random), random.uniform(2.19, 2.29), 1.3 * side)
        found.append(replace(timed(path, random), labels={"sheet": f"{sheet}"}))
    return found


def tracks(number: int, seed: int) -> list[curlfit.Throw]:
    """Tracks of 25 rows, with noise of 5 cm and 50 mrad."""
    random, found = np.random.default_rng(seed), []
    for draw in range(number):
        path = path_of(law_at(draw, draw % 2 + 1, random), random.uniform(2.19, 2.29), 1.3)
        rows = slice(0, 240, 10)
        x, y, phi = (getattr(path, name)[rows] for name in ("x", "y", "phi"))
        x, y, phi = (one + 0.05 * random.standard_normal(len(x)) for one in (x, y, phi))
        throw = curlfit.Throw.from_arrays(
            GRID[rows], x, y, phi, labels={"sheet": f"{draw % 2 + 1}"}
        )
        found.append(throw.with_sigma({"x": 0.05, "y": 0.05, "phi": 0.05}))
    return found


SETS = {
    "8 stopwatch records": draws(8, 5),
    "6 tracks": tracks(6, 6),
}
FIXED = {"mu1_xi": 0.004, "mu1_eta": 0.009, "heading": 0.0}


def flat(*shape: int) -> Any:
    """An improper density."""
    return dist.ImproperUniform(dist.constraints.real, (), shape)


def by_nuts(joint: curlfit.JointResult, seed: int) -> dict[str, Any]:
    """Draws of the mean, of the effect of the sheet and of the spreads, by name."""
    means, fits = joint.means, joint.throws
    assert means is not None
    k = len(means.spreads)
    labels = [(one.data["file"], one.data["labels"]) for one in fits]
    covariate = Covariates.of(labels, ["sheet"], []).values
    directions = np.asarray(means.directions)
    scale = np.sqrt(np.diagonal(np.asarray(means.covariance)))[: len(means.names)]
    free = scale > 0
    problems = [problem_of(one) for one in fits]
    own = [one for one in fits[0].parameters if one not in means.names]
    moving = [fits[0].parameters[name].stderr is not None for name in own]
    size = np.array([[one.parameters[name].stderr or 0.0 for name in own] for one in fits])
    begin = np.array([[one.parameters[name].value for name in own] for one in fits])
    each = np.array([item.first_spread for item in joint.variation if item.quantiles])

    def model() -> None:
        z = numpyro.sample("mean", flat(int(free.sum())))
        mean = jnp.asarray(means.estimate[: len(scale)]).at[free].add(scale[free] * z)
        effect = each * numpyro.sample("effect", flat(k))
        spread = each * jnp.abs(numpyro.sample("spread", flat(k)))
        u = numpyro.sample("u", dist.Normal(0, 1).expand([len(fits), k]).to_event(2))
        starts = numpyro.sample("own", flat(len(fits), sum(moving)))
        numpyro.deterministic("of_mean", mean)
        numpyro.deterministic("of_effect", effect)
        numpyro.deterministic("of_spread", spread)
        total = 0.0
        for row_, (fit, (problem, origin)) in enumerate(zip(fits, problems, strict=True)):
            deviation = directions @ (effect * covariate[row_, 0] + spread * u[row_])
            here = (
                jnp.asarray(begin[row_])
                .at[np.array(moving)]
                .add(size[row_][np.array(moving)] * starts[row_])
            )
            values = jnp.concatenate([mean + deviation, here]) - origin.offset(len(fit.parameters))
            total += log_likelihood(fit.model, values, problem)
        numpyro.factor("paths", total)

    start = {
        "mean": np.zeros(int(free.sum())), "effect": np.zeros(k), "spread": np.ones(k),
        "u": np.zeros((len(fits), k)), "own": np.zeros((len(fits), sum(moving))),
    }  # fmt: skip
    kernel = NUTS(model, init_strategy=init_to_value(values=start), target_accept_prob=0.95)
    run = MCMC(
        kernel, num_warmup=WARM, num_samples=DRAWS, num_chains=CHAINS, chain_method="sequential",
        progress_bar=False,
    )  # fmt: skip
    run.run(jax.random.PRNGKey(seed))
    found = run.get_samples(group_by_chain=True)
    print({k: np.asarray(v["n_eff"]).round() for k, v in summary(found).items() if "of_" in k},
          file=sys.stderr)  # fmt: skip
    return {name: np.asarray(found[name]) for name in ("of_mean", "of_effect", "of_spread")}


def main() -> None:
    """Run both and write the table."""
    table = head("", "", *(f"{level} %" for level in LEVELS))
    for title, throws in SETS.items():
        began = time.time()
        joint = curlfit.fit_together(
            throws,
            "front-back",
            stone=STONE,
            by="sheet",
            fix=FIXED,
            systematics={"all": 0.0},
            seed=1,
        )
        mine = time.time() - began
        found = by_nuts(joint, 2)
        assert joint.means is not None
        varying = [item for item in joint.variation if item.quantiles]
        of_mean, of_effect, of_spread = (
            found[name].reshape(CHAINS * DRAWS, -1)
            for name in ("of_mean", "of_effect", "of_spread")
        )
        for place, (name, spread) in enumerate((one.expression, one.quantiles) for one in varying):
            weights = np.linalg.pinv(np.asarray(joint.means.directions))[place]
            for what, quantiles, sample in (
                ("mean", one_of(joint.groups, name, "").quantiles, of_mean @ weights),
                (
                    "sheet 2 - 1",
                    one_of(joint.differences, name, "sheet").quantiles,
                    of_effect[:, place],
                ),
                ("spread", spread, of_spread[:, place]),
            ):
                other = np.quantile(sample, [float(level) / 100 for level in LEVELS])
                width = other[3] - other[1]
                ours = np.array([quantiles[level] for level in LEVELS])
                table.append(row([title, f"{what}, {name}"] + [f"{value:.5g}" for value in other]))
                table.append(
                    row(["", "off, 68 % widths"] + [f"{o:+.2f}" for o in (ours - other) / width])
                )
                print("\n".join(table[-2:]), file=sys.stderr)
        print(f"{mine:.0f} s against {time.time() - began - mine:.0f} s", file=sys.stderr)
    put("populations", "\n".join(table) + "\n")


def one_of(effects: tuple[Any, ...], name: str, by: str) -> Any:
    """The effect in a quantity, by a label."""
    return next(item for item in effects if (item.parameter, item.by) == (name, by))


if __name__ == "__main__":
    main()
