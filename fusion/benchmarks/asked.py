"""Which options a benchmark heeds, and which objects it has: what it would pass over is refused before the work."""

from __future__ import annotations

from fusion.benchmarks.printing.tables import BenchSettings
from scenes.errors import InputError, unknown

# Of those that not every benchmark has, by its name.
HEEDED = {
    "real": ("data", "bop"),
    "gel": ("data",),
    "few": ("objects",),
    "vision": ("objects", "family", "told"),
    "search": ("objects", "family"),
    "occlusion": ("objects", "family", "methods"),
    "calibration": ("objects", "family", "told"),
    "profile": ("objects", "family"),
    "skipping": ("objects",),
    "peers": ("objects", "family"),
    "faults": ("objects", "family"),
    "colour": ("objects", "family", "data"),
    "tracking": ("objects", "family", "motions", "frames", "methods"),
    "failing": ("objects", "family", "motions", "frames"),
    "memory": ("frames",),
}
OPTIONS = ("objects", "family", "motions", "frames", "methods", "data", "bop", "told")


def check(name: str, settings: BenchSettings) -> None:
    """Raise InputError for an option that this benchmark (or "all": none of them) does not heed, for an unknown family
    and for an object that no benchmark, or none of the families asked for, has.
    """
    heeded = HEEDED.get(name, ()) if name != "all" else OPTIONS
    for option in OPTIONS:
        if getattr(settings, option) in (None, False) or option in heeded:
            continue
        of = [one for one, has in HEEDED.items() if option in has]
        raise InputError(f"bench {name}: expected no --{option}, which is of {', '.join(of)}, got it")
    if settings.family is None and settings.objects is None:
        return
    from fusion.benchmarks.families.table import chosen

    families = chosen(settings.family)
    if settings.objects is None:
        return
    from fusion.benchmarks.camera.frames import objects
    from fusion.benchmarks.families.making import recordings
    from fusion.benchmarks.families.table import RECORDED
    from scenes.synthesis import library

    known = {one for family in families for one in family.objects}
    if any(family.name == RECORDED for family in families):
        known |= {path.name for path in recordings()}
    # sequences follow any object in a family's scenes
    if settings.family is None or name in ("tracking", "failing", "all"):
        known |= {*library.names(), *library.tool_names(), *library.held_out_names(), *objects()}
    for one in settings.objects:
        if one not in known:
            raise unknown("--objects", one, sorted(known), "some of")
