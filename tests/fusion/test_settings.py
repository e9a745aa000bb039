"""Every settings class hangs from one root, has a name of its own, and says what its fields are and whence."""

from __future__ import annotations

import ast
import dataclasses
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from fusion.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("scenes", "vision", "touch", "fusion")
# Named otherwise, but settings all the same: what is believed of sensors, and the errors that captures are made with.
BELIEFS = {
    *("Beliefs", "DepthModel", "CalibrationModel", "TouchModel", "SoftLayer"),
    *("DepthNoise", "TouchNoise", "RobotNoise", "NoisePreset", "GraspNoise"),
}
# A source of a value: a thesis, a paper with its year, a data sheet, another program, or an honest word.
SOURCE = re.compile(r"\bT[12]\b|\b(19|20)\d\d\b|et al|data sheet|PCL|Kinect|tuned|measured|judgement", re.IGNORECASE)
UNIT = re.compile(
    r"(?<!['’])\b(m|rad|s|N|Pa|px|Hz|no unit|cosine|radii|%)\b"
    r"|(?i:metre|radian|newton|degree|nats|voxel|cell|pixels|lengths|samples|views|share|sigma|deviation|times|factor)"
    r"|(?i:ratio|likelihood|chi-square|squared?|decay|blur|weight|quaternion|variances)",
)


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


def comments(node: ast.ClassDef, lines: list[str]) -> Iterator[tuple[ast.AnnAssign, str]]:
    """Each field with the comment above it or above its group, beside it, or below it as a docstring."""
    above = ""
    for before, field, after in zip([None, *node.body], node.body, [*node.body[1:], None], strict=False):
        if not isinstance(field, ast.AnnAssign):
            continue
        at, own = field.lineno - 2, []
        while lines[at].lstrip().startswith("#"):
            own.insert(0, lines[at].strip())
            at -= 1
        if own or not isinstance(before, ast.AnnAssign):
            above = " ".join(own)
        beside = " ".join(re.findall(r"#.*", lines[(field.end_lineno or 1) - 1]))
        below = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
        yield field, f"{above} {beside} {below}".strip()


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


@pytest.mark.parametrize(("module", "node", "lines"), FOUND, ids=NAMES)
def test_every_field_says_what_it_is(module, node, lines):
    """A comment each; in it a unit where the field is no whole number; in the class, where its numbers come from."""
    words = ast.get_docstring(node) or ""
    said = list(comments(node, lines))
    for field, comment in said:
        name, kind = ast.unparse(field.target), ast.unparse(field.annotation)
        nested = kind.removesuffix(" | None").endswith(("Settings", "Noise", "Model"))
        assert comment or nested or f"{name}:" in words, f"{node.name}.{name}: no comment"
        if "float" in kind:
            assert UNIT.search(f"{comment} {words}"), f"{node.name}.{name}: no unit in {comment!r}"
    if any("float" in ast.unparse(field.annotation) for field, _ in said):
        assert SOURCE.search(" ".join([words, *(comment for _, comment in said)])), f"{node.name}: whence?"


def test_settings_are_frozen():
    assert all(kind.__dataclass_params__.frozen for kind in reached(Settings()))
