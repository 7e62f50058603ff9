"""What the types of fields do not say by themselves, as annotations of them."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from curlfit.numerics.arrays import Floats


class Axes(NamedTuple):
    """How many axes an array has, such as `Annotated[Floats, Axes(2)]`; one without
    this annotation."""

    number: int | None
    """None for one or two"""
    columns: int = 0
    """of a table without rows"""


class Names(tuple[str, ...]):
    """The keys that a dictionary has, if it has any."""

    __slots__ = ()


class OneOf(tuple[str, ...]):
    """The admissible values of a text, where a table has them; where they stand in the
    code it is a `Literal`."""

    __slots__ = ()


class Kinds(tuple[type, ...]):
    """The types that an object may have: its entry "kind" is the default of this field
    of its type."""

    __slots__ = ()


Matrix = Annotated[Floats, Axes(2)]
Pairs = Annotated[Floats, Axes(2, columns=2)]
Arrays = dict[str, Annotated[Floats, Axes(None)]]
