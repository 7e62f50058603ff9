"""Friction laws fitted to measured friction against speed: a data set alone, see
`curlfit.inference.together.data_sets`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike

import jax.numpy as jnp
import numpy as np

from curlfit.dynamics.contact import accelerations
from curlfit.errors import InputError
from curlfit.friction import Law, NetLaw, check_load
from curlfit.friction.family import family_of
from curlfit.friction.registry import laws_under
from curlfit.friction_tables.result import DataOfTable, FrictionFit, FrictionFits
from curlfit.inference.fit.caveats import of_bounds, of_ridges
from curlfit.inference.information.thresholds import CONVERGED
from curlfit.inference.together.data_sets import DataSet, LawOnSets
from curlfit.numerics.arrays import Floats
from curlfit.numerics.threads import in_threads
from curlfit.settings.choices import Comparing
from curlfit.stone import GRAVITY, Stone
from curlfit.throws.friction_table import FrictionTable, load_friction_table

_CURVE = 80  # speeds at which a fitted law is drawn


def fit_friction(
    table: FrictionTable | str | PathLike[str],
    laws: str | type[Law] | Sequence[str | type[Law]] | None = None,
    *,
    load: str = "uniform",
    stone: Stone | None = None,
) -> FrictionFits:
    """Fit laws to measured friction: their braking force at the speeds of the table.

    Parameters
    ----------
    table : a table, or its file.
    laws : one or several; all of curlfit that do not approximate another, if not given.
    load : "uniform" or "consistent". stone : its constants.

    Raises
    ------
    DataError : the file is not such a table. InputError : an unknown law or load; a law
        with more coefficients than the table has rows.

    Examples
    --------
    >>> friction = curlfit.fit_friction(
    ...     "data/sutor_1988_friction.csv", ["sutor", "power"]
    ... )
    >>> friction.fits[0].law
    'sutor'
    """
    if not isinstance(table, FrictionTable):
        table = load_friction_table(table)
    chosen_load = check_load(load)
    wanted = [law for law, _ in laws_under(laws, (chosen_load,))]
    usable = [law for law in wanted if len(law.coefficients()) < len(table.mu)]
    if not usable:
        raise InputError(
            f"{table.name} has {len(table.mu)} rows, and {wanted[0].name} has "
            f"{len(wanted[0].coefficients())} coefficients; expected more rows "
            "than coefficients"
        )
    chosen = Comparing.of(load=chosen_load, stone=stone or Stone())
    family = family_of(usable)
    sets = [DataSet(table.name, table=table)]

    def fitted(law: type[Law]) -> FrictionFit:
        return _fitted(LawOnSets(law, chosen_load, sets, chosen, family), table)

    with in_threads(fitted, [(law,) for law in usable]) as fits:
        in_order = sorted(fits, key=lambda fit: (not fit.converged, round(fit.bic, 6)))
    observed = {"speed": table.speed, "omega": table.omega, "mu": table.mu}
    sigma = "estimated"
    if table.sigma is not None:
        observed["sigma"] = table.sigma
        sigma = "given"
    return FrictionFits(DataOfTable(table.name, sigma), observed, tuple(in_order))


def _fitted(on_table: LawOnSets, table: FrictionTable) -> FrictionFit:
    """A law fitted to the table, which is its only data set."""
    law = on_table.law
    inside = on_table.of_set(0)
    count = len(table.mu)
    is_estimated = table.sigma is None
    alone, noise = on_table.alone(0)
    weights = on_table.weights(noise)
    optimum = on_table.optimum(inside, alone.values, weights)
    at_optimum = on_table.at_optimum(optimum)
    covariance = at_optimum.covariance(inside)
    rank = covariance.identifiability.rank
    dof = float(count - rank) if is_estimated else None
    departures = on_table.departures(covariance, optimum, inside, weights)
    estimates, combinations = at_optimum.estimates(covariance, dof, departures)
    chi_squared = float(optimum.chi_squared[inside].sum())
    # the last channel is that of friction; its rows are filled up to a power of two
    off = optimum.residual[inside][0, -1, :count] / weights[inside][0, -1, :count]
    sigma = noise.sigma[inside][0, -1] if table.sigma is None else _rms(table.sigma)
    misfit = chi_squared
    if is_estimated:  # sigma, at its likeliest value, is a parameter too
        misfit = count * math.log(float(off @ off) / count)
    speed = np.geomspace(table.speed.min(), table.speed.max(), _CURVE)
    acceleration = accelerations(
        law.from_vector(covariance.values),
        on_table.stack.requests[0].stone,
        on_table.model.load,
        jnp.asarray(speed),
        jnp.full(_CURVE, np.median(table.omega)),
    )
    return FrictionFit(
        law=law.name,
        load="" if issubclass(law, NetLaw) else on_table.model.load,
        converged=bool(covariance.distance < CONVERGED),
        coefficients=estimates,
        combinations=combinations,
        rank=rank,
        chi_squared=chi_squared,
        sigma=float(sigma),
        rms=_rms(off),
        bic=misfit + rank * math.log(count),
        warnings=(
            *of_bounds(estimates, covariance.identifiability.names),
            *of_ridges(estimates, departures),
        ),
        fitted=table.mu + off,
        curve={"speed": speed, "mu": -np.asarray(acceleration.eta) / GRAVITY},
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
