"""Configuration of JAX, with a cache of compiled programs for each user.

Imported before any other use of JAX inside curlfit. 64-bit numbers are enabled earlier, by
`curlfit` itself.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

# Programs with host callbacks are never cached, and each run-time check of equinox is a callback.
# curlfit checks the status of optimistix itself.
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax

from curlfit.numerics import program_cache as cache


def _configure() -> None:
    if jax.config.values["jax_compilation_cache_dir"] is not None:
        return  # chosen by the user
    folder = cache.folder("jax")
    if folder is None:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    _use_program_cache(folder)


def _use_program_cache(folder: Path) -> None:
    """Let JAX read and write entries in that folder through `curlfit.numerics.program_cache`.

    JAX itself does not check ownership, leaves incomplete entries on a full disk or when killed,
    does not repair them, and warns at each later run. With `jax_compilation_cache_max_size` it
    needs a lock for each access, and an incomplete entry stops all writing.
    """
    try:
        from jax._src.lru_cache import _CACHE_SUFFIX, LRUCache
    except ImportError:  # another version of JAX
        return
    get, put = LRUCache.get, LRUCache.put

    def entry(self: Any, key: str) -> Path | None:
        file = Path(str(self.path)) / f"{key}{_CACHE_SUFFIX}"
        return file if file.parent == folder and not self.eviction_enabled else None

    def get_checked(self: Any, key: str) -> bytes | None:
        file = entry(self, key)
        return get(self, key) if file is None else cache.read(file)

    def put_atomically(self: Any, key: str, value: bytes) -> None:
        file = entry(self, key)
        if file is None:
            put(self, key, value)
        else:
            cache.write(file, value)

    LRUCache.get, LRUCache.put = get_checked, put_atomically  # type: ignore[method-assign]


_configure()

# Starts loading programs, now that JAX is configured.
from curlfit.numerics import read_ahead  # noqa: E402, F401
