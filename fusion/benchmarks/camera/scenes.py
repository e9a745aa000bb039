"""The synthetic captures themselves: occlusion asked and reached, lattices, symmetries, speed, and a sheet of them."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.camera.optical_cameras import optical_cameras
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Report, Spread, Table
from scenes.errors import InputError
from scenes.files.formats.ply import write_ply
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.distance_field import FieldSettings, build
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.noise.presets import PRESETS
from scenes.synthesis.recording import SynthesisSettings, synthesize, synthesize_frames

Array = NDArray[np.float64]

ASKED = (0.0, 0.3, 0.6, 0.8, 0.9, 0.95)
HIDERS = ("hand", "fingers", "object")
OBJECTS = ("drill", "mug", "bottle", "hammer", "cylinder")
# Near the surface: where evidence lies once a pose is nearly right (m).
NEAR = 0.005
SHEET_FRAMES = 20
# Captures a cell of occlusion, and in a hurry.
TRIALS = (3, 1)


def run(settings: BenchSettings) -> Report:
    """All tables of this file, and the sheet."""
    trials = settings.count(*TRIALS)
    report = Report("scenes", "synthetic captures", f"{trials} captures a cell of occlusion", settings.seed)
    for part in (_speed, optical_cameras, _lattices, _symmetries, _occlusion):
        before = len(report.tables)
        part(report, settings)
        for table in report.tables[before:]:
            settings.show(table)
    report.pictures["sheet"] = contact_sheet(settings.seed, 4 if settings.quick else SHEET_FRAMES)
    return report


def _occlusion(report: Report, settings: BenchSettings) -> None:
    trials = settings.count(*TRIALS)
    table = Table(
        "Hidden share of the object's own pixels: asked and reached",
        [
            Column("hidden by"),
            Column("asked %", 0),
            Column("reached %"),
            Column("largest error %"),
            Column("refused", 0),
        ],
        note="Refused: an object that this hider cannot hide by so much, said with what could be reached. Mean ± sd.",
    )
    small = SynthesisSettings(rgb=False, mask=True)
    hand = five_finger_hand()
    worst, refusals, made = 0.0, 0, 0
    cells = [(hider, asked) for hider in HIDERS for asked in settings.some(ASKED, 2)]
    for hider, asked in settings.progress(cells, len(cells), "occlusion"):
        reached, refused = [], 0
        for trial in range(trials):
            model = library.make(OBJECTS[trial % len(OBJECTS)])
            holding = hand if hider == "hand" else None
            seed = settings.seed + 100 * trial + int(1000 * asked)
            try:
                frame = synthesize_frames(
                    model, holding, 1, asked, noise=PRESETS["none"], seed=seed, occluders=hider, settings=small
                )[0]
            except InputError:
                refused += 1
                continue
            reached.append(hidden_share(model, frame))
        error = np.abs(np.array(reached) - asked)
        worst, refusals, made = max(worst, float(error.max(initial=0.0))), refusals + refused, made + len(reached)
        table.add(hider, 100 * asked, Spread.of(reached, 100.0), 100 * float(error.max(initial=0.0)), refused)
    report.tables.append(table)
    report.claims.append(Claim("largest error of the hidden share (%)", 100 * worst, 3.0, at_least=False))


def hidden_share(model: ObjectModel, frame: Frame) -> float:
    """Measured again, from the recorded mask against the object rendered alone."""
    assert frame.camera is not None
    assert frame.mask is not None
    assert frame.camera_from_object_truth is not None
    renderer = Renderer({"object": (model.vertices, model.faces)})
    alone, _ = renderer.own_pixels(frame.camera, {"object": frame.camera_from_object_truth}, "object")
    return 1.0 - float(frame.mask.sum()) / max(alone, 1)


def _lattices(report: Report, settings: BenchSettings) -> None:
    try:
        import igl
    except ImportError:
        return  # the oracle is a test dependency
    table = Table(
        "Signed-distance lattices against exact distances (libigl)",
        [
            Column("object"),
            Column("diameter mm", 0),
            Column("spacing mm"),
            Column("near: RMS mm", 3),
            Column("near: largest mm", 3),
            Column("everywhere: RMS mm", 3),
            Column("sign wrong %", 3),
        ],
        note=f"Near: within {1e3 * NEAR:.0f} mm of the surface; everywhere: up to 20 mm outside the object's box.",
    )
    rng = np.random.default_rng(settings.seed)
    count = 2000 if settings.quick else 10_000
    worst = 0.0
    for name in settings.progress(library.names(), len(library.names()), "lattices"):
        model = library.make(name)
        field = model.field
        surface, normals = model.sample_surface(count, seed=settings.seed)
        near = surface + rng.uniform(-NEAR, NEAR, (count, 1)) * normals
        low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
        wide = rng.uniform(low - 0.02, high + 0.02, (count, 3))
        exact = [igl.signed_distance(p, model.vertices, model.faces)[0] for p in (near, wide)]
        error = [field.distance(p) - e for p, e in zip((near, wide), exact)]
        rms = [1e3 * float(np.sqrt(np.mean(e**2))) for e in error]
        wrong = np.mean((np.sign(field.distance(near)) != np.sign(exact[0])) & (np.abs(exact[0]) > 2e-4))
        largest = 1e3 * float(np.abs(error[0]).max())
        table.add(name, 1e3 * model.diameter, 1e3 * field.spacing, rms[0], largest, rms[1], 100 * float(wrong))
        worst = max(worst, rms[0])
    report.tables.append(table)
    report.claims.append(Claim("largest RMS error near a surface (mm)", worst, 0.1, at_least=False, digits=3))


def _symmetries(report: Report, settings: BenchSettings) -> None:
    from scenes.evidence.symmetry.symmetry_detection import detect_symmetries

    table = Table(
        "Symmetries declared and found in the mesh",
        [Column("object"), Column("declared"), Column("found"), Column("same"), Column("seconds")],
        note="Discrete members (the identity among them) and continuous axes.",
    )
    same = 0
    for name in settings.progress(library.names(), len(library.names()), "symmetries"):
        model = library.make(name)
        begin = time.perf_counter()
        found = detect_symmetries(model)
        words = [f"{len(s.discrete)} discrete, {len(s.axes)} axes" for s in (model.symmetries, found)]
        same += words[0] == words[1]
        table.add(name, *words, words[0] == words[1], time.perf_counter() - begin)
    report.tables.append(table)
    report.claims.append(Claim("objects whose symmetries are found as declared", same, len(library.names()), True, 0))


def _speed(report: Report, settings: BenchSettings) -> None:
    table = Table(
        "Speed", [Column("what"), Column("wall s"), Column("processor s"), Column("demand s", 0)],
        note="Processor time counts all threads; on a machine that others use, wall time says little.",
    )  # fmt: skip
    frames = 3 if settings.quick else 100
    model, hand = library.make("drill"), five_finger_hand()
    with tempfile.TemporaryDirectory() as folder:
        synthesize(Path(folder) / "warm", model, hand, 2, 0.6, motion="carry", seed=settings.seed)
        for motion in ("carry", "slip"):
            wall, processor = time.perf_counter(), time.process_time()
            synthesize(Path(folder) / motion, model, hand, frames, 0.6, motion=motion, seed=settings.seed)
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            table.add(f"capture of {frames} VGA frames, one grasp, {motion}, lab noise", wall, processor, frames / 10)
            if motion == "carry" and not settings.quick:  # planning, once a capture, outweighs a few frames
                report.claims.append(Claim(f"capture of {frames} VGA frames (s)", wall, frames / 10, at_least=False))
    vertices, faces = rough_ball(6 if settings.quick else 8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ball.ply"
        write_ply(path, vertices, faces)
        wall, processor = time.perf_counter(), time.process_time()
        ball = ObjectModel.load(path)
        build(ball.vertices, ball.faces, FieldSettings())
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
    table.add(f"reading and checking a mesh of {len(faces):,} faces and building its lattice", wall, processor, 10.0)
    report.claims.append(Claim(f"mesh of {len(faces):,} faces to lattice (s)", wall, 10.0, at_least=False))
    report.claims.append(Claim("most memory used until then (GB)", _peak_memory(), 2.0, at_least=False))
    report.tables.append(table)


def _peak_memory() -> float:
    """GB of this process; NaN where the system does not tell."""
    try:
        import resource
    except ImportError:
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e9 if sys.platform == "darwin" else peak / 1e6


def rough_ball(subdivisions: int) -> tuple[Array, NDArray[np.int64]]:
    """A closed mesh of 20 * 4^subdivisions faces, nearly a sphere: the hardest case for closest points."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.05)
    vertices = np.array(ball.vertices)
    vertices *= 1 + 0.05 * np.sin(40 * vertices[:, :1]) * np.cos(30 * vertices[:, 1:2])
    return vertices, np.array(ball.faces, dtype=np.int64)


def contact_sheet(seed: int = 0, frames: int = SHEET_FRAMES, columns: int = 2) -> NDArray[np.uint8]:
    """(h, w, 3): captures of many kinds, each as colour with contacts, depth and mask."""
    kinds = ("hand", "hand", "fingers", "object", "hand+clutter", "fingers+clutter", "border")
    noises = ("lab", "harsh", "lab-time-of-flight", "lab-stereo", "clean")
    names = library.names()
    settings = SynthesisSettings(mask=True)
    tiles = []
    for i in range(frames):
        model, kind = library.make(names[(3 * i + 1) % len(names)]), kinds[i % len(kinds)]
        hand = five_finger_hand() if kind.startswith("hand") else None
        asked = (0.3, 0.5, 0.6, 0.75, 0.4)[i % 5]
        frame = None
        for attempt in range(4):  # another object when this one cannot be hidden so
            try:
                frame = synthesize_frames(model, hand, 1, asked, ("point",), noises[i % 5], seed + i, kind, settings)[0]
                break
            except InputError:
                model = library.make(names[(3 * i + 2 + attempt) % len(names)])
        if frame is not None:
            tiles.append(_tile(frame))
    rows = [np.concatenate(tiles[i : i + columns], axis=1) for i in range(0, len(tiles) - columns + 1, columns)]
    return np.concatenate(rows, axis=0)


def _tile(frame: Frame, width: int = 176, height: int = 132) -> NDArray[np.uint8]:
    """Colour with contacts, depth and mask side by side, cut out about the object."""
    import cv2

    assert frame.camera is not None
    assert frame.rgb is not None
    assert frame.depth is not None
    assert frame.mask is not None
    assert frame.camera_from_object_truth is not None
    middle, depth = frame.camera.project(frame.camera_from_object_truth[None, :3, 3])
    half = int(np.clip(frame.camera.fx * 0.16 / depth[0], 110, 220))
    size = (4 * half // 3, half)
    u = int(np.clip(middle[0, 0], size[0], frame.camera.width - size[0]))
    v = int(np.clip(middle[0, 1], size[1], frame.camera.height - size[1]))
    part = (slice(v - size[1], v + size[1]), slice(u - size[0], u + size[0]))
    colour = frame.rgb.copy()
    if len(frame.contacts):
        pixels, _ = frame.camera.project(frame.contacts.points)
        for x, y in pixels[np.isfinite(pixels).all(axis=1)]:
            cv2.circle(colour, (round(x), round(y)), 5, (20, 20, 20), -1, cv2.LINE_AA)
            cv2.circle(colour, (round(x), round(y)), 4, (70, 235, 90), -1, cv2.LINE_AA)
    read = frame.depth[part]
    near, far = np.quantile(read[read > 0], [0.01, 0.8]) if (read > 0).any() else (0.0, 1.0)
    grey = np.clip(255 * (1 - (read - near) / max(far - near, 0.05)), 0, 255).astype(np.uint8)
    shown = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    shown[read == 0] = 0
    mask = np.repeat(np.where(frame.mask[part], 235, 30).astype(np.uint8)[..., None], 3, axis=2)
    parts = [cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in (colour[part], shown, mask)]
    return np.pad(np.concatenate(parts, axis=1), [(2, 2), (2, 2), (0, 0)])
