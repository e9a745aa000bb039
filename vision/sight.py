"""What poses cost for what the camera saw past them: a compiled look-up of surface samples in the depth image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from scenes._numba import LENT
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


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def _sight_shares(
    depth,
    fx,
    fy,
    cx,
    cy,
    points,
    normals,
    least_cosine,
    rotations,
    translations,
    floor,
    nearest,
    growth,
    bias,
    scale,
    slack,
    out,
):
    """Fill out (n, 2): shares, of the samples facing the camera inside the image, seen past and hidden."""
    height, width = depth.shape
    flattest = least_cosine * least_cosine
    for n in range(rotations.shape[0]):
        r, t = rotations[n], translations[n]
        # the camera in the object's frame: half of the surface looks away from it, and is not turned into its own
        ox = r[0, 0] * t[0] + r[1, 0] * t[1] + r[2, 0] * t[2]
        oy = r[0, 1] * t[0] + r[1, 1] * t[1] + r[2, 1] * t[2]
        oz = r[0, 2] * t[0] + r[1, 2] * t[1] + r[2, 2] * t[2]
        facing = 0
        past = 0
        hidden = 0
        for k in range(points.shape[0]):
            px, py, pz = points[k, 0], points[k, 1], points[k, 2]
            x, y, z = px + ox, py + oy, pz + oz
            away = normals[k, 0] * x + normals[k, 1] * y + normals[k, 2] * z
            if away >= 0.0 or away * away <= flattest * (x * x + y * y + z * z):
                continue
            z = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz + t[2]
            if z <= 1e-3:
                continue
            x = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz + t[0]
            y = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz + t[1]
            u = math.floor(fx * x / z + cx + 0.5)
            v = math.floor(fy * y / z + cy + 0.5)
            if u < 0 or v < 0 or u >= width or v >= height:
                continue
            facing += 1
            seen = depth[v, u]
            if not seen > 0.0:
                continue
            independent = floor + growth * (z - nearest) * (z - nearest)
            tolerance = 2.5 * math.sqrt(independent * independent + bias * bias + scale * scale * z * z) + slack
            if seen > z + tolerance:
                past += 1
            elif seen < z - tolerance:
                hidden += 1
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
        self._points, self._normals = model.sample_surface(self.settings.samples)

    def costs(self, candidates: Array, slack: float = 0.0) -> Array:
        """(n,) nats for poses (n, 4, 4) camera_from_object; slack (m) is added to the tolerance on depth."""
        out = np.zeros((len(candidates), 2))
        if self._depth is None or self._camera is None:
            return out[:, 0]
        c, m, s = self._camera, self._model, self.settings
        points, normals = self._points, self._normals
        if len(candidates) > s.many:  # they were drawn at random: the first are as even as all
            points, normals = points[: s.samples_sifting], normals[: s.samples_sifting]
        rotations = np.ascontiguousarray(candidates[:, :3, :3])
        translations = np.ascontiguousarray(candidates[:, :3, 3])
        view = (self._depth, c.fx, c.fy, c.cx, c.cy, points, normals, s.least_cosine)
        noise = (m.axial_floor, m.axial_from, m.axial_growth, m.bias_sigma, m.scale_sigma, slack)

        def work(part: slice) -> None:
            _sight_shares(*view, rotations[part], translations[part], *noise, out[part])

        run_chunks(work, len(candidates), smallest=20_000 // len(points))
        return s.cells * (s.cost_past * np.maximum(out[:, 0] - s.free_share, 0.0) + s.cost_hidden * out[:, 1])
