"""What a posterior says: of a fit, in its record, and of a chain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from curlfit.foreign import counted
from curlfit.inference.derived.quantiles import Quantiles, quantiles_of
from curlfit.inference.fit.estimate_columns import interval_in_words
from curlfit.output.document import Document, Section
from curlfit.output.table import Column, Table
from curlfit.wording import from_to

if TYPE_CHECKING:
    from curlfit.inference.fit.estimates import Posterior
    from curlfit.inference.sampling.chain import Chain

_SHOWN = 4  # parameters in a line


def of_posterior(posterior: Posterior) -> Document:
    """What the posterior of a fit says."""
    sampling = sampled(posterior)
    table = _table(posterior.quantiles)
    return Document(
        finding=posterior.status,
        style=style(posterior),
        subject=counted(len(posterior.ess), "parameter"),
        lines=[sampling],
        sections=[Section("quantiles", "Quantiles", (table, sampling))],
    )


def of_chain(chain: Chain) -> Document:
    """What a chain says."""
    steps, walkers, _ = chain.values.shape
    quantiles = {
        name: quantiles_of(samples)
        for name, samples in zip(chain.names, chain.flat.T, strict=True)
        if len(samples) and np.ptp(samples) > 0
    }
    first = list(quantiles)[:_SHOWN]
    line = "68 %: " + ", ".join(
        f"{name} {interval_in_words(quantiles[name])}" for name in first
    )
    if len(quantiles) > _SHOWN:
        line += " ..."
    return Document(
        finding=f"{len(chain.flat)} samples",
        subject=(
            f"{counted(chain.ensembles, 'ensemble')}, {counted(walkers, 'walker')}, "
            f"{counted(steps, 'step')}, of which the first "
            f"{chain.discarded} are left out"
        ),
        lines=[line],
        sections=[Section("quantiles", "Quantiles", [_table(quantiles)])],
    )


class _Interval(NamedTuple):
    """Quantiles of a parameter."""

    name: str
    quantiles: Quantiles

    @property
    def wide(self) -> str:
        """The interval that holds 95 % of the samples, to the digit of that of 68 %."""
        scale = (self.quantiles["84"] - self.quantiles["16"]) / 3
        return from_to(self.quantiles["2.5"], self.quantiles["97.5"], scale)


_COLUMNS: tuple[Column[_Interval], ...] = (
    Column("parameter", key="name"),
    Column("68 %", format=interval_in_words, right=True, key="quantiles"),
    Column("95 %", right=True, key="wide"),
)


def _table(quantiles_by_name: Mapping[str, Quantiles]) -> Table[_Interval]:
    """Intervals of 68 and 95 % of each parameter."""
    return Table([_Interval(*pair) for pair in quantiles_by_name.items()], _COLUMNS)


def style(posterior: Posterior) -> str:
    """The style of the status of a posterior."""
    return "green" if posterior.converged else "bold yellow"


def sampled(posterior: Posterior) -> str:
    """A sentence on how a posterior was sampled, and how well."""
    worst = max(posterior.r_hat, key=posterior.r_hat.__getitem__)
    sizes = []
    for part, size_by_name in (("bulk", posterior.ess), ("tail", posterior.ess_tail)):
        if size_by_name:
            least = min(size_by_name, key=size_by_name.__getitem__)
            sizes.append(f"{size_by_name[least]:.0f} in the {part} ({least})")
    return (
        f"{posterior.samples} samples ({posterior.ensembles} ensembles, "
        f"{posterior.walkers} walkers, {posterior.steps} steps), "
        f"effective sample size at least {' and '.join(sizes)}, "
        f"R-hat at most {posterior.r_hat[worst]:.4f} ({worst}), "
        f"acceptance {posterior.acceptance:.0%}."
    )
