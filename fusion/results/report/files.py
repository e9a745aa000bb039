"""The pages' parts, filled in, and files that appear whole."""

from __future__ import annotations

import html
import os
import re
import tempfile
from collections.abc import Mapping
from importlib import resources
from pathlib import Path


def asset(name: str) -> str:
    """A file of the pages, as text."""
    return resources.files("fusion.results.report").joinpath(name).read_text(encoding="utf-8")


def page(body: str, title: str, style: str, parts: Mapping[str, str]) -> str:
    """A page: the head and the asset `body`, with title (plain text), style (CSS) and parts in the places of their
    names.
    """
    filled = {"TITLE": html.escape(title), "STYLE": style, **parts}
    # one pass, so that a capture named like a placeholder stays a name
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda match: filled[match[1]], asset("head.html") + asset(body))


def replace_file(path: Path, content: bytes) -> None:
    """Write a file; a reader never meets half of it. Its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, draft = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(draft, 0o644)
        os.replace(draft, path)
    except BaseException:
        os.unlink(draft)
        raise
