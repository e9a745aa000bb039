"""Who may import whom, how large a file and a folder may grow, and what a first import may load."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Each package with the packages it may import.
BELOW = {
    "scenes": set(),
    "vision": {"scenes"},
    "touch": {"scenes"},
    "fusion": {"scenes", "vision", "touch"},
}
# Rooms (folders and files) of a package by floor, from the ground up: a room imports lower floors only.
FLOORS = {
    "scenes": (
        {"errors", "own"},
        {"_interrupts"},
        {"threads", "cache", "_open3d", "_numba", "words"},
        {"files"},
        {"geometry"},
        {"robot"},
        {"recordings"},
        {"evidence"},
        {"reconstruction", "formats"},
        {"synthesis"},
    ),
    "fusion": (
        {"estimation"},
        {"tracking", "modelling"},
        {"truth", "advice"},
        {"results"},
        {"benchmarks"},
        {"settings"},
        {"cli"},
    ),
}
MOST_LINES = 450
MOST_FILES = 15
HEAVY = ("numba", "open3d", "scipy", "cv2", "trimesh")


@cache
def modules() -> dict[str, Path]:
    """Every module of the packages by its dotted name."""
    found = {}
    for package in BELOW:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def only_for_types(tree: ast.Module) -> set[ast.AST]:
    """Nodes below `if TYPE_CHECKING:`: nothing imports them when it runs."""
    blocks = [node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    return {inner for block in blocks for statement in block.body for inner in ast.walk(statement)}


def named(node: ast.AST) -> Iterator[str]:
    """What a node may import: statements anywhere, and strings that name a module, as "package.module:function" do."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert not node.level, "imports are absolute"
        for alias in node.names:
            whole = f"{node.module}.{alias.name}"
            yield whole if whole in modules() else str(node.module)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
        yield node.value.partition(":")[0]


@cache
def imports() -> dict[str, set[str]]:
    """Modules that each module imports, at its top, in its functions or by a string; for types alone does not count."""
    edges = {}
    for name, path in modules().items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        unused = only_for_types(tree)
        edges[name] = {to for node in ast.walk(tree) if node not in unused for to in named(node) if to in modules()}
    return edges


def room(module: str) -> str:
    """The folder or file below the package that a module is in."""
    return module.split(".")[1] if "." in module else ""


def reached(start: str) -> set[str]:
    """Every module that one imports, directly or not."""
    seen, waiting = set(), [start]
    while waiting:
        for to in imports()[waiting.pop()] - seen:
            seen.add(to)
            waiting.append(to)
    return seen


def test_the_graph_sees_functions_and_strings():
    assert "touch.published.optimisers.direct" in imports()["touch.localization"]  # a string
    assert "fusion.benchmarks" in imports()["fusion.cli.commands.measures.bench"]  # in a function
    assert len(modules()) > 200


def test_packages_import_only_those_below():
    for name, others in imports().items():
        package = name.partition(".")[0]
        for other in others:
            assert other.partition(".")[0] in BELOW[package] | {package}, f"{name} imports {other}"


@pytest.mark.parametrize("package", FLOORS)
def test_rooms_import_only_lower_floors(package):
    floor = {name: level for level, names in enumerate(FLOORS[package]) for name in names}
    rooms = {room(name) for name in modules() if name.startswith(f"{package}.")}
    assert rooms == set(floor), "give every room a floor"
    for name, others in imports().items():
        for other in others:
            if name.startswith(f"{package}.") and other.startswith(f"{package}.") and room(name) != room(other):
                assert floor[room(other)] < floor[room(name)], f"{name} imports {other}"


def test_no_module_imports_itself_in_a_circle():
    circles = {name for name in imports() if name in reached(name)}
    assert not circles


def test_an_estimate_rests_on_no_published_method_alone():
    # they are there to be compared with, apart from what `estimate` and `track` use
    for start in ("fusion.estimation.estimate", "fusion.tracking.tracker"):
        assert not [name for name in reached(start) if ".published" in name]


def test_files_and_folders_stay_small():
    counts: dict[str, int] = {}
    for path in [path for top in (*BELOW, "tests") for path in sorted((ROOT / top).rglob("*.py"))]:
        lines = len(path.read_text(encoding="utf-8").splitlines())
        assert lines <= MOST_LINES, f"{path.relative_to(ROOT)}: {lines} lines"
        folder = path.parent.relative_to(ROOT).as_posix()
        counts[folder] = counts.get(folder, 0) + 1
    assert not {folder for folder, count in counts.items() if count > MOST_FILES}


def test_tests_share_code_through_helpers_only():
    tests = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
    for path in (ROOT / "tests").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                parts = {part for name in named(node) for part in name.split(".")}
                assert not parts & tests, f"{path.relative_to(ROOT)} imports another test's file"


@pytest.mark.parametrize("package", BELOW)
def test_a_first_import_is_light(package):
    program = f"import sys, {package}; print(*(name for name in {HEAVY} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
