"""emcee, imported without `scipy.stats`: that takes 0.4 s, a tenth of an evening's fit,
and is needed by one of its moves alone, of which curlfit makes no use."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

_UNUSED = "scipy.stats"


def _imported() -> Any:
    """emcee as it is, if it or `scipy.stats` was imported already."""
    if "emcee" in sys.modules or _UNUSED in sys.modules:
        return import_module("emcee")
    # An import of what is None fails, which emcee allows for.
    sys.modules[_UNUSED] = None  # type: ignore[assignment]
    try:
        module = import_module("emcee")
    finally:
        del sys.modules[_UNUSED]
    move: Any = import_module("emcee.moves.kde")
    move.gaussian_kde = _gaussian_kde
    return module


def _gaussian_kde(*arguments: Any, **named: Any) -> Any:
    """What the move needs if somebody else in this process uses it."""
    from scipy.stats import gaussian_kde

    return gaussian_kde(*arguments, **named)


emcee = _imported()
