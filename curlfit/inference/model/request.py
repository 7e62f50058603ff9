"""What is asked of a fit: a throw with every choice made and checked.

No JAX is loaded for it, so that what cannot be fitted is refused quickly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from curlfit.errors import InputError
from curlfit.findings import Finding
from curlfit.friction import Law, Load, find_law
from curlfit.inference.derived.derive import check_derived
from curlfit.inference.model.conditions import WEAK_CONDITIONS, check_systematics
from curlfit.inference.model.parameters import ParameterSet
from curlfit.inference.model.priors import Penalty
from curlfit.losses import Loss
from curlfit.noises import Noise
from curlfit.numerics.arrays import Floats
from curlfit.settings.choices import Estimation, Fitting, Modelling
from curlfit.stone import Stone
from curlfit.throws.plausibility import require_plausible
from curlfit.throws.throw import Throw

_HELD = 1e-4  # standard deviation that holds a parameter, over that of its prior


@dataclass(frozen=True, eq=False)
class Request:
    """A throw with every choice of its fit.

    Attributes
    ----------
    throw : the rows that are used, with the sigmas that are given; condensed where
        there are very many.
    law, load : of the friction.
    stone : with the constants that are given.
    parameters : of the fit, with their bounds and priors, and those that are held.
    loss, noise : how residuals count; the noise is yet to be estimated.
    rows : `since`, `until` and `exclude`, by which these rows were selected.
    swept : times between which the stone was swept, s; None without.
    start : initial values, by name.
    fixed_by_user : values of parameters that the user fixes, by name. The fit takes
        them from `parameters`; advice on further measurements takes them from here.
    systematics : standard uncertainties of conditions that are held, by name.
    derive : derived quantities, as text.
    findings : what is unusual about the throw.
    flags : those that make this fit of the throw's file.
    """

    throw: Throw
    law: type[Law]
    load: Load
    stone: Stone
    parameters: ParameterSet
    loss: Loss
    noise: Noise
    rows: Mapping[str, Any]
    swept: tuple[float, float] | None
    start: Mapping[str, float] = field(default_factory=dict)
    fixed_by_user: Mapping[str, float] = field(default_factory=dict)
    systematics: Mapping[str, float] = field(default_factory=dict)
    derive: Sequence[str] = ()
    findings: tuple[Finding, ...] = ()
    flags: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, throw: Throw, chosen: Modelling, *, others_swept: bool = False
    ) -> Request:
        """The request to fit a throw, whose own settings are among the choices.

        `others_swept` makes `sweep` a parameter also of a throw that was not swept, on
        which it has no effect.

        Raises
        ------
        InputError : the data cannot be those of a curling stone, or a choice cannot be
            used.
        """
        used = rows_in_use(throw, chosen)
        findings = require_plausible(used)
        return cls._of_rows(
            used.condensed(), findings, chosen, others_swept=others_swept
        )

    @classmethod
    def _of_rows(
        cls,
        used: Throw,
        findings: tuple[Finding, ...],
        chosen: Modelling,
        *,
        others_swept: bool = False,
    ) -> Request:
        """The request to fit plausible rows. Raises `InputError` for a choice that
        cannot be used."""
        law = find_law(chosen.law)
        swept = chosen.swept is not None or others_swept
        parameters = ParameterSet.for_throw(
            law, used, swept=swept, **chosen.of_parameters
        )
        require_names(chosen, parameters)
        of_fit: dict[str, Any] = {}
        if isinstance(chosen, Fitting):
            of_fit = {"systematics": chosen.systematics, "derive": chosen.derive}
        return cls(
            throw=used,
            law=law,
            load=chosen.load,
            stone=Stone().with_values(dict(chosen.stone)),
            parameters=parameters,
            loss=chosen.loss,
            noise=chosen.noise,
            rows=chosen.rows,
            swept=chosen.swept,
            start=chosen.start,
            fixed_by_user=chosen.fix,
            **of_fit,
            findings=findings,
            flags=(*used.read_with, *chosen.words()),
        )

    def under(self, chosen: Modelling) -> Request:
        """The same rows under other choices of the law, its load, the noise and the
        parameters. Raises `InputError` for one that cannot be used."""
        return self._of_rows(self.throw, self.findings, chosen)

    @property
    def assumed_spin(self) -> float:
        """The spin in rad/s that the throw assumes where nothing determines
        it; 0 if none."""
        spin = self.throw.assumed.get("omega0", 0.0)
        return spin if self.parameters.fixed.get("omega0") == spin else 0.0

    @property
    def spin_taken_for_zero(self) -> bool:
        """Whether only lines and times were measured, and nothing tells the spin."""
        held_at_zero = self.parameters.fixed.get("omega0") == 0.0
        return held_at_zero and self.throw.assumed.get("omega0") == 0.0

    def penalty(self, *, first: bool) -> Penalty:
        """What the priors add to chi squared.

        The `first` fit weights all channels equally, 1 m like 1 rad, where no sigma is
        given. Priors would outweigh the data there, and the misfit that they cause
        would be taken for noise. They are therefore left out, except that the stone's
        constants and the scales, which a path hardly determines, are held near the
        modes of their priors.
        """
        penalty = self.parameters.penalty
        if not (first and self.equal_sigma()):
            return penalty
        held = np.isin(self.parameters.names, WEAK_CONDITIONS)
        return penalty._replace(weight=penalty.weight * held / _HELD)

    def equal_sigma(self) -> dict[str, float]:
        """Sigma in the first fit for channels whose own is unknown: equal weights."""
        medians = [float(np.nanmedian(series)) for series in self.throw.sigma.values()]
        equal = float(np.exp(np.mean(np.log(medians)))) if medians else 1.0
        unknown = [name for name in self.throw.seen if name not in self.throw.sigma]
        return dict.fromkeys(unknown, equal)

    def with_given_start(self, values: Floats) -> Floats:
        """Initial values, with those that the user gives, within the bounds."""
        if not self.start:
            return values
        values = values.copy()
        for name, value in self.start.items():
            values[self.parameters.index(name)] = value
        return np.clip(values, self.parameters.lower, self.parameters.upper)


def rows_in_use(throw: Throw, chosen: Estimation) -> Throw:
    """The rows of a throw that are used, with the sigmas that are given. Raises
    `InputError` where none are left."""
    return throw.with_sigma(dict(chosen.sigma)).select_rows(**chosen.rows)


def parameters_of_any(chosen: Modelling, *, others_swept: bool = False) -> ParameterSet:
    """The parameters of a fit of any throw, as far as the throw does not fix them.
    Raises `InputError` for a choice that no throw can be fitted with."""
    swept = chosen.swept is not None or others_swept
    parameters = ParameterSet.build(
        find_law(chosen.law), swept=swept, **chosen.of_parameters
    )
    require_names(chosen, parameters)
    return parameters


def require_names(chosen: Modelling, parameters: ParameterSet) -> None:
    """Raise `InputError` where an initial value, a systematic error or a derived
    quantity names what is no parameter or condition."""
    parameters.require("start", chosen.start)
    for name in chosen.start:
        if name in chosen.fix:
            raise InputError(
                f"start: {name} is fixed; expected initial values of what is estimated"
            )
    if isinstance(chosen, Fitting):
        check_systematics(chosen.systematics)
        check_derived(chosen.derive, parameters.names)
