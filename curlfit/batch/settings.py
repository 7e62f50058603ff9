"""What is done with each throw of a batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from curlfit.friction import Law, Load, NetLaw, find_law
from curlfit.inference.model.parameters import ParameterSet
from curlfit.inference.model.request import parameters_of_any
from curlfit.settings.choices import SEED, Fitting, Reading
from curlfit.settings.forms import SWITCH, OneOf, option
from curlfit.throws.load import check_reading
from curlfit.throws.throw import check_sigma

CHUNK = 128
"""Number of throws that are read and fitted together."""


@dataclass(frozen=True, kw_only=True)
class BatchSettings(Fitting, Reading):
    """What is done with each throw; values override those of the throw's own file.

    Attributes
    ----------
    any_swept : whether a file states sweeping, so that the table has
        columns of `sweep`.
    posterior : sample the posterior of each throw as well; hundreds of times slower.
    seed : of the sampling.
    """

    any_swept: Annotated[bool, option(SWITCH)] = False
    posterior: Annotated[bool, option(SWITCH)] = False
    seed: Annotated[int, option(SEED)] = 0

    def recorded(self) -> dict[str, Any]:
        """The settings as the file beside the table has them: what a name stands for
        by its name."""
        forms = self.forms()
        recorded = {}
        for name, value in self:
            form = forms[name]
            recorded[name] = value
            if isinstance(form, OneOf) and value is not None:
                recorded[name] = form.name_of(value)
        return recorded

    def checked(self) -> type[Law]:
        """The law. Raises InputError if the settings are impossible for any throw."""
        check_sigma(self.sigma)
        check_reading(self)
        self.parameter_set()
        return find_law(self.law)

    def parameter_set(self) -> ParameterSet:
        """Parameters of each throw's fit. Raises InputError for a choice that
        cannot be used."""
        return parameters_of_any(self, others_swept=self.any_swept)

    def sums(self) -> dict[str, tuple[str, ...]]:
        """Free coefficients of which only the sum enters the motion, by the sum as it
        is written."""
        law = self.checked()
        if self.load != Load.UNIFORM and not issubclass(law, NetLaw):
            return {}
        return {
            " + ".join(names): names
            for names in law.sums
            if not set(names) & set(self.fix)
        }
