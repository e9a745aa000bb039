"""Folders as others record them: a YCBInEOAT sequence, colour and depth images side by side."""

import cv2
import numpy as np

from scenes.geometry import poses

SIZE = (48, 64)
K = np.array([[80.0, 0, 31.5], [0, 82.0, 23.5], [0, 0, 1]])


def sequence(folder, names, poses_named=False, masks=None):
    """A YCBInEOAT sequence; returns its counts and truths."""
    rng = np.random.default_rng(0)
    for part in ("rgb", "depth", "annotated_poses", *([masks] if masks else [])):
        (folder / part).mkdir(parents=True)
    np.savetxt(folder / "cam_K.txt", K)
    counts, truths = [], []
    for i, name in enumerate(names):
        counts.append(rng.integers(0, 3000, SIZE).astype(np.uint16))
        truths.append(poses.make_pose(poses.random_rotations(1, rng)[0], [0.0, 0.1, 0.6]))
        cv2.imwrite(str(folder / "depth" / f"{name}.png"), counts[-1])
        cv2.imwrite(str(folder / "rgb" / f"{name}.png"), np.full((*SIZE, 3), i, np.uint8))
        np.savetxt(folder / "annotated_poses" / f"{name if poses_named else f'{i:07d}'}.txt", truths[-1])
        if masks:
            cv2.imwrite(str(folder / masks / f"{name}.png"), np.where(counts[-1] > 1500, 255, 0).astype(np.uint8))
    return counts, truths


def images(folder, names=("a", "b", "c")):
    (folder / "depth").mkdir(parents=True)
    (folder / "rgb").mkdir()
    for i, name in enumerate(names):
        cv2.imwrite(str(folder / "depth" / f"{name}.png"), np.full(SIZE, 400 + i, np.uint16))
        cv2.imwrite(str(folder / "rgb" / f"{name}.png"), np.full((*SIZE, 3), i, np.uint8))
