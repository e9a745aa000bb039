"""The predicted image in plain NumPy: the twin of vision.predicted_kernels, array by array."""

import numpy as np

from scenes.geometry import poses as se3
from scenes.geometry.cameras import is_reading
from vision import predicted_kernels as kernels
from vision.predicted import Prediction


def predicted(found, pose, side):
    """Shares (seen, agree, past, hidden, behind_hand, outline, within) and hits of a pose; found: a Predictor."""
    s, camera, depth = found.settings, found.camera, found._depth
    u, v, inside = grid(found, pose, side)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    inverse = se3.inverse(pose)
    local = rays @ inverse[:3, :3].T
    expected = np.full(u.shape, np.inf)
    if inside.any():
        origins = np.broadcast_to(inverse[:3, 3], local.shape)
        expected[inside] = found.model.surface.cast(origins[inside], local[inside])
    hit = np.isfinite(expected)
    at = np.where(inside, v, 0), np.where(inside, u, 0)
    seen = np.where(inside, depth[at].astype(np.float64), 0.0)
    read = is_reading(seen) & inside
    seen = np.where(read, seen, 0.0)
    near, past_share, hidden, by_hand, fade = told(found, rays, at, seen, np.where(hit, expected, 1.0), read & hit)
    share = in_image(found, pose)
    total = max(hit.sum() - s.unread * (hit & ~read).sum(), 1.0) / max(share, 1e-3)
    sums = [x.sum() / total for x in (fade, near, past_share, hidden, by_hand)]
    sums[3] += 1.0 - share
    return *sums, *runs_on(found, hit, near, read, hidden, seen, u, v, side), int(hit.sum())


def told(found, rays, at, seen, z, known):
    """What rays or points at depth z, whose pixels `at` are read as `seen`, are, of those that are known: near, how
    much they are seen past, hidden, hidden by the hand, and how well they agree.
    """
    s, depth, belief = found.settings, found._depth, found.belief
    smooth = np.hypot(belief.independent_sigma(z), belief.bias_sigma)
    tolerance = s.tolerance * np.hypot(smooth, belief.scale_sigma * z)
    off = np.where(known, seen - z, 0.0)
    by_hand = known & is_hand(found, at, seen)
    plane = known & is_plane(found, rays, seen)
    past = known & ((off > tolerance) | (plane & (off < -tolerance)))
    beside = known & (nearest_around(depth, belief.edge_pixels)[at] < z + tolerance)
    past_share = np.where(past & beside & (off > 0), s.past_beside, 1.0) * past
    other = plane if found._mask is None else plane | ~found._mask[at]
    near = known & ~by_hand & ~other & (np.abs(off) <= tolerance)
    hidden = known & ~by_hand & ~past & ~near
    fade = np.exp(-0.5 * np.square(off / (s.fading * smooth))) * near
    return near, past_share, hidden, by_hand & ~past, fade


def by_aspect(found, pose, aspects, which):
    """Shares (seen, agree, past, hidden, behind_hand, outline, within) and hits of a pose by the points of one of an
    object's aspects; area (px^2); and how much of what is seen is of parts that go on beyond the outline.
    """
    s, c, depth = found.settings, found.camera, found._depth
    points = se3.apply(pose, aspects.points[which, : aspects.count[which]].astype(np.float64))
    beside = aspects.near[which, : aspects.count[which]].astype(int)
    if not (points[:, 2] > 1e-3).all():
        return np.zeros(8), 0.0, 0.0
    z = points[:, 2]
    u = np.rint(np.clip(c.fx * points[:, 0] / z + c.cx, -c.width, 2 * c.width)).astype(int)
    v = np.rint(np.clip(c.fy * points[:, 1] / z + c.cy, -c.width, 2 * c.width)).astype(int)
    hit = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height)
    at = np.where(hit, v, 0), np.where(hit, u, 0)
    seen = depth[at].astype(np.float64)
    read = hit & is_reading(seen)
    rays = np.stack([(u - c.cx) / c.fx, (v - c.cy) / c.fy, np.ones(len(u))], axis=1)
    near, past, hidden, by_hand, fade = told(found, rays, at, seen, z, read)
    share = float(hit.mean())
    total = max(hit.sum() - s.unread * (hit & ~read).sum(), 1.0) / max(share, 1e-3)
    each = aspects.cell[which] * c.fx * c.fy / se3.apply(pose, found.model.centroid[None])[0, 2] ** 2
    edges = goes_on = within = 0
    for k in np.flatnonzero(hit):
        for way in range(4):
            on, back = beside[k, way], beside[k, way - 2]
            inner = on >= 0 and hit[on]
            edges += not inner
            if back < 0 or not near[k] or not near[back]:
                continue
            slope, room = seen[k] - seen[back], s.smooth + s.smooth_share * seen[k]
            if inner:
                within += hidden[on] and abs(seen[on] - seen[k] - slope) < room
                continue
            along = np.array([u[k] - u[back], v[k] - v[back]])
            i, j = np.array([u[k], v[k]]) + along
            if not (0 <= i < c.width and 0 <= j < c.height) or abs(depth[j, i] - seen[k] - slope) >= room:
                continue
            more = found.reach / max(np.linalg.norm(along), 1.0)
            far = np.rint(np.array([i, j]) + more * along).astype(int)
            lead = seen[k] + slope * (1.0 + more)
            goes_on += leads_to(found, far[:1], far[1:], np.array([lead]), np.array([room]))[0]
    agrees, lost = fade.sum() / total, 0.0
    if found._pieces is not None:
        label = found._pieces[at[0] // s.piece_step, at[1] // s.piece_step] + 1
        labels = len(found._whole)
        of_each = np.bincount(label[hit], fade[hit], minlength=labels) / total
        sums = np.bincount(found._whole, of_each)
        bound, parts = s.most_of_piece / (s.cells * s.seen), len(found._sizes)
        agrees = np.minimum(sums, bound).sum()
        earned = (of_each * np.minimum(1.0, bound / np.maximum(sums, 1e-9))[found._whole])[1 : parts + 1]
        met = np.bincount(label[hit], minlength=labels)[1 : parts + 1]
        outside = np.maximum((1.0 - s.beside) * found._sizes - met * each, 0.0) / (max(total * each, 1.0) / s.cells)
        lost = np.minimum(s.beyond / (s.cells * s.seen) * outside, earned).sum()
    shares = [agrees, *(x.sum() / total for x in (near, past, hidden, by_hand))]
    shares[3] += 1.0 - share
    return np.array([*shares, goes_on / max(edges, 1), within / max(edges, 1), hit.sum()]), total * each, lost


def size(found, candidates, picture):
    """(n,) share of all cells that the outline of each pose (n, 4, 4) amounts to."""
    s, distance = found.settings, se3.apply(candidates, found.model.centroid[None])[:, 0, 2]
    usual = found.model.mean_outline * found.camera.fx * found.camera.fy / np.maximum(distance, 1e-3) ** 2
    return np.clip(picture.area / np.maximum(usual, s.cells * s.cell), s.least_cells, 1.0)


def cost(found, candidates, picture):
    """(n,) nats of poses (n, 4, 4), of one colour each or none."""
    s, p = found.settings, picture
    hidden = s.hidden if found.told_apart else s.hidden_by_unknown
    shares = s.past * p.past + hidden * p.hidden - s.seen * p.seen
    smooth = s.runs_on * p.outline
    if not found.told_apart:
        smooth = smooth + np.minimum(s.runs_on_within * p.within, s.most_within)
    return np.where(p.count > 0, size(found, candidates, p) * (s.cells * shares + smooth), s.cells * hidden)


def picture(seen=0.9, agree=0.95, past=0.0, hidden=0.0, behind_hand=0.0, outline=0.0):
    """A predicted picture of one pose by its shares."""
    shares = np.zeros((1, kernels.SUMS))
    columns = kernels.HITS, kernels.SEEN, kernels.AGREE, kernels.PAST, kernels.BEHIND, kernels.BEHIND_HAND
    shares[0, list(columns)] = 200.0, min(seen, 0.95 * agree), agree, past, hidden, behind_hand
    shares[0, kernels.OUTLINE] = outline
    return Prediction(shares, np.zeros(1), np.array([9e3]))


def in_image(found, pose):
    """Share of the object's points that project into the image; 0 when one is behind the camera."""
    c, points = found.camera, found._points @ pose[:3, :3].T + pose[:3, 3]
    if not (points[:, 2] > 1e-3).all():
        return 0.0
    u, v = c.fx * points[:, 0] / points[:, 2] + c.cx, c.fy * points[:, 1] / points[:, 2] + c.cy
    return float(((u >= 0) & (u < c.width) & (v >= 0) & (v < c.height)).mean())


def grid(found, pose, side):
    """Pixels u, v (side^2,) over the box of the outline, and which of them are in the image."""
    c = found.camera
    points = found._points @ pose[:3, :3].T + pose[:3, 3]
    z = points[:, 2]
    ahead = (z > 1e-3).all()
    safe = np.where(z > 1e-3, z, 1.0)
    uv = np.stack([c.fx * points[:, 0] / safe + c.cx, c.fy * points[:, 1] / safe + c.cy], axis=1)
    low = np.clip(uv.min(axis=0) - 1.0, -c.width, 2 * c.width)
    high = np.clip(uv.max(axis=0) + 1.0, -c.width, 2 * c.width)
    steps = (np.arange(side) + 0.5)[:, None] / side
    u, v = np.round(low + steps * (high - low)).astype(np.int64).T
    u, v = (x.ravel() for x in np.meshgrid(u, v))
    return u, v, (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height) & ahead


def is_hand(found, at, seen):
    low, high = found._hand
    if not len(low):
        return np.zeros(seen.shape, dtype=bool)
    place = at[0] // found.settings.hand_step, at[1] // found.settings.hand_step
    return (seen > low[place] - found.settings.hand_margin) & (seen < high[place] + found.settings.hand_margin)


def is_plane(found, rays, seen):
    out = np.zeros(seen.shape, dtype=bool)
    settings, own = found.settings, found.belief.independent_sigma(seen)
    sigmas, margin = settings.plane_sigmas, settings.plane_margin
    for plane in found._planes:
        room = np.maximum(margin + sigmas * own, sigmas * plane[4] * np.hypot(own, margin / sigmas))
        height = seen * (rays @ plane[:3]) + plane[3]
        out |= (height < room) & (height >= -np.maximum(room, plane[5]))
    return out


def nearest_around(depth, reach):
    """(h, w) least depth (m) that is read within `reach` pixels along either axis; inf for none."""
    read = np.pad(np.where(is_reading(depth), depth, np.inf), reach, constant_values=np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(read, (2 * reach + 1, 2 * reach + 1))
    return windows.min(axis=(2, 3))


def runs_on(found, hit, near, read, hidden, seen, u, v, side):
    """Share of the outline across which the surface that is seen inside goes on as it was, further than edges smear;
    and beside it the borders within, where it goes on to hide.
    """
    s = found.settings
    reach = found.reach
    grids = hit, near, read, hidden, seen, u, v
    hit, near, read, hidden, seen, u, v = (np.pad(x.reshape(side, side), 1) for x in grids)
    smooth = border = within = 0
    for axis in (0, 1):
        for step in (1, -1):
            beyond = hit & ~np.roll(hit, step, axis)
            slope = seen - np.roll(seen, -step, axis)
            room = s.smooth + s.smooth_share * seen
            next_u, next_v = np.roll(u, step, axis), np.roll(v, step, axis)
            apart = np.abs(next_v - v) if axis == 0 else np.abs(next_u - u)
            far_u, far_v = (next_u, next_v - step * reach) if axis == 0 else (next_u - step * reach, next_v)
            lead = seen + slope * (1.0 + reach / np.maximum(apart, 1))
            close = near & np.roll(near, -step, axis) & (np.abs(np.roll(seen, step, axis) - seen - slope) < room)
            within += (hit & np.roll(hit & hidden, step, axis) & close).sum()
            close &= leads_to(found, far_u.ravel(), far_v.ravel(), lead.ravel(), room.ravel()).reshape(close.shape)
            smooth += (beyond & np.roll(read, step, axis) & close).sum()
            border += beyond.sum()
    return smooth / max(border, 1), within / max(border, 1)


def leads_to(found, u, v, lead, room):
    """(n,) whether pixels are read within room (m) of depths lead (m), inside the mask and not on the plane."""
    c = found.camera
    inside = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height)
    at = np.where(inside, v, 0), np.where(inside, u, 0)
    there = found._depth[at].astype(np.float64)
    good = inside & is_reading(there) & (np.abs(there - lead) < room)
    if found._mask is not None:
        good &= found._mask[at]
    rays = np.stack([(u - c.cx) / c.fx, (v - c.cy) / c.fy, np.ones(u.shape)], axis=-1)
    return good & ~is_plane(found, rays, there)
