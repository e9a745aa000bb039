"""The pages' parts, filled in, and files that appear whole."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping
from importlib import resources


def asset(name: str) -> str:
    """A file of the pages, as text."""
    return resources.files("fusion.results.report").joinpath(name).read_text(encoding="utf-8")


def page(body: str, title: str, style: str, parts: Mapping[str, str]) -> str:
    """A page: the head and the asset `body`, with title (plain text), style (CSS) and parts in the places of their
    names.
    """
    # pictures are inside the page, unless it says that they lie beside it
    filled = {"TITLE": html.escape(title), "STYLE": style, "IMAGES": "data:", **parts}
    # one pass, so that a capture named like a placeholder stays a name
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda match: filled[match[1]], asset("head.html") + asset(body))
