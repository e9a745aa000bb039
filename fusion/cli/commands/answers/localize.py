"""Find an object by touch alone, or by touch and a point cloud in the same frame."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion.cli.compiling import announce_compiling
from fusion.cli.options import (
    add_object,
    add_trust,
    number,
    percent,
    pose_lines,
    positive,
    positive_number,
    say,
    show_table,
    write_json,
)
from fusion.cli.telling import add_beliefs, beliefs_told
from fusion.results.runs import load_object

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.beliefs import Beliefs
    from scenes.recordings.frames import Contacts

METHODS = (
    "multistart",
    "gradient-descent",
    "levenberg-marquardt",
    "monte-carlo",
    "direct",
    "annealing",
    "mupf",
    "upf",
    "particle-filter",
    "annealed-particle-filter",
    "scaling-series",
    "icp",
)
SENSES = ("vision", "touch", "fused")
HEADS = ("trial", "index mm", "modes", "verdict", "sure", "time s")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument(
        "contacts",
        metavar="CONTACTS",
        type=Path,
        help="contacts.csv, a point list as .off or .ply, or a capture with gels' images",
    )
    add_trust(parser)
    add_object(parser, what="the object; of a capture its own, else needed")
    parser.add_argument("--cloud", metavar="FILE", type=Path, help="point cloud in the contacts' frame: .ply or .off")
    parser.add_argument("--method", metavar="NAME", default="multistart", help=f"{', '.join(METHODS)}")
    parser.add_argument("--trials", metavar="N", type=positive, default=1, help="independent trials (default 1)")
    parser.add_argument(
        "--max-contacts", metavar="N", type=positive, help="contacts used, another choice each trial; all are judged"
    )
    parser.add_argument("--frame", metavar="N", type=int, help="of a contacts.csv with several frames, this one")
    parser.add_argument(
        "--sure-within",
        metavar="MM",
        type=positive_number,
        help="`sure` is the probability that ADD-S is below this (default 5); from 95 %% on the verdict is ok",
    )
    add_beliefs(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 1 when the last trial is lost."""
    from scenes.errors import InputError, unknown
    from scenes.recordings.checking.validation import check_usable
    from scenes.recordings.frames import Frame
    from scenes.recordings.telling import believed

    if args.method not in METHODS:
        raise unknown("method", args.method, METHODS)
    if (args.contacts / "capture.json").is_file():
        return _run_gels(args)
    if args.object is None:
        raise InputError("localize: expected --object NAME|MESH for contacts, got none")
    if args.cloud is not None and args.method != "multistart":
        raise InputError(f"method: expected multistart with --cloud, got {args.method!r}")
    told = beliefs_told(args)
    if told and args.cloud is None:
        raise InputError(f"{told[0][0]}: expected --cloud FILE beside it: contacts alone tell their own noise")
    beliefs = believed(None, told)
    within = None if args.sure_within is None else 1e-3 * args.sure_within
    contacts = read_contacts(args.contacts, args.frame)
    cloud = _read_cloud(args.cloud)
    model = load_object(args.object, args.unit)
    check_usable(Frame(0, where=str(args.contacts), contacts=contacts, cloud=cloud), model)
    model.field  # noqa: B018  (built or read from the cache before anything is timed)
    announce_compiling()
    # a few contacts once, so that no trial's time tells of the compiler
    few = _some(contacts, 8, args.seed)
    if cloud is None:
        _by_touch(model, few, few, args.method, args.seed, within)
    else:
        _by_both(model, few, few, cloud, args.seed, beliefs, within)
    trials, verdicts = [], []
    for trial in range(args.trials):
        used = _some(contacts, args.max_contacts, args.seed + trial)
        if cloud is None:
            found = _by_touch(model, used, contacts, args.method, args.seed + trial, within)
        else:
            found = _by_both(model, used, contacts, cloud, args.seed + trial, beliefs, within)
        trials.append(found)
        verdicts.append(found["verdict"])
    _show(trials, cloud is not None)
    for note in dict.fromkeys(note for trial in trials for note in trial.get("notes", [])):
        say(note)
    _show_best(trials, "the contacts' frame", "contacts_frame_from_object")
    content = {"method": args.method, "object": model.name, "contacts": len(contacts), "trials": trials}
    write_json(args.json, content)
    return 1 if verdicts[-1] == "lost" else 0


def _run_gels(args: argparse.Namespace) -> int:
    """One frame of a capture by its gels' patches alone; exit code 1 when the last trial is lost."""
    import numpy as np

    from scenes.errors import InputError
    from scenes.geometry import poses
    from scenes.recordings.captures import read_capture
    from touch.gels.localize import localize_gels
    from touch.gels.patches import patches_of

    other = args.cloud is not None or args.method != "multistart" or args.max_contacts is not None
    if other or beliefs_told(args):
        message = "no --cloud, --method, --max-contacts or beliefs with a capture: its gels are used"
        raise InputError(f"localize: expected {message}")
    capture = read_capture(args.contacts, args.trust_paths)
    frame = capture[0] if args.frame is None else capture.frame(args.frame)
    if not frame.gels:
        raise InputError(f"{frame.where}: expected gels' images in tactile/, found none")
    model = load_object(args.object, args.unit) if args.object is not None else capture.model
    patches = patches_of(frame)
    announce_compiling()
    localize_gels(model, patches, seed=args.seed)  # once, so that no trial's time tells of the compiler
    world_from_camera = poses.inverse(frame.camera_from_world)
    turn = np.kron(np.eye(2), world_from_camera[:3, :3])
    within = None if args.sure_within is None else 1e-3 * args.sure_within
    trials = []
    for trial in range(args.trials):
        found = localize_gels(model, patches, seed=args.seed + trial, sure_within=within)
        modes = [
            {"pose": (world_from_camera @ m.pose).tolist(), "weight": m.weight, "cost": m.cost} for m in found.modes
        ]
        trials.append(
            {
                "pose": modes[0]["pose"],
                "index_mm": 1e3 * found.index,
                "time_s": found.time_s,
                "modes": len(modes),
                "verdict": found.verdict,
                "confidence": found.confidence,
                "sure_within_mm": 1e3 * found.sure_within,
                "covariance": (turn @ found.covariance @ turn.T).tolist(),
                "all_modes": modes,
            }
        )
    _show(trials, False)
    _show_best(trials, "the world", "world_from_object")
    touching = sum(len(patch) > 0 for patch in patches)
    content = {"method": "gels", "object": model.name, "contacts": touching, "trials": trials}
    write_json(args.json, content)
    return 1 if trials[-1]["verdict"] == "lost" else 0


def read_contacts(path: Path, frame: int | None = None) -> Contacts:
    """Contacts of a CSV (frame, sensor and normals may be absent), or of an OFF or PLY point list.

    Raises CaptureError for a file that is not there or is malformed, InputError for several frames and no choice.
    """
    import numpy as np

    from scenes.errors import CaptureError, InputError
    from scenes.files.formats import tables
    from scenes.files.problems import refuse
    from scenes.recordings.captures import contacts_of
    from scenes.recordings.frames import Contacts

    if not path.is_file():
        raise CaptureError(f"{path}: expected contacts (.csv, .off or .ply), found no file")
    if frame is not None and path.suffix.lower() != ".csv":
        raise InputError(f"--frame: expected contacts as .csv, which have frames, got {path}")
    if path.suffix.lower() == ".csv":
        rows = tables.read_table(path, tables.LOOSE_CONTACTS, refuse)
        frames = sorted(set(map(int, rows.frames())))
        if len(frames) > 1 and frame is None:
            raise InputError(f"{path}: expected contacts of one frame, got {len(frames)}: choose one with --frame")
        # of a file without contacts the last line of all says so
        if frame is not None and frames:
            if frame not in frames:
                raise InputError(f"{path}: expected a frame of {', '.join(map(str, frames))}, got {frame}")
            rows = rows.of_frame(frame)
        try:
            contacts = contacts_of(rows) if len(rows) else Contacts(np.zeros((0, 3)))
        except InputError as error:
            raise CaptureError(f"{path}: {error}") from error
    elif path.suffix.lower() == ".off":
        from scenes.files.formats.off import read_off

        data = read_off(path)
        contacts = Contacts(data.points, data.normals)
    elif path.suffix.lower() == ".ply":
        from scenes.files.formats.ply import read_cloud

        contacts = Contacts(read_cloud(path)[0])
    else:
        raise CaptureError(f"{path}: expected contacts in a file that ends in .csv, .off or .ply")
    if len(contacts) == 0:
        raise CaptureError(f"{path}: expected at least one contact, found none")
    return contacts


def _read_cloud(path: Path | None) -> Any:
    from scenes.files.formats.ply import read_cloud

    return None if path is None else read_cloud(path)[0]


def _some(contacts: Contacts, most: int | None, seed: int) -> Contacts:
    import numpy as np

    if most is None or most >= len(contacts):
        return contacts
    chosen = np.random.default_rng(seed).choice(len(contacts), size=most, replace=False)
    return contacts.take(np.sort(chosen))


def _by_touch(
    model: ObjectModel, used: Contacts, every: Contacts, method: str, seed: int, within: float | None
) -> dict[str, Any]:
    from touch.answers import contact_index
    from touch.localization import localize

    found = localize(model, used, seed=seed, method=method, sure_within=within)
    return {
        "pose": found.pose.tolist(),
        "index_mm": 1e3 * contact_index(model, every, found.pose),
        "time_s": found.time_s,
        "modes": len(found.modes),
        "verdict": found.verdict,
        "confidence": found.confidence,
        "sure_within_mm": 1e3 * found.sure_within,
        "covariance": found.covariance.tolist(),
        "notes": list(found.notes),
    }


def _by_both(
    model: ObjectModel,
    used: Contacts,
    every: Contacts,
    cloud: Any,
    seed: int,
    beliefs: Beliefs,
    within: float | None,
) -> dict[str, Any]:
    """The fused answer, and what each sense alone makes of the same data."""
    from fusion.estimation.estimate import estimate
    from fusion.truth.errors import Judge
    from scenes.recordings.frames import Frame

    frame, judged, judge = Frame(0, contacts=used, cloud=cloud), Frame(0, contacts=every, cloud=cloud), Judge(model)
    senses: dict[str, Any] = {}
    for name, use in (("vision", ("vision",)), ("touch", ("touch",)), ("fused", ("vision", "touch"))):
        answer = estimate(frame, model, use=use, seed=seed, beliefs=beliefs, sure_within=within)
        agreement = judge.agreement(judged, answer.pose)
        senses[name] = {
            "pose": answer.pose.tolist(),
            "index_mm": 1e3 * agreement.contacts,
            **agreement.to_json(),
            "time_s": answer.time_ms / 1e3,
            "modes": len(answer.modes),
            "verdict": answer.verdict,
            "confidence": answer.confidence,
            "sure_within_mm": 1e3 * answer.sure_within,
        }
    return {**senses["fused"], "senses": senses}


def _show_best(trials: list[dict[str, Any]], frame: str, name: str) -> None:
    """The pose of the trial whose index is the least, in words and as numbers."""
    best = min(range(len(trials)), key=lambda i: trials[i]["index_mm"])
    said, matrix = pose_lines(trials[best]["pose"])
    which = f", trial {best}" if len(trials) > 1 else ""
    say(f"object in {frame}{which}: {said}")
    say(f"{name} (m): {matrix}")


def _show(trials: list[dict[str, Any]], with_cloud: bool) -> None:
    if with_cloud:
        heads = ("trial", "sense", "cloud mm", "inliers", "contacts mm", "modes", "verdict", "sure", "time s")
        rows = [
            [
                str(trial),
                sense,
                number(found["cloud_mm"]),
                "–" if found["inlier_share"] is None else f"{100 * found['inlier_share']:.0f} %",
                number(found["contacts_mm"]),
                str(found["modes"]),
                found["verdict"],
                percent(found["confidence"]),
                number(found["time_s"], 3),
            ]
            for trial, result in enumerate(trials)
            for sense, found in result["senses"].items()
        ]
        show_table(heads, rows)
        return
    cells = [
        [
            *(str(i), number(t["index_mm"], 3), str(t["modes"]), t["verdict"], percent(t["confidence"])),
            number(t["time_s"], 3),
        ]
        for i, t in enumerate(trials)
    ]
    show_table(HEADS, cells)
    if len(trials) > 1:
        mean = sum(t["index_mm"] for t in trials) / len(trials)
        seconds = sum(t["time_s"] for t in trials) / len(trials)
        best = min(t["index_mm"] for t in trials)
        say(f"{len(trials)} trials: index mean {mean:.3f} mm, best {best:.3f} mm; time mean {seconds:.3f} s")
