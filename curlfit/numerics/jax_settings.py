"""Settings of JAX, in variables of the environment, under which curlfit cannot
compute."""

from __future__ import annotations

import functools
import os
import sys

from curlfit.errors import InputError
from curlfit.foreign import quoted

_PLATFORMS = ("JAX_PLATFORMS", "JAX_PLATFORM_NAME")
_DISABLE = "JAX_DISABLE_JIT"
_FALSE = ("n", "no", "f", "false", "off", "0")  # as JAX reads them


def require_jax() -> None:
    """Raise `InputError` where JAX may not compile, or finds no processor of the kind
    that it is told to use. JAX is loaded only if it is told to use another than the
    usual one."""
    if "jax" in sys.modules:
        _require_compilation()
        _require_processor()
        return
    disabled = os.environ.get(_DISABLE, "0")
    if disabled.lower() not in _FALSE:
        raise _no_compilation(f"{_DISABLE}={disabled}")
    for name in _PLATFORMS:
        platforms = os.environ.get(name)
        if platforms and "cpu" not in platforms.split(","):
            _require_processor()


def _require_compilation() -> None:
    import jax

    if jax.config.jax_disable_jit:  # type: ignore[attr-defined]
        setting = "jax.disable_jit"
        if _DISABLE in os.environ:
            setting = f"{_DISABLE}={os.environ[_DISABLE]}"
        raise _no_compilation(setting)


def _no_compilation(setting: str) -> InputError:
    return InputError(
        f"{setting}: curlfit computes with programs that JAX compiles; leave it out, "
        "or set it to 0"
    )


@functools.cache
def _require_processor() -> None:
    import jax

    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:  # the latter without a message
        values = {name: jax.config.values[name.lower()] for name in _PLATFORMS}
        settings = [f"{name}={value}" for name, value in values.items() if value]
        if not settings:
            raise InputError(
                f"JAX finds no processor ({quoted(str(error))}); set JAX_PLATFORMS=cpu"
            ) from None
        raise InputError(
            f"{' and '.join(settings)}: JAX finds no such processor on this machine; "
            "leave it out, or set it to cpu"
        ) from None
