"""The predicted image in plain NumPy: the twin of vision.picture.kernels, array by array."""

import numpy as np

from scenes.geometry import poses as se3
from scenes.geometry.cameras import is_reading
from vision.picture import columns
from vision.picture.prediction import Prediction


def predicted(found, pose, side):
    """Shares (seen, agree, past, hidden, behind_hand, outline, within, ends, dark), scatter and hits of a pose.

    found: a Predictor.
    """
    s, camera, depth = found.settings, found.camera, found._depth
    u, v, inside, steps = grid(found, pose, side)
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
    grids = [x.reshape(side, side) for x in (hit, near, read, hidden, seen, u, v)]
    border = *runs_on(found, *grids, steps), *ends(found, hit, near, seen, u, v, side, steps)
    # of the whole outline's border, as far as it is in the image
    return *sums, *(share * one for one in border), scatter(found, seen, expected, near), int(hit.sum())


def as_predicted(got):
    """(n, k) what a Prediction has of n poses, in the order of `predicted`."""
    shares = got.seen, got.agree, got.past, got.hidden, got.behind_hand
    border = got.outline, got.running - got.outline, got.within, got.ends, got.dark
    return np.stack([*shares, *border, got.scatter, got.count], axis=1)


def scatter(found, seen, z, near):
    """Standard deviation of how far what agrees is off, in sigmas of noise and bias."""
    if not near.any():
        return 0.0
    off = (seen - z)[near] / np.hypot(found.belief.independent_sigma(z[near]), found.belief.bias_sigma)
    return float(off.std())


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
    """Shares (seen, agree, past, hidden, behind_hand, outline, within, ends, dark), scatter and hits of a pose by the
    points of one of an object's aspects; area (px^2); and how much of what is seen is of parts that go on beyond the
    outline.
    """
    s, c, depth = found.settings, found.camera, found._depth
    points = se3.apply(pose, aspects.points[which, : aspects.count[which]].astype(np.float64))
    beside = aspects.near[which, : aspects.count[which]].astype(int)
    if not (points[:, 2] > 1e-3).all():
        return np.zeros(11), 0.0, 0.0
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
    edges = goes_on = within = ending = dark = 0
    for k in np.flatnonzero(hit):
        for way in range(4):
            on, back = beside[k, way], beside[k, way - 2]
            inner = on >= 0 and hit[on]
            edges += not inner
            if back < 0 or not near[k]:
                continue
            room = s.smooth + s.smooth_share * seen[k]
            if not inner:
                along = np.array([u[k] - u[back], v[k] - v[back]])
                far = np.array([u[k], v[k]]) + along * (1.0 + 0.5 * found.reach / max(np.linalg.norm(along), 1.0))
                step, nothing = step_at(found, *np.rint(far).astype(int)[:, None], seen[k : k + 1], 2.0 * room)
                ending, dark = ending + step[0], dark + nothing[0]
            if not near[back]:
                continue
            slope = seen[k] - seen[back]
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
    lost = 0.0
    if len(found._sizes):
        label = found._pieces[at[0] // s.piece_step, at[1] // s.piece_step]
        for part, pixels in enumerate(found._sizes):
            mine = hit & (label == part)
            outside = max((1.0 - s.beside) * pixels - mine.sum() * each, 0.0)
            lost += min(outside / max(total * each, 1.0), fade[mine].sum() / total)
    shares = [x.sum() / total for x in (fade, near, past, hidden, by_hand)]
    shares[3] += 1.0 - share
    border = [share * count / max(edges, 1) for count in (goes_on, within, ending, dark)]
    return np.array([*shares, *border, scatter(found, seen, z, near), hit.sum()]), total * each, lost


def glimpse(found, pose, aspects, which):
    """Nats of a pose by a few of the points of one of an object's aspects."""
    s, c, depth = found.settings, found.camera, found._depth
    points = se3.apply(pose, aspects.points[which, : aspects.count[which]].astype(np.float64))
    few = min(len(points), s.glimpse_points)
    order = (np.arange(few) * 7) % few if few % 7 else np.arange(few)
    points = points[((order + 0.5) * (len(points) / max(few, 1))).astype(int)]
    z = points[:, 2]
    u, v = c.fx * points[:, 0] / z + c.cx, c.fy * points[:, 1] / z + c.cy
    inside = (z > 1e-3) & (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height)
    column, row = (np.where(inside, x, 0).astype(int) // s.glimpse_step for x in (u, v))
    # the pixel in the middle of each cell
    at = tuple(
        np.minimum(x * s.glimpse_step + s.glimpse_step // 2, most - 1)
        for x, most in ((row, c.height), (column, c.width))
    )
    seen = depth[at].astype(np.float64)
    read = inside & is_reading(seen)
    rays = np.stack([(at[1] - c.cx) / c.fx, (at[0] - c.cy) / c.fy, np.ones(few)], axis=1)
    middle = se3.apply(pose, found.model.centroid[None])[0, 2]
    own = np.hypot(found.belief.independent_sigma(np.array([middle]))[0], found.belief.bias_sigma)
    tolerance = s.tolerance * np.hypot(own, found.belief.scale_sigma * middle)
    off, plane = seen - z, is_plane(found, rays, seen)
    other = plane | is_hand(found, at, seen) | (False if found._mask is None else ~found._mask[at])
    past = read & ((off > tolerance) | (plane & (off < -tolerance)))
    seen = np.where(read & ~other & (np.abs(off) <= tolerance), 1.0 - (off / tolerance) ** 2, 0.0)
    third = few // 3
    if few % 3 == 0 and 2 * past[:third].sum() > third:
        seen, past = seen[:third], past[:third]
    share = seen.mean() if few else 0.0
    nats = s.glimpse_past * past.sum() / max(len(past), 1) - s.glimpse_seen * min(share, s.glimpse_most)
    return as_far(found, pose[None], [nats])[0]


def size(found, candidates, picture):
    """(n,) share of all cells that the outline of each pose (n, 4, 4) amounts to."""
    s, distance = found.settings, se3.apply(candidates, found.model.centroid[None])[:, 0, 2]
    usual = found.model.mean_outline * found.camera.fx * found.camera.fy / np.maximum(distance, 1e-3) ** 2
    return np.clip(picture.area / np.maximum(usual, s.cells * s.cell), s.least_cells, 1.0)


def cost(found, candidates, picture):
    """(n,) nats of poses (n, 4, 4)."""
    p, score = picture, found.score
    clear = np.maximum(1.0 - p.hidden - p.behind_hand, 0.05)
    against = (
        score.past * p.past + score.past_open * p.past / clear + score.hidden * p.hidden + score.goes_on * p.beyond
    )
    agreeing = score.seen * np.minimum(p.seen, score.most_seen) - score.scatter * p.agree * p.scatter
    border = score.runs_on * p.outline + np.minimum(score.within * p.within, score.most_within)
    border = border - score.ends * p.ends - score.dark * p.dark
    weight = size(found, candidates, p) ** score.by_size
    return as_far(found, candidates, np.where(p.count > 0, weight * (against - agreeing + border), score.hidden))


def beside_the_mask(found, pose):
    """Nats for the mask's inner pixels that are not the object's at pose (4, 4)."""
    pixels, told = found._core
    if not len(pixels):
        return 0.0
    camera = found.camera
    rays = np.column_stack([(pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(pixels))])
    back = se3.inverse(pose)
    met = found.model.surface.cast(np.tile(back[:3, 3], (len(rays), 1)), rays @ back[:3, :3].T)
    return found.settings.uncovered * told * np.mean(~np.isfinite(met))


def as_far(found, candidates, nats):
    """Nats (n,) of poses (n, 4, 4) as far as their distance lets depth tell, and what is believed of that distance."""
    s, belief, out = found.settings, found.belief, []
    for pose, one in zip(candidates, nats):
        z = se3.apply(pose, found.model.centroid[None])[0, 2]
        if z <= s.resolved_to:
            out.append(one)
            continue
        told = []
        for depth in (z, s.resolved_to):
            parts = belief.independent_sigma(depth), belief.bias_sigma, belief.scale_sigma * depth
            told.append(np.log(1.0 + found.model.radius / (s.tolerance * np.linalg.norm(parts))))
        out.append(one * told[0] / told[1] + s.places * np.log(z / s.resolved_to))
    return np.array(out)


def picture(seen=0.9, agree=0.95, past=0.0, hidden=0.0, behind_hand=0.0, outline=0.0, ends=0.0):
    """A predicted picture of one pose by its shares."""
    shares = np.zeros((1, columns.SUMS))
    told = columns.HITS, columns.SEEN, columns.AGREE, columns.PAST, columns.BEHIND, columns.BEHIND_HAND
    shares[0, list(told)] = 200.0, min(seen, 0.95 * agree), agree, past, hidden, behind_hand
    shares[0, columns.OUTLINE], shares[0, columns.ENDS] = outline, ends
    return Prediction(shares, np.zeros(1), np.array([9e3]))


def in_image(found, pose):
    """Share of the object's points that project into the image; 0 when one is behind the camera."""
    c, points = found.camera, found._points @ pose[:3, :3].T + pose[:3, 3]
    if not (points[:, 2] > 1e-3).all():
        return 0.0
    u, v = c.fx * points[:, 0] / points[:, 2] + c.cx, c.fy * points[:, 1] / points[:, 2] + c.cy
    return float(((u >= 0) & (u < c.width) & (v >= 0) & (v < c.height)).mean())


def grid(found, pose, side):
    """Pixels u, v (side^2,) over the box of the outline, which of them are in the image, and steps (2, 2): u, v from
    one to the next of its row, and of its column.
    """
    c = found.camera
    points = found._points @ pose[:3, :3].T + pose[:3, 3]
    z = points[:, 2]
    ahead = (z > 1e-3).all()
    safe = np.where(z > 1e-3, z, 1.0)
    uv = np.stack([c.fx * points[:, 0] / safe + c.cx, c.fy * points[:, 1] / safe + c.cy], axis=1)
    axes = np.eye(2)
    low, high = uv.min(axis=0), uv.max(axis=0)
    if ahead and (low >= -c.width).all() and (high <= 2 * c.width).all():
        # those that bound the outline
        bound = uv if in_image(found, pose) < 1.0 else uv[: found._outer]
        vectors = np.linalg.eigh(np.cov(bound.T))[1].T[::-1]
        # the first axis to the right
        first = vectors[0] * np.sign(vectors[0, 0])
        turned = np.stack([first, [-first[1], first[0]]])
        if np.prod(np.ptp(uv @ turned.T, axis=0) + 2.0) < found.settings.slender * np.prod(high - low + 2.0):
            axes = turned
            low, high = (uv @ axes.T).min(axis=0), (uv @ axes.T).max(axis=0)
    low, high = low - 1.0, high + 1.0
    if (axes == np.eye(2)).all():
        low, high = np.clip(low, -c.width, 2 * c.width), np.clip(high, -c.width, 2 * c.width)
    shares = (np.arange(side) + 0.5) / side
    a, b = np.meshgrid(*(low + shares[:, None] * (high - low)).T)
    u, v = np.rint(np.stack([a.ravel(), b.ravel()], axis=1) @ axes).astype(np.int64).T
    inside = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height) & ahead
    return u, v, inside, (high - low)[:, None] / side * axes


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


def runs_on(found, hit, near, read, hidden, seen, u, v, steps):
    """Shares of the outline across which the surface that is seen inside goes on as it was, further than edges smear,
    beyond its rays and beyond the grid of them; and beside it the borders within, where it goes on to hide. All but
    steps, see grid: (side, side).
    """
    s = found.settings
    reach = found.reach
    hit, near, read, hidden, seen, u, v = (np.pad(x, 1) for x in (hit, near, read, hidden, seen, u, v))
    smooth = sides = border = within = 0
    for axis in (0, 1):
        apart = np.linalg.norm(steps[1 - axis])
        for step in (1, -1):
            way = -step * steps[1 - axis] / apart
            beyond = hit & ~np.roll(hit, step, axis)
            slope = seen - np.roll(seen, -step, axis)
            room = s.smooth + s.smooth_share * seen
            in_grid = np.pad(np.ones((len(u) - 2, len(u) - 2), dtype=bool), 1)
            next_u, next_v = (np.rint(at + apart * along).astype(int) for at, along in zip((u, v), way))
            ray = np.roll(in_grid, step, axis)
            next_u, next_v = (
                np.where(ray, np.roll(u, step, axis), next_u),
                np.where(ray, np.roll(v, step, axis), next_v),
            )
            far_u = np.rint(next_u + reach * way[0]).astype(int)
            far_v = np.rint(next_v + reach * way[1]).astype(int)
            lead = seen + slope * (1.0 + reach / max(apart, 1.0))
            both = near & np.roll(near, -step, axis)
            close = both & (np.abs(np.roll(seen, step, axis) - seen - slope) < room)
            within += (hit & np.roll(hit & hidden, step, axis) & close).sum()
            # where the grid ends there is no ray beyond, but a pixel
            after = np.where(ray, np.roll(np.where(read, seen, 0.0), step, axis), reading_at(found, next_u, next_v))
            on = both & (after > 0.0) & (np.abs(after - seen - slope) < room)
            on &= leads_to(found, far_u.ravel(), far_v.ravel(), lead.ravel(), room.ravel()).reshape(on.shape)
            smooth, sides = smooth + (beyond & on & ray).sum(), sides + (beyond & on & ~ray).sum()
            border += beyond.sum()
    return smooth / max(border, 1), sides / max(border, 1), within / max(border, 1)


def ends(found, hit, near, seen, u, v, side, steps):
    """Shares of the outline where what agrees ends in a step of depth, and beyond which nothing is read."""
    s = found.settings
    hit, near, seen, u, v = (x.reshape(side, side) for x in (hit, near, seen, u, v))
    beyond, ending, dark, border = np.pad(hit, 1), 0, 0, 0
    for right, below in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        edge = hit & ~beyond[1 + below : 1 + below + side, 1 + right : 1 + right + side]
        border += edge.sum()
        edge &= near
        along = right * steps[0] + below * steps[1]
        length = np.linalg.norm(along)
        far = along * (1.0 + 0.5 * found.reach / length)
        far_u, far_v = np.rint(u + far[0]).astype(int), np.rint(v + far[1]).astype(int)
        room = s.smooth + s.smooth_share * seen
        step, nothing = step_at(found, far_u[edge], far_v[edge], seen[edge], 2.0 * room[edge])
        ending, dark = ending + step.sum(), dark + nothing.sum()
    return ending / max(border, 1), dark / max(border, 1)


def step_at(found, u, v, reading, apart):
    """(n,) whether pixels are read nearer or farther than readings (m) by more than apart (m), and whether those in the
    image are not read.
    """
    c = found.camera
    inside = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height)
    there = found._depth[np.where(inside, v, 0), np.where(inside, u, 0)].astype(np.float64)
    read = is_reading(there)
    return inside & read & (np.abs(there - reading) > apart), inside & ~read


def reading_at(found, u, v):
    """Readings (m) at pixels of any shape, 0 for none and outside of the image."""
    c = found.camera
    inside = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height)
    there = found._depth[np.where(inside, v, 0), np.where(inside, u, 0)].astype(np.float64)
    return np.where(inside & is_reading(there), there, 0.0)


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
