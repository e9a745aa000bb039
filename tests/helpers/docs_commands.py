"""What a page of the documentation tells its reader to type, so that tests can type it.

A page's blocks are run in order: `sh` line by line, `python` with one namespace a page, files whose name in backquotes
and a colon end the line before them are written. A `text` block is what the block before it prints, among other things;
`…` in it stands for anything. A block under `<!-- not run: reason -->` is left out.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NAME = re.compile(r"`([^`\n]+)`:\n\n\Z")
_LEFT_OUT = re.compile(r"<!-- not run: ([^\n]+?) -->\n+\Z")
_EXIT_CODE = re.compile(r"#.*\bexit code (\d)")


@dataclass(frozen=True)
class Block:
    """One fenced block: its language and text; line of its fence; file it is the content of; why it is not run."""

    language: str
    text: str
    line: int
    file: str | None = None
    left_out: str | None = None


def all_blocks(page: Path) -> list[Block]:
    """Every fenced block of the page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in _FENCE.finditer(text):
        before = text[: match.start()]
        name, reason = _NAME.search(before), _LEFT_OUT.search(before)
        found.append(
            Block(
                match[1],
                match[2],
                before.count("\n") + 1,
                name[1] if name and match[1] not in ("sh", "text") else None,
                reason[1] if reason else None,
            )
        )
    return found


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of that language, in order."""
    return [block.text for block in all_blocks(page) if block.language == language]


def lines_of(block: Block) -> list[str]:
    """The lines of a sh block that say something; continued lines joined."""
    lines = block.text.replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


def commands(page: Path, program: str = "palpate") -> list[list[str]]:
    """The arguments of each call of `program` that begins a line of the page's sh blocks; comments gone, continued
    lines joined, what the shell does with its output left out.
    """
    typed = [line for block in all_blocks(page) if block.language == "sh" for line in lines_of(block)]
    found = []
    for line in typed:
        words = shlex.split(line, comments=True)
        if words[0] == program:
            end = next((i for i, word in enumerate(words) if word in (">", "|", "&&", ";")), len(words))
            found.append(words[1:end])
    return found


def files(page: Path) -> dict[str, str]:
    """Content by name of the blocks that follow a line ending in a name and a colon."""
    return {block.file: block.text for block in all_blocks(page) if block.file is not None}


def run(page: Path, folder: Path, given: dict[str, Any] | None = None) -> dict[str, Any]:
    """Do what the page says in `folder`, which must be the working directory; returns the names its Python has made.

    given: names that the page takes for granted.

    Raises AssertionError, with page and line, for a command that ends with another code than it should (0, or what a
    comment `# exit code N` behind it says) and for output that is not the page's.
    """
    names: dict[str, Any] = {"__name__": page.stem, **(given or {})}
    said = ""
    listed = all_blocks(page)
    for i, block in enumerate(listed):
        where = f"{page.name}, line {block.line}"
        following = listed[i + 1] if i + 1 < len(listed) and listed[i + 1].language == "text" else None
        if block.left_out is not None:
            said = ""
        elif block.language == "text":
            assert matches(block.text, said), f"{where}: expected\n{block.text}\ngot\n{said}"
        elif block.file is not None:
            path = folder / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif block.language == "python":
            said = _run_python(block, where, names, expected=following.text if following else "")
        elif block.language == "sh":
            said = "".join(_run_line(line, folder, where) for line in lines_of(block))
    return names


def script(name: str) -> Any:
    """A script of docs/, as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def matches(expected: str, said: str) -> bool:
    """Whether the lines are in what was said, one after the other, spaces apart; `…` stands for anything in a line."""
    heard = [" ".join(line.split()) for line in said.splitlines()]
    at = 0
    for line in expected.strip().splitlines():
        pattern = re.compile(".*".join(re.escape(part) for part in " ".join(line.split()).split("…")))
        hit = next((k for k in range(at, len(heard)) if pattern.fullmatch(heard[k])), None)
        if hit is None:
            return False
        at = hit + 1
    return True


def _run_python(block: Block, where: str, names: dict[str, Any], expected: str) -> str:
    from scenes.errors import PalpateError

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        try:
            exec(compile("\n" * block.line + block.text, where, "exec"), names)
        except PalpateError as error:
            # the last line of the traceback that the reader sees
            last = f"{type(error).__module__}.{type(error).__name__}: {error}"
            assert "Error:" in expected, f"{where}: {last}"
            return f"{out.getvalue()}\n{last}\n"
    assert "Error:" not in expected, f"{where}: expected {expected}"
    return out.getvalue()


def _run_line(line: str, folder: Path, where: str) -> str:
    from fusion.cli.main import main
    from fusion.cli.parser import build_parser

    wanted = _EXIT_CODE.search(line)
    words = shlex.split(line, comments=True)
    if words[:2] == ["palpate", "bench"]:  # minutes each: its arguments are checked
        build_parser().parse_args(words[1:])
        return ""
    if words[0] == "palpate":
        out = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            code = main(words[1:])
        said = out.getvalue()
    else:
        done = subprocess.run(
            ["bash", "-c", line], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
        )
        code, said = done.returncode, done.stdout
    assert code == (int(wanted[1]) if wanted else 0), f"{where}: {line}: exit code {code}\n{said}"
    return said
