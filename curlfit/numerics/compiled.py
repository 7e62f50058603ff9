"""Compiled programs that outlive the process.

A new process would have to trace, lower and compile the model, each of which takes
longer than a fit. The machine code of a `compiled` function is therefore stored in the
user's cache folder. The file name is a hash of all the program depends on: curlfit's
sources, JAX, the processor, the law and the shapes of the arrays. A law of the user
may change from run to run, so that its programs are traced each time and found by
their operations.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import pickle
import platform
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from threading import Lock, Thread
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jax.extend.mlir.passmanager import PassManager
from jaxlib import version as jaxlib_version

from curlfit.numerics import program_cache as cache
from curlfit.numerics.jax_settings import require_jax
from curlfit.numerics.threads import cores

_MOST_LOADED = 16  # programs in memory, of 5 to 30 MB each
_MOST_PARTS = 4  # of a program whose code is generated in parallel

_programs: dict[Any, Future[Any]] = {}
"""Loaded or being loaded, the most recently used last."""
_lock = Lock()


def compiled(
    *static: str, optimize: bool = False
) -> Callable[[Callable[..., Any]], _CompiledFunction]:
    """`jax.jit` for a function of arrays, whose compiled programs outlive the process.

    Parameters
    ----------
    static : names of arguments that are laws (classes), strings or tuples of
        these, not arrays.
    optimize : whether a faster program is worth a longer compilation, with more memory.
    """
    return lambda function: _CompiledFunction(function, static, optimize)


class _Call(NamedTuple):
    """The arguments of a call: those that are fixed in the program, and
    trees of arrays."""

    fixed: tuple[Any, ...]
    arrays: tuple[Any, ...]

    @property
    def key(self) -> tuple[Any, ...]:
        """What the program depends on."""
        leaves, tree = jax.tree.flatten(self.arrays)
        return self.fixed, tree, tuple((leaf.shape, leaf.dtype.str) for leaf in leaves)


class _CompiledFunction:
    def __init__(
        self, function: Callable[..., Any], static: tuple[str, ...], optimize: bool
    ) -> None:
        functools.update_wrapper(self, function)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.optimize = optimize
        self.static = [
            name in static for name in inspect.signature(function).parameters
        ]
        self.jitted = jax.jit(function, static_argnames=static)

    def __call__(self, *args: Any) -> Any:
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(args)):
            return self.jitted(*args)
        require_jax()
        call = self._call(args)
        program, is_new = self._program(call)
        if is_new:
            self._make(program, call)
        return program.result()(*call.arrays)

    def prepare(self, *args: Any) -> None:
        """Start loading or compiling, in a thread, the program of this call."""
        require_jax()
        if cores() > 1:
            call = self._call(args)
            program, is_new = self._program(call)
            if is_new:
                Thread(target=self._make, args=(program, call)).start()

    def _call(self, args: tuple[Any, ...]) -> _Call:
        fixed = []
        arguments = []
        for value, static in zip(args, self.static, strict=True):
            if static:
                fixed.append(value)
            else:
                arguments.append(value)
        # Lists and Python numbers become arrays, so that not every type is
        # compiled separately.
        arrays = jax.tree.map(
            lambda leaf: leaf if isinstance(leaf, jax.Array) else np.asarray(leaf),
            tuple(arguments),
        )
        return _Call(tuple(fixed), arrays)

    def _program(self, call: _Call) -> tuple[Future[Any], bool]:
        """The program of a call, and whether the caller has to make it."""
        key = (self, call.key)
        with _lock:
            program = _programs.pop(key, None)
            is_new = program is None
            if program is None:
                program = Future()
            _programs[key] = program  # as the last
            if len(_programs) > _MOST_LOADED:
                del _programs[next(iter(_programs))]
        return program, is_new

    def _make(self, program: Future[Any], call: _Call) -> None:
        """Load or compile the program of a call."""
        try:
            program.set_result(self._stored_or_compiled(call))
        except BaseException as error:  # raised where the program is called
            with _lock:
                _programs.pop((self, call.key), None)
            program.set_exception(error)

    def _stored_or_compiled(self, call: _Call) -> Any:
        lowered = None
        identity = self._identity(call)
        if identity is None:
            lowered = self._lowered(call)
            identity = lowered.as_text()
        file = _file(f"{self.optimize}\n{identity}")
        stored = None if file is None else _load(file)
        if stored is not None:
            return stored
        program = _compile(lowered or self._lowered(call), self.optimize)
        if file is not None:
            # Some devices cannot serialize programs, and none can once they have been
            # run: JAX returns such a one if the same function is compiled again.
            with suppress(ValueError, NotImplementedError, jax.errors.JaxRuntimeError):
                cache.write(file, pickle.dumps(serialize(program)))
        return program

    def _identity(self, call: _Call) -> str | None:
        """Text that tells the program from all others of these sources; None with
        a user's law."""
        lines = [self.name, repr(call.key[1:])]
        for value in jax.tree.leaves(call.fixed):
            if isinstance(value, type):
                if not value.shipped():  # type: ignore[attr-defined]
                    return None
                value = value.__qualname__
            lines.append(str(value))
        return "\n".join(lines)

    def _lowered(self, call: _Call) -> Any:
        fixed = iter(call.fixed)
        arrays = iter(call.arrays)
        args = [next(fixed if static else arrays) for static in self.static]
        lowered = self.jitted.lower(*args)
        # The place in Python's sources of each operation takes a sixth of the time to
        # compile, a tenth of the time to load, and two fifths of the file.
        module: Any = lowered.compiler_ir()
        with module.context:
            PassManager.parse("builtin.module(strip-debuginfo)").run(module.operation)
        return lowered


def _compile(lowered: Any, optimize: bool) -> Any:
    """Compile for a fast program if `optimize`, else for fast compilation.

    XLA's older kernel emitters take half the time and half the memory of the new ones,
    for programs that are slower by a quarter to a half. The fewer parts the code is
    split into, the less time it takes in total.
    `xla_cpu_prefer_vector_width` is left at its default: with 512 bits, trajectories
    take a tenth less time, but XLA in jaxlib 0.10 silently miscompiled the law `debris`
    summed by quadrature (`tests/inference/test_many.py` has the case).
    """
    if not optimize and jax.default_backend() == "cpu":
        options = {
            "xla_cpu_use_fusion_emitters": False,
            "xla_cpu_parallel_codegen_split_count": min(cores(), _MOST_PARTS),
        }
        # of a version without such an option
        with suppress(jax.errors.JaxRuntimeError):
            return lowered.compile(compiler_options=options)
    return lowered.compile()


def _load(file: Path) -> Any:
    """The program in a file; None if it is missing, damaged or from another build."""
    content = cache.read(file)
    if content is None:
        return None
    if b"lapack" in content:
        _initialize_lapack()
    with suppress(Exception):
        return deserialize_and_load(*pickle.loads(content))
    return None


@functools.cache
def _initialize_lapack() -> None:
    """Have JAX load LAPACK, as it does when it lowers a program that calls it."""
    jax.jit(jax.lax.linalg.cholesky).lower(np.eye(1))


def _file(identity: str) -> Path | None:
    """The file of a program; None where there is no cache."""
    folder = cache.folder()
    # A program that JAX takes from a cache of its own, named by the user, cannot
    # be serialized.
    if folder is None or jax.config.values["jax_compilation_cache_dir"] is not None:
        return None
    return folder / hashlib.sha256(f"{_fingerprint()}\n{identity}".encode()).hexdigest()


@functools.cache
def _fingerprint() -> str:
    """What all programs depend on: sources, JAX, the machine and its settings."""
    sources = sorted(Path(__file__).parents[1].rglob("*.py"))
    digest = hashlib.sha256(
        b"\0".join(source.read_bytes() for source in sources)
    ).hexdigest()
    device = jax.devices()[0]
    cpu = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu += next((line for line in lines if line.startswith("flags")), "")
    versions = (jax.__version__, jaxlib_version.__version__)
    settings = (
        os.environ.get("XLA_FLAGS", ""),
        str(jax.config.values["jax_enable_x64"]),
    )
    return "\n".join(
        (digest, *versions, device.platform, device.device_kind, cpu, *settings)
    )
