"""JAX as curlfit needs it: 64-bit numbers and a cache of compiled programs for each user.

Imported before any other use of JAX inside curlfit. The cache lies in the user's cache folder,
is keyed by the versions of curlfit and JAX, and may be deleted at any time. `CURLFIT_CACHE`
names another folder, or switches it off with `off`.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

# A program with a host callback in it is never cached, and equinox puts one in for each run-time
# check. The statuses of optimistix are read by curlfit itself.
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
from jaxlib import version as jaxlib_version

from curlfit.version import __version__


def cache_folder() -> Path | None:
    """Where compiled programs are kept, or None where the cache is off."""
    setting = os.environ.get("CURLFIT_CACHE", "")
    if setting.lower() in {"off", "0", "no", "false"}:
        return None
    if setting:
        return Path(setting).expanduser()
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "curlfit" / f"{__version__}-jax-{jax.__version__}-{jaxlib_version.__version__}"


def _configure() -> None:
    jax.config.update("jax_enable_x64", True)
    if jax.config.values["jax_compilation_cache_dir"] is not None:
        return  # the user's own choice stands
    folder = cache_folder()
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError:
        return
    if not os.access(folder, os.W_OK):
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


_configure()
