"""`--config FILE`: settings from TOML, one table for each nested dataclass; `--show-config` prints them as such a file.

Works on any tree of frozen dataclasses: the default value of a field tells its type. What has no place is refused, with
the name that is written alike. Light at import: settings are loaded where they are read.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_type_hints

from scenes.errors import InputError, unknown

if TYPE_CHECKING:
    from fusion.estimation.settings import EstimateSettings
    from fusion.tracking.answer import TrackSettings
    from scenes.recordings.beliefs import Beliefs

T = TypeVar("T")


@dataclass(frozen=True)
class CommandConfig:
    """What a config file may hold: [estimate] of one frame, [track] of sequences (its `first` is [estimate]), [beliefs]
    of what cameras, calibrations, fingertips and meshes are worth.
    """

    estimate: EstimateSettings
    track: TrackSettings
    beliefs: Beliefs

    @staticmethod
    def defaults() -> CommandConfig:
        """Those of the library."""
        from fusion.estimation.settings import EstimateSettings
        from fusion.tracking.answer import TrackSettings
        from scenes.recordings.beliefs import Beliefs

        return CommandConfig(EstimateSettings(), TrackSettings(), Beliefs())

    @property
    def believed(self) -> Beliefs | None:
        """The beliefs, when they are others than the library's; None leaves it to what a recording says of its own."""
        return None if self.beliefs == type(self.beliefs)() else self.beliefs


def add_config(parser: argparse.ArgumentParser) -> None:
    """--config and --show-config."""
    parser.add_argument("--config", metavar="FILE", type=Path, help="settings as TOML, like --show-config prints them")
    parser.add_argument(
        "--show-config", action=_Show, nargs=0, help="print all settings (after --config FILE: with its own) and exit"
    )


class _Show(argparse.Action):
    """--show-config: needs no capture, so it ends the run."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *_: object) -> None:
        sys.stdout.write(to_toml(read_config(getattr(namespace, "config", None))))
        parser.exit()


def read_config(path: Path | None) -> CommandConfig:
    """The defaults, with what the file says instead.

    Raises InputError, naming the file and the setting, for what is unknown or of another type.
    """
    settings = CommandConfig.defaults()
    if path is None:
        return settings
    try:
        import tomllib
    except ModuleNotFoundError:  # Python 3.10
        import tomli as tomllib  # type: ignore[no-redef]
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: expected a config file, it cannot be opened: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected TOML, got malformed text: {error}") from error
    # the first frame of a track is an estimate: said once, it holds for both
    if "estimate" in content:
        settings = merged(settings, {"estimate": content["estimate"]}, str(path))
        settings = replace(settings, track=replace(settings.track, first=settings.estimate))
    return merged(settings, {name: value for name, value in content.items() if name != "estimate"}, str(path))


def merged(settings: T, content: Mapping[str, Any], where: str) -> T:
    """The dataclass with the values of a table; `where` begins the messages of InputError."""
    known = {field.name for field in fields(settings)}  # type: ignore[arg-type]
    changes: dict[str, Any] = {}
    for name, value in content.items():
        if name not in known:
            raise unknown(where, name, sorted(known), "a setting of")
        changes[name] = _value(getattr(settings, name), value, f"{where}: {name}", settings, name)
    return replace(settings, **changes)  # type: ignore[type-var]


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


def to_toml(settings: Any) -> str:
    """The settings as a file that `read_config` reads back: plain values of a table first, then its parts."""
    return "\n".join(_lines(settings, "")).lstrip("\n") + "\n"


def _lines(settings: Any, path: str) -> Iterator[str]:
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    plain = {name: value for name, value in values.items() if not is_dataclass(value)}
    if path and plain:
        yield f"\n[{path}]"
    for name, value in plain.items():
        yield f"{name} = {_text(value)}"
    for name, value in values.items():
        if is_dataclass(value):
            yield from _lines(value, f"{path}.{name}" if path else name)


def _text(value: Any) -> str:
    if value is None:
        return "false"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return "inf" if value == math.inf else "-inf" if value == -math.inf else repr(float(value))
    if isinstance(value, int):
        return str(value)
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_text, value))}]"
    if is_dataclass(value):
        return "{ " + ", ".join(f"{f.name} = {_text(getattr(value, f.name))}" for f in fields(value)) + " }"
    import json

    return json.dumps(str(value))
