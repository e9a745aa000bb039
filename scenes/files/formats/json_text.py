"""JSON as captures have it: a key that stands twice is a mistake, of which Python's own reader keeps the last."""

from __future__ import annotations

import json
from typing import Any


def each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of these keys and values, for `object_pairs_hook`; raises ValueError for a key that stands twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"expected each key once, got {twice[:60]!r} twice")
    return found


def parsed(text: str) -> Any:
    """The content of a JSON text; raises ValueError for what is none, and for a key that stands twice in an object."""
    return json.loads(text, object_pairs_hook=each_once)
