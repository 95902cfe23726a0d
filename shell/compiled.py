"""Compiled functions (kernels) whose cache notices every change of what was compiled in.

Numba compiles the functions that a kernel calls, and the values of the constants that it names, into the kernel, and
keeps the result on disk. Its own stamp covers the kernel's file alone: when a function or constant of another file
changes, as after an update, the old code would run on. The stamp here covers these, too. Every kernel of the project
is made with `njit` of this module.
"""

import hashlib
import inspect
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, Final, Self, TypeVar

import numba
import numpy as np
from numba import config, types
from numba.core import caching, cgutils, dispatcher, event
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys
from numba.experimental import structref
from numba.extending import intrinsic, is_jitted
from numba.np.arrayobj import make_array

from shell.service import say
from shell.watchdog import WATCHDOG

__all__ = ["Held", "borrowed", "hold", "njit"]


@contextmanager
def _missing(*names: str) -> Iterator[None]:
    """Let the import of modules fail meanwhile."""
    there = {name: sys.modules.pop(name) for name in names if name in sys.modules}
    sys.modules |= dict.fromkeys(names)  # type: ignore[arg-type]  # None: not to be found
    try:
        yield
    finally:
        for name in names:
            del sys.modules[name]
        sys.modules |= there


# Numba imports both only to see that they are there, 0.2 s for SciPy's. No kernel calls functions of CFFI, or np.cov;
# for products of matrices Numba imports SciPy's again.
with _missing("cffi", "scipy.linalg.cython_blas"):
    import numba.core.typing.cffi_utils
    import numba.np.arraymath

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
#: A process that compiles for longer logs the reason.
SILENT_S: Final = 4.0


def _borrowed(_context: Any, arrays: Any) -> Any:
    """Return a (named) tuple of arrays and numbers whose arrays no reference is counted to, inside a kernel.

    Numba counts references to arrays with an atomic addition at nearly every access of a tuple, which takes longer
    than the arithmetic. The caller of the kernel holds the arrays meanwhile; the result must not leave the kernel.
    """

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _uncounted(context, builder, signature.return_type, values[0])

    return arrays(arrays), codegen


def _uncounted(context: Any, builder: Any, of_type: Any, value: Any) -> Any:
    """Return a value of compiled code, and what is in a tuple, without the counter of references of an array."""
    if isinstance(of_type, types.Array):
        array = make_array(of_type)(context, builder, value)  # type: ignore[no-untyped-call]
        array.meminfo = cgutils.get_null_value(array.meminfo.type)  # type: ignore[no-untyped-call]
        return array._getvalue()  # noqa: SLF001  numba's own way to store the value
    each_type: Any = of_type if isinstance(of_type, types.BaseTuple) else ()
    if each_type:
        elements = cgutils.unpack_tuple(builder, value, len(each_type))  # type: ignore[no-untyped-call]
        parts = [_uncounted(context, builder, *each) for each in zip(each_type, elements, strict=True)]
        return context.make_tuple(builder, of_type, parts)
    return value


borrowed: Any = intrinsic(_borrowed)


class _Stamped:
    """A place of the cache whose stamp is that of everything that a kernel is made of."""

    def __init__(self, py_func: FunctionType, py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[call-arg]  # the numba class beside this one takes them
        self._globals = py_func.__globals__
        self._file = py_file

    def get_source_stamp(self) -> Self:
        """Return what has the stamp as its text, for `Index`: most kernels of a process are never called."""
        return self

    def __str__(self) -> str:
        """Return a hash over the files of the kernel and of the kernels that it can call, and over what these name.

        The files' names are those of their modules: a copy of the project can use what the project has compiled.
        """
        parts: dict[str, str] = {}
        _collect(self._file, self._globals, parts)
        return hashlib.sha256(repr(sorted(parts.items())).encode()).hexdigest()


class FolderGiven(_Stamped, UserProvidedCacheLocator):
    """The folder of `NUMBA_CACHE_DIR`."""


class FolderOfSource(_Stamped, InTreeCacheLocator):
    """`__pycache__` beside the source, where it can be written."""


class FolderOfUser(_Stamped, UserWideCacheLocator):
    """The user's cache folder."""


class Index(caching.IndexDataCacheFile):
    """The kernels of a function on disk, by the types of their arguments."""

    def _load_index(self) -> Any:
        """Return what was kept; nothing where the class of an argument is gone, which Numba finds before the stamp."""
        self._source_stamp = str(self._source_stamp)
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except (AttributeError, ImportError):
            return {}


caching.IndexDataCacheFile = Index  # type: ignore[misc]


class Cache(caching.FunctionCache):
    """The cache of a kernel, which loads without what the compiler alone needs, and prepares when it compiles."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kernel for a signature, None if there is none."""
        rtsys.initialize(target_context)
        return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


dispatcher.FunctionCache = Cache  # type: ignore[attr-defined]


def _collect(file: str, names: dict[str, Any], parts: dict[str, str]) -> None:
    """Add a file, constants and fields of tuples among its module's `names`, and the files of kernels among them."""
    module = names["__name__"]
    parts[module] = _content(file)
    for name, value in list(names.items()):
        if name.startswith("__"):
            continue
        if is_jitted(value):
            callee = value.py_func.__globals__
            if callee["__name__"] not in parts:
                _collect(inspect.getfile(value.py_func), callee, parts)
        elif _is_plain(value):
            parts[f"{module}:{name}"] = repr(value)
        elif isinstance(value, type) and issubclass(value, tuple):
            parts[f"{module}:{name}"] = repr(getattr(value, "_fields", ()))
        elif isinstance(value, np.ndarray):
            parts[f"{module}:{name}"] = f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"


def _is_plain(value: object) -> bool:
    """Tell whether a value is a constant whose text says all of it; the text of others may have an address."""
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    return isinstance(value, int | float | complex | str | np.generic)


@cache
def _content(file: str) -> str:
    """Hash a source file once in a process: what was imported does not change later."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


#: Where a kernel is kept, in this order.
PLACES: Final[tuple[Any, ...]] = (FolderGiven, FolderOfSource, FolderOfUser)
config.CACHE_LOCATOR_CLASSES = ",".join(  # type: ignore[attr-defined]  # numba makes its settings at run time
    f"{place.__module__}.{place.__qualname__}" for place in PLACES
)


class _Compiling(event.Listener):
    """Tells the watchdog, and after `SILENT_S` the user, that kernels are compiled one by one."""

    keeps = True

    def __init__(self) -> None:
        self._begun_s = self._newest_s = float("-inf")
        self._has_said = False

    def on_start(self, event: Any) -> None:  # noqa: ARG002 - Numba gives it
        """Note that the compiler begins or ends with a kernel."""
        WATCHDOG.compiles()
        now_s = time.monotonic()
        if now_s - self._newest_s > SILENT_S:
            self._begun_s = now_s
        self._newest_s = now_s
        if now_s - self._begun_s >= SILENT_S and not self._has_said:
            self._has_said = True
            when = "as on every first start" if self.keeps else "at each start: no folder for them can be written"
            say("kernels", f"compiled for this processor, {when}")

    on_end = on_start


COMPILING: Final = _Compiling()
event.register("numba:compile", COMPILING)  # type: ignore[no-untyped-call]


def njit(signature: Any = None, *, cache: bool = False, **options: Any) -> Callable[[Kernel], "Dispatcher[Kernel]"]:
    """Return what compiles a function as ``numba.njit`` does, and keeps the kernel where `cache` is set.

    With a signature all arguments are converted to its types. No kernel is compiled or loaded before its first call.

    On a machine where none of `PLACES` can be written, such as a container without volumes, the kernel is compiled in
    memory by every process. There Numba raises RuntimeError for ``cache=True``.
    """

    def compile_kernel(function: Kernel) -> "Dispatcher[Kernel]":
        keeps = cache and any(place.from_function(function, inspect.getfile(function)) for place in PLACES)
        COMPILING.keeps &= keeps or not cache
        compiling: Any = numba.njit  # its overloads do not know arguments that are passed on
        kernel: Dispatcher[Kernel] = compiling(cache=keeps, **options)(function)
        if signature is None:
            return kernel

        def compile_signature(*_: Any, **__: Any) -> Any:
            with global_compiler_lock:
                kernel.disable_compile(False)  # another thread may have been here meanwhile
                entry = kernel.compile(signature)
                kernel.disable_compile()  # from now on arguments are converted
            return entry

        kernel._compile_for_args = compile_signature  # type: ignore[attr-defined]  # noqa: SLF001  what a first call calls
        return kernel

    return compile_kernel


@structref.register
class HeldType(types.StructRef):
    """The type of `Held` in kernels; it depends on the type of the value."""


class Held(structref.StructRefProxy):
    """A (named) tuple of arrays and numbers that `hold` has bound, for kernels: its attribute `value`.

    A call of a kernel takes as long as some hundred frames if it has to look at 40 arrays each time.
    """


structref.define_proxy(Held, HeldType, ["value"])  # type: ignore[no-untyped-call]


@njit(cache=True)
def hold(value: Any) -> Held:
    """Return a (named) tuple as an argument for kernels that is looked at once."""
    return Held(value)  # type: ignore[no-untyped-call]
