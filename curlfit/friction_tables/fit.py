"""Friction laws fitted to measured friction against speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import Array

from curlfit.dynamics.contact import accelerations
from curlfit.errors import InputError
from curlfit.friction import LAWS, Law, Load, NetLaw, check_load, find_law
from curlfit.friction_tables.result import FrictionFit, FrictionFits
from curlfit.friction_tables.table import FrictionTable, load_friction_table
from curlfit.inference.fit.caveats import of_bounds
from curlfit.inference.fit.covariance import CONVERGED, Covariance, Sigmas
from curlfit.inference.fit.estimates import Estimate
from curlfit.inference.fit.factors import Factors
from curlfit.inference.fit.summary import weakness
from curlfit.inference.identifiability import Bounded, r_factor
from curlfit.inference.least_squares import PRECISE
from curlfit.numerics.arrays import Floats
from curlfit.numerics.arrow_matrix import Blocks
from curlfit.numerics.bounded_solver import BoundedDescent, BoundedLeastSquares, GainRatio
from curlfit.stone import GRAVITY, Stone

_CURVE = 80  # speeds at which a fitted law is drawn
_STARTS = 1.0, 0.4, 2.5  # multiples of the default coefficients


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
    DataError : the file is not such a table. InputError : an unknown law or load; a law with more
        coefficients than the table has rows.

    Examples
    --------
    >>> friction = curlfit.fit_friction("data/sutor_1988_friction.csv", ["sutor", "power"])
    >>> friction.fits[0].law
    'sutor'
    """
    if not isinstance(table, FrictionTable):
        table = load_friction_table(table)
    if laws is None:
        laws = [law for law in LAWS.values() if law.shipped() and not law.approximates]
    wanted = [find_law(law) for law in ([laws] if isinstance(laws, str | type) else laws)]
    usable = [law for law in wanted if len(law.coefficients()) < len(table.mu)]
    if not usable:
        raise InputError(
            f"{table.name} has {len(table.mu)} rows, and {wanted[0].name} has "
            f"{len(wanted[0].coefficients())} coefficients; expected more rows than coefficients"
        )
    fits = [_fit(law, check_load(load), stone or Stone(), table) for law in usable]
    observed = {"speed": table.speed, "omega": table.omega, "mu": table.mu}
    return FrictionFits(
        {"file": table.name, "sigma": "estimated" if table.sigma is None else "given"},
        observed if table.sigma is None else observed | {"sigma": table.sigma},
        tuple(sorted(fits, key=lambda one: (not one.converged, one.bic))),
    )


def _fit(law: type[Law], load: Load, stone: Stone, table: FrictionTable) -> FrictionFit:
    items = law.coefficients()
    lower, upper, typical, default = np.array(
        [
            (item.default, item.default, item.typical, item.default)
            if item.optional
            else (item.lower, item.upper, item.typical, item.default)
            for item in items
        ]
    ).T
    weight = np.ones(len(table.mu)) if table.sigma is None else 1 / table.sigma

    def friction(values: Array, speed: Any, omega: Any) -> Array:
        return -accelerations(law.from_vector(values), stone, load, speed, omega).eta / GRAVITY

    def residual(values: Array, _: Any) -> Array:
        return (friction(values, table.speed, table.omega) - table.mu) * weight

    @jax.jit
    def solved(start: Array) -> Any:
        solver = BoundedLeastSquares(
            descent=BoundedDescent(lower, upper, typical), search=GainRatio(PRECISE.damping),
            control=PRECISE, blocks=Blocks.of(np.ones(len(items), bool)), penalty=None,
        )  # fmt: skip
        found: Any = optx.least_squares(residual, solver, start, None, max_steps=None, throw=False)
        return found.value, found.state.residual, found.state.jacobian

    starts = [np.clip(scale * default, lower, upper) for scale in _STARTS]
    each = [tuple(map(np.asarray, solved(jnp.asarray(start)))) for start in starts]
    values, rest, jacobian = min(
        each, key=lambda one: np.nan_to_num(np.sum(one[1] ** 2), nan=np.inf)
    )
    raw = rest / weight
    free = max(len(raw) - int(np.linalg.matrix_rank(jacobian[:, upper > lower])), 1)
    sigma = 1.0 if table.sigma is not None else max(float(np.sqrt(rest @ rest / free)), 1e-12)
    about = Bounded(values, lower, upper), typical, rest / sigma, jacobian / sigma
    found = _covariance(items, *about, estimated=table.sigma is None)
    estimates = _estimates(items, found)
    curve = np.geomspace(table.speed.min(), table.speed.max(), _CURVE)
    spin = np.full(_CURVE, float(np.median(table.omega)))
    chi_squared, count = float(rest @ rest) / sigma**2, len(raw)
    rank = int(found.identifiability.rank)
    # sigma, if estimated, is a parameter too
    misfit = (
        chi_squared if table.sigma is not None else count * math.log(float(rest @ rest) / count)
    )
    return FrictionFit(
        law=law.name, load="" if issubclass(law, NetLaw) else load,
        converged=bool(found.distance < CONVERGED), coefficients=estimates,
        combinations=found.combinations, rank=rank, chi_squared=chi_squared,
        sigma=sigma if table.sigma is None else float(np.sqrt(np.mean(table.sigma**2))),
        rms=float(np.sqrt(np.mean(raw**2))), bic=misfit + rank * math.log(count),
        warnings=tuple(of_bounds(estimates, found.identifiability.names)), fitted=table.mu + raw,
        curve={"speed": curve, "mu": np.asarray(friction(jnp.asarray(values), curve, spin))},
    )  # fmt: skip


def _covariance(
    items: Sequence[Any], bounded: Bounded, typical: Floats, rest: Floats, jacobian: Floats,
    *, estimated: bool,
) -> Covariance:  # fmt: skip
    rows = r_factor(np.column_stack([jacobian, rest]))
    one = Bounded(*(part[None] for part in bounded))
    factors = Factors.of(rows[None], one, typical, None).at(0)
    known = Sigmas(np.array([len(rest)]), np.array([estimated]), "linear", len(rest))
    names = [item.name for item in items]
    return Covariance.of(names, bounded, typical, (factors, factors), jacobian[None], known, False)


def _estimates(items: Sequence[Any], found: Covariance) -> dict[str, Estimate]:
    estimates = {}
    for place, item in enumerate(items):
        stderr, verdict, dof = (None, "fixed", None) if item.optional else found.classified(place)
        estimates[item.name] = Estimate.of(
            item, float(found.values[place]), verdict, stderr=stderr, dof=dof,
            reason=weakness(verdict, item.typical),
        )  # fmt: skip
    return estimates
