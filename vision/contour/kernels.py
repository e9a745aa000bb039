"""Compiled loops over the lines across an outline. Pixels along each line; logarithms are natural."""

from __future__ import annotations

import numba
import numpy as np

from scenes._numba import LENT


@numba.njit(cache=True, nogil=True, **LENT)
def is_grey(image):
    """Whether the channels of an image (h, w, 3) are alike."""
    for v in range(image.shape[0]):
        coloured = np.uint8(0)
        for u in range(image.shape[1]):
            coloured |= (image[v, u, 0] ^ image[v, u, 1]) | (image[v, u, 0] ^ image[v, u, 2])
        if coloured > 0:
            return False
    return True


@numba.njit(cache=True, nogil=True, **LENT)
def places_across(places, normals, first, low, columns, rows):
    """Fill columns and rows (n, k) with the places first, first + 1, ... (px) along normals (n, 2) from places (n, 2),
    less the corner low (2,) of the image's part that is read.
    """
    for n in range(places.shape[0]):
        for k in range(columns.shape[1]):
            away = float(first + k)
            columns[n, k] = places[n, 0] + away * normals[n, 0] - low[0]
            rows[n, k] = places[n, 1] + away * normals[n, 1] - low[1]


@numba.njit(cache=True, nogil=True)
def offset_tables(bins, ratios, group, temper, first, near, log_p, sides):
    """Fill log_p (n, m): log probability of each offset at which a line's colours change from object to ground; and
    sides (n, 2): mean log ratio of the samples inside and outside, those from near[0] to near[1] from the middle one.

    bins (n, k): the colour of each sample of a line, from inside to outside; ratios (g, b): log of how much likelier a
    colour is inside than outside, in each group of lines; group (n,). Offset j lies before sample first + j: what is
    before it is the object's, the rest is not.
    """
    n, k = bins.shape
    m = log_p.shape[1]
    for i in range(n):
        ratio = ratios[group[i]]
        inner, outer = 0.0, 0.0
        for d in range(near[0], near[1] + 1):
            inner += ratio[bins[i, k // 2 - d]]
            outer += ratio[bins[i, k // 2 + d]]
        sides[i, 0] = inner / (near[1] - near[0] + 1)
        sides[i, 1] = outer / (near[1] - near[0] + 1)
        total = 0.0
        for s in range(first):
            total += ratio[bins[i, s]]
        best = -np.inf
        for j in range(m):
            value = temper * total
            log_p[i, j] = value
            best = max(best, value)
            if first + j < k:
                total += ratio[bins[i, first + j]]
        mass = 0.0
        for j in range(m):
            mass += np.exp(log_p[i, j] - best)
        norm = best + np.log(mass)
        for j in range(m):
            log_p[i, j] -= norm


@numba.njit(cache=True, nogil=True)
def sites(log_p, lowest, expected, window, mean, precision):
    """Fill mean (n,) and precision (n,): the Gaussian that stands for each line near where it is expected.

    log_p (n, m) over offsets lowest, lowest + 1, ... (px). The table times a Gaussian of standard deviation window
    about expected (n,) has two moments; what is left when that Gaussian is divided out again says what the line says
    there (Minka, UAI 2001). A line that says nothing there, or less than nothing, has precision 0.
    """
    n, m = log_p.shape
    own = 1.0 / (window * window)
    for i in range(n):
        best = -np.inf
        for j in range(m):
            off = lowest + j - expected[i]
            best = max(best, log_p[i, j] - 0.5 * own * off * off)
        mass, first, second = 0.0, 0.0, 0.0
        for j in range(m):
            off = lowest + j - expected[i]
            p = np.exp(log_p[i, j] - 0.5 * own * off * off - best)
            mass += p
            first += p * off
            second += p * off * off
        middle = first / mass
        variance = max(second / mass - middle * middle, 0.0) + 1.0 / 12.0
        left = 1.0 / variance - own
        if left <= 0.0:
            mean[i], precision[i] = expected[i], 0.0
        else:
            mean[i], precision[i] = expected[i] + middle / variance / left, left


@numba.njit(cache=True, nogil=True)
def weigh(log_p, lowest, rows, moved, widths, share, left, weight):
    """Fill left (n,): how far (px) each place is from what its line says (see `sites`), what all lines share left in,
    and weight (n,) of each line.

    rows (n, m): how a place's offset changes with a pose's move, six of them, and with what all lines share, and moved
    (m,) by how much these do. widths: of the Gaussian within which a line is read (px); of a line beyond what its
    colours say (px, standard deviation); odds that it is wrong, times its density there. share (n,): of each line.
    """
    window, floor, wrong = widths
    n = len(log_p)
    expected, mean, precision = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        for k in range(6):
            left[i] += rows[i, k] * moved[k]
        expected[i] = left[i]
        for k in range(6, rows.shape[1]):
            expected[i] += rows[i, k] * moved[k]
    sites(log_p, lowest, expected, window, mean, precision)
    for i in range(n):
        left[i] -= mean[i]
        if precision[i] > 0.0:
            variance = 1.0 / max(precision[i], 1e-6) + floor * floor
            off = mean[i] - expected[i]
            odds = wrong * np.sqrt(2.0 * np.pi * variance) * np.exp(min(0.5 * off * off / variance, 50.0))
            weight[i] = share[i] / variance / (1.0 + odds)


@numba.njit(cache=True, nogil=True)
def sum_up(rows, weight, left, whole, pull):
    """Add to whole (m, m) and pull (m,) the matrix and the gradient of rows (n, m) with weight (n,) and left (n,)."""
    n, m = rows.shape
    for i in range(n):
        for a in range(m):
            scaled = weight[i] * rows[i, a]
            pull[a] += scaled * left[i]
            for b in range(a + 1):
                whole[a, b] += scaled * rows[i, b]
    for a in range(m):
        for b in range(a):
            whole[b, a] = whole[a, b]


@numba.njit(cache=True, nogil=True)
def marginalise(rows, weight, left, information, early, gradient, hessian, common):
    """Fill gradient (6,) and hessian (6, 6): what rows (n, 6 + k) with weight (n,) and left (n,), see `sum_up`, say of
    a pose's move when what they share is marginalised, k errors of which is known information (k, k), and pulled by
    early (k,). Fills common (k,): the likeliest of these where the pose stays.
    """
    size = rows.shape[1]
    k = size - 6
    whole, pull = np.zeros((size, size)), np.zeros(size)
    sum_up(rows, weight, left, whole, pull)
    # Cholesky's factor of what is known of them, and what it makes of their pull, column 0, and of their ties to a move
    factor, solved = np.zeros((k, k)), np.zeros((k, 7))
    for a in range(k):
        for b in range(a + 1):
            total = whole[6 + a, 6 + b] + information[a, b]
            for c in range(b):
                total -= factor[a, c] * factor[b, c]
            factor[a, b] = np.sqrt(total) if a == b else total / factor[b, b]
        for column in range(7):
            total = pull[6 + a] + early[a] if column == 0 else whole[6 + a, column - 1]
            for c in range(a):
                total -= factor[a, c] * solved[c, column]
            solved[a, column] = total / factor[a, a]
    for i in range(6):
        gradient[i] = pull[i]
        for c in range(k):
            gradient[i] -= solved[c, 1 + i] * solved[c, 0]
        for j in range(6):
            hessian[i, j] = whole[i, j]
            for c in range(k):
                hessian[i, j] -= solved[c, 1 + i] * solved[c, 1 + j]
    for a in range(k - 1, -1, -1):
        total = -solved[a, 0]
        for c in range(a + 1, k):
            total -= factor[c, a] * common[c]
        common[a] = total / factor[a, a]


@numba.njit(cache=True, nogil=True)
def shift_scores(table, lowest, normals, most, unknown, scores):
    """Fill scores (2 most + 1, 2 most + 1): mean over the lines of table (n, m), over offsets lowest, lowest + 1, ...
    (px), where a shift of the whole outline by (dv, du) px, rows first, moves each; unknown: outside its table.
    """
    n, m = table.shape
    for a in range(2 * most + 1):
        for b in range(2 * most + 1):
            total = 0.0
            for i in range(n):
                along = (b - most) * normals[i, 0] + (a - most) * normals[i, 1] - lowest
                j = int(np.floor(along + 0.5))
                total += table[i, j] if 0 <= j < m else unknown
            scores[a, b] = total / n


@numba.njit(cache=True, nogil=True)
def box(points, rotation, translation, camera, bounds):
    """Fill bounds (5,): least and largest u, least and largest v (px), and least depth (m) of points (n, 3) of an
    object at a pose; camera (fx, fy, cx, cy). Points that are not ahead have their depth told only.
    """
    fx, fy, cx, cy = camera
    bounds[0], bounds[1], bounds[2], bounds[3], bounds[4] = np.inf, -np.inf, np.inf, -np.inf, np.inf
    for i in range(len(points)):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        z = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c + translation[2]
        bounds[4] = min(bounds[4], z)
        if z <= 0.0:
            continue
        u = fx * (rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c + translation[0]) / z + cx
        v = fy * (rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c + translation[1]) / z + cy
        bounds[0], bounds[1] = min(bounds[0], u), max(bounds[1], u)
        bounds[2], bounds[3] = min(bounds[2], v), max(bounds[3], v)


@numba.njit(cache=True, nogil=True)
def contrasts(colours, first, levels, brightest, height, slope, change):
    """Of samples (n, k, c) of lines, levels of 255, fill levels (c, 256): how many of each channel have that level;
    brightest (256,): how many have that as their largest channel;
    height (n,) and slope (n,): how much the channel that changes most on a line changes on all of it, and in one sample
    at most; and change (n, m): over two samples on either side of the places from sample first on, in any channel.
    """
    n, k, c = colours.shape
    for i in range(n):
        for j in range(k):
            most = np.int64(0)
            for q in range(c):
                level = np.int64(colours[i, j, q])
                levels[q, level] += 1
                most = max(most, level)
            brightest[most] += 1
        height[i] = -1.0
        for q in range(c):
            low, high, steepest = np.int64(255), np.int64(0), np.int64(0)
            for j in range(k):
                value = np.int64(colours[i, j, q])
                low, high = min(low, value), max(high, value)
                if j >= 2:
                    steepest = max(steepest, abs(value - np.int64(colours[i, j - 2, q])))
            if high - low > height[i]:
                height[i], slope[i] = high - low, 0.5 * steepest
        for j in range(change.shape[1]):
            at, most = first + j, np.int64(0)
            for q in range(c):
                before = np.int64(colours[i, at, q]) + np.int64(colours[i, at + 1, q])
                after = np.int64(colours[i, at + 3, q]) + np.int64(colours[i, at + 4, q])
                most = max(most, abs(after - before))
            change[i, j] = 0.5 * most


@numba.njit(cache=True, nogil=True)
def tally(bins, weight, inner, outer, sides):
    """Fill sides (2, b, g): how often each colour is among the first `inner` samples and from sample `outer` on of all
    lines' bins (n, k), where line i counts weight[i, g] for group g.
    """
    n, k = bins.shape
    for i in range(n):
        for j in range(inner):
            for g in range(weight.shape[1]):
                sides[0, bins[i, j], g] += weight[i, g]
        for j in range(outer, k):
            for g in range(weight.shape[1]):
                sides[1, bins[i, j], g] += weight[i, g]


@numba.njit(cache=True, nogil=True)
def smooth(counts, levels, room):
    """Give half of each bin's counts (2, levels^c, g) to its neighbours along every axis of colour, the outermost bins'
    own outer neighbours included. room: as counts, for working in.
    """
    sides, bins, groups = counts.shape
    stride = bins // levels
    while stride > 0:
        room[:] = counts
        for side in range(sides):
            for b in range(bins):
                level = b // stride % levels
                lower, upper = b - stride if level > 0 else b, b + stride if level < levels - 1 else b
                for g in range(groups):
                    own = room[side, lower, g] + 2.0 * room[side, b, g] + room[side, upper, g]
                    counts[side, b, g] = own / 4.0
        stride //= levels


@numba.njit(cache=True, nogil=True)
def brackets(grid, u, v):
    """Places (n, 2) of a grid of columns u (w,) and rows v (h,) that hit the object and that do not, of all neighbours
    of which one does: down and up, then to the right and to the left; and the depth (n,) of the former. grid (h, w):
    depth (m) at each, inf where it does not.
    """
    height, width = grid.shape
    hit = np.isfinite(grid)
    count = 0
    for i in range(height):
        for j in range(width):
            count += i + 1 < height and hit[i, j] != hit[i + 1, j]
            count += j + 1 < width and hit[i, j] != hit[i, j + 1]
    inner, outer, depth = np.zeros((count, 2)), np.zeros((count, 2)), np.zeros(count)
    n = 0
    for down, right in ((1, 0), (0, 1)):
        for first in (True, False):
            for i in range(height - down):
                for j in range(width - right):
                    if hit[i, j] == first and hit[i + down, j + right] != first:
                        a, b = (i, j), (i + down, j + right)
                        if not first:
                            a, b = b, a
                        inner[n, 0], inner[n, 1] = u[a[1]], v[a[0]]
                        outer[n, 0], outer[n, 1] = u[b[1]], v[b[0]]
                        depth[n] = grid[a]
                        n += 1
    return inner, outer, depth


@numba.njit(cache=True, nogil=True)
def narrow(inner, outer, middle, z, depth):
    """Halve brackets inner, outer (n, 2) of a border in place: at middle (n, 2) the object has depth z (n,), inf where
    it is not; depth (n,) is that at the inner ends.
    """
    for n in range(len(z)):
        if np.isfinite(z[n]):
            depth[n] = z[n]
            inner[n] = middle[n]
        else:
            outer[n] = middle[n]


@numba.njit(cache=True, nogil=True)
def rays_through(places, camera, rotation, origin, rays):
    """Fill rays (n, 6) float32: origin (3,), and directions through places (n, 2) px whose depth grows by 1 along them,
    turned by rotation (3, 3) from the camera's frame; camera (fx, fy, cx, cy).
    """
    fx, fy, cx, cy = camera
    for i in range(len(places)):
        x, y = (places[i, 0] - cx) / fx, (places[i, 1] - cy) / fy
        for j in range(3):
            rays[i, j] = origin[j]
            rays[i, 3 + j] = rotation[j, 0] * x + rotation[j, 1] * y + rotation[j, 2]


@numba.njit(cache=True, nogil=True)
def spreads(places, reach, found):
    """Fill found (n, 4): how many places (n, 2) are within reach (px) of each along both axes of the image, itself
    included, and their variances and covariance there, uu, vv and uv.
    """
    for i in range(len(places)):
        count, u, v, uu, vv, uv = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(len(places)):
            a, b = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1]
            if abs(a) < reach and abs(b) < reach:
                count += 1
                u += a
                v += b
                uu += a * a
                vv += b * b
                uv += a * b
        found[i, 0] = count
        found[i, 1] = uu / count - (u / count) ** 2
        found[i, 2] = vv / count - (v / count) ** 2
        found[i, 3] = uv / count - (u / count) * (v / count)


@numba.njit(cache=True, nogil=True)
def misfit(off, weight, share, alone, block, fitted, ratio, information):
    """How many times the variance of lines (n,), off by so many px, is what their weights say, by the median line, 1 at
    least; ratio[0]. Fills information (b,) of blocks of the image with what their lines tell then, were neighbours no
    more alike than these; ratio[1]: variance (px^2) of what whole blocks are off by beyond that, 0 at least, when
    `fitted` of them are used up (the method of moments; DerSimonian and Laird 1986); ratio[2]: blocks beyond these.

    share: what the weights count neighbours by now, alone: without what was found before; block (n,) of each line.
    """
    scatter = np.zeros(len(off))
    pulls = np.zeros(len(information))
    count = 0
    for i in range(len(off)):
        if weight[i] > 0.0:
            scatter[count] = weight[i] / share[i] * off[i] ** 2
            count += 1
    # of a square whose mean is 1, by its median: 1 / 0.6745^2
    ratio[0] = max(1.0, np.median(scatter[:count]) * 2.198) if count else 1.0
    for i in range(len(off)):
        own = weight[i] * alone[i] / share[i] / ratio[0]
        information[block[i]] += own
        pulls[block[i]] += own * off[i]
    total, squares, misfit, some = 0.0, 0.0, 0.0, 0
    for b in range(len(information)):
        if information[b] > 0.0:
            total += information[b]
            squares += information[b] ** 2
            misfit += pulls[b] ** 2 / information[b]
            some += 1
    ratio[2] = max(some - fitted, 0)
    apart = total - squares / total if total > 0.0 else 0.0
    ratio[1] = max(0.0, misfit - ratio[2]) / apart if apart > 1e-9 and some > fitted else 0.0


@numba.njit(cache=True, nogil=True)
def temper(off, weight, share, alone, block, fitted, prior, ratio, information):
    """Make lines (n,) less sure in place, share and weight, by what `misfit` finds of them, and those of a block no
    surer together than blocks disagree: as this frame shows it, and as `prior` says, its variance (px^2) and how many
    blocks that is worth. ratio and information: see `misfit`.
    """
    misfit(off, weight, share, alone, block, fitted, ratio, information)
    variance, count = prior
    apart = (count * variance + ratio[2] * ratio[1]) / (count + ratio[2])
    for i in range(len(off)):
        own = alone[i] / ratio[0] / (1.0 + apart * information[block[i]])
        weight[i] *= own / share[i]
        share[i] = own


@numba.njit(cache=True, nogil=True)
def neighbours(places, reach, count):
    """Fill count (n,): how many places (n, 2) are within reach (px) of each, itself included."""
    for i in range(len(places)):
        near = 0
        for j in range(len(places)):
            a, b = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1]
            if a * a + b * b < reach * reach:
                near += 1
        count[i] = near
