"""Every settings class hangs from one root, has a name of its own."""

from __future__ import annotations

import ast
import dataclasses
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from fusion.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("scenes", "vision", "touch", "fusion")
# Named otherwise, but settings all the same: what is believed of sensors, and the errors that captures are made with.
BELIEFS = {"DepthModel", "CalibrationModel", "DepthNoise", "TouchNoise", "RobotNoise", "NoisePreset", "SoftLayer"}


def classes() -> Iterator[tuple[str, ast.ClassDef, list[str]]]:
    """Dotted module, definition and the file's lines of every class whose name says that it is one of settings."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            for node in ast.parse(text).body:
                if isinstance(node, ast.ClassDef) and (node.name.endswith("Settings") or node.name in BELIEFS):
                    yield module, node, text.splitlines()


FOUND = list(classes())
NAMES = [f"{module}.{node.name}" for module, node, _ in FOUND]


def reached(value: object) -> Iterator[type]:
    """Types of all dataclasses in `value`, itself included."""
    if dataclasses.is_dataclass(value):
        yield type(value)
        for field in dataclasses.fields(value):
            yield from reached(getattr(value, field.name))
    elif isinstance(value, tuple):
        for part in value:
            yield from reached(part)


def test_every_class_is_reached_from_the_root():
    there = {f"{kind.__module__}.{kind.__qualname__}" for kind in reached(Settings())}
    assert sorted(set(NAMES) - there) == []


def test_one_name_one_class():
    assert [name for name, count in Counter(node.name for _, node, _ in FOUND).items() if count > 1] == []


def test_settings_are_frozen():
    assert all(kind.__dataclass_params__.frozen for kind in reached(Settings()))
