"""Messages of ROS 1 bags, ROS 2 bags (SQLite, MCAP) and single .mcap files, by the library rosbags: no ROS is needed.

Whatever a damaged file makes the library raise becomes one CaptureError with the file's name.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError

Array = NDArray[np.float64]

ENDINGS = (".bag", ".mcap", ".db3")
NANOSECONDS = 1_000_000_000


def is_bag(path: str | Path) -> bool:
    """True for a file that ends like a bag and for a ROS 2 folder with metadata.yaml."""
    path = Path(path)
    return (path.is_file() and path.suffix.lower() in ENDINGS) or (path / "metadata.yaml").is_file()


class Bag:
    """An open bag. types: message type by topic; counts: messages by topic."""

    def __init__(self, path: Path, reader: Any, broken: tuple[type[Exception], ...]) -> None:
        """Use `open_bag`."""
        self.path = path
        self._reader = reader
        self._broken = broken
        self.types: dict[str, str] = {c.topic: c.msgtype for c in reader.connections}
        self.counts: dict[str, int] = dict.fromkeys(self.types, 0)
        for connection in reader.connections:
            self.counts[connection.topic] += connection.msgcount

    def messages(self, topics: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
        """(topic, time of receipt in nanoseconds, message) of these topics, in the bag's order."""
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:
            return
        for connection in connections:
            if connection.msgtype not in self._reader.typestore.fielddefs:
                where = f"{self.path}, {connection.topic}"
                raise CaptureError(
                    f"{where}: expected the definition of {connection.msgtype} in the topic map, got none"
                )
        try:
            for connection, received, raw in self._reader.messages(connections=connections):
                yield connection.topic, received, self._reader.deserialize(raw, connection.msgtype)
        except self._broken as error:
            raise _damaged(self.path, error) from error


@contextmanager
def open_bag(path: Path, definitions: Mapping[str, str]) -> Iterator[Bag]:
    """Open a bag for reading; definitions: text by message type, for types that the bag does not define itself.

    Raises InputError when rosbags is not installed, CaptureError for a file that is no bag or a damaged one.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.rosbag1 import ReaderError as Error1
        from rosbags.rosbag2 import ReaderError as Error2
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
    except ImportError as error:
        raise InputError("reading ROS bags needs rosbags: pip install 'palpate[ros]'") from error

    broken: tuple[type[Exception], ...] = (AnyReaderError, Error1, Error2, SerdeError, TypesysError, struct.error)
    # what the decompressors, SQLite and the parsers raise on bytes that were cut off or overwritten
    broken += (OSError, EOFError, ValueError, LookupError, AssertionError, RuntimeError, AttributeError, TypeError)
    broken += (OverflowError, MemoryError, *_database_errors())
    store = get_typestore(Stores.LATEST)
    try:
        given: dict[str, Any] = {}
        for name, text in definitions.items():
            given.update(get_types_from_msg(text, name))
        missing = {name: fields for name, fields in given.items() if name not in store.fielddefs}
        store.register(missing)
    except (TypesysError, ValueError, KeyError, IndexError, AttributeError, TypeError) as error:
        raise CaptureError(f"topic map, definitions: expected ROS message definitions: {_first_line(error)}") from error
    try:
        reader = AnyReader([path], default_typestore=store)
        reader.open()
    except broken as error:
        raise _damaged(path, error) from error
    try:
        absent = {name: fields for name, fields in given.items() if name not in reader.typestore.fielddefs}
        reader.typestore.register(absent)
        yield Bag(path, reader, broken)
    finally:
        reader.close()


def _database_errors() -> tuple[type[Exception], ...]:
    import sqlite3

    try:
        import apsw
    except ImportError:
        return (sqlite3.Error,)
    return (sqlite3.Error, apsw.Error)


def _damaged(path: Path, error: Exception) -> CaptureError:
    return CaptureError(f"{path}: expected a readable ROS bag, it is damaged or incomplete: {_first_line(error)}")


def _first_line(error: Exception) -> str:
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0][:160]


def stamp_ns(message: Any, received: int) -> int:
    """The header's time in nanoseconds; the time of receipt where there is no header or nobody filled it in."""
    header = getattr(message, "header", None)
    if header is None:
        return received
    return int(header.stamp.sec) * NANOSECONDS + int(header.stamp.nanosec) or received


def frame_id(message: Any) -> str:
    """The header's frame without a leading slash, "" when it has none."""
    return str(getattr(getattr(message, "header", None), "frame_id", "")).lstrip("/")


def pick(message: Any, path: str, where: str) -> list[Any]:
    """The values at a path like `states[].contact_positions[]`: one for each element of each `[]`.

    Raises CaptureError naming the first step that the message does not have.
    """
    values = [message]
    for step in path.split("."):
        name = step.removesuffix("[]")
        if any(not hasattr(value, name) for value in values):
            known = [n for n in getattr(values[0], "__dataclass_fields__", {}) if not n.startswith("__")]
            raise CaptureError(f"{where}: expected the field {path}, there is no {name!r} among {', '.join(known)}")
        values = [getattr(value, name) for value in values]
        if step.endswith("[]"):
            values = [_element for value in values for _element in _elements(value, path, where)]
    return values


def _elements(value: Any, path: str, where: str) -> list[Any]:
    if isinstance(value, str | bytes) or not hasattr(value, "__len__"):
        raise CaptureError(f"{where}: expected a list at {path}, got {type(value).__name__}")
    return list(value)


def numbers(values: Sequence[Any], where: str) -> Array:
    """(n,) float64 of numbers and arrays of numbers, one after the other."""
    try:
        return np.concatenate([np.atleast_1d(np.asarray(value, dtype=np.float64)).ravel() for value in values])
    except (TypeError, ValueError) as error:
        if not values:
            return np.zeros(0)
        raise CaptureError(f"{where}: expected numbers, got {type(values[0]).__name__}") from error


def vectors(values: Sequence[Any], where: str) -> Array:
    """(n, 3) of messages with x, y, z (geometry_msgs Point, Vector3) or arrays of three numbers."""
    rows = [[v.x, v.y, v.z] if hasattr(v, "x") else v for v in values]
    try:
        return np.array(rows, dtype=np.float64).reshape(len(rows), 3)
    except (TypeError, ValueError) as error:
        kind = type(values[0]).__name__
        raise CaptureError(f"{where}: expected vectors (x, y, z or three numbers), got {kind}") from error
