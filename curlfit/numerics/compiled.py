"""Compiled programs that outlive the process.

JAX's own cache saves a new process the compilation, but not the tracing and lowering of the model,
which take longer than a fit. A `compiled` function is stored with its machine code in the user's
cache folder, and the next process runs it without tracing. The file name is a hash of all the
program depends on: curlfit's sources, JAX, the processor, the law and the shapes of the arrays. A
file that is missing or cannot be read is replaced.
"""

from __future__ import annotations

import functools
import gc
import hashlib
import inspect
import os
import pickle
import platform
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from ctypes import CDLL
from pathlib import Path
from threading import Lock, Thread
from typing import Any, NamedTuple, TypeVar

from curlfit.numerics import jax_setup  # noqa: F401  (configures JAX before its first use)

# isort: split
import jax
import numpy as np
from jax import Array
from jax.experimental.serialize_executable import serialize
from jaxlib import version as jaxlib_version

from curlfit.numerics import program_cache as cache
from curlfit.numerics.read_ahead import AHEAD, deserialized
from curlfit.numerics.threads import cores

BATCH = 64
"""Throws or vectors in one call of a program: few enough for a processor's cache, enough to
amortize the cost of a pass."""

_MOST_LOADED = 16  # programs in memory, of 5 to 30 MB each
_MOST_PARTS = 4  # of a program whose code is generated in parallel

Record = TypeVar("Record")


def compiled(
    *static: str, optimize: bool = False
) -> Callable[[Callable[..., Any]], _CompiledFunction]:
    """`jax.jit` for a function of arrays, whose compiled programs outlive the process.

    Parameters
    ----------
    static : names of arguments that are laws (classes), strings or tuples of these, not arrays.
    optimize : whether a faster program is worth a longer compilation, with more memory.
    """
    return lambda function: _CompiledFunction(function, static, optimize)


class _LoadedPrograms:
    """The most recently used programs, in memory; safe for use by several threads."""

    def __init__(self) -> None:
        self.programs: OrderedDict[Any, Any] = OrderedDict()
        self.lock = Lock()

    def get(self, key: Any) -> Any:
        with self.lock:
            program = self.programs.get(key)
            if program is not None:
                self.programs.move_to_end(key)
            return program

    def __setitem__(self, key: Any, program: Any) -> None:
        with self.lock:
            self.programs[key] = program
            full = len(self.programs) > _MOST_LOADED
            if full:
                self.programs.popitem(last=False)
        if full:
            return_memory()


_loaded = _LoadedPrograms()


class _Program(NamedTuple):
    """A compiled program, of arrays alone, and the structure of its result."""

    run: Any
    structure: Any

    def __call__(self, leaves: list[Any]) -> Any:
        return jax.tree.unflatten(self.structure, self.run(*leaves))


class _Call(NamedTuple):
    """The arguments of a call: those that are fixed in the program, and its arrays."""

    fixed: tuple[Any, ...]
    tree: Any
    leaves: list[Any]

    @property
    def key(self) -> tuple[Any, ...]:
        """What the program depends on."""
        return self.fixed, self.tree, tuple((leaf.shape, leaf.dtype.str) for leaf in self.leaves)


_locks: dict[Any, Lock] = {}
"""One per program, held by the thread that loads or compiles it."""


class _CompiledFunction:
    def __init__(
        self, function: Callable[..., Any], static: tuple[str, ...], optimize: bool
    ) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self.name = function.__qualname__
        self.static = static
        self.optimize = optimize
        self.names = tuple(inspect.signature(function).parameters)

    def __call__(self, *args: Any) -> Any:
        call = self._call(args)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in call.leaves):
            return self.jitted(*args)
        key = self, call.key
        program = _loaded.get(key)
        if program is None:
            with _locks.setdefault(key, Lock()):
                program = _loaded.get(key)  # from another thread
                if program is None:
                    file = self._cache_file(call)
                    found = None if file is None else _load(file, call.leaves)
                    if found is not None:
                        _loaded[key], result = found
                        return result
                    program = _loaded[key] = self._compile(call, file)
        return program(call.leaves)

    def prepare(self, *args: Any) -> None:
        """Start compiling, in a thread, the program of this call, unless it is already stored."""
        call = self._call(args)
        key = self, call.key
        if cores() < 2 or _loaded.get(key) is not None:
            return
        file, lock = self._cache_file(call), _locks.setdefault(key, Lock())
        if file is None or file.exists() or not lock.acquire(blocking=False):
            return

        def compile_it() -> None:
            try:
                with suppress(Exception):  # which the call will raise again
                    _loaded[key] = self._compile(call, file)
            finally:
                lock.release()

        Thread(target=compile_it).start()

    def _call(self, args: tuple[Any, ...]) -> _Call:
        named = tuple(zip(self.names, args, strict=True))
        dynamic = tuple(value for name, value in named if name not in self.static)
        fixed = tuple(value for name, value in named if name in self.static)
        leaves, tree = jax.tree.flatten(dynamic)
        # Lists and Python numbers become arrays, so that not every type is compiled separately.
        leaves = [leaf if isinstance(leaf, jax.Array) else np.asarray(leaf) for leaf in leaves]
        return _Call(fixed, tree, leaves)

    @functools.cached_property
    def jitted(self) -> Any:
        """The function under `jax.jit`, for use within other programs."""
        return jax.jit(self.function, static_argnames=self.static)

    def _compile(self, call: _Call, file: Path | None) -> _Program:
        structures = []

        def of_leaves(*leaves: Array) -> list[Array]:
            fixed_values = iter(call.fixed)
            arrays = iter(jax.tree.unflatten(call.tree, leaves))
            result = self.function(
                *(next(fixed_values if name in self.static else arrays) for name in self.names)
            )
            out, structure = jax.tree.flatten(result)
            structures.append(structure)
            return out

        of_leaves.__name__ = self.name
        # A program from JAX's own cache cannot be serialized.
        with gc_paused(), _jax_cache_disabled if file is not None else nullcontext():
            lowered = jax.jit(of_leaves).lower(*call.leaves)
            _remove_locations(lowered)
            with _compiling as programs:
                run = _compile_lowered(lowered, self.optimize, parts=cores() // programs)
            program = _Program(run, structures[0])
        if file is not None:
            # Some devices cannot serialize programs.
            with suppress(ValueError, NotImplementedError):
                cache.write(file, _serialized(program))
                AHEAD.note(file)
        del lowered
        return_memory()
        return program

    def _cache_file(self, call: _Call) -> Path | None:
        """The file of the program; None if it is not to be stored."""
        folder = cache.folder("programs")
        words = []
        for value in jax.tree.leaves(call.fixed):
            if isinstance(value, type):
                if not value.shipped():  # type: ignore[attr-defined]
                    return None  # a user's law may change from run to run
                value = value.__qualname__
            words.append(str(value))
        if folder is None:
            return None
        words += [str(self.optimize), repr(call.key[1:]), _fingerprint()]
        key = "\n".join((self.__module__, self.name, *words))
        return folder / hashlib.sha256(key.encode()).hexdigest()


def _remove_locations(lowered: Any) -> None:
    """Remove the Python source location of each operation, which saves a sixth of the time to
    compile, a tenth of the time to load, and two fifths of the file."""
    from jaxlib.mlir.passmanager import PassManager

    module = lowered.compiler_ir()
    with module.context:
        PassManager.parse("builtin.module(strip-debuginfo)").run(module.operation)


class _Count:
    """Context manager that counts the threads within it, this one included."""

    def __init__(self) -> None:
        self.inside = 0
        self.lock = Lock()

    def __enter__(self) -> int:
        with self.lock:
            if not self.inside:
                self.begin()
            self.inside += 1
            return self.inside

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.inside -= 1
            if not self.inside:
                self.end()

    def begin(self) -> None:
        """Called when the first thread enters."""

    def end(self) -> None:
        """Called when the last thread leaves."""


_compiling = _Count()


def _compile_lowered(lowered: Any, optimize: bool, *, parts: int) -> Any:
    """Compile for a fast program if `optimize`, else for fast compilation.

    XLA's older kernel emitters take half the time and half the memory of the new ones, for programs
    that are slower by a quarter to a half. The fewer parts the code is split into, the less time it
    takes in total: there are only as many as there are spare processors.
    `xla_cpu_prefer_vector_width` is left at its default: with 512 bits, trajectories take a tenth
    less time, but XLA in jaxlib 0.10 silently miscompiled the law `debris` summed by quadrature
    (`tests/inference/test_many.py` has the case).
    """
    if not optimize and jax.default_backend() == "cpu":
        options = {
            "xla_cpu_use_fusion_emitters": False,
            "xla_cpu_parallel_codegen_split_count": min(max(parts, 1), _MOST_PARTS),
        }
        with suppress(jax.errors.JaxRuntimeError):  # of a version without such an option
            return lowered.compile(compiler_options=options)
    return lowered.compile()


def return_memory() -> None:
    """Return memory freed by XLA's threads to the system, which glibc would retain: half of what a
    program needs while it is compiled or loaded."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # of another C library
            CDLL(None).malloc_trim(0)


@contextmanager
def gc_paused() -> Iterator[None]:
    """Pause Python's cyclic garbage collector, which traverses all of JAX repeatedly: a seventh of
    the time to trace and compile, a fifth of the time to fit many throws."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class _JaxCacheDisabled(_Count):
    """Context in which JAX does not use its own cache."""

    enabled: bool

    def begin(self) -> None:
        """Disable the cache and remember its setting."""
        self.enabled = jax.config.values["jax_enable_compilation_cache"]
        self._enable(False)

    def end(self) -> None:
        """Restore the setting."""
        self._enable(self.enabled)

    @staticmethod
    def _enable(enabled: bool) -> None:
        from jax.experimental.compilation_cache.compilation_cache import reset_cache

        jax.config.update("jax_enable_compilation_cache", enabled)
        reset_cache()  # JAX determines only once whether there is a cache


_jax_cache_disabled = _JaxCacheDisabled()


@functools.cache
def _fingerprint() -> str:
    """What all programs depend on: sources, JAX, the machine and its settings."""
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


def _serialized(program: _Program) -> bytes:
    # The structure has curlfit's types, which need not be imported where the rest is read ahead.
    return pickle.dumps((serialize(program.run), pickle.dumps(program.structure)))


def _load(file: Path, leaves: list[Any]) -> tuple[_Program, Any] | None:
    """The program in a file, and its result; None if there is no usable file."""
    # A damaged file, or one from another build, may raise any exception, even when run.
    with suppress(Exception):
        found = AHEAD.taken(file)
        if found is None:
            content = cache.read(file)
            if content is None:
                return None
            found = deserialized(content)
        run, structure = found
        program = _Program(run, pickle.loads(structure))
        result = jax.block_until_ready(program(leaves))
        AHEAD.note(file)
        return_memory()
        return program, result
    return None


def stacked(records: Sequence[Record]) -> Record:
    """Records of equal shapes as one record, stacked along the first axis of each array."""
    record: Record = jax.tree.map(lambda *leaves: np.stack(leaves), *records)
    return record


def unstacked(stack: Any) -> list[Any]:
    """The records of a stack."""
    leaves, tree = jax.tree.flatten(stack)
    return [jax.tree.unflatten(tree, parts) for parts in zip(*leaves, strict=True)]


def in_batches(program: Callable[..., Any], stacks: tuple[Any, ...], batch: int = BATCH) -> Any:
    """Apply a program for `batch` records to the arrays of any number of records."""
    count = len(jax.tree.leaves(stacks)[0])
    rows = np.minimum(np.arange(-(-count // batch) * batch), count - 1)
    parts = [
        program(*jax.tree.map(lambda leaf, rows=rows[k : k + batch]: leaf[rows], stacks))
        for k in range(0, count, batch)
    ]
    return jax.tree.map(
        lambda *leaves: (np.concatenate(leaves) if parts[1:] else np.asarray(leaves[0]))[:count],
        *parts,
    )
