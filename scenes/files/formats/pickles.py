"""Pickles as data: NumPy arrays and plain containers are rebuilt, anything else is refused before it can run.

A pickle is a program that may call any function by its name. The only names admitted here are those that NumPy's own
arrays, numbers and types are written with, and they are looked up in a table of stand-ins, not imported by what the
file says: a stand-in keeps numbers, and becomes an array when all is read.
"""

from __future__ import annotations

import io
import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError

# A file of poses, joints and intrinsics of an hour is smaller.
LARGEST = 512 * 1024 * 1024
# Containers in one another.
DEEPEST = 50
# Values, each counted as often as it is named: an hour of poses, joints and intrinsics has fewer.
MOST = 20_000_000
# What says "an array" where NumPy writes its class.
ARRAY = "numpy.ndarray"


def _kind_of(text: Any) -> np.dtype[Any]:
    """A type of plain numbers by its name."""
    found = np.dtype(text) if isinstance(text, str) else None
    if found is None or found.kind not in "biufc":
        raise pickle.UnpicklingError(f"expected a type of numbers, got {str(text)[:40]!r}")
    return found


class _Kind:
    """Stands for a numpy.dtype."""

    def __init__(self, text: Any = None, *rest: Any) -> None:
        self.kind = _kind_of(text)

    def __setstate__(self, state: Any) -> None:
        """Only the order of bytes is taken."""
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else None
        if order in ("<", ">"):
            self.kind = self.kind.newbyteorder(order)


class _Array:
    """Stands for an array: first empty, then what its state says."""

    def __init__(self, subtype: Any = None, shape: Any = None, kind: Any = None) -> None:
        if subtype != ARRAY:
            raise pickle.UnpicklingError("expected an ndarray, got a class of its own")
        self.value: NDArray[Any] = np.zeros(0)

    def __setstate__(self, state: Any) -> None:
        """(version, shape, type, Fortran order, bytes)."""
        _, shape, kind, fortran, data = state
        if not isinstance(kind, _Kind) or not isinstance(data, bytes):
            raise pickle.UnpicklingError("expected an array of numbers")
        self.value = _shaped(data, kind.kind, shape, bool(fortran))


def _shaped(data: Any, kind: np.dtype[Any], shape: Any, fortran: bool) -> NDArray[Any]:
    return np.frombuffer(data, dtype=kind).reshape(shape, order="F" if fortran else "C").copy()


def _from_buffer(buffer: Any, kind: Any, shape: Any, order: Any) -> NDArray[Any]:
    """How protocol 5 writes arrays."""
    if not isinstance(kind, _Kind) or not isinstance(buffer, (bytes, bytearray)):
        raise pickle.UnpicklingError("expected an array of numbers")
    return _shaped(bytes(buffer), kind.kind, shape, order == "F")


def _scalar(kind: Any = None, data: Any = None) -> Any:
    """A NumPy number from its bytes."""
    if not isinstance(kind, _Kind) or not isinstance(data, bytes) or len(data) != kind.kind.itemsize:
        raise pickle.UnpicklingError("expected a number by its bytes")
    return np.frombuffer(data, dtype=kind.kind)[0]


def _encode(text: Any = None, encoding: Any = "latin1") -> bytes:
    """How old protocols write bytes."""
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError("expected bytes written as latin-1")
    return text.encode("latin-1")


ADMITTED: dict[tuple[str, str], Any] = {
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _Array for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): _scalar for core in ("core", "_core")},
    **{(f"numpy.{core}.numeric", "_frombuffer"): _from_buffer for core in ("core", "_core")},
    **{(builtins, "set"): set for builtins in ("builtins", "__builtin__")},
    **{(builtins, "frozenset"): frozenset for builtins in ("builtins", "__builtin__")},
    ("numpy", "ndarray"): ARRAY,
    ("numpy", "dtype"): _Kind,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): OrderedDict,
}


class _Reader(pickle.Unpickler):
    """Finds nothing but what is admitted."""

    def find_class(self, module: str, name: str) -> Any:
        """The admitted thing of that name."""
        if (module, name) not in ADMITTED:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        return ADMITTED[module, name]

    def persistent_load(self, pid: Any) -> NoReturn:
        """Nothing outside the file is part of it."""
        raise pickle.UnpicklingError("it asks for something outside the file")


def read_plain(path: Path) -> Any:
    """What a pickle holds, if that is NumPy arrays, numbers, texts and plain containers of them.

    Raises CaptureError, one line, for any other pickle, a damaged or too large one.
    """
    if path.stat().st_size > LARGEST:
        raise CaptureError(f"{path}: expected a pickle of up to {LARGEST >> 20} MB, got {path.stat().st_size >> 20} MB")
    try:
        return _plain(_Reader(io.BytesIO(path.read_bytes())).load(), 0, {})[0]
    except pickle.UnpicklingError as error:
        raise CaptureError(f"{path}: expected a pickle of NumPy arrays and plain containers only: {error}") from error
    except (
        *(ArithmeticError, AttributeError, EOFError, ImportError, LookupError, MemoryError),
        *(RecursionError, TypeError, ValueError, OSError, AssertionError),
    ) as error:
        said = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise CaptureError(f"{path}: expected a whole pickle, got a damaged one: {said[:120]}") from error


def _plain(content: Any, depth: int, done: dict[int, tuple[Any, int, Any]]) -> tuple[Any, int]:
    """The same as data only, with arrays where they were stood for; and how many values it names.

    done: containers by id, with what became of them: a file of a few bytes may name one container a billion times.
    """
    if depth > DEEPEST:
        raise pickle.UnpicklingError(f"its containers are in one another more than {DEEPEST} deep")
    if isinstance(content, _Array):
        return content.value, 1
    if isinstance(content, dict) or type(content) in (list, tuple, set, frozenset):
        if id(content) not in done:
            pairs = isinstance(content, dict)
            inner = [part for pair in content.items() for part in pair] if pairs else content
            parts = [_plain(part, depth + 1, done) for part in inner]
            count = 1 + sum(size for _, size in parts)
            if count > MOST:
                raise pickle.UnpicklingError(f"it names more than {MOST // 1_000_000} million values")
            values = [value for value, _ in parts]
            out = dict(zip(values[::2], values[1::2])) if pairs else type(content)(values)
            done[id(content)] = out, count, content  # kept, so that its id stays its own
        return done[id(content)][:2]
    if isinstance(content, (np.ndarray, np.generic)) and content.dtype.kind in "biufc":
        return content, 1
    if isinstance(content, (str, bytes, int, float, complex, type(None))):
        return content, 1
    raise pickle.UnpicklingError(f"it holds a {type(content).__name__.strip('_')}")
