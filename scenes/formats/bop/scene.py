"""A scene folder of a BOP data set as a capture of one of its objects, and a capture as such a data set.

Layout: bop_toolkit's docs/bop_datasets_format.md. A scene holds any number of objects and instances of them; a capture
is about one. Numbers of images and objects are kept; millimetres here, metres in the capture.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError, InputError
from scenes.files.formats import images
from scenes.files.formats.ply import write_ply
from scenes.files.problems import refuse
from scenes.formats.conversion import Converted, Dropped, at_least_one, located, new_folder
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.appearance.texture import coloured_mesh
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings import bop
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.captures import Capture, write_capture
from scenes.recordings.frames import Frame
from scenes.recordings.manifest import Manifest, read_model
from scenes.recordings.telling import beliefs_json, believed
from scenes.words import counted

Array = NDArray[np.float64]

IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
SPLIT = "test"
BELIEFS = "beliefs.json"
# Tolerance of bop_toolkit's visibility test, for the shares of scene_gt_info.json where there is no mask.
VISIBILITY_DELTA = 0.015


@dataclass(frozen=True)
class Choice:
    """Which object: object_id (None: the only one of the scene), instance (0-based among those of that object in an
    image; None: the only one), models (folder of the meshes; None: looked for beside the scene).
    """

    object_id: int | None = None
    instance: int | None = None
    models: Path | None = None


def is_scene(folder: str | Path) -> bool:
    """True for a scene folder: scene_camera.json and no capture.json."""
    return (Path(folder) / "scene_camera.json").is_file() and not (Path(folder) / "capture.json").is_file()


def convert(folder: Path, out: Path, choice: Choice | None = None, model: ObjectModel | None = None) -> Converted:
    """Write the scene as a capture of the chosen object, mesh from the data set unless `model` is given.

    Depth images keep their counts and each its own scale; images without the object, without a camera, or without the
    depth image that others have, are dropped and counted. Raises PalpateError for a choice that is not unique and for
    broken files.
    """
    choice = choice or Choice()
    cameras = bop.read_frames(folder / "scene_camera.json", refuse)
    truths = _optional(folder / "scene_gt.json")
    shares = _optional(folder / "scene_gt_info.json")
    object_id = _object_id(folder, truths, choice.object_id)
    rows = {number: _row(folder, number, entry, object_id, choice.instance) for number, entry in truths.items()}
    model = model or _model(folder, object_id, choice.models)
    entries = {number: _camera(folder, number, entry) for number, entry in cameras.items()}
    scales = {number: entry.depth_scale for number, entry in entries.items()}
    placed = bool(entries) and all(entry.camera_from_world is not None for entry in entries.values())
    beliefs = _beliefs(folder / BELIEFS)
    dropped = Dropped()
    kept: list[int] = []
    blind = sorted(_image_numbers(folder) - set(entries))
    if blind:
        dropped.add("images", f"no entry in scene_camera.json, the first is {blind[0]:06d}", len(blind))

    def frames() -> Iterator[Frame]:
        for number in sorted(entries):
            row = rows.get(number)
            if truths and row is None:
                dropped.add("images", _why_no_row(truths.get(number), object_id, choice.instance))
                continue
            frame = _frame(folder, number, entries[number], row, truths.get(number), placed, dropped)
            if frame is not None:
                kept.append(number)
                yield replace(frame, beliefs=beliefs)

    notes: dict[str, Any] = {"source": "bop", "scene_id": int(folder.name) if folder.name.isdecimal() else 0}
    seen = _shares(shares, rows)
    if seen:
        notes["visible_fraction"] = seen
    # BOP's world is wherever the data set put it: a fixed frame, as a robot's base is
    world = "robot base" if placed else "camera"
    written = write_capture(
        out, at_least_one(frames(), folder, dropped), model, None, world, scales, notes=notes, object_id=object_id
    )
    return Converted((written,), len(kept), dropped)


def _beliefs(path: Path) -> Beliefs | None:
    """What a capture said of its sensors when it was written as BOP."""
    return believed(None, [(str(path), bop.read_json(path, refuse))]) if path.is_file() else None


def objects(folder: Path) -> list[int]:
    """Numbers of the objects whose poses the scene's ground truth knows; none without one."""
    return _known(_optional(folder / "scene_gt.json"))


def read(folder: Path, choice: Choice, most: int) -> tuple[ObjectModel, list[Frame]]:
    """The chosen object's mesh, and up to `most` of the images that show it, evenly picked, without writing a capture.

    Of several instances in an image the first is taken unless one is chosen. Raises PalpateError for broken files.
    """
    cameras = bop.read_frames(folder / "scene_camera.json", refuse)
    truths = _optional(folder / "scene_gt.json")
    object_id = _object_id(folder, truths, choice.object_id)
    wanted = choice.instance or 0
    rows = {number: _row(folder, number, entry, object_id, wanted) for number, entry in truths.items()}
    seen = sorted(number for number, row in rows.items() if row is not None and number in cameras)
    dropped, found = Dropped(), []
    for at in sorted(set(np.linspace(0, len(seen) - 1, min(most, len(seen))).astype(int))):
        number = seen[at]
        entry = _camera(folder, number, cameras[number])
        frame = _frame(folder, number, entry, rows[number], truths[number], False, dropped)
        if frame is not None:
            found.append(frame)
    return _model(folder, object_id, choice.models), found


def _optional(path: Path) -> Mapping[int, Any]:
    return bop.read_frames(path, refuse) if path.is_file() else {}


def _known(truths: Mapping[int, Any]) -> list[int]:
    rows = [row for entry in truths.values() if isinstance(entry, list) for row in entry if isinstance(row, dict)]
    return sorted({row["obj_id"] for row in rows if isinstance(row.get("obj_id"), int)})


def _object_id(folder: Path, truths: Mapping[int, Any], asked: int | None) -> int:
    known = _known(truths)
    listed = ", ".join(map(str, known))
    if asked is not None:
        if known and asked not in known:
            raise InputError(f"{folder}: expected an object of scene_gt.json ({listed}), got --object-id {asked}")
        return asked
    if len(known) != 1:
        got = f"several: choose one of {listed} with --object-id" if known else "no scene_gt.json: say --object-id"
        raise InputError(f"{folder}: expected one object, got {got}")
    return int(known[0])


def _row(folder: Path, number: int, entry: Any, object_id: int, instance: int | None) -> int | None:
    """Which of the image's ground truths is the chosen instance: the number in its mask's name."""
    if not isinstance(entry, list) or not all(isinstance(row, dict) for row in entry):
        raise CaptureError(f"{folder / 'scene_gt.json'}, frame {number}: expected a list of objects")
    rows = [index for index, row in enumerate(entry) if row.get("obj_id") == object_id]
    if instance is None and len(rows) > 1:
        raise InputError(
            f"{folder}: expected one object {object_id} an image, got {len(rows)} in image {number}:"
            f" choose with --instance 0 to {len(rows) - 1}"
        )
    at = instance or 0
    return rows[at] if at < len(rows) else None


def _why_no_row(entry: Any, object_id: int, instance: int | None) -> str:
    """Why an image is not of the chosen object, by its entry of scene_gt.json."""
    count = sum(row.get("obj_id") == object_id for row in entry or ())
    if count == 0:
        return f"object {object_id} is not in scene_gt.json"
    return f"object {object_id} is there {counted(count, 'time')}, without --instance {instance} (from 0)"


def _camera(folder: Path, number: int, entry: Any) -> bop.SceneCamera:
    try:
        return bop.camera_entry(entry)
    except InputError as error:
        raise CaptureError(f"{folder / 'scene_camera.json'}, frame {number}: {error}") from error


def _model(folder: Path, object_id: int, models: Path | None) -> ObjectModel:
    name = f"obj_{object_id:06d}"
    for place in [models] if models is not None else list(_model_folders(folder)):
        if (place / f"{name}.ply").is_file():
            return read_model(
                place.parent, Manifest(object_id, f"{place.name}/{name}.ply", "mm", name, None, "camera", {})
            )
    where = models if models is not None else "a folder models beside the data set's scenes"
    raise CaptureError(f"{folder}: expected {name}.ply in {where}, found none: say --models DIR or --object MESH")


def _model_folders(folder: Path) -> Iterator[Path]:
    """models, models_cad, models_eval … of the data set, whose scenes are one or two folders below it."""
    for place in list(folder.resolve().parents)[:3]:
        named = [path for path in place.iterdir() if path.is_dir() and re.fullmatch(r"models(_\w+)?", path.name)]
        # the plain name first: the others are variants of it
        yield from sorted(named, key=lambda path: (len(path.name), path.name))


def _image_numbers(folder: Path) -> set[int]:
    """Numbers of the images that are there, whatever kind they are of."""
    places = [folder / name for name in ("depth", "rgb", "gray") if (folder / name).is_dir()]
    files = (path for place in places for path in place.iterdir() if path.suffix.lower() in IMAGE_ENDINGS)
    return {int(path.stem) for path in files if path.stem.isdecimal()}


def _find(folder: Path, name: str) -> Path | None:
    """The image of that name, whatever its ending."""
    return next((path for ending in IMAGE_ENDINGS if (path := folder / f"{name}{ending}").is_file()), None)


def _frame(
    folder: Path, number: int, entry: bop.SceneCamera, row: int | None, truths: Any, placed: bool, dropped: Dropped
) -> Frame | None:
    name = f"{number:06d}"
    depth_file = _find(folder / "depth", name)
    if depth_file is None and (folder / "depth").is_dir():
        dropped.add("images", "no depth image")
        return None
    colour_file = _find(folder / "rgb", name) or _find(folder / "gray", name)
    if depth_file is None and colour_file is None:
        dropped.add("images", "no image file")
        return None
    depth = rgb = mask = truth = None
    if depth_file is not None:
        depth = located(depth_file, lambda path: images.read_depth(path, entry.depth_scale))
    if colour_file is not None:
        rgb = located(colour_file, images.read_rgb)
    if row is not None:
        mask_file = _find(folder / "mask_visib", f"{name}_{row:06d}")
        mask = None if mask_file is None else located(mask_file, images.read_mask)
        where = f"{folder / 'scene_gt.json'}, frame {number}"
        truth = _truth(where, truths[row])
    seen = [image for image in (depth, rgb, mask) if image is not None]
    if len({image.shape[:2] for image in seen}) > 1:
        sizes = ", ".join(f"{image.shape[1]}x{image.shape[0]}" for image in seen)
        raise CaptureError(f"{folder}, frame {number}: expected images of one size, got {sizes}")
    world = entry.camera_from_world if placed and entry.camera_from_world is not None else np.eye(4)
    return Frame(
        index=number,
        where=f"{folder}, frame {number}",
        camera=bop.camera(entry, seen[0].shape),
        camera_from_world=world,
        depth=depth,
        rgb=rgb,
        mask=mask,
        camera_from_object_truth=truth,
    )


def _truth(where: str, row: dict[str, Any]) -> Array:
    try:
        found = bop.truth_entry([row], row["obj_id"])
    except InputError as error:
        raise CaptureError(f"{where}: {error}") from error
    if found is None:
        raise CaptureError(f"{where}: expected a pose, found none")
    return found[0]


def _shares(shares: Mapping[int, Any], rows: dict[int, int | None]) -> dict[str, float]:
    """visib_fract of the chosen instance by image, where scene_gt_info.json says it."""
    found = {}
    for number, row in rows.items():
        entry = shares.get(number)
        if row is not None and isinstance(entry, list) and row < len(entry) and isinstance(entry[row], dict):
            share = entry[row].get("visib_fract")
            if isinstance(share, int | float) and np.isfinite(share):
                found[str(number)] = float(share)
    return found


# ---- a capture as a BOP data set


def export(capture: Capture, out: Path) -> Converted:
    """Write OUT/models and the scene OUT/test/SCENE (its number: the capture's note scene_id, else 0).

    Depth, colour and masks are copied as they are. Frames without a camera are dropped and counted; so is all that a
    hand knows, for which BOP has no place. Raises CaptureError when no frame has a camera.
    """
    cameras = _optional(capture.path / "scene_camera.json")
    number = capture.manifest.notes.get("scene_id", 0)
    scene = Path(SPLIT) / f"{number if isinstance(number, int) and number >= 0 else 0:06d}"
    object_id, model = capture.manifest.object_id, capture.model
    dropped = Dropped()
    truths, infos, kept = {}, {}, {}
    renderer = Renderer({"object": (model.vertices, model.faces)})
    with new_folder(out) as partial:
        (partial / scene).mkdir(parents=True)
        for frame in capture:
            _count_touch(frame, dropped)
            if frame.camera is None:
                dropped.add("frames", "no camera")
                continue
            key, name = str(frame.index), f"{frame.index:06d}"
            kept[key] = cameras[frame.index]
            _copy(capture.path, partial / scene, f"depth/{name}.png", f"rgb/{name}.png")
            if frame.cloud is not None:
                dropped.add("clouds", "BOP has depth images only")
            if frame.mask is not None:
                images.write_mask(partial / scene / "mask_visib" / f"{name}_000000.png", frame.mask)
            if frame.camera_from_object_truth is not None:
                truths[key] = bop.truth_json(frame.camera_from_object_truth, object_id)
                infos[key] = [_truth_info(frame, frame.camera_from_object_truth, renderer)]
        if not kept:
            raise CaptureError(f"{capture.path}: expected a frame with a camera to write as BOP, found none")
        bop.write_json(partial / scene / "scene_camera.json", kept)
        if capture.beliefs is not None:  # no file of BOP's, but nobody else minds it and the way back finds it
            bop.write_json(partial / scene / BELIEFS, beliefs_json(capture.beliefs))
        if truths:
            bop.write_json(partial / scene / "scene_gt.json", truths)
            bop.write_json(partial / scene / "scene_gt_info.json", infos)
            _write_targets(partial, scene, truths, object_id)
        (partial / "models").mkdir()
        vertices, faces, colours = coloured_mesh(model.vertices, model.faces, model.texture)
        write_ply(partial / "models" / f"obj_{object_id:06d}.ply", vertices / bop.MM, faces, colours)
        info = {str(object_id): bop.model_json(model.vertices, model.diameter, model.symmetries)}
        bop.write_json(partial / "models" / "models_info.json", info)
    return Converted((out / scene, out / "models"), len(kept), dropped)


def _count_touch(frame: Frame, dropped: Dropped) -> None:
    why = "BOP has no place for them"
    dropped.add("contacts", why, len(frame.contacts))
    dropped.add("regions without contact", why, 0 if frame.no_contact is None else len(frame.no_contact))
    dropped.add("wrenches", why, len(frame.wrenches))
    dropped.add("tactile arrays", why, len(frame.tactile))
    dropped.add("joint configurations", why, int(frame.joints is not None))
    dropped.add("hand poses", why, int(frame.world_from_hand is not None))
    dropped.add("priors", why, int(frame.prior is not None))


def _copy(source: Path, target: Path, *names: str) -> None:
    for name in names:
        if (source / name).is_file():
            (target / name).parent.mkdir(exist_ok=True)
            shutil.copyfile(source / name, target / name)


def _truth_info(frame: Frame, truth: Array, renderer: Renderer) -> dict[str, Any]:
    """A row of scene_gt_info.json: boxes (x, y, width, height), counts of pixels, visible share.

    Without a mask what is seen follows from the depth image, as bop_toolkit's visibility test does it.
    """
    camera = frame.camera
    if camera is None:
        raise CaptureError(f"{frame.where}: expected a camera, found none")
    width, height = camera.width, camera.height
    # on a canvas of three images a side, so that what the image cuts off counts among all pixels
    wide = Camera(camera.fx, camera.fy, camera.cx + width, camera.cy + height, 3 * width, 3 * height)
    whole = renderer.render(wide, {"object": truth}).depth
    alone = whole[height : 2 * height, width : 2 * width]
    silhouette = alone > 0
    reading = frame.depth > 0 if frame.depth is not None else np.zeros(silhouette.shape, dtype=bool)
    if frame.mask is not None:
        visible = frame.mask
    else:
        stretch = np.linalg.norm(camera.rays(), axis=-1)
        seen = np.zeros(silhouette.shape) if frame.depth is None else frame.depth
        visible = silhouette & (~reading | ((alone - seen) * stretch <= VISIBILITY_DELTA))
    every = int((whole > 0).sum())
    return {
        "bbox_obj": _box(whole > 0, (width, height)),
        "bbox_visib": _box(visible),
        "px_count_all": every,
        "px_count_valid": int((silhouette & reading).sum()),
        "px_count_visib": int(visible.sum()),
        "visib_fract": min(1.0, float(visible.sum()) / every) if every else 0.0,
    }


def _box(mask: NDArray[np.bool_], origin: tuple[int, int] = (0, 0)) -> list[int]:
    """x, y, width, height between the outermost pixels, from the pixel `origin`; -1 four times for none, like BOP."""
    v, u = np.nonzero(mask)
    if len(u) == 0:
        return [-1, -1, -1, -1]
    low, high = (int(u.min()), int(v.min())), (int(u.max()), int(v.max()))
    return [low[0] - origin[0], low[1] - origin[1], high[0] - low[0], high[1] - low[1]]


def _write_targets(out: Path, scene: Path, truths: dict[str, Any], object_id: int) -> None:
    number = int(scene.name)
    bop.write_json(
        out / f"{SPLIT}_targets_bop19.json",
        [{"im_id": int(key), "inst_count": 1, "obj_id": object_id, "scene_id": number} for key in truths],
    )
