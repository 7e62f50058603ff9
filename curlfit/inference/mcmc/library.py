"""emcee without `scipy.stats`, which only its kernel-density move needs and which takes as long to
load as JAX.

That move is not used here. In a program that uses it, `scipy.stats` is loaded at its first call.
"""

from __future__ import annotations

import sys
from typing import Any

_STATS = "scipy.stats"
_deferred = _STATS not in sys.modules and "emcee" not in sys.modules

if _deferred:
    sys.modules[_STATS] = None  # type: ignore[assignment]  # importing it fails, which emcee handles
try:
    import emcee
finally:
    if _deferred:
        del sys.modules[_STATS]


def _gaussian_kde(*arguments: Any, **options: Any) -> Any:
    from scipy.stats import gaussian_kde

    return gaussian_kde(*arguments, **options)


if _deferred:
    emcee.moves.kde.gaussian_kde = _gaussian_kde

Move, State = emcee.moves.Move, emcee.state.State

__all__ = ["Move", "State", "emcee"]
