"""What is shipped: the wheel holds the pages and the typing marks; the citation names the version."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from email import message_from_string
from pathlib import Path

import pytest

from fusion.cli.versions import NEEDED, OPTIONAL

ROOMS = ("scenes", "vision", "touch", "fusion")
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from a copy: building leaves folders behind."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    for room in ROOMS:
        shutil.copytree(ROOT / room, source / room, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "--wheel-dir", str(folder), str(source)]
    subprocess.run(pip, check=True, capture_output=True)
    return next(folder.glob("palpate-*.whl"))


@pytest.mark.slow
def test_the_wheel_holds_pages_schemas_and_typing_marks(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"{room}/py.typed" for room in ROOMS} <= names
    report = ROOT / "fusion" / "results" / "report"
    shipped = [path for path in report.iterdir() if path.suffix in (".js", ".css", ".html")]
    schemas = sorted((ROOT / "scenes" / "files" / "schemas").glob("*.json"))
    assert shipped
    assert len(schemas) == 4
    assert {path.relative_to(ROOT).as_posix() for path in (*shipped, *schemas)} <= names
    assert not [name for name in names if name.startswith("tests/")]


@pytest.mark.slow
def test_the_metadata_is_as_an_index_wants_it(wheel):
    with zipfile.ZipFile(wheel) as content:
        info = next(name for name in content.namelist() if name.endswith(".dist-info/METADATA"))
        fields = message_from_string(content.read(info).decode())
        assert any(name.endswith("licenses/LICENSE") for name in content.namelist())
    assert fields["License-Expression"] == "MIT"
    assert fields["Description-Content-Type"] == "text/markdown"
    assert not [line for line in fields.get_all("Classifier") if line.startswith("License ::")]
    extras = fields.get_all("Provides-Extra")
    assert {"ros", "viewer", "cluster", "peers", "test"} <= set(extras)
    needed = {re.match(r"[\w.-]+", line)[0] for line in fields.get_all("Requires-Dist") if "extra ==" not in line}
    assert set(NEEDED) <= needed
    for extra, package in OPTIONAL.items():
        names = [line for line in fields.get_all("Requires-Dist") if f'extra == "{extra}"' in line.replace("'", '"')]
        assert any(re.match(rf"({package}|dask)\b", line) for line in names), extra


@pytest.mark.slow
def test_the_wheel_works_where_nothing_of_the_source_is(wheel, tmp_path):
    """In a new environment: the wheel as a user installs it; what it needs is borrowed from this one."""
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "env")], check=True)
    python, palpate = (tmp_path / "env" / "bin" / name for name in ("python", "palpate"))
    # a source on the path would be an installed palpate to pip
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    install = [python, "-m", "pip", "install", "--quiet", "--no-deps", str(wheel)]
    subprocess.run(install, check=True, capture_output=True, env=kept)
    site = next((tmp_path / "env" / "lib").glob("python3*/site-packages"))
    (site / "borrowed.pth").write_text(f"{sysconfig.get_paths()['purelib']}\n")  # its own .pth files are not read

    def run(*argv: object) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(list(map(str, argv)), cwd=tmp_path, env=kept, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done

    where = run(python, "-c", "import scenes, vision, touch, fusion; print(fusion.__file__, scenes.__file__)").stdout
    assert all(str(site) in part for part in where.split())
    assert run(palpate, "--version").stdout.startswith(f"palpate {wheel.name.split('-')[1]}\n")
    assert run(palpate, "doctor").stdout.endswith("all is well\n")
    run(palpate, "synth", "c", "--object", "cylinder", "--occlusion", "0.3", "--seed", "1")
    assert "no problem" in run(palpate, "validate", "c").stdout
    run(palpate, "estimate", "c", "--out", "o")
    assert (tmp_path / "o/report.html").stat().st_size > 10_000
    assert "no problem" in run(palpate, "validate", "o/result.json").stdout


@pytest.mark.parametrize("name", ROOMS)
def test_another_package_of_our_names_is_said(tmp_path, name):
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("")
    paths = os.pathsep.join([str(tmp_path), str(ROOT)])
    first = next(room for room in ("fusion", "scenes") if room != name)
    done = subprocess.run(
        [sys.executable, "-c", f"import {first}"], cwd=tmp_path, env={**os.environ, "PYTHONPATH": paths},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    line = done.stderr.strip().splitlines()[-1]
    assert line.startswith(f"ImportError: palpate: expected its package {name!r}")
    assert "environment of its own" in line


def test_a_folder_of_our_names_is_no_package(tmp_path):
    """As the tests' own folders, or data beside a script: Python prefers a package to it, and so do we."""
    (tmp_path / "vision").mkdir()
    paths = os.pathsep.join([str(tmp_path), str(ROOT)])
    subprocess.run(
        [sys.executable, "-c", "import fusion, vision; vision.look"], cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": paths}, check=True,
    )  # fmt: skip


def test_the_citation_names_the_version_and_the_authors():
    project = (ROOT / "pyproject.toml").read_text()
    version = re.search(r'^version = "([^"]+)"', project, re.M)[1]
    cited = (ROOT / "CITATION.cff").read_text()
    assert f"version: {version}" in cited
    assert "palpate maintainers" in cited
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()
