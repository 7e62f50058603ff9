"""Which noise models are compared."""

from __future__ import annotations

from collections.abc import Sequence

from curlfit.errors import InputError
from curlfit.inference.noise.models import NOISES, check_noise


def noise_models(noise: str | Sequence[str], loss: str = "linear") -> tuple[str, ...]:
    """Names of noise models, given as a sequence or separated by commas, without duplicates.

    Raises `InputError` if one is unknown or not compatible with the loss, or if there is none.
    """
    names = noise.split(",") if isinstance(noise, str) else noise
    found = tuple(dict.fromkeys(name.strip() for name in names))
    if not found:
        raise InputError(f"noise = []: expected one or several of {', '.join(NOISES)}")
    return tuple(check_noise(name, loss) for name in found)
