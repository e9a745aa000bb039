"""Trajectories as TUM's RGB-D benchmark writes them: `timestamp tx ty tz qx qy qz qw`, seconds and metres.

Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012. Here each row is camera_from_object.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError
from scenes.files.whole import replace_file
from scenes.geometry import poses

Array = NDArray[np.float64]

HEADER = "# timestamp tx ty tz qx qy qz qw (camera_from_object, s, m)"
NANOSECONDS = 1_000_000_000


def write_tum(path: Path, trajectory: Mapping[int, Array], stamps_ns: Mapping[int, int]) -> None:
    """Write camera_from_object (4, 4) by frame, in the order of their stamps (whole nanoseconds, kept to the last)."""
    rows = [HEADER]
    for frame in sorted(trajectory, key=lambda number: stamps_ns[number]):
        seconds, rest = divmod(stamps_ns[frame], NANOSECONDS)
        w, x, y, z = poses.to_quaternion(trajectory[frame][:3, :3]).tolist()
        numbers = [*trajectory[frame][:3, 3].tolist(), x, y, z, w]
        rows.append(f"{seconds}.{rest:09d} " + " ".join(map(repr, numbers)))
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, "\n".join([*rows, ""]).encode("ascii"))


def read_tum(path: Path) -> dict[int, Array]:
    """camera_from_object (4, 4) by stamp in nanoseconds; raises CaptureError with the line for anything else."""
    found = {}
    for number, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            whole, _, rest = words[0].partition(".")
            stamp = int(whole) * NANOSECONDS + int((rest + "000000000")[:9])
            x, y, z, qx, qy, qz, qw = (float(word) for word in words[1:])
            found[stamp] = poses.check_pose(poses.make_pose(poses.from_quaternion([qw, qx, qy, qz]), [x, y, z]))
        except ValueError as error:
            raise CaptureError(f"{path}, line {number}: expected a time and 7 numbers, got {line[:60]!r}") from error
    return found
