"""Ctrl-C while libraries are loaded: it ends the command, whatever they make of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
# Ctrl-C comes while it is loaded, and it goes on without what it was loading.
SWALLOWS = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
except BaseException:
    print("swallowed")
"""
# What is compiled knows nothing of Python's errors but that there was one.
TAKES_IT_FOR_ANOTHER = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
except BaseException:
    failed = True
else:
    failed = False
if failed:
    raise ImportError("its extension failed to import")
"""


@pytest.mark.parametrize("name", ["trimesh", "numba", "scipy"])
@pytest.mark.parametrize("source", [SWALLOWS, TAKES_IT_FOR_ANOTHER])
def test_a_library_that_makes_something_else_of_it(name, source, tmp_path):
    libraries = tmp_path / "libraries"
    libraries.mkdir()
    (libraries / f"{name}.py").write_text(source)
    argv = [sys.executable, "-m", "fusion.cli.main", "synth", str(tmp_path / "mug"), "--object", "mug"]
    where = {**os.environ, "PYTHONPATH": os.pathsep.join((str(libraries), str(ROOT)))}
    # what runs in the background may have been told to pass Ctrl-C over, and tells its own so
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    ended = subprocess.run(argv, capture_output=True, text=True, cwd=ROOT, env=where, check=False, preexec_fn=heard)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "palpate: interrupted\n")
    assert not (tmp_path / "mug").exists()
