"""Make a closed mesh of an object that has no model, from views of it in one capture or several."""

from __future__ import annotations

import argparse
from pathlib import Path

from fusion.cli.options import add_trust, check_target, number, positive_number, say, show_table, write_json
from scenes.words import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    add_trust(parser)
    parser.add_argument("captures", metavar="CAPTURE", type=Path, nargs="+", help="folders of captures")
    parser.add_argument(
        "-o", "--output", metavar="MESH.ply", type=Path, required=True, help="the mesh to write, metres"
    )
    parser.add_argument(
        "--poses",
        metavar="SOURCE|FILE",
        action="append",
        help="of the views: hand, truth, world, or a poses.csv (once a capture); default: the hand's if there is one",
    )
    parser.add_argument("--shape", choices=("mesh", "superquadric"), default="mesh", help="default mesh")
    parser.add_argument(
        "--size", metavar="MM", type=positive_number, default=300.0, help="the object's largest extent (default 300)"
    )
    parser.add_argument(
        "--frame", choices=("own", "truth"), default="own", help="axes of the mesh: its own, or the captures' model's"
    )


def run(args: argparse.Namespace) -> int:
    """Exit code 0: a model whose error is large is still what was seen."""
    from fusion.modelling import SOURCES, ModelSettings, ShapeError, compare_shapes, make_model, model_json, write_model
    from scenes.errors import InputError
    from scenes.recordings.captures import read_capture
    from vision.modelling import ModelViewSettings

    if args.output.suffix.lower() != ".ply":
        raise InputError(f"output: expected a name that ends in .ply, got {args.output}")
    check_target(args.output)
    given = args.poses or ["auto"]
    named = len(given) == 1 and given[0] in SOURCES
    for file in [] if named else given:
        if not Path(file).is_file():
            raise InputError(f"poses: expected {', '.join(SOURCES)} or a poses.csv, got {file!r}")
    settings = ModelSettings(shape=args.shape, views=ModelViewSettings(size=1e-3 * args.size))
    captures = [read_capture(path, args.trust_paths) for path in args.captures]
    made = make_model(captures, given[0] if named else "file", [] if named else given, settings)
    errors: dict[str, ShapeError] = {}
    pose = None
    if made.true_from_model is not None:
        errors, pose = compare_shapes(made, captures[0].model)
    if args.frame == "truth" and pose is None:
        raise InputError("frame: expected captures with ground truth for --frame truth, got none")
    write_model(args.output, made.result, pose if args.frame == "truth" else None)
    content = {**model_json(made, errors, settings), "captures": [capture.name for capture in captures]}
    write_json(args.json, content)
    source = {"hand": "the hand", "truth": "the ground truth", "world": "an object at rest", "file": "a file"}
    made_of = f"{counted(content['faces'], 'triangle')} from {counted(made.views, 'view')}"
    say(
        f"{args.output}: {made_of}, poses of {source[made.source]};"
        f" {100 * content['observed_share']:.0f} % of the vertices were seen, {content['diameter_mm']:.0f} mm across"
    )
    if errors:
        heads = ("distance", "part", "mean mm", "95 % mm", "of the surface")
        words = {"model": "model to true", "true": "true to model"}
        rows = [
            (words[name.split("_")[0]], name.split("_")[-1], number(1e3 * e.mean), number(1e3 * e.p95), _share(e.share))
            for name, e in errors.items()
        ]
        show_table(heads, rows)
    return 0


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"
