"""One process at a time: a file that is held is held until its handle is closed or its process ends."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys

from scenes.files import claimed as module
from scenes.files.claimed import claimed


def test_a_file_is_held_once(tmp_path):
    path = tmp_path / "file"
    path.write_text("kept")
    first = claimed(path)
    assert first is not None
    assert claimed(path) is None
    assert path.read_text() == "kept"
    os.close(first)
    second = claimed(path)
    assert second is not None
    os.close(second)


def test_a_killed_process_holds_nothing(tmp_path):
    path = tmp_path / "file"
    code = "import sys, time; from pathlib import Path; from scenes.files.claimed import claimed\n"
    code += "print(claimed(Path(sys.argv[1])), flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code, path], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline().strip().isdecimal()
        assert claimed(path) is None
        other.send_signal(signal.SIGKILL)
    handle = claimed(path)
    assert handle is not None
    os.close(handle)


def test_a_file_system_that_cannot_hold_keeps_nobody_out(tmp_path, monkeypatch):
    def cannot(handle):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(module, "_hold", cannot)
    handles = [claimed(tmp_path / "file") for _ in range(2)]
    assert None not in handles
    for handle in handles:
        os.close(handle)
