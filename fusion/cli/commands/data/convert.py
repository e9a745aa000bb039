"""Turn foreign recordings into captures, and captures into foreign files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion.cli.formats import SOURCES, TABLE, TARGETS, refuse_unused
from fusion.cli.options import (
    add_object,
    add_trust,
    check_folder,
    check_target,
    positive_number,
    say,
    warn,
    whole,
    write_json,
)
from fusion.cli.point_lists import ENDINGS, convert_list
from fusion.cli.telling import add_beliefs, beliefs_told
from fusion.results.runs import load_object

if TYPE_CHECKING:
    from scenes.formats.conversion import Converted
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.captures import Capture

STAMP_RATE = 30.0
# Frames a second between which stamps are whole nanoseconds that differ, and fit the 64 bits of a time.
STAMP_RATES = (1e-3, 1e9)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    sources = "; ".join(f"{name} ({what})" for name, what in SOURCES.items())
    targets = "; ".join(f"{name} ({what})" for name, what in TARGETS.items())
    parser.add_argument(
        "source", metavar="IN", type=Path, help="recording, capture, result, contacts (.off, .ply, .csv), mesh or cloud"
    )
    parser.add_argument("out", metavar="OUT", type=Path, help="folder or file to write")
    parser.add_argument("--from", dest="kind", metavar="FORMAT", help=f"of a recording, else seen from it: {sources}")
    parser.add_argument(
        "--to",
        metavar="FORMAT",
        help=f"what a capture (or a result, with its capture) becomes: {targets}; default: by the ending of OUT, else"
        " bop of images and off of clouds",
    )
    add_object(parser, what="instead of the recording's object, or where it has none")
    parser.add_argument("--object-id", metavar="N", type=whole, help="bop, tacman: which object of several")
    parser.add_argument("--instance", metavar="K", type=whole, help="bop: which of several in an image, from 0")
    parser.add_argument("--models", metavar="DIR", type=Path, help="bop: folder of the meshes, else looked for")
    parser.add_argument(
        "--hand", metavar="URDF", type=Path, help="feelsight: the hand, sensors.json with gels beside it"
    )
    parser.add_argument(
        "--topics",
        metavar="FILE|NAME",
        type=Path,
        help="ros: the topic map (docs/formats.md), or a ready one: object-in-hand",
    )
    parser.add_argument("--intrinsics", metavar="FX,FY,CX,CY", help="images, ready topic maps: the camera, pixels")
    parser.add_argument(
        "--depth-scale", metavar="MM", type=positive_number, help="images, ycbineoat: millimetres per count (default 1)"
    )
    parser.add_argument(
        "--result", metavar="FILE", type=Path, help="glb, tum: poses.csv, result.json or their folder; else the truth"
    )
    parser.add_argument(
        "--frame", metavar="N", type=whole, help="glb: whose cloud and hand (or the first); contacts: which"
    )
    parser.add_argument("--fps", metavar="F", type=positive_number, help="tum: where no stamps are known (30)")
    add_beliefs(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 0; what was written and what was dropped is listed."""
    from scenes.errors import InputError
    from scenes.recordings.telling import believed
    from scenes.recordings.writing import tell

    told = beliefs_told(args)
    believed(None, told)  # a mistake in it is one line now, not one after the work
    if told and (args.source / "capture.json").is_file():
        raise InputError(f"{told[0][0]}: expected a recording that becomes a capture, got a capture")
    done = convert(args)
    for path in done.written if told else ():
        if (path / "capture.json").is_file():
            tell(path, told)
    write_json(args.json, done.to_json())
    for path in done.written:
        say(f"wrote {path}")
    for line in (*done.dropped.lines(), *done.remarks):
        say(line)
    return 0


def convert(args: argparse.Namespace) -> Converted:
    """Convert by what the source is and what the arguments ask for; raises PalpateError when no way is known."""
    from scenes.errors import InputError, unknown

    for name, choices in (("kind", SOURCES), ("to", TARGETS)):
        asked = getattr(args, name)
        if asked is not None and asked not in choices:
            option = "--from" if name == "kind" else "--to"
            raise unknown(option, asked, choices)
    source: Path = args.source
    if not source.exists():
        raise InputError(f"{source}: expected a recording, a capture or a file, found nothing")
    if args.kind is None:
        if (source / "capture.json").is_file():
            return _export(args)
        from fusion.results.files import capture_of, find_result, read_result

        result = find_result(source)
        if result is not None:
            if args.result is not None:
                raise InputError(f"--result: expected a capture beside it, got {source}, which is a result")
            args.source = capture_of(result, read_result(result)[0])
            return _export(args, result)
    if args.to is not None:
        raise InputError(f"{source}: expected a capture (capture.json) for --to {args.to}, found none")
    kind = args.kind or _kind(source, args.out)
    refuse_unused(args, source=kind)
    if kind == TABLE:
        return convert_list(source, args.out, args.frame)
    return _import(kind, args)


def _kind(source: Path, out: Path) -> str:
    """The format of a recording, by its files."""
    from scenes.errors import InputError
    from scenes.formats import handover, image_folder, tacman
    from scenes.formats.bop import scene as bop_scene
    from scenes.formats.gels import digit_grasps, feelsight
    from scenes.formats.ros import bag as ros_bag

    if source.is_file():
        if ros_bag.is_bag(source):
            return "ros"
        if source.suffix.lower() == ".ini":
            return "tacman"
        as_capture = source.suffix.lower() in ENDINGS and out.suffix == ""
        return "contacts" if as_capture else TABLE
    checks = (
        ("bop", bop_scene.is_scene),
        ("ros", ros_bag.is_bag),
        ("ycbineoat", image_folder.is_sequence),
        ("handover", _is_handover),
        ("images", image_folder.is_image_folder),
        ("feelsight", feelsight.is_log),
        ("digit", lambda folder: bool(digit_grasps.grasps_in(folder))),
    )
    for name, fits in checks:
        if fits(source):
            return name
    if any(tacman.is_set(path) for path in source.glob("*.ini")):
        return "tacman"
    scenes = [path.parent.name for path in sorted(source.glob("*/scene_camera.json"))]
    if scenes:
        raise InputError(f"{source}: expected one scene folder of the data set, such as {source / scenes[0]}")
    files = ", ".join(handover.FILES)
    names = ", ".join(SOURCES)
    raise InputError(f"{source}: expected a capture (capture.json) or a recording ({names}; {files}), found neither")


def _is_handover(folder: Path) -> bool:
    from scenes.formats import handover

    return handover.is_grasp(folder) or any(handover.is_grasp(path) for path in folder.iterdir() if path.is_dir())


def _object(args: argparse.Namespace, needed: str | None = None) -> ObjectModel | None:
    """--object, None without one; raises InputError when `needed` says what cannot do without."""
    from scenes.errors import InputError

    if args.object is None and needed is not None:
        raise InputError(f"{args.source}: expected --object NAME|MESH for {needed}, got none")
    return None if args.object is None else load_object(args.object, args.unit)


def _import(kind: str, args: argparse.Namespace) -> Converted:
    from scenes.errors import InputError
    from scenes.formats import image_folder, tacman
    from scenes.formats.bop import scene as bop_scene
    from scenes.formats.conversion import Converted, Dropped

    source, out = args.source, args.out
    if kind == "bop":
        choice = bop_scene.Choice(args.object_id, args.instance, args.models)
        return bop_scene.convert(source, out, choice, _object(args))
    if kind == "ycbineoat":
        model = _needed(args, "a YCBInEOAT sequence")
        return image_folder.convert_sequence(source, out, model, args.depth_scale or 1.0)
    if kind == "images":
        return image_folder.convert_images(source, out, _needed(args, "a folder of images"), _intrinsics(args))
    if kind == "contacts":
        from fusion.cli.commands.answers.localize import read_contacts

        model = _needed(args, f"a capture (or OUT ending in {', '.join(ENDINGS)})")
        return tacman.convert_contacts(read_contacts(source, args.frame), out, model, str(source))
    if kind == "ros":
        from scenes.formats.ros import recording as ros
        from scenes.formats.ros import topics as ros_map

        if args.topics is None:
            raise InputError(f"{source}: expected --topics FILE, a topic map (docs/formats.md), got none")
        from scenes.formats.ros import maps

        if str(args.topics) in maps.names():
            given = _intrinsics(args)
            k = None if given is None else given.matrix
            known = None if k is None else (float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))
            return ros.convert(source, out, maps.ready_map(str(args.topics), source, known), _object(args))
        if args.intrinsics is not None:
            raise InputError(f"--intrinsics: expected a ready topic map ({', '.join(maps.names())}), got {args.topics}")
        return ros.convert(source, out, ros_map.read_map(args.topics), _object(args))
    if kind == "feelsight":
        from scenes.formats.gels import feelsight
        from scenes.robot.hands import Hand

        hand = None if args.hand is None else Hand.load(args.hand)
        return feelsight.convert(source, out, _needed(args, "a FeelSight log"), hand)
    if kind == "digit":
        from scenes.formats.gels import digit_grasps

        found = digit_grasps.grasps_in(source) if source.is_dir() else []
        single = found == [source]
        parts = [
            digit_grasps.convert(path, out if single else out / "_".join(path.relative_to(source).parts), _object(args))
            for path in found
        ]
    elif kind == "tacman":
        if source.is_file():
            return tacman.convert(source, out, _object(args), args.object_id)
        sets = [path for path in sorted(source.glob("*.ini")) if tacman.is_set(path)]
        parts = [tacman.convert(path, out / path.stem, _object(args), args.object_id) for path in sets]
    else:
        from scenes.formats import handover

        grasps = [(source, out)] if handover.is_grasp(source) else []
        folders = sorted(path for path in source.iterdir() if path.is_dir()) if source.is_dir() and not grasps else []
        grasps += [(path, out / path.name) for path in folders if handover.is_grasp(path)]
        parts = [handover.convert(*pair) for pair in grasps]
    if not parts:
        raise InputError(f"{source}: expected {SOURCES[kind]}, found none")
    dropped = Dropped()
    for part in parts:
        dropped.merge(part.dropped)
    remarks = tuple(line for part in parts for line in part.remarks)
    written = tuple(path for part in parts for path in part.written)
    return Converted(written, sum(part.frames for part in parts), dropped, remarks)


def _needed(args: argparse.Namespace, what: str) -> ObjectModel:
    from scenes.errors import InputError

    model = _object(args, what)
    if model is None:
        raise InputError(f"{args.source}: expected --object NAME|MESH for {what}, got none")
    return model


def _intrinsics(args: argparse.Namespace) -> Any:
    """--intrinsics and --depth-scale, or None: the folder's camera.json."""
    import numpy as np

    from scenes.errors import InputError
    from scenes.formats import image_folder
    from scenes.recordings import bop

    if args.intrinsics is None:
        if args.depth_scale is not None:
            raise InputError("--depth-scale: expected --intrinsics beside it; a camera.json says its own depth_scale")
        return None
    try:
        fx, fy, cx, cy = bop.numbers(args.intrinsics.split(","), 4, "--intrinsics")
        entry = bop.camera_entry({"cam_K": [fx, 0, cx, 0, fy, cy, 0, 0, 1]})
    except InputError as error:
        raise InputError(f"--intrinsics: expected FX,FY,CX,CY in pixels, got {args.intrinsics!r}") from error
    beside = args.source / "camera.json"
    scale = args.depth_scale
    if scale is None:  # other intrinsics make no other counts
        scale = image_folder.read_depth_scale(beside) if beside.is_file() else 1.0
    return image_folder.Intrinsics(np.asarray(entry.matrix), scale)


# ---- from a capture


def _export(args: argparse.Namespace, result: Path | None = None) -> Converted:
    """A capture, with the poses of `result` where the source was one, as --to or the ending of OUT says."""
    from scenes.errors import InputError
    from scenes.formats import handover
    from scenes.formats.bop import scene as bop_scene
    from scenes.formats.conversion import Converted
    from scenes.recordings.captures import read_capture

    capture = read_capture(args.source, args.trust_paths)
    endings = {".glb": "glb", ".tum": "tum"}
    ending = args.out.suffix.lower()
    if args.to is None and ending[1:].isalpha() and ending not in endings:
        raise InputError(f"{args.out}: expected a folder, or a file that ends in {' or '.join(endings)}; else say --to")
    images = (capture.path / "scene_camera.json").is_file()
    to = args.to or endings.get(ending, "bop" if images else "off")
    refuse_unused(args, target=to)
    (check_folder if to in ("bop", "off") else check_target)(args.out)
    if to == "bop":
        return bop_scene.export(capture, args.out)
    if to == "off":
        written = handover.export(capture, args.out)
        return Converted(tuple(written), len(written))
    result = result or args.result
    poses = _poses(capture, result)
    if to == "tum":
        from scenes.formats.tum import write_tum

        write_tum(args.out, poses, _stamps(capture, args.fps))
    else:
        _write_glb(capture, args, poses, result is not None)
    return Converted((args.out,), len(poses))


def _poses(capture: Capture, result: Path | None) -> dict[int, Any]:
    """camera_from_object by frame: the result's, or the ground truth without one."""
    from scenes.errors import CaptureError, InputError

    if result is None:
        found = {frame.index: frame.camera_from_object_truth for frame in capture}
        known = {number: pose for number, pose in found.items() if pose is not None}
        if not known:
            raise InputError(f"{capture.path}: expected ground truth or --result, found neither")
        return known
    known = _result_poses(result, capture)
    strangers = sorted(set(known) - set(capture.frame_ids))
    if strangers:
        raise InputError(f"{result}: expected frames of {capture.path}, got {strangers[0]}, which it does not have")
    if not known:
        raise CaptureError(f"{result}: expected poses, found none")
    return known


def _result_poses(path: Path, capture: Capture) -> dict[int, Any]:
    from fusion.results.files import check_is_of, find_result, read_result
    from scenes.errors import CaptureError
    from scenes.recordings.bop import read_poses
    from scenes.recordings.pose_rows import best_rows

    result = find_result(path)
    if result is not None:
        content, answers = read_result(result)
        check_is_of(result, content, answers, capture)
        return {answer.frame: answer.pose for answer in answers}
    if path.is_dir():
        path = path / "poses.csv"
        if not path.is_file():
            raise CaptureError(f"{path.parent}: expected result.json or poses.csv in it, found neither")
    return {number: row.pose for number, row in best_rows(read_poses(path), capture, str(path)).items()}


def _stamps(capture: Capture, fps: float | None) -> dict[int, int]:
    """Nanoseconds by frame: what the recording said, else frames at `fps` from 0, which is said unless asked for.

    Raises InputError for a rate beside the recording's own times: who gives it believes that it does something.
    """
    from scenes.errors import InputError
    from scenes.recordings.manifest import frame_stamps

    low, high = STAMP_RATES
    if fps is not None and not low <= fps <= high:
        raise InputError(f"--fps: expected frames a second from {low:g} to {high:g}, got {fps:g}")
    try:
        said = frame_stamps(capture.manifest.notes, capture.frame_ids)
    except InputError as error:
        raise InputError(f"{capture.path / 'capture.json'}: {error}") from error
    if said is not None and fps is not None:
        where = f"{capture.path / 'capture.json'}, which has them (stamps_ns)"
        raise InputError(f"--fps: expected a recording without times, got {where}: leave it out")
    if said is not None:
        return said
    if fps is None:
        fps = STAMP_RATE
        warn(f"the recording has no times (stamps_ns): frames are written as if {fps:g} came in a second (--fps)")
    return {number: round(1e9 * number / fps) for number in capture.frame_ids}


def _write_glb(capture: Capture, args: argparse.Namespace, found: dict[int, Any], estimated: bool) -> None:
    from scenes.formats.glb import write_glb
    from scenes.geometry import poses

    shown = args.frame if args.frame is not None else min(found)
    frame = capture.frame(shown)
    world_from_camera, truths = {}, {}
    for number in found:
        one = capture.frame(number)
        world_from_camera[number] = poses.inverse(one.camera_from_world)
        if estimated and one.camera_from_object_truth is not None:
            truths[number] = one.camera_from_object_truth
    write_glb(args.out, capture.model, found, frame, world_from_camera, truths, capture.world)
