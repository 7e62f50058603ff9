"""What is done with each throw of a batch, and the columns of its table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from curlfit.friction import Law, Load, NetLaw, find_law
from curlfit.inference.parameters import ParameterSet
from curlfit.options.settings import checked_parameters
from curlfit.settings.choices import SEED, Fitting, Reading
from curlfit.settings.forms import SWITCH, OneOf, option
from curlfit.throws.load import check_reading
from curlfit.throws.throw import check_sigma

CHUNK = 128
"""Number of throws that are read and fitted together."""
INFORMATION, LABELS, DURATION = "information", "labels", "duration"
"""Columns from which a second fit takes what a throw says of its coefficients, its
groups, and how long it was seen, in s."""
LEFT_OPEN = "left_open"
"""Column of the coefficients that values along a ridge leave open (`FitResult.ridge`);
tables of earlier versions lack it."""
QUANTILES = ("16", "50", "84")
"""Quantiles of the posterior, in percent."""


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
        return checked_parameters(self, others_swept=self.any_swept)

    def sums(self) -> dict[str, tuple[str, ...]]:
        """Free coefficients of which only the sum enters the motion, by the
        sum as written."""
        law = self.checked()
        if self.load != Load.UNIFORM and not issubclass(law, NetLaw):
            return {}
        return {
            " + ".join(names): names
            for names in law.sums
            if not set(names) & set(self.fix)
        }


def columns(plan: BatchSettings) -> list[str]:
    """Columns of the table of results; those of text, which may contain
    commas, come last."""
    plan.checked()
    found = [
        "file",
        "shot",
        "stone_index",
        "status",
        "n_observations",
        "rms_x",
        "rms_y",
        "rms_phi",
    ]
    more = [*QUANTILES] if plan.posterior else []
    if plan.systematics:
        more.append("systematic")
    for name in plan.parameter_set().names:
        found += [name, *(f"{name}_{what}" for what in ("stderr", "verdict", *more))]
    for name in plan.sums():
        found += [name, *(f"{name} {what}" for what in ("stderr", *more))]
    for text in plan.derive:
        found += [text, f"{text} stderr"]
    texts = LEFT_OPEN, LABELS, "combinations", "warnings", "reason"
    return [*found, DURATION, INFORMATION, *texts]
