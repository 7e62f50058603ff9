"""JAX as curlfit needs it, with a cache of compiled programs for each user.

Imported before any other use of JAX inside curlfit. 64-bit numbers are switched on by `curlfit`
itself, before that.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

# A program with a host callback in it is never cached, and equinox puts one in for each run-time
# check. The statuses of optimistix are read by curlfit itself.
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax

from curlfit.numerics import program_cache as cache


def _configure() -> None:
    if jax.config.values["jax_compilation_cache_dir"] is not None:
        return  # the user's own choice stands
    folder = cache.folder("jax")
    if folder is None:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    _keep_in(folder)


def _keep_in(folder: Path) -> None:
    """Have JAX read and write the entries in that folder as `curlfit.numerics.program_cache` does.

    JAX itself reads whatever lies there, and leaves half of an entry behind on a full disk or when
    killed, does not mend it, and warns of it ever after. With `jax_compilation_cache_max_size` it
    needs a lock for each access, and half of an entry ends all writing.
    """
    try:
        from jax._src.lru_cache import _CACHE_SUFFIX, LRUCache
    except ImportError:  # another version of JAX, which may do better
        return
    get, put = LRUCache.get, LRUCache.put

    def ours(self: Any, key: str) -> Path | None:
        file = Path(str(self.path)) / f"{key}{_CACHE_SUFFIX}"
        return file if file.parent == folder and not self.eviction_enabled else None

    def get_own(self: Any, key: str) -> bytes | None:
        file = ours(self, key)
        return get(self, key) if file is None else cache.read(file)

    def put_whole(self: Any, key: str, value: bytes) -> None:
        file = ours(self, key)
        if file is None:
            put(self, key, value)
        else:
            cache.write(file, value)

    LRUCache.get, LRUCache.put = get_own, put_whole  # type: ignore[method-assign]


_configure()
