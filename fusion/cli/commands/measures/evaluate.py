"""Measure a poses.csv against a capture's ground truth: ADD, ADD-S, AUC, MSSD, MSPD, VSD, NEES, recall."""

from __future__ import annotations

import argparse
from pathlib import Path

from fusion.cli.options import add_object, add_trust, number, show_table, warn, write_json
from fusion.results.runs import load_object

FRAME_HEADS = (
    ("frame", "frame", 0),
    ("add_mm", "ADD mm", 2),
    ("add_s_mm", "ADD-S mm", 2),
    ("mssd_mm", "MSSD mm", 2),
    ("mspd_px", "MSPD px", 2),
    ("vsd", "VSD", 3),
    ("rotation_deg", "rot °", 2),
    ("translation_mm", "trans mm", 2),
    ("nees", "NEES", 1),
    ("time_s", "time s", 3),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    parser.add_argument("poses", metavar="POSES.csv", type=Path, help="estimated poses, BOP's format")
    parser.add_argument("capture", metavar="CAPTURE", type=Path, help="folder of the capture with ground truth")
    parser.add_argument(
        "--result", metavar="FILE", type=Path, help="covariances (default: result.json beside the poses)"
    )
    add_object(parser, what="instead of the capture's object")


def run(args: argparse.Namespace) -> int:
    """Print errors by frame (up to 20) and over all."""
    from fusion.results.files import read_covariances
    from fusion.truth.evaluate import evaluate
    from scenes.recordings.bop import read_poses
    from scenes.recordings.captures import read_capture
    from scenes.recordings.pose_rows import rows_of
    from scenes.words import counted

    rows = read_poses(args.poses)
    beside = args.poses.with_name("result.json")
    source = args.result or (beside if beside.is_file() else None)
    covariances = read_covariances(source) if source is not None else None
    capture = read_capture(args.capture, args.trust_paths)
    model = load_object(args.object, args.unit) if args.object else None
    own = rows_of(rows, capture, str(args.poses))
    if len(own) < len(rows):
        warn(f"{args.poses}: {counted(len(rows) - len(own), 'row')} of other objects or scenes passed over")
    found = evaluate(own, capture, covariances, model=model)
    if len(found["frames"]) <= 20:
        cells = [[number(float(f[key]), digits) for key, _, digits in FRAME_HEADS] for f in found["frames"]]
        show_table([head for _, head, _ in FRAME_HEADS], cells)
    show_table(
        ("over all frames", ""),
        [[name.replace("_", " "), number(value, 3)] for name, value in found["summary"].items()],
    )
    write_json(args.json, found)
    return 0
