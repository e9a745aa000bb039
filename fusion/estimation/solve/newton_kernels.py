"""The compiled joint solution: all terms of a system in one pass over its rows, and Gauss-Newton steps on them.

Unknowns (m,): turn and move of the pose, the whitened calibration, scale and bias (see fusion.estimation.solve.joint).
Only lower triangles are added up, four rows at a time, so that what is added to stays in registers.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from fusion.estimation.solve.considered_kernels import add_of_pose, confounded
from fusion.estimation.solve.kernels import prior_row, touch_rows, vision_rows
from scenes._numba import FUSED, LENT
from scenes.geometry.rotation_kernels import exp_times

# Unknowns before the scale: pose and calibration; what pixels tell of the pose, and of pose and scale.
BEFORE, POSE, FIRST = 12, 6, 7
# Added to a unit diagonal: keeps the factor of a singular system finite, and changes no digit of another.
JITTER = 1e-9
# Longest step: rad, and as a share of the object's radius; and where steps end (rad, m).
LONGEST, SHORTEST_TURN, SHORTEST_MOVE = 0.3, 1e-5, 1e-6


@numba.njit(cache=True, nogil=True, **LENT)
def factorize(a, n):
    """Cholesky of the symmetric a (n, n), upper triangle in place: a = U^T U; False where it is not positive.

    Four pivots at a time, so that what they are taken off is fetched and put back once; each number's differences are
    taken in the order of the pivots, as one by one.
    """
    for k in range(0, n, 4):
        end = min(k + 4, n)
        for p in range(k, end):
            pivot = a[p, p]
            if not pivot > 0.0:
                return False
            root = math.sqrt(pivot)
            for j in range(p, n):
                a[p, j] /= root
            for i in range(p + 1, end):
                factor = a[p, i]
                for j in range(i, n):
                    a[i, j] -= factor * a[p, j]
        for i in range(end, n):
            f0, f1, f2, f3 = a[k, i], a[k + 1, i], a[k + 2, i], a[k + 3, i]
            for j in range(i, n):
                a[i, j] = a[i, j] - f0 * a[k, j] - f1 * a[k + 1, j] - f2 * a[k + 2, j] - f3 * a[k + 3, j]
    return True


@numba.njit(cache=True, nogil=True, **LENT)
def solved(u, n, x):
    """Solve U^T U x = x in place, of the first n unknowns."""
    for i in range(n):
        x[i] /= u[i, i]
        for j in range(i + 1, n):
            x[j] -= u[i, j] * x[i]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for j in range(i + 1, n):
            total -= u[i, j] * x[j]
        x[i] = total / u[i, i]


@numba.njit(cache=True, nogil=True, fastmath=FUSED, **LENT)
def add_products(design, information, residuals, count, normal, gradient):
    """Add design^T diag(information) design to the lower triangle of normal, and its product with residuals to
    gradient, over the first `count` rows. What is beside the diagonal, above it, is not told.

    Two lines of normal at a time, so that each part of a row is fetched half as often.
    """
    m = design.shape[1]
    n = 0
    while n + 4 <= count:
        q0, q1, q2, q3 = information[n], information[n + 1], information[n + 2], information[n + 3]
        r0, r1, r2, r3 = residuals[n], residuals[n + 1], residuals[n + 2], residuals[n + 3]
        for i in range(0, m - 1, 2):
            k = i + 1
            c0, c1, c2, c3 = design[n, i] * q0, design[n + 1, i] * q1, design[n + 2, i] * q2, design[n + 3, i] * q3
            e0, e1, e2, e3 = design[n, k] * q0, design[n + 1, k] * q1, design[n + 2, k] * q2, design[n + 3, k] * q3
            gradient[i] += c0 * r0 + c1 * r1 + c2 * r2 + c3 * r3
            gradient[k] += e0 * r0 + e1 * r1 + e2 * r2 + e3 * r3
            for j in range(k + 1):
                d0, d1, d2, d3 = design[n, j], design[n + 1, j], design[n + 2, j], design[n + 3, j]
                normal[i, j] += c0 * d0 + c1 * d1 + c2 * d2 + c3 * d3
                normal[k, j] += e0 * d0 + e1 * d1 + e2 * d2 + e3 * d3
        if m % 2:
            i = m - 1
            c0, c1, c2, c3 = design[n, i] * q0, design[n + 1, i] * q1, design[n + 2, i] * q2, design[n + 3, i] * q3
            gradient[i] += c0 * r0 + c1 * r1 + c2 * r2 + c3 * r3
            for j in range(m):
                normal[i, j] += (
                    c0 * design[n, j] + c1 * design[n + 1, j] + c2 * design[n + 2, j] + c3 * design[n + 3, j]
                )
        n += 4
    for k in range(n, count):
        for i in range(m):
            c = design[k, i] * information[k]
            gradient[i] += c * residuals[k]
            for j in range(i + 1):
                normal[i, j] += c * design[k, j]


@numba.njit(cache=True, nogil=True, **LENT)
def bias_of(seen_white, whitened, bias):
    """Fill bias (n,) with what the whitened unknowns (k,) of it make at rows seen_white (n, k): four rows at a time,
    since one waits for each of its own sums.
    """
    n, count = 0, seen_white.shape[0]
    while n + 4 <= count:
        b0 = b1 = b2 = b3 = 0.0
        for j in range(seen_white.shape[1]):
            own = whitened[j]
            b0 += seen_white[n, j] * own
            b1 += seen_white[n + 1, j] * own
            b2 += seen_white[n + 2, j] * own
            b3 += seen_white[n + 3, j] * own
        bias[n], bias[n + 1], bias[n + 2], bias[n + 3] = b0, b1, b2, b3
        n += 4
    for k in range(n, count):
        bias[k] = 0.0
        for j in range(seen_white.shape[1]):
            bias[k] += seen_white[k, j] * whitened[j]


@numba.njit(cache=True, nogil=True, **LENT)
def design_of(index, jac, along, seen_white, scale, count, design):
    """Fill design (n, 7 + k): what pixels say of (turn, move), the whitened scale and bias; see vision_rows."""
    for n in range(count):
        for i in range(6):
            design[n, i] = jac[n, i]
        design[n, 6] = jac[n, 6] * scale
        row = index[n]
        for j in range(seen_white.shape[1]):
            design[n, FIRST + j] = along[n] * seen_white[row, j]


@numba.njit(cache=True, nogil=True)
def terms(scene, seen, touch, hand, room, rotation, middle, unknown, normal, gradient):
    """Cost of a system, what of it the vision rows say, and how many of these count; fills normal (m, m) and gradient
    (m,).

    scene: lattice, prior, a prior that says nothing, least cosine, whether there is a camera, bend of contacts, whether
    pixels tell of scale and bias no more than a pose explains (`confounded`): the gradient is then not the cost's.
    seen: rows, floors, is_pixel, sigma, weight, normals, slope as of vision_rows, the whitened bias (n, k) of every row
    and the whitening of the scale. touch: prepared rows, whitening (6, 6) of the calibration and its centre (3,). hand:
    constant, gradient and normal matrix of its pixels in the whitened (calibration, scale, bias), of no length for
    none. room: what vision_rows fills, and design (n, 7 + k).
    """
    desk = working_desk(seen)
    total, seen_cost, count = cost_at(scene, seen, touch, hand, room, desk, rotation, middle, unknown)
    derive(scene, seen, touch, hand, room, desk, count, middle, unknown, normal, gradient)
    return total, seen_cost, count


@numba.njit(cache=True, nogil=True)
def working_desk(seen):
    """What `cost_at` leaves to `derive`: bias (n,) of the rows; matrix and gradient of what touch says, and the prior;
    and two of each as long as the design is wide.
    """
    c = FIRST + seen[7].shape[1]
    square, line = np.zeros((2, 6, 6)), np.zeros((2, 6))
    return np.zeros(seen[0].shape[0]), (square, line), (np.zeros((c, c)), np.zeros(c))


@numba.njit(cache=True, nogil=True)
def lay(scene, seen, room, rotation, middle, unknown):
    """Fill the room as `terms` does; returns what the vision rows cost, and how many of them count."""
    bias = np.zeros(seen[0].shape[0])
    cost, count = _rows_at(scene, seen, room, bias, rotation, middle, unknown)
    design_of(room[0], room[1], room[2], seen[7], seen[8], count, room[5])
    return cost, count


@numba.njit(cache=True, nogil=True)
def _rows_at(scene, seen, room, bias, rotation, middle, unknown):
    """Cost of the vision rows, and how many of them count; fills the room but for the design."""
    lattice, _, _, least_cosine, has_camera, _, _ = scene
    rows, floors, is_pixel, sigma, weight, normals, slope, seen_white, scale = seen
    index, jac, along, residuals, information, _ = room
    if not rows.shape[0]:
        return 0.0, 0
    bias_of(seen_white, unknown[BEFORE + 1 :], bias)
    return vision_rows(
        lattice,
        rows,
        floors,
        is_pixel,
        sigma,
        weight,
        normals,
        slope,
        least_cosine,
        has_camera,
        rotation,
        middle,
        scale * unknown[BEFORE],
        bias,
        index,
        jac,
        along,
        residuals,
        information,
    )


@numba.njit(cache=True, nogil=True)
def cost_at(scene, seen, touch, hand, room, desk, rotation, middle, unknown):
    """What `terms` returns; fills the room but for the design, and the desk, from which `derive` goes on: a step that
    is refused needs no derivatives.
    """
    lattice, prior, no_prior, _, _, bend, _ = scene
    felt, white_xi, centre = touch
    bias, (squares, lines), _ = desk
    total = 0.0
    for i in range(POSE, unknown.shape[0]):
        total += 0.5 * unknown[i] * unknown[i]
    seen_cost, count = _rows_at(scene, seen, room, bias, rotation, middle, unknown)
    total += seen_cost
    if felt.shape[0]:
        xi = np.zeros(6)
        for i in range(6):
            for j in range(6):
                xi[i] += white_xi[i, j] * unknown[POSE + j]
        scratch = np.zeros((10, 3))
        total += touch_rows(lattice, felt, bend, rotation, middle, xi, centre, no_prior, squares[0], lines[0], scratch)
    constant, hand_gradient, hand_normal = hand
    if hand_gradient.shape[0]:
        total += constant
        for i in range(hand_gradient.shape[0]):
            along_x = 0.0
            for j in range(hand_gradient.shape[0]):
                along_x += hand_normal[i, j] * unknown[POSE + j]
            total += unknown[POSE + i] * (hand_gradient[i] + 0.5 * along_x)
    total += prior_row(rotation, middle, prior, squares[1], lines[1])
    return total, seen_cost, count


@numba.njit(cache=True, nogil=True)
def derive(scene, seen, touch, hand, room, desk, count, middle, unknown, normal, gradient):
    """Fill normal (m, m) and gradient (m,) where `cost_at` last was, of which `count` vision rows count."""
    considered = scene[6]
    seen_white, scale = seen[7], seen[8]
    index, jac, along, residuals, information, design = room
    _, (squares, lines), (part, pull) = desk
    m = unknown.shape[0]
    for i in range(m):
        gradient[i] = unknown[i] if i >= POSE else 0.0
        for j in range(m):
            normal[i, j] = 0.0
        if i >= POSE:
            normal[i, i] = 1.0
    if seen[0].shape[0]:
        design_of(index, jac, along, seen_white, scale, count, design)
        part[:], pull[:] = 0.0, 0.0
        if considered:
            add_of_pose(design, information, residuals, count, part[:POSE], pull[:POSE])
            confounded(part, pull)
        else:
            add_products(design, information, residuals, count, part, pull)
        for i in range(design.shape[1]):
            a = i if i < POSE else i + POSE
            gradient[a] += pull[i]
            for j in range(i + 1):
                normal[a, j if j < POSE else j + POSE] += part[i, j]
    if touch[0].shape[0]:
        _add_touch(squares[0], lines[0], middle, touch[1], touch[2], normal, gradient)
    _, hand_gradient, hand_normal = hand
    for i in range(hand_gradient.shape[0]):
        along_x = 0.0
        for j in range(hand_gradient.shape[0]):
            along_x += hand_normal[i, j] * unknown[POSE + j]
        gradient[POSE + i] += hand_gradient[i] + along_x
        for j in range(i + 1):
            normal[POSE + i, POSE + j] += hand_normal[i, j]
    for i in range(6):
        gradient[i] += lines[1, i]
        for j in range(i + 1):
            normal[i, j] += squares[1, i, j]
    for i in range(m):
        for j in range(i):
            normal[j, i] = normal[i, j]


@numba.njit(cache=True, nogil=True)
def _add_touch(hessian, slope, middle, white_xi, centre, normal, gradient):
    """Add what touch says of pose and whitened calibration, of hessian (6, 6) and slope (6,) by the pose. Moving all
    contacts by the calibration's correction is moving the object back, about the calibration's centre.
    """
    x, y, z = middle[0] - centre[0], middle[1] - centre[1], middle[2] - centre[2]
    chain = np.zeros((6, 12))
    for i in range(6):
        chain[i, i] = 1.0
        for j in range(6):
            chain[i, POSE + j] = -white_xi[i, j]
    for j in range(6):
        # the lever -[middle - centre]x in the rows of the move
        chain[3, POSE + j] -= z * white_xi[1, j] - y * white_xi[2, j]
        chain[4, POSE + j] -= x * white_xi[2, j] - z * white_xi[0, j]
        chain[5, POSE + j] -= y * white_xi[0, j] - x * white_xi[1, j]
    product = np.zeros((6, 12))
    for i in range(6):
        for k in range(6):
            for j in range(12):
                product[i, j] += hessian[i, k] * chain[k, j]
    for i in range(12):
        for k in range(6):
            gradient[i] += chain[k, i] * slope[k]
            for j in range(i + 1):
                normal[i, j] += chain[k, i] * product[k, j]


@numba.njit(cache=True, nogil=True)
def descend(scene, seen, touch, hand, room, limits, width, rotation, middle, unknown, normal, gradient):
    """Gauss-Newton in place on rotation (3, 3), middle (3,) of the centroid and unknown (m,), of which the first six
    stay zero; fills normal and gradient there. Returns (cost, log determinant of what is solved for, what the vision
    rows cost where the room was filled last, how many of them count there, whether that is where this ends).

    limits: how many unknowns are solved for, steps, gain (nats) below which none is taken, how many may be refused, and
    the object's radius (m). width (m,): information believed of the pose beside the prior. Where pixels do not tell of
    scale and bias by their cost (see `terms`) these are solved for after pose and calibration, by as many steps more,
    none of which the cost refuses.
    """
    free, steps, worth, most_refused, radius = limits
    m = unknown.shape[0]
    desk = working_desk(seen)
    cost, seen_cost, count = cost_at(scene, seen, touch, hand, room, desk, rotation, middle, unknown)
    derive(scene, seen, touch, hand, room, desk, count, middle, unknown, normal, gradient)
    damping, refused, there = 1e-6, 0, True
    damped, step = np.zeros((m, m)), np.zeros(m)
    new_rotation, new_middle, new_unknown = np.zeros((3, 3)), np.zeros(3), np.zeros(m)
    considered = scene[6] and free > BEFORE
    for whole in range(2 if considered else 1):
        now = BEFORE if considered and not whole else free
        for _ in range(steps):
            for i in range(now):
                step[i] = -gradient[i]
                for j in range(i, now):
                    damped[i, j] = normal[i, j]
                damped[i, i] += (0.0 if whole else damping) * normal[i, i] + width[i]
            if not factorize(damped, now):
                break
            solved(damped, now, step)
            turn = max(abs(step[0]), abs(step[1]), abs(step[2]))
            move = max(abs(step[3]), abs(step[4]), abs(step[5]))
            shorten = min(1.0, LONGEST / max(turn, 1e-12))
            shorten = min(shorten, LONGEST * radius / max(move, 1e-12))
            gain = 0.0
            for i in range(now):
                step[i] *= shorten
                gain -= step[i] * gradient[i]
            if gain < 2.0 * worth:
                break
            exp_times(step, rotation, new_rotation)
            for i in range(3):
                new_middle[i] = middle[i] + step[3 + i]
            for i in range(POSE, m):
                new_unknown[i] = unknown[i] + (step[i] if i < now else 0.0)
            trial, seen_cost, count = cost_at(
                scene, seen, touch, hand, room, desk, new_rotation, new_middle, new_unknown
            )
            there = whole > 0 or trial <= cost
            if there:
                cost = trial
                rotation[:], middle[:], unknown[:] = new_rotation, new_middle, new_unknown
                derive(scene, seen, touch, hand, room, desk, count, middle, unknown, normal, gradient)
                damping = max(damping * 0.1, 1e-9)
                if shorten * turn < SHORTEST_TURN and shorten * move < SHORTEST_MOVE:
                    break
            else:
                refused += 1
                if refused > most_refused:
                    break
                damping = max(damping, 1e-5) * 100.0
    # of a system of unit diagonal
    log_scales = 0.0
    for i in range(free):
        scale = 1.0 / math.sqrt(max(normal[i, i] + width[i], 1e-300))
        log_scales += math.log(scale)
        step[i] = scale
    for i in range(free):
        for j in range(i, free):
            damped[i, j] = normal[i, j] * step[i] * step[j]
        damped[i, i] += width[i] * step[i] * step[i] + JITTER
    log_det = -2.0 * log_scales
    if factorize(damped, free):
        for i in range(free):
            log_det += 2.0 * math.log(damped[i, i])
    return cost, log_det, seen_cost, count, there


@numba.njit(cache=True, nogil=True)
def left_out(design, information, residuals, group, groups, columns, whole, share, own, moved):
    """How the pose would move without each of the groups, one Gauss-Newton step away: fills moved (groups, 6); and own
    (m, m): the information of all rows. Returns whether every system could be solved.

    design (n, c), information (n,), residuals (n,): of rows; group (n,): of each, below `groups`. columns (c,): the
    unknown of each column of the design, m and more for those that are not solved for. whole (m, m): the information on
    all unknowns; share: of a group that is left out.
    """
    m, c = whole.shape[0], design.shape[1]
    parts, pulls = np.zeros((groups, c, c)), np.zeros((groups, c))
    order = np.argsort(group, kind="mergesort")
    at = 0
    rows, info, res = np.zeros_like(design), np.zeros_like(information), np.zeros_like(residuals)
    for n in range(order.shape[0]):
        rows[n], info[n], res[n] = design[order[n]], information[order[n]], residuals[order[n]]
    for g in range(groups):
        end = at
        while end < order.shape[0] and group[order[end]] == g:
            end += 1
        add_products(rows[at:end], info[at:end], res[at:end], end - at, parts[g], pulls[g])
        at = end
    left, pull = np.zeros((m, m)), np.zeros(m)
    good = True
    for g in range(groups):
        left[:], pull[:] = whole, 0.0
        for i in range(c):
            if columns[i] >= m:
                continue
            pull[columns[i]] = pulls[g, i]
            for j in range(i + 1):
                if columns[j] >= m:
                    continue
                left[columns[j], columns[i]] -= share * parts[g, i, j]
                own[columns[i], columns[j]] += parts[g, i, j]
        good = good and factorize(left, m)
        if good:
            solved(left, m, pull)
            for i in range(POSE):
                moved[g, i] = pull[i]
    for i in range(m):
        for j in range(i):
            own[j, i] = own[i, j]
    return good
