"""Sequences of a family and a motion, made once and kept. Metres, radians."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion.benchmarks.families.making import hand_of, judge_of, settings_of, true_model
from fusion.benchmarks.families.table import FAMILIES, Family

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.frames import Frame
    from scenes.synthesis.recording import SynthesisSettings

# The family whose every motion is asked for most, and the share of the object that is hidden in the first frame.
USUAL = "lab"
OCCLUSION = 0.6


def recorded(
    name: str,
    motion: str,
    frames: int,
    seed: int,
    folder: Path | None,
    occlusion: float = OCCLUSION,
    settings: SynthesisSettings | None = None,
    family: Family = FAMILIES[USUAL],
    **how: Any,
) -> tuple[ObjectModel, list[Frame], dict[str, Any]] | None:
    """A sequence and its notes; None when no grasp of three seeds hides the object by as much as asked.

    folder: where the capture (with the true mesh) is kept for the next run, None keeps none. how: more arguments of
    scenes.synthesize.
    """
    from scenes.errors import InputError
    from scenes.recordings.captures import read_capture
    from scenes.synthesis.recording import synthesize

    settings = settings or settings_of(family)
    model = judge_of(name, family.mesh_error).model
    for attempt in range(3):
        with tempfile.TemporaryDirectory() as scratch:
            label = f"{family.name}-{name.replace(':', '-')}-{motion}-{frames}-{seed}-{attempt}"
            kept = Path(scratch if folder is None else folder) / label
            try:
                if not (kept / "capture.json").is_file():
                    drawn = family.seeds[(seed + 1000 * attempt) % len(family.seeds)]
                    arguments = {"touch": family.touch, "scene": family.scene, **how}
                    synthesize(
                        kept, true_model(name), hand_of(family), frames, occlusion, noise=family.preset(), seed=drawn,
                        motion=motion, settings=settings, **arguments,
                    )  # fmt: skip
            except InputError:
                continue
            capture = read_capture(kept)
            return model, list(capture), capture.manifest.notes["motion"]
    return None
