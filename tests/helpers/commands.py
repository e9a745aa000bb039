"""The command line as tests use it: run a command, or see it refused with one line."""

from __future__ import annotations

import pytest

from fusion.cli.main import main


def run(*argv: object) -> int:
    """The exit code of a command line; its words may be paths and numbers."""
    return main([str(a) for a in argv])


def refused(capture: pytest.CaptureFixture[str], *argv: object) -> str:
    """Run a command that must fail: exit code 2, one line on stderr, nothing else; returns the line."""
    assert run(*argv) == 2
    out, err = capture.readouterr()
    assert err.startswith("palpate: ")
    assert err.count("\n") == 1, err
    assert "Traceback" not in err
    assert out == ""
    return err
