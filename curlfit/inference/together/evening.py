"""What an evening of draws tells that were timed and taped, not tracked.

A draw gives a few numbers: times between lines, where it came to rest, its curl, its
turns. They hold its friction and how strongly it curls, and these may differ from draw
to draw, between sheets and along the evening. They hold next to nothing of how friction
and curl depend on speed and spin, which is the same for all draws: such a coefficient
has the prior of what is `usual` on other ice, so that its uncertainty is in every
standard error, and an evening that does tell it (by two times of each draw, or by turns
that differ) has its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from curlfit.friction import Law
from curlfit.settings.choices import Fitting
from curlfit.throws.throw import Throw


def same_in_all(
    throws: Sequence[Throw], law: type[Law]
) -> dict[str, tuple[float, float]]:
    """Coefficients that are the same for all draws of an evening, with mean and
    standard deviation on other ice; none if one of the throws has a path."""
    if any(throw.has_path for throw in throws):
        return {}
    return {item.name: item.usual for item in law.coefficients() if item.usual}


def with_usual_priors(
    throws: Sequence[Throw], chosen: Sequence[Fitting], law: type[Law]
) -> list[Fitting]:
    """The choices of throws, with priors of the coefficients that are the same in all,
    unless a choice names them."""
    named = {name for choice in chosen[0].by_parameter.values() for name in choice}
    usual = {
        name: f"{mean!r}+-{deviation!r}"
        for name, (mean, deviation) in same_in_all(throws, law).items()
        if name not in named
    }
    return [replace(choice, priors={**choice.priors, **usual}) for choice in chosen]
