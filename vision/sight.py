"""What poses cost for what the camera saw past them: a compiled look-up of surface samples in the depth image."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from scenes._numba import LENT
from scenes.geometry.cameras import FARTHEST_READING
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from scenes.threads import run_chunks

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SightSettings:
    """What seeing past an object costs a pose. Values tuned on generated captures."""

    # Surface samples that are looked up, and how many independent cells they amount to.
    samples: int = 400
    cells: float = 40.0
    # Samples looked up when many poses are only sifted, and how many poses are many.
    samples_sifting: int = 130
    many: int = 500
    # Least cosine of the incidence of a sample that is looked up: flatter ones are a pixel from the outline, where a
    # camera reads what is behind.
    least_cosine: float = 0.3
    # What one cell costs (negative log likelihood) when the camera sees past it: clutter in front is common, a hole in
    # the object is a flying pixel at most.
    cost_past: float = 7.0
    # Something unknown in front of a cell is less likely than the object's own surface there.
    cost_hidden: float = 0.3
    # Of a right pose at most this share is seen past (noise at the outline): it costs nothing.
    free_share: float = 0.02


# Samples of a block, and of what a processor does at once; where the columns of a block begin: point and normal; and
# those of the working room: nearest and farthest depth (m) that agrees.
LENGTH, LANES = 64, 8
PX, PY, PZ, NX, NY, NZ = (k * LENGTH for k in range(6))
BLOCK = 6 * LENGTH
NEARER, FARTHER = 0, LENGTH
ROOM = 2 * LENGTH


def blocks_of(points: Array, normals: Array) -> Array:
    """(k, BLOCK) samples (n, 3) of a surface for the kernel; those that fill up the last block face nowhere."""
    out = np.zeros((-(-len(points) // LENGTH) * LENGTH, 6))
    out[: len(points), :3], out[: len(points), 3:] = points, normals
    return np.ascontiguousarray(out.reshape(-1, LENGTH, 6).transpose(0, 2, 1)).reshape(-1, BLOCK)


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def _look_up(block, count, camera, least_cosine, pose, noise, room, pixels):
    """Fill in the room the depths that agree with `count` samples of a block, several at a time, and pixels (LENGTH,)
    with the one of each, -1 for those that face away or are outside of the image. pose: rotation and translation.
    """
    fx, fy, cx, cy, height, width = camera
    r, t = pose
    floor, nearest, growth, bias, scale, slack = noise
    r00, r01, r02, r10, r11, r12 = r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2]
    r20, r21, r22, t0, t1, t2 = r[2, 0], r[2, 1], r[2, 2], t[0], t[1], t[2]
    flattest = least_cosine * least_cosine
    # the camera in the object's frame: half of the surface looks away from it, and is not turned into its own
    ox = r00 * t0 + r10 * t1 + r20 * t2
    oy = r01 * t0 + r11 * t1 + r21 * t2
    oz = r02 * t0 + r12 * t1 + r22 * t2
    high, wide = float(height), float(width)
    for k in range(count):
        px, py, pz = block[PX + k], block[PY + k], block[PZ + k]
        x, y, z = px + ox, py + oy, pz + oz
        away = block[NX + k] * x + block[NY + k] * y + block[NZ + k] * z
        faces = (away < 0.0) & (away * away > flattest * (x * x + y * y + z * z))
        z = r20 * px + r21 * py + r22 * pz + t2
        x = r00 * px + r01 * py + r02 * pz + t0
        y = r10 * px + r11 * py + r12 * pz + t1
        u, v = np.floor(fx * x / z + cx + 0.5), np.floor(fy * y / z + cy + 0.5)
        inside = faces & (z > 1e-3) & (u >= 0.0) & (v >= 0.0) & (u < wide) & (v < high)
        pixels[k] = np.int64((v * wide + u) if inside else -1.0)
        independent = floor + growth * (z - nearest) * (z - nearest)
        tolerance = 2.5 * np.sqrt(independent * independent + bias * bias + scale * scale * z * z) + slack
        room[NEARER + k], room[FARTHER + k] = z - tolerance, z + tolerance


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def _sight_shares(depth, camera, blocks, count, least_cosine, rotations, translations, noise, work, out):
    """Fill out (n, 2): shares, of the samples facing the camera inside the image, seen past and hidden.

    depth (h w,) m; camera: fx, fy, cx, cy, h, w; blocks (k, BLOCK): see `blocks_of`, of so many samples. noise: floor,
    depth it grows from, growth, bias, scale of depth, and what is added to the tolerance (m). work: room (ROOM,), and
    pixels and places (2, LENGTH).
    """
    room, lists = work
    pixels, places = lists[0], lists[1]
    for n in range(rotations.shape[0]):
        facing = past = hidden = 0
        for b in range((count + LENGTH - 1) // LENGTH):
            left = min(count - b * LENGTH, LENGTH)
            pose = rotations[n], translations[n]
            whole = (left + LANES - 1) // LANES * LANES
            _look_up(blocks[b], whole, camera, least_cosine, pose, noise, room, pixels)
            # listed without a branch: which of them face the camera, no processor guesses
            listed = 0
            for k in range(left):
                places[listed] = k
                listed += pixels[k] >= 0
            facing += listed
            for i in range(listed):
                k = places[i]
                seen = depth[pixels[k]]
                past += (seen > room[FARTHER + k]) & (seen < FARTHEST_READING)
                hidden += (seen > 0.0) & (seen < room[NEARER + k])
        out[n, 0] = past / facing if facing > 0 else 0.0
        out[n, 1] = hidden / facing if facing > 0 else 1.0


class Sight:
    """What poses cost for what the camera saw past them, or for what must be hiding them: microseconds a pose.

    A sample of the surface that lies in front of what its pixel saw contradicts the image, whether or not another part
    of the object hides it (that part is then even farther in front), so no rendering is needed.
    """

    def __init__(
        self,
        frame: Frame,
        model: ObjectModel,
        depth_model: DepthModel | None = None,
        settings: SightSettings | None = None,
    ) -> None:
        """Frame with or without a depth image; without one every pose costs nothing."""
        self._camera = frame.camera
        self._depth = (
            None if frame.depth is None or frame.camera is None else np.ascontiguousarray(frame.depth, np.float32)
        )
        self._model = depth_model or DepthModel()
        self.settings = settings or SightSettings()
        self._blocks = blocks_of(*model.sample_surface(self.settings.samples))

    def costs(self, candidates: Array, slack: float = 0.0) -> Array:
        """(n,) nats for poses (n, 4, 4) camera_from_object; slack (m) is added to the tolerance on depth."""
        out = np.zeros((len(candidates), 2))
        if self._depth is None or self._camera is None:
            return out[:, 0]
        c, m, s = self._camera, self._model, self.settings
        # when they are many, fewer samples: they were drawn at random, the first are as even as all
        count = min(s.samples_sifting, s.samples) if len(candidates) > s.many else s.samples
        rotations = np.ascontiguousarray(candidates[:, :3, :3])
        translations = np.ascontiguousarray(candidates[:, :3, 3])
        camera = c.fx, c.fy, c.cx, c.cy, *self._depth.shape
        noise = (m.axial_floor, m.axial_from, m.axial_growth, m.bias_sigma, m.scale_sigma, slack)
        view = self._depth.reshape(-1), camera, self._blocks, count, s.least_cosine

        def work(part: slice) -> None:
            rooms = np.zeros(ROOM), np.zeros((2, LENGTH), dtype=np.int64)
            _sight_shares(*view, rotations[part], translations[part], noise, rooms, out[part])

        run_chunks(work, len(candidates), smallest=20_000 // count)
        return s.cells * (s.cost_past * np.maximum(out[:, 0] - s.free_share, 0.0) + s.cost_hidden * out[:, 1])
