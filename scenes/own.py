"""Whether the four packages are palpate's own: the names are common, and another's of one may come first."""

from __future__ import annotations

from importlib.machinery import PathFinder
from pathlib import Path

PACKAGES = ("scenes", "vision", "touch", "fusion")


def check_packages() -> None:
    """Raise ImportError, in one line, when a package of these names that Python would load is not beside this one."""
    home = Path(__file__).resolve().parents[1]
    for name in PACKAGES:
        found = _folder(name)
        if found is not None and found != home / name:
            raise ImportError(
                f"palpate: expected its package {name!r} in {home}, but Python finds another one in {found}:"
                " uninstall or rename that, or install palpate into an environment of its own"
            )


def _folder(name: str) -> Path | None:
    """Where Python would load the package from; None when import hooks decide (an editable install), or nothing is."""
    spec = PathFinder.find_spec(name)
    if spec is None or spec.origin is None:  # a folder without __init__.py gives way to any package
        return None
    return Path(spec.origin).resolve().parent
