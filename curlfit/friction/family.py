"""Several laws as one, so that one compiled program serves them all.

Most of a program is the motion of the stone, whatever the law, and most of the time of a first
comparison of laws is compiling. A family is a law that is any one of its members: which one is a
number among its coefficients, and only the forces of the ring are in the program once for each.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any, ClassVar

import numpy as np

from curlfit.friction.base import Law, LocalLaw, coefficient, on_new_law
from curlfit.numerics.arrays import Floats


class LawFamily(Law):
    """A law that is any one of several; all motions of a batch are under the same one.

    Its coefficients are the index of the member, those of the member, and as many unused ones as
    another member has more.
    """

    members: ClassVar[tuple[type[LocalLaw], ...]] = ()

    @classmethod
    def shipped(cls) -> bool:
        """Whether all members are part of curlfit."""
        return all(member.shipped() for member in cls.members)

    def steepness(self) -> Any:
        """Absolute exponent of the dependence of friction on the speed."""
        index, *coefficients = (getattr(self, item.name) for item in self.coefficients())
        return sum(
            (index == number) * member.from_vector(coefficients).steepness()
            for number, member in enumerate(self.members)
            if member.steepness is not Law.steepness
        )

    @classmethod
    def columns(cls, member: type[Law], size: int) -> list[int]:
        """Where `size` parameters of a member, its coefficients first, stand among the family's."""
        k, own = len(cls.coefficients()), len(member.coefficients())
        return [*range(1, own + 1), *range(k, k + size - own)]

    @classmethod
    def padded(cls, member: type[Law], values: Floats, fill: float = 0.0) -> Floats:
        """Arrays by parameter of a member, along the last axis, with the family's other columns."""
        size = values.shape[-1]
        added = len(cls.coefficients()) - len(member.coefficients())
        found = np.full((*values.shape[:-1], size + added), fill)
        found[..., cls.columns(member, size)] = values
        return found

    @classmethod
    def vector(cls, member: type[Law], values: Floats) -> Floats:
        """Parameter vectors of a member as vectors of the family."""
        found = cls.padded(member, values)
        found[..., 0] = cls.members.index(member)
        return found


def family_of(laws: Iterable[type[Law]]) -> type[LawFamily] | None:
    """The family of those laws that can be in one; None where they are fewer than two."""
    members = tuple(dict.fromkeys(law for law in laws if _can_be_member(law)))
    return _family(members) if len(members) > 1 else None


def _can_be_member(law: type[Law]) -> bool:
    """A law of the ring that enters the steps of a motion by its steepness alone."""
    plain = not law.corners and law.quickness is Law.quickness
    # A user's law may change from run to run, and programs with it are not stored.
    return issubclass(law, LocalLaw) and plain and law.shipped()


@cache
def _family(members: tuple[Any, ...]) -> type[LawFamily]:
    count = max(len(member.coefficients()) for member in members)
    names = ["member", *(f"c{number}" for number in range(1, count + 1))]
    family = type(
        f"LawFamily[{', '.join(member.name for member in members)}]",
        (LawFamily,),
        {
            "__annotations__": dict.fromkeys(names, float),
            "__module__": __name__,
            "members": members,
            **{name: coefficient(0.0, name) for name in names},
        },
    )
    for callback in on_new_law:
        callback(family)
    return family
