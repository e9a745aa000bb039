"""Make a capture of a generated or scanned object, hidden behind a hand as much as asked."""

from __future__ import annotations

import argparse
from pathlib import Path

from fusion.cli.options import add_object, check_folder, names, positive, say, share, write_json
from fusion.results.runs import load_object
from scenes.synthesis.staging.pieces import PIECES
from scenes.words import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument("out", metavar="OUT", type=Path, help="folder to write; an older capture is replaced")
    add_object(parser, required=True)
    parser.add_argument("--frames", metavar="N", type=positive, default=1, help="how many (default 1)")
    parser.add_argument("--occlusion", metavar="F", type=share, help="hidden share (default 0.6; occluders none: 0)")
    parser.add_argument(
        "--hand",
        metavar="NAME",
        help="five-finger (default), gripper (two flat fingers), a URDF, or none: loose fingers",
    )
    parser.add_argument(
        "--touch", metavar="KINDS", type=names, default=("point",), help="point, wrench, array, gel, empty"
    )
    parser.add_argument("--taxels", metavar="LAYOUT", help="of arrays: fingertip (12, default), pad (3 x 8)")
    noises = (
        "none, clean, lab (default), harsh, lab-time-of-flight, lab-stereo;"
        " or a camera imitated from its optics: d435, d455, xtion, azure-kinect, l515"
    )
    parser.add_argument("--noise", metavar="NAME", default="lab", help=noises)
    hiders = "hand, fingers, object, neighbours (on a table), border or none; +clutter lets other things stand about"
    parser.add_argument("--occluders", metavar="KIND", help=hiders)
    pieces = "; ".join(f"{name}: {what}" for name, what in PIECES.items())
    parser.add_argument("--scene", metavar="A+B", help=f"what else is there, joined by +. {pieces}")
    errors = (
        "fat (1 mm), scaled (1 %%), scan (another one, bumps of some mm), bent, dented: the mesh is not quite"
        " the object's"
    )
    parser.add_argument("--mesh-error", metavar="NAME", help=errors)
    moves = (
        "carry, turn, slip, slide, regrasp, leave, close, shake, camera, pick or put: one grasp filmed;"
        " default: every frame another grasp and view"
    )
    parser.add_argument("--motion", metavar="KIND", help=moves)


def run(args: argparse.Namespace) -> int:
    """Write the capture."""
    from scenes.errors import InputError
    from scenes.recordings.writing import refuse_foreign_folder
    from scenes.synthesis.recording import synthesize

    refuse_foreign_folder(args.out)  # before the work, not after it
    check_folder(args.out)
    model, hand = load_object(args.object, args.unit), _grasping(args)
    if args.taxels is not None and "array" not in args.touch:
        raise InputError(f"--taxels: expected --touch array beside it, whose layout it is, got {','.join(args.touch)}")
    capture = synthesize(
        args.out,
        model,
        hand,
        args.frames,
        args.occlusion,
        args.touch,
        args.noise,
        args.seed,
        args.occluders,
        motion=args.motion,
        taxels=args.taxels or "fingertip",
        scene=args.scene,
        mesh_error=args.mesh_error,
    )
    contacts = [max(len(frame.contacts), len(frame.wrenches), len(frame.tactile), len(frame.gels)) for frame in capture]
    occlusion = capture.manifest.notes["occlusion"]
    asked = {"object": model.name, "occlusion": occlusion, "noise": args.noise, "seed": args.seed}
    write_json(args.json, {"capture": str(capture.path), "frames": len(capture), "contacts": contacts, **asked})
    felt = f"{min(contacts)}" if min(contacts) == max(contacts) else f"{min(contacts)} to {max(contacts)}"
    hidden = f"{100 * occlusion:.0f} % hidden"
    felt += " contact" if felt == "1" else " contacts"
    say(f"{capture.path}: {counted(len(capture), 'frame')} of {model.name}, {hidden}, {felt}")
    return 0


def _grasping(args: argparse.Namespace):  # type: ignore[no-untyped-def]  # as load_hand
    """The hand that hides the object, None where something else does; InputError where one is asked for in vain."""
    from scenes.errors import InputError

    kind = (args.occluders or "hand").partition("+")[0]
    if kind == "hand":
        return load_hand(args.hand or "five-finger")
    if args.hand not in (None, "none"):
        raise InputError(f"--hand: expected occluders hand, which it is, got {args.hand} with {args.occluders}")
    return None


def load_hand(name: str):  # type: ignore[no-untyped-def]  # naming Hand here would import it for --help
    """A Hand by name or URDF, None for "none"; raises InputError for anything else."""
    from scenes.errors import InputError
    from scenes.robot.hands import Hand
    from scenes.synthesis.gripper import parallel_gripper
    from scenes.synthesis.hands import five_finger_hand

    if name == "gripper":
        return parallel_gripper()
    if name.replace("_", "-") == "five-finger":
        return five_finger_hand()
    if name == "none":
        return None
    if not Path(name).is_file():
        raise InputError(f"hand: expected five-finger, gripper, none or a URDF file, got {name!r}")
    return Hand.load(name)
