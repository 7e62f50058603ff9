"""Compiled programs, kept ready to run.

JAX's own cache spares a new process the compiling, but not the tracing and lowering of the model,
which take longer than a fit. A `kept` function is stored whole, machine code and all, in the user's
cache folder, and the next process runs it without tracing anything. What it was made from is in
its name: curlfit's sources, JAX, the processor, the law and the shapes of the arrays. A file that
is gone or cannot be read is made anew.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import inspect
import os
import pickle
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, TypeVar

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import numpy as np
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jaxlib import version as jaxlib_version

from curlfit.numerics import program_cache as cache

BATCH = 64
"""Throws or vectors that are followed side by side: few enough for a processor's cache, enough to
share the cost of a pass."""

Record = TypeVar("Record")


def kept(*static: str, often: bool = False) -> Callable[[Callable[..., Any]], _Kept]:
    """`jax.jit` for a function of arrays, whose compiled programs outlive the process.

    Parameters
    ----------
    static : names of arguments that are no arrays but laws (classes) or words.
    often : run so often that a faster program is worth more time and memory for its compiling.
    """
    return lambda function: _Kept(function, static, often)


class _Kept:
    def __init__(self, function: Callable[..., Any], static: tuple[str, ...], often: bool) -> None:
        functools.update_wrapper(self, function)
        self.name = function.__qualname__
        self.static = static
        self.often = often
        self.names = tuple(inspect.signature(function).parameters)
        self.jitted = jax.jit(function, static_argnames=static)
        self.programs: dict[Any, Any] = {}

    def __call__(self, *args: Any) -> Any:
        named = tuple(zip(self.names, args, strict=True))
        dynamic = tuple(value for name, value in named if name not in self.static)
        leaves, tree = jax.tree.flatten(dynamic)
        fixed = tuple(value for name, value in named if name in self.static)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return self.jitted(*args)
        # Lists of numbers and Python numbers become arrays of one kind, or each would be compiled.
        leaves = [leaf if isinstance(leaf, jax.Array) else np.asarray(leaf) for leaf in leaves]
        key = (fixed, tree, tuple((leaf.shape, leaf.dtype.str) for leaf in leaves))
        program = self.programs.get(key)
        if program is None:
            dynamic = jax.tree.unflatten(tree, leaves)
            program = self.programs[key] = self._ready(fixed, dynamic, repr(key[1:]))
        return program(*jax.tree.unflatten(tree, leaves))

    def _ready(self, fixed: tuple[Any, ...], dynamic: tuple[Any, ...], shapes: str) -> Any:
        file = self._file(fixed, shapes)
        whole = None if file is None else cache.read(file)
        if whole is not None:
            # A damaged file, or one of another build, fails in as many ways as there are builds,
            # some of them not before it is run.
            with suppress(Exception):
                program = _loaded(whole)
                jax.block_until_ready(program(*dynamic))
                return program
        return self._made(fixed, dynamic, file)

    def _made(self, fixed: tuple[Any, ...], dynamic: tuple[Any, ...], file: Path | None) -> Any:
        given, rest = iter(fixed), iter(dynamic)
        args = [next(given) if name in self.static else next(rest) for name in self.names]
        # A program out of JAX's own cache cannot be stored again.
        with unswept(), _without_cache() if file is not None else nullcontext():
            program = _compiled(self.jitted.lower(*args), self.often)
        if file is not None:
            # One that cannot be kept (of a device that gives none) is made again.
            with suppress(ValueError, NotImplementedError):
                cache.write(file, pickle.dumps(serialize(program)))
        return program

    def _file(self, fixed: tuple[Any, ...], shapes: str) -> Path | None:
        """Where the program lies; None where it is not to be kept."""
        folder = cache.folder("programs")
        words = []
        for value in fixed:
            if isinstance(value, type):
                if not value.shipped():  # type: ignore[attr-defined]
                    return None  # a law of the user's may change from run to run
                value = value.__qualname__
            words.append(str(value))
        if folder is None:
            return None
        about = "\n".join((self.__module__, self.name, *words, shapes, _origin()))
        return folder / hashlib.sha256(about.encode()).hexdigest()


def _compiled(lowered: Any, often: bool) -> Any:
    """As fast to run as may be where that matters, else as fast to make.

    XLA's older emitters of kernels take half the time and half the memory of the new ones, and make
    programs that are slower by a quarter to a half. `xla_cpu_prefer_vector_width` stays as it is:
    with 512 bits, paths take a tenth less, and XLA 0.10 compiles the law `debris` wrongly, without
    a word (`tests/numerics` has the case).
    """
    if not often and jax.default_backend() == "cpu":
        with suppress(jax.errors.JaxRuntimeError):  # of a version that knows no such option
            return lowered.compile(compiler_options={"xla_cpu_use_fusion_emitters": False})
    return lowered.compile()


@contextmanager
def unswept() -> Iterator[None]:
    """Without Python's search for cycles of objects, which goes through all of JAX ever again and
    takes a seventh of the time to trace and compile, a fifth of many fits. What makes many cycles
    has no place here."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@contextmanager
def _without_cache() -> Iterator[None]:
    from jax.experimental.compilation_cache.compilation_cache import reset_cache

    used = jax.config.values["jax_enable_compilation_cache"]
    jax.config.update("jax_enable_compilation_cache", False)
    reset_cache()  # JAX asks but once whether there is a cache
    try:
        yield
    finally:
        jax.config.update("jax_enable_compilation_cache", used)
        reset_cache()


@functools.cache
def _origin() -> str:
    """What every program depends on: sources, JAX, the machine and its settings."""
    sources = sorted(Path(__file__).parents[1].rglob("*.py"))
    stamps = [
        f"{source.name} {source.stat().st_mtime_ns} {source.stat().st_size}" for source in sources
    ]
    device = jax.devices()[0]
    cpu = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu += next((line for line in lines if line.startswith("flags")), "")
    versions = (jax.__version__, jaxlib_version.__version__)
    settings = (os.environ.get("XLA_FLAGS", ""), str(jax.config.values["jax_enable_x64"]))
    return "\n".join((*stamps, *versions, device.platform, device.device_kind, cpu, *settings))


def _loaded(whole: bytes) -> Any:
    from jaxlib import lapack

    lapack.prepare_lapack_call("geqrf_ffi", np.dtype(float))  # makes LAPACK known to programs
    return deserialize_and_load(*pickle.loads(whole))


def stacked(each: Sequence[Record]) -> Record:
    """Records of one shape as one, along the first axis of each array."""
    found: Record = jax.tree.map(lambda *leaves: np.stack(leaves), *each)
    return found


def unstacked(stack: Any) -> list[Any]:
    """What was stacked, one by one."""
    leaves, tree = jax.tree.flatten(stack)
    return [jax.tree.unflatten(tree, parts) for parts in zip(*leaves, strict=True)]


def in_batches(program: Callable[..., Any], stacks: tuple[Any, ...], batch: int = BATCH) -> Any:
    """What a program of `batch` records makes of the arrays of any number of records."""
    count = len(jax.tree.leaves(stacks)[0])
    fill = np.minimum(np.arange(-(-count // batch) * batch), count - 1)
    parts = [
        program(*jax.tree.map(lambda leaf, here=fill[k : k + batch]: leaf[here], stacks))
        for k in range(0, count, batch)
    ]
    return jax.tree.map(
        lambda *leaves: (np.concatenate(leaves) if parts[1:] else np.asarray(leaves[0]))[:count],
        *parts,
    )
