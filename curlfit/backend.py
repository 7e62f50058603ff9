"""JAX as curlfit needs it: 64-bit numbers and a cache of compiled programs for each user.

Imported before any other use of JAX inside curlfit. The cache lies in the user's cache folder,
is keyed by the versions of curlfit and JAX, and may be deleted at any time. `CURLFIT_CACHE`
names another folder, or switches it off with `off`.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

# A program with a host callback in it is never cached, and equinox puts one in for each run-time
# check. The statuses of optimistix are read by curlfit itself.
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
from jaxlib import version as jaxlib_version

from curlfit.errors import InputError
from curlfit.files import replaced
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
    _keep_whole_entries()


def _keep_whole_entries() -> None:
    """Have entries of the cache moved into place. JAX itself leaves half of one behind on a full
    disk or when killed, does not mend it, and warns of it ever after."""
    try:
        from jax._src.lru_cache import _CACHE_SUFFIX, LRUCache
    except ImportError:  # another version of JAX, which may do better
        return
    put = LRUCache.put

    def put_whole(self: Any, key: str, value: bytes) -> None:
        file = Path(str(self.path)) / f"{key}{_CACHE_SUFFIX}"
        if self.eviction_enabled or not file.parent.is_dir():
            put(self, key, value)
        elif not file.exists():
            with suppress(InputError), replaced(file) as temporary:
                temporary.write_bytes(value)

    LRUCache.put = put_whole  # type: ignore[method-assign]


_configure()
