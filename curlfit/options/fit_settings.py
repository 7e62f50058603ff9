"""A fit as it is asked for on the command line: its flags, and all that can be refused."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from curlfit.options import settings as s

if TYPE_CHECKING:
    from curlfit.friction import Law, Load
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.parameters import ParameterSet
    from curlfit.stone import Stone
    from curlfit.throws.throw import Throw


def fit_flags(
    reading: Mapping[str, Any],
    *,
    law: str | None,
    load: str | None,
    until: float | None,
    stone: list[str] | None,
    sigma: list[str] | None,
    fix: list[str] | None,
    bound: list[str] | None,
    start: list[str] | None,
    unbounded: bool,
    **others: Any,
) -> dict[str, Any]:
    """The flags of a fit as settings."""
    return {
        **reading,
        "law": law,
        "load": load,
        "until": until,
        "stone": s.pairs("--stone", stone or ()),
        "sigma": s.pairs("--sigma", sigma or ()),
        "fix": s.pairs("--fix", fix or ()),
        "bound": s.intervals("--bound", bound or ()),
        "start": s.pairs("--start", start or ()),
        "unbounded": unbounded or None,
        **others,
    }


class FitWanted(NamedTuple):
    """A fit that is asked for; `cut` is the throw up to `until`."""

    throw: Throw
    cut: Throw
    wanted: dict[str, Any]
    law: type[Law]
    load: Load
    loss: str
    noise: str
    stone: Stone
    choices: dict[str, Any]
    parameters: ParameterSet

    def fit(self) -> FitResult:
        """Make it."""
        from curlfit.inference.fit.fit import fit

        return fit(
            self.throw, self.law, load=self.load, stone=self.stone,
            until=self.wanted.get("until"), start=self.wanted.get("start"), loss=self.loss,
            noise=self.noise, **self.choices,
        )  # fmt: skip


def fit_wanted(data: Path, config: Path | None, flags: Mapping[str, Any]) -> FitWanted:
    """The fit that is asked for, looked through before anything slow is loaded.

    Raises
    ------
    InputError : the data, a setting or a value cannot be used.
    """
    from curlfit.friction import check_load, find_law
    from curlfit.inference.noise.models import check_noise
    from curlfit.inference.parameters import ParameterSet, check_loss

    throw, wanted, stone = s.prepared(data, config, flags)
    law = find_law(wanted.get("law", "front-back"))
    load = check_load(wanted.get("load", "uniform"))
    loss = check_loss(wanted.get("loss", "linear"))
    noise = check_noise(wanted.get("noise", "white"), loss)
    choices: dict[str, Any] = {
        "fix": wanted.get("fix"),
        "bounds": wanted.get("bound"),
        "unbounded": bool(wanted.get("unbounded", False)),
    }
    cut = throw.until(wanted.get("until"))
    cut.require_motion()
    parameters = ParameterSet.for_throw(law, cut, **choices)
    parameters.require("--start", wanted.get("start", {}))
    return FitWanted(throw, cut, wanted, law, load, loss, noise, stone, choices, parameters)
