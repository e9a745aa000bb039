"""A page opened in a headless Chromium, with a script of the test's own before everything else in it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest


def in_browser(page: str, probe: str, folder: Path, width: int = 1400) -> Any:
    """What the probe, put before everything else in the page, reports from a headless Chromium."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium on this machine to open the page with")
    path = folder / "probed.html"
    path.write_text(page.replace("<style>", probe + "<style>", 1))
    flags = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        "--disable-sync",
        "--enable-unsafe-swiftshader",
    ]
    flags += ["--enable-unsafe-swiftshader"]  # WebGL where there is no graphics card
    flags += ["--disable-component-update", "--no-first-run", f"--user-data-dir={folder / 'profile'}"]
    flags += [f"--window-size={width},900", "--virtual-time-budget=3000", "--dump-dom"]
    run = subprocess.run([chromium, *flags, path.as_uri()], capture_output=True, text=True, timeout=120, check=False)
    answer = re.search(r"PROBE(\{.*\})PROBE", run.stdout.split("<body")[-1])
    assert answer, f"the page did not report back: {run.stderr[-500:]}"
    return json.loads(answer[1].replace("&amp;", "&"))
