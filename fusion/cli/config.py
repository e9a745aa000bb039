"""`--config FILE`: settings from TOML, one table for each nested dataclass; `--show-config` prints them as such a file.

Beliefs are told by flags, too (`fusion.cli.telling`); the printed ones have all that was told. Light at import:
settings are loaded where they are read.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenes.files.merged import merged, read_toml

if TYPE_CHECKING:
    from fusion.estimation.settings import EstimateSettings
    from fusion.tracking.answer import TrackSettings
    from scenes.recordings.beliefs import Beliefs
    from scenes.recordings.telling import Told


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


def add_config(parser: argparse.ArgumentParser) -> None:
    """--config and --show-config."""
    parser.add_argument("--config", metavar="FILE", type=Path, help="settings as TOML, like --show-config prints them")
    parser.add_argument(
        "--show-config", action=_Show, nargs=0, help="print all settings, with what stands before this, and exit"
    )


class _Show(argparse.Action):
    """--show-config: needs no capture, so it ends the run."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *_: object) -> None:
        from scenes.recordings.telling import believed

        settings = replace(read_config(namespace.config), beliefs=believed(_recorded(namespace), told(namespace)))
        sys.stdout.write(to_toml(settings))
        parser.exit()


def _recorded(args: argparse.Namespace) -> Beliefs | None:
    """What the command's capture says, when it stands before --show-config."""
    path = getattr(args, "capture", None)
    if path is None or not (path / "capture.json").is_file():
        return None
    from scenes.recordings.captures import read_capture

    return read_capture(path, args.trust_paths).beliefs


def told(args: argparse.Namespace) -> list[Told]:
    """What the config file's [beliefs] and the flags of `add_beliefs` say, the stronger last; empty for nothing.

    Raises InputError for what has no place or is no size, before the work and not in it.
    """
    from fusion.cli.telling import beliefs_told
    from scenes.recordings.beliefs import Beliefs
    from scenes.recordings.telling import believed

    path = getattr(args, "config", None)
    content = {} if path is None else read_toml(path)
    found = [(f"{path}: beliefs", content["beliefs"])] if "beliefs" in content else []
    # a file that --show-config printed has the library's beliefs in full, and says nothing of a recording's
    if believed(None, found) == Beliefs() and "camera" not in (found[0][1] if found else {}):
        found = []
    found += beliefs_told(args)
    believed(None, found)
    return found


def read_config(path: Path | None) -> CommandConfig:
    """The defaults, with what the file says instead.

    Raises InputError, naming the file and the setting, for what is unknown or of another type.
    """
    from scenes.recordings.telling import believed

    settings = CommandConfig.defaults()
    if path is None:
        return settings
    content = read_toml(path)
    if "beliefs" in content:
        settings = replace(settings, beliefs=believed(None, [(f"{path}: beliefs", content.pop("beliefs"))]))
    # the first frame of a track is an estimate: said once, it holds for both
    if "estimate" in content:
        settings = merged(settings, {"estimate": content["estimate"]}, str(path))
        settings = replace(settings, track=replace(settings.track, first=settings.estimate))
    return merged(settings, {name: value for name, value in content.items() if name != "estimate"}, str(path))


def estimate_settings(path: Path | None) -> EstimateSettings:
    """Those of one frame, as `read_config` has them; without a file nothing else is loaded."""
    from fusion.estimation.settings import EstimateSettings

    return EstimateSettings() if path is None else read_config(path).estimate


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
