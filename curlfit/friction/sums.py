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
        terms = []
        for part in self.parts:
            values = [getattr(self, c.name) for c in part.coefficients()]
            terms.append(part(*values))
        return terms

    def traction(self, point: RingPoint) -> tuple[Any, Any]:
        tractions = [term.traction(point) for term in self.terms]
        across = sum(traction[0] for traction in tractions)
        along = sum(traction[1] for traction in tractions)
        return across, along

    def edges(self, turned: Any) -> Edges:
        edges = [term.edges(turned) for term in self.terms]
        front = tuple(angle for of_term in edges for angle in of_term.front)
        back = tuple(angle for of_term in edges for angle in of_term.back)
        return Edges(front, back)

    def quickness(self, time: Any) -> Any:
        return sum(term.quickness(time) for term in self.terms)

    def steepness(self) -> Any:
        return sum(term.steepness() for term in self.terms)

    def fault(self) -> str | None:
        faults = [term.fault() for term in self.terms]
        return next((fault for fault in faults if fault), None)


@cache
def sum_of(*parts: type[LocalLaw]) -> type[Sum]:
    """The law of which these are the parts. Raises `InputError` unless one brakes, all
    act on the ring, and no two have a coefficient of one name."""
    name = "+".join(part.name for part in parts)
    uses = Counter(c.name for part in parts for c in part.coefficients())
    for coefficient, count in uses.items():
        if count > 1:
            raise InputError(f"{name}: two of these have a coefficient {coefficient}")
    if not all(issubclass(part, LocalLaw) for part in parts):
        raise InputError(
            f"{name}: expected laws of the ring, and a law of the whole stone is none"
        )
    if not any(part.brakes for part in parts):
        raise InputError(
            f"{name}: nothing brakes the stone; expected a law, as in power+sideways"
        )
    # A sum with a part of the user is not shipped (`Law.shipped`).
    modules_of_users = [part.__module__ for part in parts if not part.shipped()]
    coefficients: dict[str, Any] = {
        declared.name: field(default=declared.default, metadata=declared.metadata)
        for part in parts
        for declared in fields(part)
    }
    attributes = {
        "__annotations__": dict.fromkeys(coefficients, float),
        "__doc__": f"The sum of {' and '.join(part.name for part in parts)}.",
        "__module__": modules_of_users[0] if modules_of_users else __name__,
        "__qualname__": name,
        "name": name,
        "parts": parts,
        "formula": " + ".join(part.formula for part in parts),
        "source": "; ".join(part.source for part in parts),
        "predicts": "as its parts together",
        "corners": tuple(sorted({angle for part in parts for angle in part.corners})),
        "sums": tuple(names for part in parts for names in part.sums),
    }
    return type(name, (Sum,), coefficients | attributes)


for _sum in (
    sum_of(Power, Sideways),
    sum_of(Power, Transverse),
    sum_of(Power, Pivot),
    sum_of(FrontBack, Sideways),
):
    LAWS[_sum.name] = _sum
