"""The model of a fit: law, load, and the conditions among its parameters."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, NamedTuple, Self

from curlfit.environment import Environment
from curlfit.friction import Law, Load
from curlfit.friction.family import LawFamily
from curlfit.numerics.arrays import Floats

if TYPE_CHECKING:
    from curlfit.inference.model.request import Request


class Model(NamedTuple):
    """A law, a load, and the conditions that are parameters besides the
    law's coefficients."""

    law: type[Law]
    load: Load
    conditions: tuple[str, ...] = ()
    """names from `curlfit.inference.model.conditions.CONDITIONS`"""
    family: type[LawFamily] | None = None
    """of which the law is a member, if the programs of the family are to be used"""

    @classmethod
    def of(cls, request: Request, family: type[LawFamily] | None = None) -> Self:
        """The model of a request, with the programs of a family of laws if its law is
        a member."""
        return cls(request.law, request.load, request.parameters.conditions).within(
            family
        )

    def within(self, family: type[LawFamily] | None) -> Self:
        """The model with the programs of a family, if its law is a member."""
        member = family is not None and self.law in family.members
        return self._replace(family=family) if member else self

    @property
    def of_program(self) -> Model:
        """The model that a program is compiled for, called with `vector` of
        the parameters."""
        return (
            self
            if self.family is None
            else Model(self.family, self.load, self.conditions)
        )

    def vector(self, values: Floats) -> Floats:
        """Parameter vectors, or their first columns, as a program takes them."""
        return values if self.family is None else self.family.vector(self.law, values)

    def columns(self, size: int) -> list[int]:
        """Columns of the first `size` parameters in such a vector."""
        return (
            [*range(size)]
            if self.family is None
            else self.family.columns(self.law, size)
        )

    @property
    def has_environment(self) -> bool:
        """Whether any force besides friction, or change of the friction, is
        a parameter."""
        return any(field.name in self.conditions for field in fields(Environment))

    @property
    def has_slope(self) -> bool:
        """Whether a slope of the ice is a parameter."""
        return "slope_x" in self.conditions or "slope_y" in self.conditions
