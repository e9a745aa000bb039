"""The compiled predicted image: rays over the outline of each pose, what each of them is, and what they add up to.

One pass over the rays of many poses, without arrays between the steps; the twin in plain NumPy is in the tests. Camera
frame, metres, pixels.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT
from scenes.geometry.cameras import FARTHEST_READING
from vision.picture.columns import (
    AGREE,
    BEHIND,
    BEHIND_HAND,
    BY_HAND,
    DARK,
    ENDS,
    HIDDEN,
    HIT,
    HITS,
    NEAR,
    OUTLINE,
    PAST,
    READ,
    SCATTER,
    SEEN,
    SIDES,
    UNREAD,
    WITHIN,
)
from vision.picture.scoring_kernels import scatter_of

# Nearer than this (m) before the camera nothing is projected.
NEAREST = 1e-3


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def spread(depth, least, most):
    """Lower least (h, w) and raise most (h, w), +inf and -inf before, to the least and the largest of depth (h, w) at
    and beside each pixel; inf there is nothing.
    """
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if z == math.inf:
                continue
            for j in range(max(v - 1, 0), min(v + 2, height)):
                for i in range(max(u - 1, 0), min(u + 2, width)):
                    least[j, i] = min(least[j, i], z)
                    most[j, i] = max(most[j, i], z)


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def outline_rays(points, outer, poses, camera, middle, slender, u, v, step, places, rays, index, inside):
    """Pixels u, v (n, side^2) of a grid over the box of each pose's outline; fills rays and index, and returns how many
    rays.

    The box is upright; along the outline's own axes where that holds less than the share `slender` of the upright one:
    of a stick that lies aslant in the image hardly a ray would meet it.
    points (m, 3): of the surface, object frame, the first `outer` of which bound all of them in every view. poses
    (n, 4, 4): camera_from_object. camera: fx, fy, cx, cy, width, height. middle (3,): what the ray caster takes off its
    points. step (n, 4): pixels u, v from a ray to the next of its row, and to that in the next row. places (m, 2): to
    work in. rays (n side^2, 6): origin and direction with z = 1, object frame about the middle, of the pixels in the
    image; index: where among all they belong. inside (n,): share of the points that project into the image.
    """
    fx, fy, cx, cy, width, height = camera
    side = int(np.rint(math.sqrt(u.shape[1])))
    count = 0
    for n in range(poses.shape[0]):
        r, t = poses[n], poses[n, :3, 3]
        ahead = True
        within = known = 0
        for k in range(points.shape[0]):
            if k == outer and within == k and ahead:
                # all of them are in the image, and so is what they bound
                within = points.shape[0]
                break
            px, py, pz = points[k, 0], points[k, 1], points[k, 2]
            x = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz + t[0]
            y = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz + t[1]
            z = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz + t[2]
            if not z > NEAREST:
                ahead = False
                z = 1.0
            a, b = fx * x / z + cx, fy * y / z + cy
            within += 0.0 <= a < width and 0.0 <= b < height
            places[k, 0], places[k, 1] = a, b
            known = k + 1
        inside[n] = within / points.shape[0] if ahead else 0.0
        low_u, low_v, long_u, long_v, cosine, sine = outline_box(places[:known], width, slender if ahead else 0.0)
        along, down = long_u / side, long_v / side
        step[n, 0], step[n, 1], step[n, 2], step[n, 3] = cosine * along, sine * along, -sine * down, cosine * down
        for j in range(side):
            b = low_v + (j + 0.5) / side * long_v
            for i in range(side):
                a = low_u + (i + 0.5) / side * long_u
                u[n, j * side + i] = int(np.rint(cosine * a - sine * b))
                v[n, j * side + i] = int(np.rint(sine * a + cosine * b))
        if not ahead:
            continue
        ox = -(r[0, 0] * t[0] + r[1, 0] * t[1] + r[2, 0] * t[2]) - middle[0]
        oy = -(r[0, 1] * t[0] + r[1, 1] * t[1] + r[2, 1] * t[2]) - middle[1]
        oz = -(r[0, 2] * t[0] + r[1, 2] * t[1] + r[2, 2] * t[2]) - middle[2]
        for k in range(side * side):
            if u[n, k] < 0 or u[n, k] >= width or v[n, k] < 0 or v[n, k] >= height:
                continue
            x, y = (u[n, k] - cx) / fx, (v[n, k] - cy) / fy
            rays[count, 0], rays[count, 1], rays[count, 2] = ox, oy, oz
            rays[count, 3] = r[0, 0] * x + r[1, 0] * y + r[2, 0]
            rays[count, 4] = r[0, 1] * x + r[1, 1] * y + r[2, 1]
            rays[count, 5] = r[0, 2] * x + r[1, 2] * y + r[2, 2]
            index[count] = n * side * side + k
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def outline_box(places, width, slender):
    """The box around places (m, 2) px, a pixel wider: its least coordinates and lengths along its own two axes, and the
    cosine and sine of the angle of the first of them; upright, or see outline_rays. Far outside an image of this width
    nothing is asked.
    """
    low_u = low_v = math.inf
    high_u = high_v = -math.inf
    middle_u = middle_v = 0.0
    for k in range(places.shape[0]):
        a, b = places[k, 0], places[k, 1]
        low_u, high_u = min(low_u, a), max(high_u, a)
        low_v, high_v = min(low_v, b), max(high_v, b)
        middle_u, middle_v = middle_u + a, middle_v + b
    upright = (high_u - low_u + 2.0) * (high_v - low_v + 2.0)
    near = -width <= low_u and high_u <= 2.0 * width and -width <= low_v and high_v <= 2.0 * width
    if slender > 0.0 and near:
        middle_u, middle_v = middle_u / places.shape[0], middle_v / places.shape[0]
        uu = uv = vv = 0.0
        for k in range(places.shape[0]):
            a, b = places[k, 0] - middle_u, places[k, 1] - middle_v
            uu, uv, vv = uu + a * a, uv + a * b, vv + b * b
        angle = 0.5 * math.atan2(2.0 * uv, uu - vv)
        cosine, sine = math.cos(angle), math.sin(angle)
        low_a = low_b = math.inf
        high_a = high_b = -math.inf
        for k in range(places.shape[0]):
            a = cosine * places[k, 0] + sine * places[k, 1]
            b = cosine * places[k, 1] - sine * places[k, 0]
            low_a, high_a = min(low_a, a), max(high_a, a)
            low_b, high_b = min(low_b, b), max(high_b, b)
        if (high_a - low_a + 2.0) * (high_b - low_b + 2.0) < slender * upright:
            return low_a - 1.0, low_b - 1.0, high_a - low_a + 2.0, high_b - low_b + 2.0, cosine, sine
    low_u, high_u = min(max(low_u - 1.0, -width), 2.0 * width), min(max(high_u + 1.0, -width), 2.0 * width)
    low_v, high_v = min(max(low_v - 1.0, -width), 2.0 * width), min(max(high_v + 1.0, -width), 2.0 * width)
    return low_u, low_v, high_u - low_u, high_v - low_v, 1.0, 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def compare_pixels(met, index, u, v, image, camera, noise, limits, expected, seen, state, past, fade):
    """What each ray is: fills expected, seen, state, past and fade, all (n side^2,), which begin as zeros.

    met (k,): depth (m) at which ray `index` (k,), in order, meets the object, inf for none. u, v (n side^2,): pixels.
    image: depth (h, w); mask (h, w) or (0, 0); least and largest depth (m) of the hand at every so many pixels or
    (0, 0); planes (k, 6), see `find_plane`. noise: floor, growth, depth it grows from, bias and scale of
    a DepthModel.
    limits: tolerance (sigmas), fading (sigmas), share past beside an edge, reach of an edge (px), step of the hand (px)
    and its margin (m), margin (m) and sigmas of the plane.
    state: bits as named here; expected and seen: depths (m), 0 where there is none; past: how much of a ray is seen
    past; fade: how well one at the predicted depth agrees.
    """
    depth = image[0]
    for k in range(index.shape[0]):
        place = index[k]
        column, row = u[place], v[place]
        reading = np.float64(depth[row, column])
        read = 0.0 < reading < FARTHEST_READING
        bits = READ if read else 0
        seen[place] = reading if read else 0.0
        z = met[k]
        if not z < math.inf:
            state[place] = bits
            continue
        bits |= HIT
        expected[place] = z
        if not read:
            state[place] = bits
            continue
        state[place], past[place], fade[place] = what_is(image, camera, noise, limits, column, row, reading, z)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always", **LENT)
def what_is(image, camera, noise, limits, column, row, reading, z):
    """What a ray or point is that meets the object at depth z (m), and of whose pixel the `reading` (m) is one: its
    state, how much of it is seen past, and how well it agrees. image, camera, noise, limits: of compare_pixels.

    Written out where it is asked: handing over images and numbers takes as long as all that is done with them.
    """
    depth, mask, hand_low, hand_high, planes = image
    floor, growth, least_from, bias, scale = noise
    tolerance_sigmas, fading, beside_share, reach, step, hand_margin, plane_margin, plane_sigmas = limits
    independent = floor + growth * (z - least_from) * (z - least_from)
    smooth = math.sqrt(independent * independent + bias * bias)
    tolerance = tolerance_sigmas * math.sqrt(smooth * smooth + scale * scale * z * z)
    off = reading - z
    by_hand = is_by_hand(hand_low, hand_high, column // step, row // step, reading, hand_margin)
    is_plane = False
    if planes.shape[0] > 0:
        is_plane = is_on_planes(planes, camera, noise, column, row, reading, plane_margin, plane_sigmas)
    # nothing is under the table or behind the wall; what is at its depth is the table, and hides the object at most
    is_past = off > tolerance or (is_plane and off < -tolerance)
    bits, past, fade = HIT | READ, 0.0, 0.0
    if is_past:
        past = 1.0
        # beside the edge of something near a camera often reads what is behind it: stereo's windows, mixed light
        if off > 0.0 and _beside(depth, row, column, reach, z + tolerance, depth.shape[0], depth.shape[1]):
            past = beside_share
    other = is_plane or (mask.shape[0] > 0 and not mask[row, column])
    near = not by_hand and not other and abs(off) <= tolerance
    if near:
        bits |= NEAR
        away = off / (fading * smooth)
        fade = math.exp(-0.5 * away * away)
    if by_hand:
        if not is_past:
            bits |= BY_HAND
    elif not is_past and not near:
        bits |= HIDDEN
    return bits, past, fade


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def hides(places, beyond, tolerance, depth, hand_low, size, hand, out):
    """Fill out (n,) with whether at places (n, 2) of the image (px) something is nearer than beyond (n,) m by more than
    tolerance (n,) m, or the hand is in front; outside the image something is.

    depth (h, w); hand_low: least depth (m) of the hand at every so many pixels or (0, 0). size: width and height of the
    image; hand: that step and margin (m).
    """
    width, height = size
    step, margin = hand
    for n in range(places.shape[0]):
        u, v = np.rint(places[n, 0]), np.rint(places[n, 1])
        # not true of NaN either
        if not (0.0 <= u < width and 0.0 <= v < height):
            out[n] = True
            continue
        column, row = int(u), int(v)
        reading = np.float64(depth[row, column])
        out[n] = 0.0 < reading < FARTHEST_READING and reading < beyond[n] - tolerance[n]
        if not out[n] and hand_low.shape[0] > 0:
            out[n] = hand_low[row // step, column // step] < beyond[n] + margin


@numba.njit(cache=True, nogil=True, **LENT)
def _beside(depth, row, column, reach, nearer, height, width):
    """Whether within `reach` pixels along either axis something is read that is nearer (m)."""
    first, last = max(column - reach, 0), min(column + reach + 1, width)
    for j in range(max(row - reach, 0), min(row + reach + 1, height)):
        found = 0
        for i in range(first, last):
            # places that cannot be below 0: nobody counts them from the end; and no branch within a row
            reading = depth[np.uint64(j), np.uint64(i)]
            found += (reading > 0.0) & (reading < nearer)
        if found > 0:
            return True
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def sum_up(u, v, step, image, camera, noise, limits, expected, seen, state, past, fade, out):
    """What the rays (n side^2,) of each pose add up to: fills out (n, SUMS); see the columns' names.

    The surface runs on across the outline where two pixels beyond it are within smooth (m) and smooth_share (of depth)
    of where the two rays before it lead: the next ray's, and one so far on that no smeared edge reaches it. What is
    the table's, or outside of the mask, is another thing for sure. Within the outline it runs on where the next ray is
    hidden, and seen where they lead. What agrees ends where beyond the outline, past half of what an edge smears, the
    reading is nearer or farther by twice what a smooth surface may be off.
    u, v (n, side^2), step (n, 4): see outline_rays. image, camera, noise: as of compare_pixels. limits: smooth (m), its
    share of depth, reach of an edge (px), margin (m) and sigmas of the plane.
    """
    smooth, smooth_share, reach, plane_margin, plane_sigmas = limits
    side = int(np.rint(math.sqrt(u.shape[1])))
    for n in range(out.shape[0]):
        begin = n * side * side
        edges = running = sides = within = ends = dark = 0
        count = total = squares = 0.0
        # pixels from ray to ray
        across, down = math.hypot(step[n, 0], step[n, 1]), math.hypot(step[n, 2], step[n, 3])
        for j in range(side):
            for i in range(side):
                at = j * side + i
                k = begin + at
                bits = state[k]
                if not bits & HIT:
                    continue
                out[n, HITS] += 1.0
                if not bits & READ:
                    out[n, UNREAD] += 1.0
                out[n, SEEN] += fade[k]
                out[n, PAST] += past[k]
                if bits & NEAR:
                    out[n, AGREE] += 1.0
                    z = expected[k]
                    off = (seen[k] - z) / smooth_sigma(noise, z)
                    count, total, squares = count + 1.0, total + off, squares + off * off
                elif bits & HIDDEN:
                    out[n, BEHIND] += 1.0
                elif bits & BY_HAND:
                    out[n, BEHIND_HAND] += 1.0
                for way in range(4):
                    # the neighbour outside, and the one inside on the other side
                    dj, di = (way - 1, 0) if way % 2 == 0 else (0, way - 2)
                    in_grid = 0 <= j + dj < side and 0 <= i + di < side
                    beyond = k + dj * side + di
                    back = k - dj * side - di
                    inner = in_grid and state[beyond] & HIT
                    edges += not inner
                    # of that way, pixels from ray to ray, and u and v of one
                    length = across if di else down
                    right = (di * step[n, 0] + dj * step[n, 2]) / max(length, 1e-9)
                    low = (di * step[n, 1] + dj * step[n, 3]) / max(length, 1e-9)
                    if not inner and bits & NEAR:
                        column = int(np.rint(u[n, at] + right * (length + 0.5 * reach)))
                        row = int(np.rint(v[n, at] + low * (length + 0.5 * reach)))
                        end = ends_at(image[0], column, row, seen[k], 2.0 * (smooth + smooth_share * seen[k]))
                        ends, dark = ends + (end == ENDS), dark + (end == DARK)
                    if not 0 <= j - dj < side or not 0 <= i - di < side:
                        continue
                    if not bits & NEAR or not state[back] & NEAR or (inner and not state[beyond] & HIDDEN):
                        continue
                    # the grid ends where the outline does: beyond a straight side of it there is a pixel, but no ray
                    column, row = int(np.rint(u[n, at] + right * length)), int(np.rint(v[n, at] + low * length))
                    if in_grid:
                        after, column, row = seen[beyond], u[n, beyond - begin], v[n, beyond - begin]
                    else:
                        after = reading_at(image[0], column, row)
                    slope = seen[k] - seen[back]
                    room = smooth + smooth_share * seen[k]
                    if (
                        not after > 0.0
                        or (in_grid and not state[beyond] & READ)
                        or abs(after - seen[k] - slope) >= room
                    ):
                        continue
                    if inner:
                        within += 1
                        continue
                    column, row = int(np.rint(column + right * reach)), int(np.rint(row + low * reach))
                    lead = seen[k] + slope * (1.0 + reach / max(length, 1.0))
                    on = leads_to(image, camera, noise, column, row, lead, room, plane_margin, plane_sigmas)
                    running, sides = running + (on and in_grid), sides + (on and not in_grid)
        out[n, OUTLINE], out[n, SIDES] = running / max(edges, 1), sides / max(edges, 1)
        out[n, WITHIN] = within / max(edges, 1)
        out[n, ENDS], out[n, DARK] = ends / max(edges, 1), dark / max(edges, 1)
        out[n, SCATTER] = scatter_of(count, total, squares)


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def smooth_sigma(noise, z):
    """Noise and smooth bias (m, standard deviation) of a reading at depth z (m); noise: of compare_pixels."""
    own = noise[0] + noise[1] * (z - noise[2]) * (z - noise[2])
    return math.sqrt(own * own + noise[3] * noise[3])


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def ends_at(depth, column, row, reading, apart):
    """What is beside the outline at a pixel of depth (h, w): ENDS, where it is nearer or farther than `reading` (m) by
    more than apart (m), DARK, where nothing is read, or 0; outside of the image nothing is known.
    """
    if not (0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
        return 0
    there = np.float64(depth[row, column])
    if not 0.0 < there < FARTHEST_READING:
        return DARK
    return ENDS if abs(there - reading) > apart else 0


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def leads_to(image, camera, noise, column, row, lead, room, plane_margin, plane_sigmas):
    """Whether a pixel is read within `room` (m) of depth `lead` (m), and may be of the object."""
    depth, mask, _, _, planes = image
    if not (0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
        return False
    reading = np.float64(depth[row, column])
    if not 0.0 < reading < FARTHEST_READING or abs(reading - lead) >= room:
        return False
    if mask.shape[0] > 0 and not mask[row, column]:
        return False
    return not is_on_planes(planes, camera, noise, column, row, reading, plane_margin, plane_sigmas)


@numba.njit(cache=True, nogil=True, **LENT)
def reading_at(depth, column, row):
    """The reading (m) of a pixel, 0 for none and outside of the image."""
    if not (0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
        return 0.0
    reading = np.float64(depth[row, column])
    return reading if 0.0 < reading < FARTHEST_READING else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always", **LENT)
def is_by_hand(low, high, column, row, reading, margin):
    """Whether a reading (m) is the hand's, whose least and largest depth are low and high (h, w), or (0, 0) for none,
    there; column, row: in these. margin (m).
    """
    return low.shape[0] > 0 and low[row, column] - margin < reading < high[row, column] + margin


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def is_on_planes(planes, camera, noise, column, row, reading, margin, sigmas):
    """Whether a reading (m) of a pixel is a table's or wall's, or behind the first, where nothing is but noise.

    planes (k, 6): unit normal towards the camera, offset, how much more readings scatter than is believed, and how far
    (m) behind it there is nothing else.
    """
    fx, fy, cx, cy, _, _ = camera
    x, y = (column - cx) / fx, (row - cy) / fy
    own = noise[0] + noise[1] * (reading - noise[2]) * (reading - noise[2])
    for k in range(planes.shape[0]):
        away = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2]
        height = reading * away + planes[k, 3]
        smooth = margin / sigmas
        room = max(margin + sigmas * own, sigmas * planes[k, 4] * math.sqrt(own * own + smooth * smooth))
        if -max(room, planes[k, 5]) <= height < room:
            return True
    return False
