"""Sums of laws of the ring: of a law that brakes, and of what else acts
on the stone."""

from __future__ import annotations

from collections import Counter
from dataclasses import field, fields
from functools import cache
from typing import Any, ClassVar

from curlfit.errors import InputError
from curlfit.friction.base import LAWS, Edges, LocalLaw, RingPoint
from curlfit.friction.front_back import FrontBack
from curlfit.friction.isotropic import Power
from curlfit.friction.mechanisms import Pivot, Sideways, Transverse


class Sum(LocalLaw):
    """Several laws of the ring that act together; the traction is the sum of theirs."""

    parts: ClassVar[tuple[type[LocalLaw], ...]] = ()

    @classmethod
    def register(cls, name: str) -> None:
        """A sum is found by the names of its parts."""

    @property
    def terms(self) -> list[LocalLaw]:
        """The parts with their coefficients."""
        return [
            part(
                **{item.name: getattr(self, item.name) for item in part.coefficients()}
            )
            for part in self.parts
        ]

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        across, along = zip(*(part.traction(point) for part in self.terms), strict=True)
        return sum(across), sum(along)

    def edges(self, turned: Any) -> Edges:
        front, back = zip(*(part.edges(turned) for part in self.terms), strict=True)
        return Edges(sum(front, ()), sum(back, ()))

    def quickness(self, time: Any) -> Any:
        return sum(part.quickness(time) for part in self.terms)

    def steepness(self) -> Any:
        return sum(part.steepness() for part in self.terms)

    def fault(self) -> str | None:
        return next(filter(None, (part.fault() for part in self.terms)), None)


@cache
def sum_of(*parts: type[LocalLaw]) -> type[Sum]:
    """The law of which these are the parts. Raises `InputError` unless one brakes, all
    act on the ring, and no two have a coefficient of one name."""
    name = "+".join(part.name for part in parts)
    names = Counter(item.name for part in parts for item in part.coefficients())
    twice = [one for one, count in names.items() if count > 1]
    if twice:
        raise InputError(f"{name}: two of these have a coefficient {twice[0]}")
    if not all(issubclass(part, LocalLaw) for part in parts):
        raise InputError(
            f"{name}: expected laws of the ring, and a law of the whole stone is none"
        )
    if not any(part.brakes for part in parts):
        raise InputError(
            f"{name}: nothing brakes the stone; expected a law, as in power+sideways"
        )
    own = next((part.__module__ for part in parts if not part.shipped()), __name__)
    given: dict[str, Any] = {
        item.name: field(default=item.default, metadata=item.metadata)
        for part in parts
        for item in fields(part)
    }
    return type(
        name,
        (Sum,),
        given
        | {
            "__annotations__": dict.fromkeys(given, float),
            "__doc__": f"The sum of {' and '.join(part.name for part in parts)}.",
            "__module__": own,
            "__qualname__": name,
            "name": name,
            "parts": parts,
            "formula": " + ".join(part.formula for part in parts),
            "source": "; ".join(part.source for part in parts),
            "predicts": "as its parts together",
            "corners": tuple(
                sorted({angle for part in parts for angle in part.corners})
            ),
            "sums": sum((part.sums for part in parts), ()),
        },
    )


for _parts in (
    (Power, Sideways),
    (Power, Transverse),
    (Power, Pivot),
    (FrontBack, Sideways),
):
    _sum = sum_of(*_parts)
    LAWS[_sum.name] = _sum
