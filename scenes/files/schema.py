"""The JSON files by their schemas (JSON Schema 2020-12), which are shipped beside this module for other tools too."""

from __future__ import annotations

import json
from functools import cache
from importlib import resources
from typing import Any

NAMES = ("capture", "sensors", "topics", "result")
# A complaint quotes what it complains of: so much of it is enough.
LONGEST = 200


@cache
def schema(name: str) -> dict[str, Any]:
    """The schema of NAME.json, one of NAMES."""
    text = resources.files("scenes.files").joinpath(f"schemas/{name}.schema.json").read_text(encoding="utf-8")
    content: dict[str, Any] = json.loads(text)
    return content


def complaints(content: Any, name: str) -> list[str]:
    """What in the content of a file is not as the schema has it, each with its place; empty when all is well."""
    from jsonschema import Draft202012Validator

    found = Draft202012Validator(schema(name)).iter_errors(content)
    lines = []
    for error in sorted(found, key=lambda error: [str(part) for part in error.absolute_path]):
        place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in error.absolute_path)
        said = " ".join(error.message.split())
        said = said if len(said) <= LONGEST else f"{said[: LONGEST // 2]} … {said[-LONGEST // 2 :]}"
        lines.append(f"{place.lstrip('.')}: {said}" if place else said)
    return lines


def kind_of(content: Any) -> str | None:
    """Which of NAMES the content of a file is meant to be; None for none of them."""
    if not isinstance(content, dict):
        return None
    by_format = {"palpate-capture": "capture", "palpate-topics": "topics"}
    if content.get("format") in by_format:
        return by_format[content["format"]]
    if isinstance(content.get("frames"), list):
        return "result"
    if content and all(isinstance(entry, dict) and "link" in entry for entry in content.values()):
        return "sensors"
    return None
