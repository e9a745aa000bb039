"""A tracker's whole state as bytes, and back: a track goes on after a power cut as if nothing had been.

What the state is: everything that can be reached from the tracker's attributes (of plain objects every entry of
`vars`, of dataclasses every field), whatever it is called, so a new attribute is saved without a word here. Kept are
numbers, texts, arrays with their type and layout, lists, tuples, dicts, sets, deques, random generators, and objects of
our own classes made of these; two attributes that are one object stay one. Two things are not kept:

- what is *given*: the object model and the hand (and what these own), found again by name in whoever restores;
- what is *remade* (`REMADE`): caches that hold what no file can, which their class makes anew where it finds None, and
  what a step leaves lying about that no later one reads.

Anything else (an open file, a thread, a ray-casting scene, a function) is refused with its place in the tracker when
the state is saved, so a tracker that grows such an attribute fails the tests at once. No pickle: arrays in an .npz and
one text of JSON; the only classes that are made are those of the packages below.
"""

from __future__ import annotations

import hashlib
import importlib
import io
import json
import zipfile
import zlib
from collections import deque
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.tracker import Tracker
from scenes.errors import InputError
from scenes.geometry.objects import ObjectModel
from scenes.robot.hands import Hand
from vision.look.warm import Looker

FORMAT = "palpate-tracker"
VERSION = 1
# Classes come from these packages only.
PACKAGES = ("scenes", "vision", "touch", "fusion")
# Attributes that come back as None because their class makes them anew when it needs them, bit by bit the same: a
# hand's laid-out mesh of the last joints, what the last frame was looked at for, a search that runs beside the frames.
REMADE: dict[type, tuple[str, ...]] = {Looker: ("_surface",), Tracker: ("_sensed", "_aside")}

# What bytes that no tracker has written make of reading them; RuntimeError is that of archives with a password and of
# values nested without end.
UNREADABLE = (
    *(ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, RuntimeError),
    *(EOFError, OSError, MemoryError, zipfile.BadZipFile, zlib.error),
)
_PLAIN = (type(None), bool, int, float, str)


def save_tracker(tracker: Tracker, hand: Hand | None = None) -> bytes:
    """The tracker's state. hand: that of its frames, when they have one. Raises InputError for what cannot be kept."""
    writer = _Writer({"model": tracker.model, "hand": hand})
    kept = {"format": FORMAT, "version": VERSION, "model": _shape_of(tracker.model)}
    state = {**kept, "tracker": writer.object(tracker, "tracker")}
    text = np.frombuffer(json.dumps(state).encode(), dtype=np.uint8)
    out = io.BytesIO()
    np.savez(out, allow_pickle=False, state=text, **{f"a{i}": array for i, array in enumerate(writer.arrays)})
    return out.getvalue()


def restore_tracker(tracker: Tracker, content: bytes, hand: Hand | None = None) -> None:
    """Make `tracker`, new and with the same model, the one that was saved. Raises InputError for bytes that are none,
    for those of another object, and for those of a palpate whose trackers have other attributes; the tracker is then as
    it was.
    """
    if not isinstance(content, bytes | bytearray | memoryview):
        raise InputError(f"a tracker's state: expected the bytes of save_tracker, got {type(content).__name__}")
    if not zipfile.is_zipfile(io.BytesIO(content)):  # NumPy would advise to unpickle it
        raise InputError(f"a tracker's state: expected what save_tracker wrote, got {len(content)} other bytes")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            state = json.loads(file["state"].tobytes())
            if not isinstance(state, dict) or (state.get("format"), state.get("version")) != (FORMAT, VERSION):
                raise InputError(f"expected {FORMAT} version {VERSION}")
            if state.get("model") not in (None, _shape_of(tracker.model)):
                raise InputError(f"expected that of a track of {tracker.model.name}, got one of another mesh")
            arrays = {name: file[name] for name in file.files}
        made = _Reader({"model": tracker.model, "hand": hand}, arrays).value(state["tracker"])
    except InputError as error:
        raise InputError(f"a tracker's state: {error}") from error
    except UNREADABLE as error:
        said = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"a tracker's state: expected what save_tracker wrote: {said[:120]}") from error
    if type(made) is not type(tracker):
        raise InputError(f"a tracker's state: expected a {type(tracker).__name__}, got a {type(made).__name__}")
    lacks = sorted(set(vars(tracker)) - set(vars(made)))
    if lacks:
        raise InputError(f"a tracker's state: expected {lacks[0]}, found none: another version of palpate wrote it")
    vars(tracker).clear()
    vars(tracker).update(vars(made))


def _shape_of(model: ObjectModel) -> str:
    """What tells an object's mesh from others."""
    parts = np.ascontiguousarray(model.vertices), np.ascontiguousarray(model.faces)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


def digest(value: Any) -> str:
    """Settings, frames and the like in twelve characters, alike where they are alike. Raises InputError for what cannot
    be kept.
    """
    writer = _Writer({})
    found = hashlib.sha256(json.dumps(writer.value(value, "value")).encode())
    for array in writer.arrays:
        found.update(f"{array.dtype.str}{array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()[:12]


class _Writer:
    """Values as JSON; arrays aside."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        self.arrays: list[NDArray[Any]] = []
        self._seen: dict[int, int] = {}
        self._kept: list[Any] = []  # nothing may die, and its id be another's, while this runs
        self._given = {id(owner): name for name, owner in given.items() if owner is not None}
        for name, owner in given.items():
            for part, value in vars(owner).items() if owner is not None else ():
                if _is_own(type(value)):
                    self._given.setdefault(id(value), f"{name}.{part}")

    def value(self, value: Any, place: str) -> Any:
        if isinstance(value, _PLAIN) and type(value) in _PLAIN:
            return value
        if id(value) in self._given:
            return {"given": self._given[id(value)]}
        if id(value) in self._seen:
            return {"same": self._seen[id(value)]}
        self._seen[id(value)] = len(self._seen)
        self._kept.append(value)
        if isinstance(value, np.generic):
            self.arrays.append(np.asarray(value))
            return {"scalar": len(self.arrays) - 1}
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise InputError(f"{place}: expected an array of numbers, got one of {value.dtype}")
            self.arrays.append(value)
            return {"array": len(self.arrays) - 1}
        if type(value) in (list, tuple):
            return {type(value).__name__: [self.value(one, f"{place}[{i}]") for i, one in enumerate(value)]}
        if type(value) in (set, frozenset):
            return {type(value).__name__: [self.value(one, f"{place} member") for one in sorted(value)]}
        if isinstance(value, deque):
            return {"deque": [self.value(one, f"{place}[{i}]") for i, one in enumerate(value)], "most": value.maxlen}
        if type(value) is dict:
            pairs = [[self.value(k, f"{place} key"), self.value(v, f"{place}[{k!r}]")] for k, v in value.items()]
            return {"dict": pairs}
        if isinstance(value, np.random.Generator):
            return {"generator": json.loads(json.dumps(value.bit_generator.state, default=_listed))}
        return self.object(value, place)

    def object(self, value: Any, place: str) -> Any:
        """An object of our own class by its attributes."""
        kind = type(value)
        if (
            not _is_own(kind)
            or "<locals>" in kind.__qualname__
            or not (is_dataclass(value) or hasattr(value, "__dict__"))
        ):
            raise InputError(f"{place}: expected what a state can keep, got a {kind.__module__}.{kind.__qualname__}")
        self._seen.setdefault(id(value), len(self._seen))
        names = [f.name for f in fields(value)] if is_dataclass(value) else list(vars(value))
        for more in set(getattr(value, "__dict__", ())) - set(names):
            if not isinstance(getattr(kind, more, None), cached_property):  # what is computed of the fields is again
                raise InputError(f"{place}: expected a {kind.__name__} to have its fields only, got {more}")
        gone = REMADE.get(kind, ())
        parts = {n: None if n in gone else self.value(getattr(value, n), f"{place}.{n}") for n in names}
        return {"object": f"{kind.__module__}:{kind.__qualname__}", "id": self._seen[id(value)], "parts": parts}


class _Reader:
    """The way back. Objects are numbered in the order in which the writer met them."""

    def __init__(self, given: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        self._given, self._arrays = given, arrays
        self._made: list[Any] = []

    def value(self, entry: Any) -> Any:
        if not isinstance(entry, dict):
            return entry
        if "given" in entry:
            name, _, part = entry["given"].partition(".")
            owner = self._given[name]
            if owner is None:
                raise InputError(f"expected the {name} that it was saved with, got none")
            lazy = isinstance(getattr(type(owner), part, None), cached_property)  # made when it is asked for
            if part and not lazy and part not in vars(owner):
                raise InputError(
                    f"expected a part of the {name}, got {part[:80]!r}: another version of palpate wrote it"
                )
            return getattr(owner, part) if part else owner
        if "same" in entry:
            return self._made[entry["same"]]
        place = len(self._made)
        self._made.append(None)
        if "object" in entry:
            return self._object(entry, place)
        made: Any = None
        if "list" in entry:
            made = self._made[place] = []
            made.extend(self.value(one) for one in entry["list"])
        elif "dict" in entry:
            made = self._made[place] = {}
            for key, value in entry["dict"]:
                name = self.value(key)
                made[name] = self.value(value)
        elif "tuple" in entry:
            made = tuple(self.value(one) for one in entry["tuple"])
        elif "set" in entry:
            made = {self.value(one) for one in entry["set"]}
        elif "frozenset" in entry:
            made = frozenset(self.value(one) for one in entry["frozenset"])
        elif "deque" in entry:
            made = deque((self.value(one) for one in entry["deque"]), maxlen=entry["most"])
        elif "generator" in entry:
            made = np.random.Generator(getattr(np.random, entry["generator"]["bit_generator"])())
            made.bit_generator.state = entry["generator"]
        elif "scalar" in entry:
            made = self._arrays[f"a{entry['scalar']}"][()]
        else:
            made = self._arrays[f"a{entry['array']}"]
        self._made[place] = made
        return made

    def _object(self, entry: dict[str, Any], place: int) -> Any:
        kind = _own_class(entry["object"])
        made: Any = object.__new__(kind)
        self._made[place] = made  # before its parts, which may lead back to it
        parts = {name: self.value(value) for name, value in entry["parts"].items()}
        if is_dataclass(kind) and {f.name for f in fields(kind)} != set(parts):
            raise InputError(f"expected the fields of {kind.__name__}, got others: another version of palpate wrote it")
        for name, value in parts.items():
            object.__setattr__(made, name, value)  # frozen ones, too, and as they were: nothing is checked or rounded
        return made


def _is_own(kind: type) -> bool:
    return kind.__module__.partition(".")[0] in PACKAGES


def _own_class(name: str) -> type:
    """The class of "module:name" in our packages."""
    module, _, path = name.partition(":")
    found: Any = None
    if module.partition(".")[0] in PACKAGES:
        try:
            found = importlib.import_module(module)
            for part in path.split("."):
                found = getattr(found, part)
        except (ImportError, AttributeError):
            found = None
    if not isinstance(found, type) or not _is_own(found):
        raise InputError(f"expected a class of palpate, got {name[:80]!r}: another version of palpate wrote it")
    return found


def _listed(value: Any) -> Any:
    """Arrays within a bit generator's state."""
    return value.tolist() if isinstance(value, np.ndarray) else int(value)
