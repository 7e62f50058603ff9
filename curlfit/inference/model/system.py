"""The stone and its surroundings, as a parameter vector describes them.

A parameter vector contains the law's coefficients, then the conditions that are
parameters of the fit, then `x0 y0 heading v0 phi0 omega0`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from curlfit.dynamics.trajectory import InitialState, simulate
from curlfit.environment import Environment
from curlfit.friction import Law
from curlfit.inference.model.model import Model
from curlfit.inference.model.parameters import START_NAMES
from curlfit.inference.model.problem import Problem
from curlfit.numerics.arrays import Floats
from curlfit.numerics.batches import BATCH, in_batches
from curlfit.numerics.compiled import compiled
from curlfit.stone import Stone


class System(NamedTuple):
    """A stone on the ice, and the scales of its measurement."""

    law: Law
    stone: Stone
    environment: Environment
    start: InitialState
    length_scale: Any
    """ratio of measured to true lengths"""
    time_scale: Any
    """ratio of measured to true times"""

    @classmethod
    def of(
        cls, model: Model, values: Any, stone: Stone, environment: Environment
    ) -> System:
        """From a parameter vector; `stone` and `environment` give the
        other conditions."""
        k = len(model.law.coefficients())
        conditions = {
            name: values[k + index] for index, name in enumerate(model.conditions)
        }
        first = k + len(model.conditions)
        start = {name: values[first + index] for index, name in enumerate(START_NAMES)}
        return cls(
            model.law.from_vector(values),
            _replaced(stone, conditions),
            _replaced(environment, conditions),
            InitialState(
                x=start["x0"],
                y=start["y0"],
                heading=start["heading"],
                v=start["v0"],
                phi=start["phi0"],
                omega=start["omega0"],
            ),
            conditions.get("length_scale", 1.0),
            conditions.get("time_scale", 1.0),
        )


def _replaced(record: Any, values: dict[str, Any]) -> Any:
    return replace(
        record, **{name: values[name] for name in vars(record) if name in values}
    )


def assumed_conditions(model: Model, problems: Problem) -> Floats:
    """Values of the model's conditions assumed for many throws, shape
    (throws, conditions)."""
    assumed = np.ones((len(problems.times), len(model.conditions)))
    value_by_name = vars(problems.stone) | vars(problems.environment)
    for column, name in enumerate(model.conditions):
        assumed[:, column] = value_by_name.get(name, 1.0)
    return assumed


def motions(
    model: Model, values: Floats, stone: Stone, environment: Environment, times: Floats
) -> tuple[Floats, Floats]:
    """Motions of many parameter vectors at times since the start: x, y, phi, vx, vy and
    omega, of shape (vectors, 6, times), and times of rest. One program serves any
    number of vectors."""
    states_and_rests: tuple[Floats, Floats] = in_batches(
        lambda vectors: _motions(model, vectors, stone, environment, times), (values,)
    )
    return states_and_rests


def prepare_motions(
    model: Model, parameters: int, stone: Stone, environment: Environment, times: Floats
) -> None:
    """Begin compiling the program of `motions`."""
    _motions.prepare(model, np.zeros((BATCH, parameters)), stone, environment, times)


@compiled("model")
def _motions(
    model: Model, values: Array, stone: Stone, environment: Environment, times: Array
) -> tuple[Array, Array]:
    def one(values: Array) -> tuple[Array, Array]:
        system = System.of(model, values, stone, environment)
        path = simulate(
            system.law,
            system.stone,
            system.start,
            times,
            load=model.load,
            t0=0.0,
            environment=system.environment,
        )
        return jnp.stack(
            [path.x, path.y, path.phi, path.vx, path.vy, path.omega]
        ), path.rest

    return jax.vmap(one)(values)
