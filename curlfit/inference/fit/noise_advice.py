"""Which noise model describes correlated residuals: those that are recommended have been tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from curlfit.inference.fit.residuals import CORRELATED
from curlfit.inference.fit.result import FitResult
from curlfit.inference.noise.models import is_rough
from curlfit.output.text import join_words, two_digits

_FARTHER = (
    2.0  # rms residual of the law over that with independent noise, up to which it is as near
)


def with_noise_advice(result: FitResult, refit: Callable[[FitResult, str], FitResult]) -> FitResult:
    """A fit with independent noise whose warning about correlated residuals says what helps."""
    if not any(one.startswith(CORRELATED) for one in result.warnings):
        return result
    advice = _advice(result, refit)
    warnings = (
        f"{one}; {advice}" if one.startswith(CORRELATED) else one for one in result.warnings
    )
    return replace(result, warnings=tuple(warnings))


def _advice(result: FitResult, refit: Callable[[FitResult, str], FitResult]) -> str:
    doubtful = [name for name, item in result.independence.items() if item.doubtful]
    left = {name: result.observed[name] - result.fitted[name] for name in doubtful}
    if not any(is_rough(series[np.isfinite(series)]) for series in left.values()):
        return (
            "no noise is that smooth: it is the law that deviates from the data (or from a formula "
            "or filter that made them), and its standard errors do not contain that"
        )
    for noise in ("ar1", "discrepancy"):
        other = refit(result, noise)
        if _describes(other, result):
            tried = f"`--noise {noise}`, which was tried, leaves independent residuals"
            return tried + _errors(other, result)
    return "`--noise ar1` and `--noise discrepancy`, which were tried, do not describe them either"


def _describes(other: FitResult, white: FitResult) -> bool:
    """Whether a noise model makes residuals independent and leaves the law as near to the data."""
    near = all(other.rms[name] <= _FARTHER * size for name, size in white.rms.items())
    return other.converged and near and not any(one.doubtful for one in other.independence.values())


def _errors(other: FitResult, white: FitResult) -> str:
    """How many times as large the standard errors of the coefficients are."""
    names = [*white.coefficients, *(item.expression for item in white.combinations)]
    pairs = {name: (white[name].stderr, other[name].stderr) for name in names if name in other}
    found = {name: new / old for name, (old, new) in pairs.items() if old and new}
    if not found:
        return ""
    times = join_words([f"{two_digits(ratio)} ({name})" for name, ratio in found.items()])
    return f"; standard errors are then larger by factors of {times}"
