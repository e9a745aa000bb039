"""Frames of `bench vision`: objects behind a grasping hand, kept as captures so that a second run reads them back."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.benchmarks.printing.tables import own_seed
from scenes.errors import InputError
from scenes.recordings.frames import Frame

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.robot.hands import Hand

ROOT = Path(__file__).resolve().parents[3]
# Generated objects, and the scanned ones that are taken when they are there.
GENERATED = ("box", "bottle", "bust", "cylinder", "drill", "hammer", "l_block", "light_bulb", "mug", "wine_glass")
SCANNED = "ycb"
LEVELS = (0.0, 0.3, 0.6, 0.8)
# Grasps drawn anew for one frame before it is left out: not every object can be hidden by 80 %.
MOST_REFUSED = 3


@dataclass(frozen=True)
class Preset:
    """noise preset; mask: the true visible pixels are given."""

    noise: str
    mask: bool

    @property
    def title(self) -> str:
        """As tables name it."""
        return f"{self.noise}, {'the mask given' if self.mask else 'no mask'}"


PRESETS = (Preset("clean", True), Preset("lab", False))


def objects(chosen: tuple[str, ...] | None = None) -> dict[str, Callable[[], ObjectModel]]:
    """Name -> maker of all objects, or of the chosen ones. Raises InputError, listing the names, for unknown ones."""
    from scenes.synthesis import library

    makers: dict[str, Callable[[], ObjectModel]] = {name: partial(library.make, name) for name in GENERATED}
    folder = Path(os.environ.get("PALPATE_DATA") or ROOT.parent / "shared" / "data") / SCANNED
    if folder.is_dir():
        makers |= {f"{SCANNED}:{path.stem}": partial(_scanned, path) for path in sorted(folder.glob("*.ply"))}
    unknown = [name for name in chosen or () if name not in makers]
    if unknown:
        raise InputError(f"objects: expected some of {', '.join(makers)}, got {', '.join(unknown)}")
    return makers if chosen is None else {name: makers[name] for name in chosen}


def _scanned(path: Path) -> ObjectModel:
    from scenes.evidence.symmetry.symmetry_detection import detect_symmetries
    from scenes.geometry.objects import ObjectModel

    model = ObjectModel.load(path)
    return model.with_symmetries(detect_symmetries(model))


def frames(
    folder: Path, name: str, model: ObjectModel, hand: Hand, preset: Preset, level: float, count: int, seed: int
) -> list[Frame]:
    """Up to `count` frames with truth and prior, read from the folder or made and written there.

    A frame depends on seed, object, noise, level and its number. Contacts are none: vision is alone.
    """
    from scenes.recordings.captures import read_capture, write_capture

    label = f"{name.replace(':', '-')}-{preset.noise}-{100 * level:.0f}-seed{seed}-{count}"
    path = folder / label
    if not (path / "capture.json").is_file():
        made = [frame for i in range(count) if (frame := _made(model, hand, preset, level, seed, i)) is not None]
        if not made:
            return []
        numbered = [replace(frame, index=i) for i, frame in enumerate(made)]
        write_capture(path, numbered, model, hand=hand, notes={"noise": preset.noise, "occlusion": level, "seed": seed})
    found = list(read_capture(path))
    return found if preset.mask else [replace(frame, mask=None) for frame in found]


def _made(model: ObjectModel, hand: Hand, preset: Preset, level: float, seed: int, index: int) -> Frame | None:
    from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

    settings = SynthesisSettings(mask=True, rgb=False)
    for attempt in range(MOST_REFUSED):
        drawn = own_seed(seed, model.name, preset.noise, level, index, attempt)
        try:
            return synthesize_frames(
                model, hand, 1, level, touch=(), noise=preset.noise, seed=drawn, settings=settings
            )[0]
        except InputError:  # a grasp that cannot hide so much is drawn anew
            continue
    return None
