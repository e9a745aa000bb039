"""The compiled glimpse of poses: a few points of an object's aspects against a small image of what may be the object.

Thousands of poses are asked; what is hopeless among them is told by two dozen lookups each. Camera frame, metres,
pixels.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT
from scenes.geometry.cameras import FARTHEST_READING
from vision.picture.aspect_kernels import aspect_of
from vision.picture.kernels import NEAREST, is_by_hand, is_on_planes, smooth_sigma

# Added to a depth (m) to say that what is read there is not the object, and on the other side of zero that it is a
# table's or wall's: farther than any camera reads.
OTHER = 1000.0


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def draw_small(image, camera, noise, limits, step, small):
    """Fill small (ceil(h / step), ceil(w / step)) with what is read in the middle of every so many pixels: the depth
    (m) of what may be the object, OTHER more if it is the hand's or outside of the mask, its negative if it is a
    table's or wall's, 0 for none. All else: of vision.picture.kernels.compare_pixels.
    """
    depth, mask, hand_low, hand_high, planes = image
    _, _, _, _, hand_step, hand_margin, plane_margin, plane_sigmas = limits
    height, width = depth.shape
    for j in range(small.shape[0]):
        row = min(j * step + step // 2, height - 1)
        for i in range(small.shape[1]):
            column = min(i * step + step // 2, width - 1)
            reading = np.float64(depth[row, column])
            small[j, i] = 0.0
            if not 0.0 < reading < FARTHEST_READING:
                continue
            if is_on_planes(planes, camera, noise, column, row, reading, plane_margin, plane_sigmas):
                small[j, i] = -reading
                continue
            other = mask.shape[0] > 0 and not mask[row, column]
            if not other:
                other = is_by_hand(hand_low, hand_high, column // hand_step, row // hand_step, reading, hand_margin)
            small[j, i] = reading + OTHER if other else reading


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def glimpse_aspects(points, count, cells, centroid, poses, small, step, camera, noise, sigmas, shares):
    """What few of the points that the object shows at poses (n, 4, 4) are: fills shares (n, 2), of them that are seen,
    each as well as it agrees, and that are seen past. Points behind the camera or outside of the image are neither.

    points (k, m, 3), count (k,): of vision.picture.aspects.Glimpses, by 6 cells^2 directions around centroid (3,).
    small: of draw_small, at every `step` pixels. camera, noise: of compare_pixels; sigmas: of depth within which a
    point agrees, as at the centroid's depth.

    A pose takes as long as its points take to be fetched and its branches to be guessed: the points of one lie side by
    side, and what can be told by arithmetic is.
    """
    fx, fy, cx, cy = camera[0] / step, camera[1] / step, camera[2] / step, camera[3] / step
    width, height = camera[4] / step, camera[5] / step
    for n in range(poses.shape[0]):
        r, t = poses[n], poses[n, :3, 3]
        which, z = aspect_of(cells, centroid, r, t)
        own = smooth_sigma(noise, z)
        tolerance = sigmas * math.sqrt(own * own + noise[4] * noise[4] * z * z)
        each = 1.0 / tolerance
        few = count[which]
        third = few // 3 if few % 3 == 0 else -1
        seen, past = 0.0, 0
        for m in range(few):
            # all over the outline from the first on; where most of a third are seen past, no more need be known
            if m == third and 2 * past > m:
                seen, past = 3.0 * seen, 3 * past
                break
            px, py, pz = (
                np.float64(points[which, m, 0]),
                np.float64(points[which, m, 1]),
                np.float64(points[which, m, 2]),
            )
            z = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz + t[2]
            x = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz + t[0]
            y = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz + t[1]
            inverse = 1.0 / z
            u, v = fx * x * inverse + cx, fy * y * inverse + cy
            # not true of NaN either
            if not (z > NEAREST and 0.0 <= u < width and 0.0 <= v < height):
                continue
            # places that cannot be below 0: nobody counts them from the end
            reading = np.float64(small[np.uint64(v), np.uint64(u)])
            plane, other = reading < 0.0, reading > OTHER
            off = abs(reading) - (OTHER if other else 0.0) - z
            past += (reading != 0.0) & ((off > tolerance) | (plane & (off < -tolerance)))
            agrees = max(1.0 - (off * each) * (off * each), 0.0)
            seen += 0.0 if plane | other | (reading == 0.0) else agrees
        shares[n, 0], shares[n, 1] = seen / max(few, 1), past / max(few, 1)
