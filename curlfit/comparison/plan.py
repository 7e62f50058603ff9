"""Which laws are compared, under which loads."""

from __future__ import annotations

from collections.abc import Sequence

from curlfit.friction import LAWS, Law, NetLaw, find_law


def plan(laws: Sequence[str | type[Law]] | None, load: str) -> list[tuple[type[Law], str]]:
    """Laws and loads to be fitted; `load` may be "both".

    Where no law is named, all of curlfit's own except those that approximate another. A law without
    a ring has no load and is listed once. Raises `InputError` for an unknown name.
    """
    wanted = laws or [law for law in LAWS.values() if law.shipped() and not law.approximates]
    chosen = [find_law(law) for law in ([wanted] if isinstance(wanted, str) else wanted)]
    loads = ("uniform", "consistent") if load == "both" else (load,)
    return [
        (law, one)
        for law in dict.fromkeys(chosen)
        for one in (loads[:1] if issubclass(law, NetLaw) else loads)
    ]
