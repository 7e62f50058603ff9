"""Friction laws fitted to measured friction against speed: a data set alone, see
`curlfit.inference.joint.data_sets`."""

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
from curlfit.friction_tables.result import FrictionFit, FrictionFits
from curlfit.inference.fit.caveats import of_bounds, of_ridges
from curlfit.inference.fit.covariance import CONVERGED
from curlfit.inference.joint.data_sets import DataSet, LawOnSets
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
    with in_threads(
        lambda law: _fitted(LawOnSets(law, chosen_load, sets, chosen, family), table),
        [(law,) for law in usable],
    ) as each:
        fits = sorted(each, key=lambda one: (not one.converged, round(one.bic, 6)))
    observed = {"speed": table.speed, "omega": table.omega, "mu": table.mu}
    return FrictionFits(
        {"file": table.name, "sigma": "estimated" if table.sigma is None else "given"},
        observed if table.sigma is None else observed | {"sigma": table.sigma},
        tuple(fits),
    )


def _fitted(on: LawOnSets, table: FrictionTable) -> FrictionFit:
    inside, count, law = on.of_set(0), len(table.mu), on.law
    alone, noise = on.alone(0)
    weights = on.weights(noise)
    found = on.optimum(inside, alone.values, weights)
    joint = on.told(found)
    known = joint.by(inside)
    rank = known.identifiability.rank
    dof = float(count - rank) if table.sigma is None else None
    departures = on.departures(known, found, inside, weights)
    estimates, combinations = joint.estimates(known, dof, departures)
    chi_squared = float(found.chi_squared[inside].sum())
    raw = found.residual[inside][0, -1, :count] / weights[inside][0, -1, :count]
    # sigma, if estimated, is a parameter too
    misfit = chi_squared if dof is None else count * math.log(float(raw @ raw) / count)
    sigma = noise.sigma[inside][0, -1] if table.sigma is None else _rms(table.sigma)
    curve = np.geomspace(table.speed.min(), table.speed.max(), _CURVE)
    along = accelerations(
        law.from_vector(known.values),
        on.rounds.throws[0].stone,
        on.model.load,
        jnp.asarray(curve),
        jnp.full(_CURVE, np.median(table.omega)),
    ).eta
    return FrictionFit(
        law=law.name,
        load="" if issubclass(law, NetLaw) else on.model.load,
        converged=bool(known.distance < CONVERGED),
        coefficients=estimates,
        combinations=combinations,
        rank=rank,
        chi_squared=chi_squared,
        sigma=float(sigma),
        rms=_rms(raw),
        bic=misfit + rank * math.log(count),
        warnings=(
            *of_bounds(estimates, known.identifiability.names),
            *of_ridges(estimates, departures),
        ),
        fitted=table.mu + raw,
        curve={"speed": curve, "mu": -np.asarray(along) / GRAVITY},
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
