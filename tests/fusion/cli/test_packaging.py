"""What is shipped: the wheel holds the pages and the typing marks; the citation names the version."""

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
def test_the_wheel_holds_pages_and_typing_marks(tmp_path):
    source = tmp_path / "source"  # building leaves folders behind
    for room in ("scenes", "vision", "touch", "fusion"):
        shutil.copytree(ROOT / room, source / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "--wheel-dir", str(tmp_path), str(source)]
    subprocess.run(pip, check=True, capture_output=True)
    wheel = next(tmp_path.glob("palpate-*.whl"))
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"{room}/py.typed" for room in ("scenes", "vision", "touch", "fusion")} <= names
    report = ROOT / "fusion" / "results" / "report"
    pages = [path for path in report.iterdir() if path.suffix in (".js", ".css", ".html")]
    assert pages
    assert {path.relative_to(ROOT).as_posix() for path in pages} <= names
    assert not [name for name in names if name.startswith("tests/")]


def test_the_citation_names_the_version_and_the_authors():
    project = (ROOT / "pyproject.toml").read_text()
    version = re.search(r'^version = "([^"]+)"', project, re.M)[1]
    cited = (ROOT / "CITATION.cff").read_text()
    assert f"version: {version}" in cited
    assert "palpate maintainers" in cited
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()
