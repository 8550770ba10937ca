"""How kernels are compiled: numba, without the GIL, cached on disk by what is compiled.

A compiled kernel is kept in a file named by its fingerprint and the types of its arguments. The fingerprint is that of
the kernel's bytecode, of the kernels that it calls and of the constants that it uses, wherever they are defined: an
edit recompiles the kernels that it changes and no others. Of several processes that need the same kernel one compiles,
and the others wait for its file. Files that no process has used for months are removed when a new one is written. Why
numba's own cache is not used is in docs/decisions/0001-numba-kernels.md.
"""

import contextlib
import dis
import hashlib
import logging
import os
import pickle
import re
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from functools import cache
from pathlib import Path
from time import monotonic
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import llvmlite.ir
import numba
import numpy as np
from numba.core import types
from numba.core.caching import CompileResultCacheImpl, NullCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic  # pyright: ignore[reportPrivateUsage]
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature
from numba.extending import intrinsic
from numba.np import linalg

_log = logging.getLogger("lightopt.core")

_NO_SETTINGS = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_THREADING_LAYER")  # which change no machine code
_UNUSED_S = 90 * 86400.0  # files of kernels that were not used for so long are removed [s]
LOGGED_SECONDS = 0.1  # compiling a kernel takes longer than this, loading it less

_VERSIONS = repr((sys.version_info[:2], numba.__version__, llvmlite.__version__, np.__version__))


@cache
def cache_folder() -> Path:
    """Folder of compiled kernels, in the user's cache; a temporary one where that cannot be written."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        base = Path(chosen)
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = base / "lightopt" / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        # compiled kernels are pickles: never in a folder whose name others could have taken
        folder = Path(tempfile.mkdtemp(prefix="lightopt-kernels-"))
    return folder


def compiled_before() -> bool:
    """Whether kernels were compiled on this machine; if not, the first run takes longer than the next one."""
    return any(cache_folder().glob("*.kernel"))


def kernel(function: Callable[..., Any]) -> Any:
    """Decorate a function that runs compiled, on arrays and numbers, without holding the interpreter's lock."""
    compiled: Any = numba.njit(nogil=True, error_model="numpy")(function)
    if isinstance(compiled, Dispatcher):  # not where NUMBA_DISABLE_JIT is set
        _keep_on_disk(compiled)
    return compiled


def _call(_typing: Any, _function: Any, _a: Any, _b: Any, _c: Any, _d: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, addresses: Any) -> Any:
        pointer = llvmlite.ir.IntType(8).as_pointer()
        kind = llvmlite.ir.FunctionType(llvmlite.ir.VoidType(), [pointer] * 4)
        function = builder.inttoptr(addresses[0], kind.as_pointer())
        builder.call(function, [builder.inttoptr(address, pointer) for address in addresses[1:]])
        return context.get_dummy_value()

    return types.void(*[types.int64] * 5), generate


# call, from a kernel, a C function of four pointers that returns nothing; all five are given as addresses
call_address: Any = intrinsic(_call)


def _same_bits(kind_from: Any, kind_to: Any) -> Any:
    def typed(_typing: Any, _value: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            return builder.bitcast(values[0], context.get_value_type(kind_to))

        return kind_to(kind_from), generate

    return typed


# the number in whose place, from a kernel, another one of the same bits is taken: float64 to int64, and back
bits_of_float: Any = intrinsic(_same_bits(types.float64, types.int64))
float_of_bits: Any = intrinsic(_same_bits(types.int64, types.float64))


@cache
def fingerprint(compiled: Any) -> str:
    """Digest of all that the machine code of a kernel depends on, but the types of its arguments and the processor.

    Raises TypeError: When the kernel uses something whose content has no digest, such as a module of the package
    """
    function: FunctionType = compiled.py_func
    digest = hashlib.sha256(_VERSIONS.encode())
    digest.update(f"{function.__module__}\n".encode())  # kept machine code names the modules of its types
    code = function.__code__
    _add_code(digest, code, skip=1 if function.__doc__ is not None else 0)
    digest.update(repr(function.__defaults__).encode())
    used = {name: function.__globals__[name] for name in _globals_of(code) if name in function.__globals__}
    cells = (cell.cell_contents for cell in function.__closure__ or ())
    used.update(zip(code.co_freevars, cells, strict=True))
    for name, value in sorted(used.items()):
        digest.update(f"{name} = {_content(value, name, function)}\n".encode())
    return digest.hexdigest()


def _add_code(digest: Any, code: CodeType, *, skip: int = 0) -> None:
    """Add bytecode and constants, without line numbers and without the docstring, which is the first constant."""
    digest.update(repr((code.co_code, code.co_names, code.co_varnames, code.co_freevars)).encode())
    for constant in code.co_consts[skip:]:
        if isinstance(constant, CodeType):
            _add_code(digest, constant)
        else:
            content = sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant
            digest.update(f"{content!r}\n".encode())


def _globals_of(code: CodeType) -> set[str]:
    names = {step.argval for step in dis.get_instructions(code) if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return names.union(*map(_globals_of, inner))


def _content(value: Any, name: str, user: FunctionType) -> str:
    """What a kernel sees of a global: the fingerprint of another kernel, the value of a constant."""
    if isinstance(value, Dispatcher):
        function = value.py_func  # pyright: ignore[reportAttributeAccessIssue]
        return "itself" if function is user else fingerprint(value)
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic | np.dtype):
        return repr(value)
    if isinstance(value, tuple):
        fields = getattr(value, "_fields", ())
        return repr((fields, [_content(item, name, user) for item in value]))  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.flags.c_contiguous} {value.tobytes('A').hex()}"
    if isinstance(value, type) and (value.__module__ in ("builtins", "numpy") or hasattr(value, "_fields")):
        return f"{value.__module__} {value.__qualname__} {getattr(value, '_fields', '')}"
    if isinstance(value, BuiltinFunctionType | np.ufunc):
        return f"{value.__name__}"
    if isinstance(value, _Intrinsic):  # how numba makes the code of a call; what it uses are parts of numba
        digest = hashlib.sha256()
        _add_code(digest, value._defn.__code__)  # pyright: ignore[reportPrivateUsage]
        return digest.hexdigest()
    if isinstance(value, ModuleType) and value.__name__.split(".")[0] in ("math", "numpy"):
        return value.__name__
    what = f"{user.__qualname__} uses {name}, a {type(value).__name__}"
    raise TypeError(f"{what}: a compiled kernel may use other kernels, numbers, arrays, math and numpy")


def _keep_on_disk(compiled: Any) -> None:
    """Let a kernel load what was compiled before, and compile what was not while no other process does."""
    found = _DiskCache(compiled)
    compiled._cache = found
    compile_here, call_template = compiled.compile, compiled.get_call_template

    def one_for_all_constants(arguments: Any, keywords: Any) -> Any:
        # else each number that a kernel is called with by name or literally is a type of its own, compiled anew
        plain = {name: types.unliteral(kind) for name, kind in keywords.items()}
        return call_template(tuple(map(types.unliteral, arguments)), plain)

    def compile_once(signature: Any) -> Any:
        # numba's lock first: a thread that holds it may need the file of a kernel that this one calls
        with global_compiler_lock:
            _load_array_functions()
            with found.turn(signature):
                begun = monotonic()
                result = compile_here(signature)
                if (seconds := monotonic() - begun) > LOGGED_SECONDS:
                    _log.info("compiled %s in %.1f s", compiled.__name__, seconds)
                return result

    compiled.compile, compiled.get_call_template = compile_once, one_for_all_constants


@cache
def _load_array_functions() -> None:
    """Load numba's functions of arrays, under its lock, without SciPy's BLAS, which no kernel uses."""

    def refuse() -> None:
        raise ImportError

    ensure_blas = linalg.ensure_blas
    linalg.ensure_blas = refuse
    try:
        import numba.np.arraymath  # noqa: F401  # pyright: ignore[reportUnusedImport]
    finally:
        linalg.ensure_blas = ensure_blas


class _DiskCache(NullCache):
    """Files of one kernel, one for each set of argument types and kind of processor."""

    def __init__(self, compiled: Any) -> None:
        self._compiled = compiled
        self._form = object.__new__(CompileResultCacheImpl)  # how numba puts a kernel into bytes, which needs no state

    @property
    def cache_path(self) -> str:  # pyright: ignore[reportIncompatibleMethodOverride]
        return str(cache_folder())

    @contextlib.contextmanager
    def turn(self, signature: Any) -> Generator[None]:
        """Hold the kernel's lock where its file has yet to be made."""
        arguments = tuple(normalize_signature(signature)[0])
        path = self._path(arguments)
        if arguments in self._compiled.overloads or path.exists() or sys.platform == "win32":
            yield
            return
        import fcntl

        with path.with_suffix(".lock").open("wb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # ends with the process, however it ends
            yield

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        path = self._path(tuple(normalize_signature(sig)[0]))
        target_context.refresh()
        try:
            content = pickle.loads(path.read_bytes())  # noqa: S301  (a folder of the user's own)
        except (OSError, EOFError, pickle.UnpicklingError):  # not there yet, or cut off by a power failure
            return None
        except (ImportError, AttributeError):  # of another release, whose modules had other names
            return None
        with contextlib.suppress(OSError):  # a file of another user
            os.utime(path)
        return self._form.rebuild(target_context, content)

    def save_overload(self, sig: Any, cres: Any) -> None:
        if not self._form.check_cachable(cres):
            return
        path = self._path(tuple(normalize_signature(sig)[0]))
        with contextlib.suppress(OSError):  # a full disk: compiled again the next time
            descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=path.stem)
            try:
                with os.fdopen(descriptor, "wb") as file:
                    file.write(dumps(self._form.reduce(cres)))
                Path(name).replace(path)
                _remove_unused(path.parent)
            except BaseException:
                Path(name).unlink(missing_ok=True)
                raise

    def _path(self, arguments: tuple[Any, ...]) -> Path:
        codegen = self._compiled.targetctx.codegen()
        options = sorted((name, repr(value)) for name, value in self._compiled.targetoptions.items())
        # settings of the compiler, such as to check bounds
        settings = sorted((n, v) for n, v in os.environ.items() if n.startswith("NUMBA_") and n not in _NO_SETTINGS)
        key = f"{fingerprint(self._compiled)} {_type_names(arguments)} {codegen.magic_tuple()} {options} {settings}"
        name = re.sub(r"\W", "", self._compiled.py_func.__name__)
        return cache_folder() / f"{name}-{hashlib.sha256(key.encode()).hexdigest()[:32]}.kernel"


@cache
def _remove_unused(folder: Path) -> None:
    """Remove the files that no process has used for long, once in a process; who still needs one compiles it anew."""
    oldest = time.time() - _UNUSED_S
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # open in another process on Windows, or removed by it
            if path.stat().st_mtime < oldest:
                path.unlink()


def _type_names(arguments: tuple[Any, ...]) -> str:
    """Types of arguments; those of named tuples with their fields, which numba's own name of the type lacks."""
    names: list[str] = []
    for kind in arguments:
        names.append(str(kind))
        if isinstance(kind, types.BaseNamedTuple):
            names.append(repr(kind.fields))  # pyright: ignore[reportAttributeAccessIssue]
        if isinstance(kind, types.BaseTuple):
            names.append(_type_names(tuple(kind)))  # pyright: ignore[reportArgumentType]
    return ", ".join(names)
