"""The model of a fit: law, load, and the conditions among its parameters."""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

from curlfit.environment import Environment
from curlfit.friction import Law, Load


class Model(NamedTuple):
    """A law, a load, and the conditions that are parameters beside the law's coefficients."""

    law: type[Law]
    load: Load
    conditions: tuple[str, ...] = ()
    """names out of `curlfit.inference.conditions.CONDITIONS`"""

    @property
    def has_environment(self) -> bool:
        """Whether what acts on a stone besides friction, or changes it, is a parameter."""
        return any(field.name in self.conditions for field in fields(Environment))

    @property
    def has_slope(self) -> bool:
        """Whether a slope of the ice is a parameter."""
        return "slope_x" in self.conditions or "slope_y" in self.conditions
