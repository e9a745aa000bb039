"""Which pixels are the object's: intersection over union against the truth, with and without a coarse start."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Report, Spread, Table
from scenes.errors import InputError
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames
from vision.look.mask.mask import object_mask
from vision.look.points import CROP_MARGIN

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OBJECTS = ("drill", "mug", "bottle", "hammer", "bust", "box")
HIDDEN = (0.0, 0.3, 0.6, 0.8)
# A table or wall right behind hand and object (m) instead of somewhere in the room.
NEAR = (0.02, 0.15)
NOTHING = Contacts(np.zeros((0, 3)))


@dataclass(frozen=True)
class Scene:
    """What the object is seen among: occluders as in `synthesize_frames`, distance of the wall or table behind (m)."""

    title: str
    occluders: str
    behind: tuple[float, float]


SCENES = (
    Scene("hand, wall far behind", "hand", (0.3, 1.0)),
    Scene("hand, table near", "hand", NEAR),
    Scene("hand, clutter on a near table", "hand+clutter", NEAR),
    Scene("unknown fingers, clutter on a near table", "fingers+clutter", NEAR),
)


@dataclass(frozen=True)
class Way:
    """start: with the coarse start; contacts: with what the fingers felt; colour: with the colour image."""

    title: str
    start: bool
    contacts: bool
    colour: bool

    def mask(self, frame: Frame, model: ObjectModel) -> Mask:
        """The object's pixels by this way."""
        seen = replace(frame, mask=None, contacts=frame.contacts if self.contacts else NOTHING)
        return object_mask(seen, model, start=frame.prior if self.start else None, colour=self.colour)


WAYS = (
    Way("start", True, True, True),
    Way("start, no colour", True, True, False),
    Way("no start", False, True, True),
    Way("no start, no touch", False, False, True),
)


def usual_crop(frame: Frame, model: ObjectModel) -> Mask:
    """All that is read within the model's ball around the start: what a crop without segmentation takes."""
    assert frame.depth is not None
    assert frame.camera is not None
    assert frame.prior is not None
    centre = frame.prior[:3, :3] @ model.centroid + frame.prior[:3, 3]
    rays = frame.camera.rays()
    near = np.linalg.norm(rays * frame.depth[..., None] - centre, axis=2)
    return np.asarray((frame.depth > 0) & (near < model.radius + CROP_MARGIN))


def scores(found: Mask, frame: Frame) -> tuple[float, float, float]:
    """Intersection over union, share found, share right; among pixels that have a reading."""
    assert frame.depth is not None
    assert frame.mask is not None
    read = frame.depth > 0
    found, truth = found & read, frame.mask & read
    both = float((found & truth).sum())
    return both / max((found | truth).sum(), 1), both / max(truth.sum(), 1), both / max(found.sum(), 1)


def run(settings: BenchSettings) -> Report:
    """One table of scenes and hidden shares, one of objects."""
    trials = settings.count(2, 1)
    names = tuple(settings.some(OBJECTS, 1))
    report = Report(
        "segmentation", "the object's pixels in a full scene", f"{trials} captures of each object and cell, lab noise",
        settings.seed,
    )  # fmt: skip
    ways: dict[str, Callable[[Frame, ObjectModel], Mask]] = {
        "usual crop": usual_crop,
        **{w.title: w.mask for w in WAYS},
    }
    note = (
        "Intersection over union of pixels with a reading, per cent. Usual crop: all within the model's ball about the"
        " start. Starts are 16 degrees and 33 mm off. Things have flat colours, kinder than real ones: see no colour."
    )
    columns = [Column("scene"), Column("hidden %", 0), *(Column(name, 0) for name in ways), Column("found %", 0)]
    columns += [Column("right %", 0), Column("processor ms", 0), Column("frames", 0)]
    table = Table("Scenes: mean IoU", columns, note=note + " Found, right, time: with the start.")
    per_object: dict[str, dict[str, list[float]]] = {name: {way: [] for way in ways} for name in names}
    cells = [(scene, share) for scene in SCENES for share in settings.some(HIDDEN, 2)]
    everything: dict[str, list[float]] = {way: [] for way in ways}
    for scene, share in settings.progress(cells, len(cells), "segmentation"):
        iou: dict[str, list[float]] = {way: [] for way in ways}
        found, right, spent = [], [], []
        for name, frame, model in frames(scene, share, names, trials, settings.seed):
            for way, mask in ways.items():
                begin = time.process_time()
                result = scores(mask(frame, model), frame)
                if way == "start":
                    spent.append(time.process_time() - begin)
                    found.append(result[1])
                    right.append(result[2])
                iou[way].append(result[0])
                per_object[name][way].append(result[0])
                if scene.occluders.startswith("hand"):
                    everything[way].append(result[0])
        means = [100 * float(np.mean(values)) if values else float("nan") for values in iou.values()]
        cell = [Spread.of(values, scale).mean for values, scale in ((found, 100.0), (right, 100.0))]
        table.add(scene.title, 100 * share, *means, *cell, Spread.of(spent, 1e3).median, len(found))
    report.tables.append(table)
    settings.show(table)
    objects = Table("Objects, over all scenes: mean IoU", [Column("object"), *(Column(name, 0) for name in ways)])
    for name, values in per_object.items():
        objects.add(name, *(100 * float(np.mean(v)) if v else float("nan") for v in values.values()))
    report.tables.append(objects)
    for way in ("start", "no start"):
        median = float(np.median(everything[way])) if everything[way] else float("nan")
        report.claims.append(Claim(f"median IoU behind a known hand, {way}", median, 0.8, at_least=True))
    return report


def frames(
    scene: Scene, share: float, names: tuple[str, ...], trials: int, seed: int
) -> list[tuple[str, Frame, ObjectModel]]:
    """Captures of a cell with truth, start and contacts; an object that cannot be hidden so is left out."""
    hand = five_finger_hand() if scene.occluders.startswith("hand") else None
    settings = SynthesisSettings(mask=True, background_distance=scene.behind)
    made = []
    for name in names:
        model = library.make(name)
        for trial in range(trials):
            own = seed + 1000 * trial + int(100 * share)
            try:
                frame = synthesize_frames(
                    model, hand, 1, share, noise="lab", seed=own, occluders=scene.occluders, settings=settings
                )[0]
            except InputError:
                continue
            made.append((name, frame, model))
    return made
