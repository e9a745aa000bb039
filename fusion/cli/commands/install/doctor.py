"""Look at this machine: the libraries, the cache, the threads, and what the first run will have to compile."""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections.abc import Callable

from fusion.cli.compiling import TAKES, kernels_compiled
from fusion.cli.options import say, write_json
from scenes.words import counted

GOOD, NOTE, BAD = "good", "note", "BAD "


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """It has none of its own."""


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when something is missing that palpate needs."""
    rows = []
    for check in (_python, _packages, _libraries, _own, _cache, _threads, _kernels):
        rows += check()
    write_json(args.json, {"checks": [dict(zip(("what", "state", "found"), map(str.strip, row))) for row in rows]})
    width = max(len(row[0]) for row in rows)
    for what, state, found in rows:
        say(f"{state}  {what:<{width}}  {found}")
    bad = [row for row in rows if row[1] == BAD]
    say("all is well" if not bad else f"{len(bad)} to mend: {', '.join(row[0] for row in bad)}")
    return 1 if bad else 0


Row = tuple[str, str, str]


def _python() -> list[Row]:
    state = GOOD if sys.platform == "linux" else NOTE
    said = "" if state == GOOD else " (tested on Linux only)"
    return [("Python", state, f"{platform.python_version()}, {platform.system()} {platform.machine()}{said}")]


def _packages() -> list[Row]:
    from fusion.cli.versions import OPTIONAL, dependencies, version_of

    rows: list[Row] = []
    for name in dependencies():
        found = version_of(name)
        rows.append((name, GOOD if found else BAD, found or f"not installed: pip install {name}"))
    for extra, name in OPTIONAL.items():
        found = version_of(name)
        rows.append((name, GOOD if found else NOTE, found or f"not installed: pip install 'palpate[{extra}]' adds it"))
    return rows


def _attempt(what: str, look: Callable[[], str], bad: str = BAD) -> Row:
    """One row; any failure to load is what is being looked for."""
    try:
        return what, GOOD, look()
    except Exception as error:  # noqa: BLE001  (a broken library may raise anything)
        return what, bad, " ".join(str(error).split())[:160]


def _libraries() -> list[Row]:
    def ray_casting() -> str:
        import numpy as np

        from scenes._open3d import open3d

        library = open3d()
        scene = library.t.geometry.RaycastingScene()
        corners = np.array([[-1, -1, 1], [1, -1, 1], [0, 1, 1]], dtype=np.float32)
        scene.add_triangles(corners, np.array([[0, 1, 2]], dtype=np.uint32))
        hit = float(scene.cast_rays(np.array([[0, 0, 0, 0, 0, 1]], dtype=np.float32))["t_hit"].numpy()[0])
        if abs(hit - 1.0) > 1e-6:
            raise ValueError(f"expected a ray to hit at 1 m, got {hit}")
        return "loads and casts rays"

    def images() -> str:
        import cv2
        import numpy as np

        ok, data = cv2.imencode(".png", np.full((4, 4), 1000, dtype=np.uint16))
        again = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if ok else None
        if again is None or again[0, 0] != 1000:
            raise ValueError("expected a 16-bit PNG to read back as written")
        return "writes and reads 16-bit PNG"

    return [_attempt("Open3D's libraries", ray_casting), _attempt("OpenCV", images)]


def _own() -> list[Row]:
    import scenes

    folder = os.path.dirname(os.path.dirname(os.path.abspath(scenes.__file__)))
    return [("palpate's packages", GOOD, folder)]


def _cache() -> list[Row]:
    from scenes.cache import cache_folder

    def look() -> str:
        import tempfile

        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        files = [path for path in folder.iterdir() if path.is_file()]
        size = sum(path.stat().st_size for path in files) / 1e6
        return f"{folder}: {counted(len(files), 'file')}, {size:.0f} MB (PALPATE_CACHE moves it)"

    return [_attempt("cache of lattices", look, NOTE)]


def _threads() -> list[Row]:
    from scenes.threads import VARIABLE, thread_count

    def look() -> str:
        told = os.environ.get(VARIABLE)
        return f"{thread_count()} of {os.cpu_count()} cores" + (f" ({VARIABLE}={told})" if told else "")

    return [_attempt("threads", look)]


def _kernels() -> list[Row]:
    def look() -> str:
        compiled, folder = kernels_compiled()
        return f"compiled, in {folder}" if compiled else f"the first run compiles them, {TAKES}, into {folder}"

    return [_attempt("compiled kernels", look)]
