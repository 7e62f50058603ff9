"""What is asked of a joint fit: throws with every choice made and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from curlfit.errors import InputError, require_kind
from curlfit.foreign import quoted
from curlfit.friction import Law, find_law
from curlfit.inference.derived.derive import check_derived
from curlfit.inference.model.priors import Normal
from curlfit.inference.model.request import Request
from curlfit.inference.together.effects import Covariates
from curlfit.inference.together.evening import untold, with_usual_priors
from curlfit.settings.choices import Fitting
from curlfit.throws.throw import Throw, require_throw

VARYING = 4
"""Throws from which on their coefficients may vary."""


@dataclass(frozen=True, eq=False)
class JointRequest:
    """Throws with every choice of their joint fit.

    Attributes
    ----------
    throws : each with the choices of its fit, of which law, load, loss and noise are
        those of all.
    shared : coefficients that are equal in all throws, or have a common mean.
    may_vary : whether the coefficients are searched for what varies about a mean.
    covariates : groups and trends on which the means depend.
    untold : priors of coefficients of which the throws tell nothing.
    """

    throws: tuple[Request, ...]
    shared: tuple[str, ...]
    may_vary: bool
    covariates: Covariates
    untold: dict[str, Normal]

    @classmethod
    def of(
        cls,
        throws: Sequence[Throw],
        choices: Mapping[str, Any],
        *,
        share: str | Sequence[str] | None = None,
        by: str | Sequence[str] = (),
        trend: str | Sequence[str] = (),
        trend_by: str | Sequence[str] = (),
    ) -> JointRequest:
        """The request to fit throws; arguments as in `fit_together`. Where one of the
        choices is not given, each throw's own applies; law and load must then agree.

        Raises
        ------
        InputError : fewer than two throws, or a choice that cannot be used.
        """
        require_kind(throws, Sequence, "throws", "a list of throws")
        for throw in throws:
            require_throw(throw)
        if len(throws) < 2:
            raise InputError(
                f"{len(throws)} throw to fit together; expected two or more"
            )
        law = choices.get("law")
        law = find_law(_common(throws, "law", "front-back") if law is None else law)
        load = choices.get("load") or _common(throws, "load", "uniform")
        of_all = {**choices, "law": law, "load": load}
        chosen = [Fitting.of(throw.settings, **of_all) for throw in throws]
        differ = bool(by or trend)
        shared = _shared(law, share or "all", chosen[0], mean=differ)
        without_usual = chosen
        chosen = with_usual_priors(throws, chosen, law)
        covariates = Covariates.of(
            [(throw.name, throw.labels) for throw in throws], by, trend, trend_by
        )
        usual = share is None and len(throws) >= VARYING
        return cls(
            throws=requests_of(throws, chosen),
            shared=shared,
            may_vary=differ or (usual and not chosen[0].loss.is_robust),
            covariates=covariates,
            untold=untold(throws, without_usual, law),
        )


def requests_of(
    throws: Sequence[Throw], chosen: Sequence[Fitting]
) -> tuple[Request, ...]:
    """The requests of throws that are fitted together: where one was swept, the effect
    of sweeping is a parameter of all. Raises `InputError` as `Request.of`."""
    any_swept = any(choice.swept is not None for choice in chosen)
    return tuple(
        Request.of(throw, choice, others_swept=any_swept)
        for throw, choice in zip(throws, chosen, strict=True)
    )


def _common(throws: Sequence[Throw], name: str, default: str) -> str:
    """The law or load that the throws state. Raises `InputError` where they differ."""
    first = throws[0].defaults.get(name, default)
    for throw in throws[1:]:
        stated = throw.defaults.get(name, default)
        if stated != first:
            raise InputError(
                f"{throws[0].name} and {throw.name} state different values of {name}, "
                f"{first} and {stated}; give the one for this fit"
            )
    return str(first)


def _shared(
    law: type[Law], share: str | Sequence[str], chosen: Fitting, *, mean: bool
) -> tuple[str, ...]:
    """Names of the shared coefficients. Raises `InputError` for one that the law does
    not have, or for choices that exclude a `mean` with groups or trends."""
    names_of_law = tuple(coefficient.name for coefficient in law.coefficients())
    shared = (share,) if isinstance(share, str) else tuple(share)
    if share == "all":
        shared = names_of_law
    for name in shared:
        if name not in names_of_law:
            raise InputError(
                f"share: law {law.name} has no coefficient {quoted(name)}; "
                f"it has {', '.join(names_of_law)}"
            )
    if mean and chosen.loss.is_robust:
        raise InputError("by, trend: groups and trends are estimated with loss linear")
    if mean and set(shared) != set(names_of_law):
        raise InputError("share: with groups or trends, all coefficients have a mean")
    check_derived(chosen.derive, names_of_law)
    return shared
