"""What a posterior says: of a fit, in its record, and of a chain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from curlfit.foreign import counted
from curlfit.inference.derived import Quantiles, quantiles_of
from curlfit.output.console import PlainTable
from curlfit.output.document import Document, Section
from curlfit.wording import from_to

if TYPE_CHECKING:
    from curlfit.inference.fit.estimates import Posterior
    from curlfit.inference.mcmc.chain import Chain

_SHOWN = 4  # parameters in a line


def of_posterior(posterior: Posterior) -> Document:
    """What the posterior of a fit says."""
    said = sampled(posterior)
    return Document(
        finding=posterior.status,
        style=style(posterior),
        subject=counted(len(posterior.ess), "parameter"),
        lines=[said],
        sections=[
            Section("quantiles", "Quantiles", (_table(posterior.quantiles), said))
        ],
    )


def of_chain(chain: Chain) -> Document:
    """What a chain says."""
    steps, walkers, _ = chain.values.shape
    known = {
        name: quantiles_of(samples)
        for name, samples in zip(chain.names, chain.flat.T, strict=True)
        if len(samples) and np.ptp(samples) > 0
    }
    shown = ", ".join(f"{name} {_middle(known[name])}" for name in list(known)[:_SHOWN])
    return Document(
        finding=f"{len(chain.flat)} samples",
        subject=(
            f"{counted(chain.ensembles, 'ensemble')}, {counted(walkers, 'walker')}, "
            f"{counted(steps, 'step')}, of which the first "
            f"{chain.discarded} are left out"
        ),
        lines=[f"68 %: {shown} ..." if len(known) > _SHOWN else f"68 %: {shown}"],
        sections=[Section("quantiles", "Quantiles", [_table(known)])],
    )


def _table(quantiles: Mapping[str, Quantiles]) -> PlainTable:
    return PlainTable(
        {
            "parameter": name,
            ">68 %": _middle(one),
            ">95 %": from_to(one["2.5"], one["97.5"], (one["84"] - one["16"]) / 3),
        }
        for name, one in quantiles.items()
    )


def _middle(quantiles: Quantiles) -> str:
    return from_to(quantiles["16"], quantiles["84"])


def style(posterior: Posterior) -> str:
    """The style of its status."""
    return "green" if posterior.converged else "bold yellow"


def sampled(posterior: Posterior) -> str:
    """How it was sampled, and how well."""
    worst = max(posterior.r_hat, key=posterior.r_hat.__getitem__)
    sizes = []
    for part, ess in (("bulk", posterior.ess), ("tail", posterior.ess_tail)):
        if ess:
            least = min(ess, key=ess.__getitem__)
            sizes.append(f"{ess[least]:.0f} in the {part} ({least})")
    return (
        f"{posterior.samples} samples ({posterior.ensembles} ensembles, "
        f"{posterior.walkers} walkers, {posterior.steps} steps), "
        f"effective sample size at least {' and '.join(sizes)}, "
        f"R-hat at most {posterior.r_hat[worst]:.4f} ({worst}), "
        f"acceptance {posterior.acceptance:.0%}."
    )
