"""Compiled Levenberg-Marquardt on poses: many starts, each worked by one thread from its first step to its last.

So sums have one order, and bits do not depend on the number of threads.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scenes._numba import LENT
from scenes.evidence.block_kernels import blocks_of, near_blocks
from scenes.evidence.kernels import sort_rows, table_terms, working_room
from scenes.geometry.rotation_kernels import exp_times

# Levenberg-Marquardt: start, factors and limits of the damping (relative to the Hessian's own diagonal).
DAMPING_START = 1e-3
DAMPING_DOWN = 0.25
DAMPING_UP = 6.0
DAMPING_MAX = 1e8

# One-sided rows farther outside the surface than this (m) are left out while a pose stays near: most of the space that
# was seen to be empty is far from every pose that is tried.
REACH = 0.02
# By how much more than its own motion a point's distance in the lattice may change: a difference of distances along
# each axis is at most the way, so that a gradient of interpolated ones is at most the root of three long.
STEEPEST = 1.75


@numba.njit(cache=True, nogil=True, **LENT)
def solve(hessian, gradient, damping, floor, factor, step):
    """Step = -(H + damping diag(H) + floor)^-1 gradient by Cholesky; False when not positive definite."""
    for i in range(6):
        for j in range(i + 1):
            total = hessian[i, j]
            if i == j:
                total += damping * hessian[i, i] + floor[i]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                if not total > 1e-12 * (hessian[i, i] + floor[i]):
                    return False
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(6):
        total = -gradient[i]
        for k in range(i):
            total -= factor[i, k] * step[k]
        step[i] = total / factor[i, i]
    for i in range(5, -1, -1):
        total = step[i]
        for k in range(i + 1, 6):
            total -= factor[k, i] * step[k]
        step[i] = total / factor[i, i]
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy", **LENT)
def eliminate(matrix, vector):
    """Solve matrix (n, n) x = vector (n,) by elimination with pivots, in place: vector becomes x."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        for j in range(k, n):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        vector[k], vector[pivot] = vector[pivot], vector[k]
        for i in range(k + 1, n):
            share = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, n):
                matrix[i, j] -= share * matrix[k, j]
            vector[i] -= share * vector[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            vector[k] -= matrix[k, j] * vector[j]
        vector[k] /= matrix[k, k]


@numba.njit(cache=True, nogil=True)
def align_poses(lattice, rows, stage, prior, limits, rotations, middles, costs, hessians, used):
    """Levenberg-Marquardt on poses, in place: rotations (b, 3, 3), middles (b, 3) -> costs (b,), hessians (b, 6, 6).

    Stops at `iterations` tried steps, or when a step turns less than tolerance_angle (rad) and moves less than
    tolerance_distance (m). Steps are shortened to longest_angle and longest_distance. radius (m) of the object scales
    the floor of the damping, so that directions without information stay put. A step that raises the cost is undone.
    rows, stage, lattice, prior: see kernels.cost_poses; limits: the numbers named here, in their order.
    """
    blur, blur_normal, huber, bend = stage
    contacts, speaking, told, silent, quiet = sort_rows(rows, blur, blur_normal)
    space = np.zeros((3, 6, 6)), np.zeros((4, 6)), np.zeros((3, 3)), np.zeros(3)
    _align_each(
        lattice,
        (contacts, speaking, told),
        (silent, quiet, blocks_of(quiet)),
        (huber, bend),
        prior,
        limits,
        working_room(),
        space,
        rotations,
        middles,
        costs,
        hessians,
        used,
    )


@numba.njit(cache=True, nogil=True, **LENT)
def _align_each(lattice, table, quiet, losses, prior, limits, room, space, rotations, middles, costs, hessians, used):
    """align_poses, of a table that is sorted: see kernels.table_terms. quiet: silent rows in blocks, how many, and room
    for those that are near. space (3, 6, 6), (4, 6), (3, 3), (3,): to work in.
    """
    iterations, tolerance_angle, tolerance_distance, radius, longest_angle, longest_distance = limits
    silent, quiet_ones, near = quiet
    matrices, vectors, rotation, middle = space
    hessian, new_hessian, factor = matrices[0], matrices[1], matrices[2]
    gradient, new_gradient, step, floor = vectors[0], vectors[1], vectors[2], vectors[3]
    _, rooms, nodes, _, _ = room
    for b in range(rotations.shape[0]):
        k, lever = near_blocks(lattice, silent, quiet_ones, rotations[b], middles[b], REACH, rooms, nodes, near)
        # how far (m) a row left out may have come since
        spent = 0.0
        pose = rotations[b], middles[b]
        cost = table_terms(lattice, table, (near, k), losses, pose, prior, True, (hessian, gradient), room)
        damping = DAMPING_START
        count = 0
        while count < iterations:
            count += 1
            largest = 0.0
            for i in range(3):
                largest = max(largest, hessian[i, i] / (radius * radius), hessian[3 + i, 3 + i])
            if largest <= 0.0:
                break  # no row has anything to say here
            for i in range(3):
                floor[i] = 1e-9 * largest * radius * radius
                floor[3 + i] = 1e-9 * largest
            if not solve(hessian, gradient, damping, floor, factor, step):
                damping = max(damping, 1e-6) * DAMPING_UP
                if damping > DAMPING_MAX:
                    break
                continue
            angle = math.sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
            distance = math.sqrt(step[3] * step[3] + step[4] * step[4] + step[5] * step[5])
            shorten = 1.0
            if angle > longest_angle:
                shorten = longest_angle / angle
            if distance * shorten > longest_distance:
                shorten = longest_distance / distance
            for i in range(6):
                step[i] *= shorten
            exp_times(step, rotations[b], rotation)
            for i in range(3):
                middle[i] = middles[b, i] + step[3 + i]
            travel = shorten * (angle * (lever + spent) + distance)
            begun = STEEPEST * (spent + travel) > REACH
            if begun:
                k, lever = near_blocks(lattice, silent, quiet_ones, rotation, middle, REACH, rooms, nodes, near)
            pose, derivatives = (rotation, middle), (new_hessian, new_gradient)
            new_cost = table_terms(lattice, table, (near, k), losses, pose, prior, True, derivatives, room)
            if new_cost <= cost:
                spent = 0.0 if begun else spent + travel
                gain = cost - new_cost
                cost = new_cost
                for i in range(3):
                    middles[b, i] = middle[i]
                    for j in range(3):
                        rotations[b, i, j] = rotation[i, j]
                for i in range(6):
                    gradient[i] = new_gradient[i]
                    for j in range(6):
                        hessian[i, j] = new_hessian[i, j]
                damping = max(damping * DAMPING_DOWN, 1e-9)
                if angle * shorten < tolerance_angle and distance * shorten < tolerance_distance:
                    break
                if gain < 1e-10 * (1.0 + cost) and shorten == 1.0 and damping < 1e-2:
                    break
            else:
                # the pose stays; what is active was chosen about the one that was tried
                spent = travel if begun else spent
                damping *= DAMPING_UP
                if damping > DAMPING_MAX or (angle < tolerance_angle and distance < tolerance_distance):
                    break
        costs[b] = cost
        used[b] = count
        for i in range(6):
            for j in range(6):
                hessians[b, i, j] = hessian[i, j]


@numba.njit(cache=True, nogil=True)
def align_each(lattice, rows, edges, stage, prior, limits, rotations, middles, costs, hessians, used):
    """`align_poses` of poses that have a table each: rows[edges[k] : edges[k + 1]] of pose k; edges (b + 1,)."""
    for b in range(rotations.shape[0]):
        one = slice(b, b + 1)
        own = rows[edges[b] : edges[b + 1]]
        align_poses(
            lattice, own, stage, prior, limits, rotations[one], middles[one], costs[one], hessians[one], used[one]
        )
