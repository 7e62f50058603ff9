"""Several laws as one, so that one compiled program serves them all.

Most of a program is the motion of the stone, whatever the law, and a first comparison
of laws spends most of its time compiling. A family is a law that can be any one of its
members: one of its coefficients selects the member, and only the forces of the ring are
compiled once per member.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, ClassVar

import numpy as np

from curlfit.friction.base import Law, LocalLaw, coefficient
from curlfit.numerics.arrays import Floats

_NEVER = -1e9  # rad, an angle that no stone reaches


class LawFamily(Law):
    """A law that can be any one of several, the same for all motions of a batch.

    Its coefficients are the index of the member, the coefficients of that member, and
    unused ones up to the largest number that any member has.
    """

    members: ClassVar[tuple[type[LocalLaw], ...]] = ()

    @classmethod
    def shipped(cls) -> bool:
        """Whether all members are part of curlfit."""
        return all(member.shipped() for member in cls.members)

    @property
    def corners(self) -> tuple[Any, ...]:  # type: ignore[override]
        """Angles turned (rad) at which friction has a kink, padded by angles
        never reached."""
        count = max(len(member.corners) for member in self.members)
        index = self._values()[0]
        corners = []
        for corner_number in range(count):
            corner: Any = 0
            for number, member in enumerate(self.members):
                of_member = _NEVER
                if corner_number < len(member.corners):
                    of_member = member.corners[corner_number]
                corner = corner + (index == number) * of_member
            corners.append(corner)
        return tuple(corners)

    def quickness(self, time: Any) -> Any:
        """Relative rate of the explicit change of friction with time since
        release, 1/s."""
        changing = [
            member for member in self.members if member.quickness is not Law.quickness
        ]
        return self._of_member(lambda law: law.quickness(time), changing) + 0.0 * time

    def steepness(self) -> Any:
        """Absolute exponent of the dependence of friction on the speed."""
        steep = [
            member for member in self.members if member.steepness is not Law.steepness
        ]
        return self._of_member(lambda law: law.steepness(), steep)

    def _values(self) -> list[Any]:
        """The index of the selected member, and its coefficients."""
        return [getattr(self, field.name) for field in self.coefficients()]

    def _of_member(
        self, quantity: Callable[[Law], Any], members: list[type[LocalLaw]]
    ) -> Any:
        """A quantity of the selected member if it is one of `members`; else 0."""
        index, *values = self._values()
        total: Any = 0.0
        for member in members:
            selected = index == self.members.index(member)
            # Other members have their defaults, since they may be undefined at
            # these coefficients.
            coefficients = [
                selected * value + (1 - selected) * coefficient.default
                for value, coefficient in zip(
                    values, member.coefficients(), strict=False
                )
            ]
            total = total + selected * quantity(member.from_vector(coefficients))
        return total

    @classmethod
    def columns(cls, member: type[Law], size: int) -> list[int]:
        """Indices of `size` parameters of a member, its coefficients first, among
        the family's."""
        k = len(cls.coefficients())
        count = len(member.coefficients())
        return [*range(1, count + 1), *range(k, k + size - count)]

    @classmethod
    def padded(cls, member: type[Law], values: Floats, fill: float = 0.0) -> Floats:
        """Arrays by parameter of a member, along the last axis, padded to those
        of the family."""
        size = values.shape[-1]
        added = len(cls.coefficients()) - len(member.coefficients())
        of_family = np.full((*values.shape[:-1], size + added), fill)
        of_family[..., cls.columns(member, size)] = values
        return of_family

    @classmethod
    def vector(cls, member: type[Law], values: Floats) -> Floats:
        """Parameter vectors of a member as vectors of the family."""
        of_family = cls.padded(member, values)
        of_family[..., 0] = cls.members.index(member)
        return of_family


def family_of(laws: Iterable[type[Law]]) -> type[LawFamily] | None:
    """The family of those laws that can belong to one; None if there are
    fewer than two."""
    # A user's law may change from run to run, so programs with it are not stored.
    ring = (law for law in laws if issubclass(law, LocalLaw) and law.shipped())
    members = tuple(dict.fromkeys(ring))
    return _family(members) if len(members) > 1 else None


@cache
def _family(members: tuple[Any, ...]) -> type[LawFamily]:
    count = max(len(member.coefficients()) for member in members)
    names = ["member", *(f"c{number}" for number in range(1, count + 1))]
    return type(
        f"LawFamily[{', '.join(member.name for member in members)}]",
        (LawFamily,),
        {
            "__annotations__": dict.fromkeys(names, float),
            "__module__": __name__,
            "members": members,
            **{name: coefficient(0.0, name) for name in names},
        },
    )
