"""Tables of a file (TOML or JSON) laid over a tree of frozen dataclasses: what is not said stays as it is.

The default value of a field tells its type. What has no place is refused, with the name that is written alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from scenes.errors import InputError, unknown

T = TypeVar("T")

# Sizes (of any unit) that no setting has in earnest are beyond these; squares and quotients of what is not stay finite.
SIZES = (1e-12, 1e12)


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file; raises InputError naming it."""
    try:
        import tomllib
    except ModuleNotFoundError:  # Python 3.10
        import tomli as tomllib  # type: ignore[no-redef]
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: expected a TOML file, it cannot be opened: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected TOML, got malformed text: {error}") from error


def merged(settings: T, content: Mapping[str, Any], where: str) -> T:
    """The dataclass with the values of a table; `where` begins the messages of InputError."""
    known = {field.name for field in fields(settings)}  # type: ignore[arg-type]
    changes: dict[str, Any] = {}
    for name, value in content.items():
        if name not in known:
            raise unknown(where, name, sorted(known), "a setting of")
        changes[name] = _value(getattr(settings, name), value, f"{where}: {name}", settings, name)
    try:
        return replace(settings, **changes)  # type: ignore[type-var]
    except InputError as error:  # what the class itself has to say of its values
        raise InputError(f"{where}: {error}") from error


def _value(default: Any, value: Any, where: str, owner: Any, name: str) -> Any:
    """The value in the type of the default; `false` where a part may be left out."""
    if is_dataclass(default):
        if value is False and _may_be_none(owner, name):
            return None
        if not isinstance(value, Mapping):
            raise InputError(f"{where}: expected a table of settings, got {value!r}")
        return merged(default, value, where)
    if isinstance(default, bool):
        return _typed(value, (bool,), "true or false", where)
    if isinstance(default, int):
        return _typed(value, (int,), "a whole number", where)
    if isinstance(default, float):
        number = float(_typed(value, (int, float), "a number", where))
        if math.isnan(number):
            raise InputError(f"{where}: expected a number, got nan")
        low, high = SIZES
        if math.isfinite(number) and number and not low <= abs(number) <= high:
            raise InputError(f"{where}: expected 0 or a number from {low:g} to {high:g} in size, got {number:g}")
        return number
    if isinstance(default, str):
        return _typed(value, (str,), "a text", where)
    if isinstance(default, tuple):
        return _items(default, value, where)
    if default is None:
        return None if value is False else _items((), value, where) if isinstance(value, list) else value
    raise InputError(f"{where}: expected no setting here: a {type(default).__name__} is not set by a file")


def _items(default: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise InputError(f"{where}: expected a list, got {value!r}")
    if not default:
        return tuple(value)
    if not is_dataclass(default[0]) and len(value) != len(default):
        raise InputError(f"{where}: expected {len(default)} values, got {len(value)}")
    like = [default[min(i, len(default) - 1)] for i in range(len(value))]
    return tuple(_value(d, v, f"{where}[{i}]", None, "") for i, (d, v) in enumerate(zip(like, value)))


def _typed(value: Any, kinds: tuple[type, ...], expected: str, where: str) -> Any:
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        raise InputError(f"{where}: expected {expected}, got {value!r}")
    return value


def _may_be_none(owner: Any, name: str) -> bool:
    return owner is not None and type(None) in get_args(get_type_hints(type(owner))[name])
