"""What a page of the documentation tells its reader to type, so that tests can type it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# a file's name in backquotes and a colon at the end of the line before the block
_NAMED = re.compile(r"`([^`\n]+)`:\n\n```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of that language, in order."""
    return [text for kind, text in _BLOCK.findall(page.read_text(encoding="utf-8")) if kind == language]


def commands(page: Path, program: str = "palpate") -> list[list[str]]:
    """The arguments of each call of `program` in the page's sh blocks; comments gone, continued lines joined."""
    lines = "\n".join(blocks(page, "sh")).replace("\\\n", " ").splitlines()
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[1:] for line in words if line and line[0] == program]


def files(page: Path) -> dict[str, str]:
    """Content by name of the blocks that follow a line ending in a name and a colon."""
    return {name: text for name, _, text in _NAMED.findall(page.read_text(encoding="utf-8"))}
