"""Calibrate a gel sensor's colours from presses of a ball of known radius."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.cli.options import check_target, positive_number, say, write_json

if TYPE_CHECKING:
    from scenes.robot.gels import Gel

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp")
BACKGROUND = "background"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's own arguments."""
    parser.add_argument(
        "images",
        metavar="IMAGES",
        type=Path,
        nargs="+",
        help="presses of the ball, or a folder of them and background.png",
    )
    parser.add_argument("--ball", metavar="MM", type=positive_number, required=True, help="the ball's radius")
    parser.add_argument("--background", metavar="FILE", type=Path, help="the untouched skin's image")
    parser.add_argument("--sensors", metavar="FILE", type=Path, help="sensors.json with the gel; --sensor of several")
    parser.add_argument("--sensor", metavar="NAME", help="which gel of sensors.json")
    parser.add_argument(
        "--mm-per-pixel", metavar="MM", type=positive_number, help="of a flat gel, instead of --sensors"
    )
    parser.add_argument("--digit", action="store_true", help="a DIGIT, instead of --sensors")
    parser.add_argument(
        "--like",
        metavar="FILE",
        type=Path,
        help="a calibration of another such sensor: presses that look like a ball of another radius there are refused",
    )
    parser.add_argument(
        "--with",
        dest="others",
        metavar="FILE",
        type=Path,
        action="append",
        default=[],
        help="calibrations of more such sensors: what is written is the mean, for any sensor of the kind; repeat",
    )
    parser.add_argument(
        "-o", "--out", metavar="FILE", type=Path, default=Path("gel_calibration.json"), help="file to write"
    )


def run(args: argparse.Namespace) -> int:
    """Write the calibration; named under "calibration" of the gel in sensors.json it is used."""
    from dataclasses import replace

    import numpy as np

    from scenes.errors import InputError
    from scenes.files.formats import images
    from scenes.files.whole import replace_file
    from scenes.formats.conversion import located
    from touch.gels.skin.calibration import DOUBTED, calibrate, largest_ball
    from touch.gels.skin.photometry import mean_of, read_photometry

    check_target(args.out)
    if args.sensor is not None and args.sensors is None:
        raise InputError(f"--sensor: expected --sensors FILE beside it, whose gel it is, got {args.sensor} alone")
    paths = _images(args.images)
    background = args.background or next((p for p in paths if p.stem == BACKGROUND), None)
    presses = [path for path in paths if path != background and path.stem != BACKGROUND]
    if not presses:
        raise InputError(f"calibrate-gel: expected images of presses ({', '.join(ENDINGS)}), found none")
    gel = _gel(args, None if background is None else located(background, images.read_rgb))
    if background is not None:
        gel = replace(gel, background=located(background, images.read_rgb))
        if gel.background is not None and gel.background.shape[:2] != (gel.height, gel.width):
            got = f"{gel.background.shape[1]}x{gel.background.shape[0]}"
            raise InputError(
                f"{background}: expected an image of {gel.width}x{gel.height} pixels as the gel's, got {got}"
            )
    if gel.background is None:
        raise InputError("calibrate-gel: expected the untouched skin: --background FILE or background.png, found none")
    shown = [located(path, images.read_rgb) for path in presses]
    like = None if args.like is None else read_photometry(args.like)
    found = calibrate(shown, gel, 1e-3 * args.ball, [str(path) for path in presses], like)
    mean = mean_of([found, *(read_photometry(path) for path in args.others)])
    content = mean.to_json()
    replace_file(args.out, (json.dumps(content) + "\n").encode())
    depths = [round(1e3 * depth, 3) for depth in found.depths]
    most = largest_ball(found)
    write_json(
        args.json,
        {"calibration": str(args.out), "presses": found.presses, "misfit": found.misfit, "depths_mm": depths}
        | {"sensors": mean.sensors, "light": found.light, "largest_ball_mm": 1e3 * most if np.isfinite(most) else None},
    )
    pressed = f"{found.presses} press{'' if found.presses == 1 else 'es'} of a {args.ball:g} mm ball"
    say(f"{pressed}; {100 * found.misfit:.0f} % of their slopes unexplained")
    told = "" if like is not None else " (--like FILE, another finger's calibration, tells more)"
    say(f"if the ball has that radius, it was pressed {min(depths):.2g} to {max(depths):.2g} mm deep{told}")
    said = f"by its brightness the ball's radius is {1e3 * most:.2g} mm or less"
    if not np.isfinite(most):
        say("its brightness says nothing of the ball's radius")
    elif found.light > DOUBTED:
        say(f"{said}: {args.ball:g} mm is right only if no light but the lamps' reaches the skin")
    else:
        say(f"{said}: lamps then have {100 * found.light:.0f} % of the light on the skin")
    say(f"wrote {args.out}" + (f", the mean of {mean.sensors} sensors" if mean.sensors > 1 else ""))
    return 0


def _images(given: list[Path]) -> list[Path]:
    from scenes.errors import InputError

    out = []
    for path in given:
        if path.is_dir():
            out += sorted(p for p in path.iterdir() if p.suffix.lower() in ENDINGS)
        elif path.is_file():
            out.append(path)
        else:
            raise InputError(f"{path}: expected an image or a folder of images, found nothing")
    return out


def _gel(args: argparse.Namespace, background) -> Gel:  # type: ignore[no-untyped-def]  # numpy only where it is used
    """The sensor by sensors.json, as a DIGIT, or flat with --mm-per-pixel."""
    import numpy as np

    from scenes.errors import InputError, unknown
    from scenes.robot.digit import digit_gel
    from scenes.robot.gels import Gel
    from scenes.robot.sensors import read_sensors

    if sum([args.sensors is not None, args.mm_per_pixel is not None, args.digit]) != 1:
        raise InputError("calibrate-gel: expected one of --sensors FILE, --mm-per-pixel MM and --digit")
    if args.sensors is not None:
        gels = {name: sensor.gel for name, sensor in read_sensors(args.sensors).items() if sensor.gel is not None}
        if args.sensor is None and len(gels) != 1:
            raise InputError(f"{args.sensors}: expected one gel, got {', '.join(gels) or 'none'}: choose with --sensor")
        name = args.sensor or next(iter(gels))
        if name not in gels:
            raise unknown("sensor", name, gels)
        return gels[name]
    if background is None:
        raise InputError("calibrate-gel: expected the untouched skin: --background FILE or background.png, found none")
    height, width = background.shape[:2]
    if args.digit:
        return digit_gel((width, height))
    return Gel(width, height, np.zeros((height, width)), 1e-3 * args.mm_per_pixel)
