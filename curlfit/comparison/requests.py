"""What is asked of a comparison on one throw: a fit of each law, load and noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from curlfit.friction import Law, Load
from curlfit.friction.registry import laws_under
from curlfit.inference.model.conditions import ALL
from curlfit.inference.model.parameters import options_of, require_known
from curlfit.inference.model.request import Request
from curlfit.noises import Noise
from curlfit.settings.choices import Comparing, Fitting
from curlfit.throws.throw import Throw, require_path


def requests_of(
    throw: Throw, chosen: Comparing, called: Mapping[str, str] | None = None
) -> list[Request]:
    """The requests to fit each law to a throw, under each load and noise.

    Parameters
    ----------
    called : what the user calls a choice, such as a flag, by its name; the name itself
        by default.

    Raises
    ------
    InputError : the throw has no path or is not that of a curling stone; a name that no
        law has; or a choice that a law refuses.
    """
    require_path(throw)
    laws_and_loads = laws_under(chosen.laws, chosen.load)
    options = {**chosen.by_parameter, "start": chosen.start}
    called = called or {}
    require_known(
        [law for law, _ in laws_and_loads],
        {called.get(name, name): values for name, values in options.items()},
    )
    requests: list[Request] = []
    for noise in chosen.noise:
        for law, load in laws_and_loads:
            choices = _choices_under(chosen, law, load, noise)
            if requests:
                requests.append(requests[0].under(choices))
            else:
                requests.append(Request.of(throw, choices))
    return requests


def with_free_signs(request: Request, chosen: Comparing) -> Request:
    """The same request, with coefficients of either sign."""
    choices = _choices_under(chosen, request.law, request.load, request.noise)
    return request.under(replace(choices, unbounded=True))


def _choices_under(
    chosen: Comparing, law: type[Law], load: Load, noise: Noise
) -> Fitting:
    """The choices of a fit of one law, without those of what it does not have."""
    of_law = options_of(law, {**chosen.by_parameter, "start": chosen.start})
    of_law |= {"load": load, "noise": noise, "systematics": {ALL: 0.0}}
    return Fitting.of(vars(chosen) | of_law, law=law)
