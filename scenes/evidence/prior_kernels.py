"""The compiled prior: value, gradient and Hessian of a Gaussian on a pose."""

from __future__ import annotations

import math

import numba

from scenes._numba import LENT
from scenes.geometry.rotation_kernels import log_rotation


@numba.njit(cache=True, nogil=True, **LENT)
def prior_terms(rotation, middle, prior, need, hessian, gradient, scratch):
    """Half the squared Mahalanobis distance to the prior; its derivative uses the inverse left Jacobian of SO(3).

    prior: its rotation (3, 3), middle (3,) and information (6, 6). Adds to gradient and the lower half of hessian.
    scratch (10, 3): working room.
    """
    prior_rotation, prior_middle, information = prior
    any_information = 0.0
    for i in range(6):
        any_information += information[i, i]
    if any_information == 0.0:
        return 0.0
    relative = scratch[1:4]
    for i in range(3):
        for j in range(3):
            relative[i, j] = (
                rotation[i, 0] * prior_rotation[j, 0]
                + rotation[i, 1] * prior_rotation[j, 1]
                + rotation[i, 2] * prior_rotation[j, 2]
            )
    delta = scratch[7:9].reshape(6)
    phi = scratch[0]
    log_rotation(relative, phi)
    for i in range(3):
        delta[i] = phi[i]
        delta[3 + i] = middle[i] - prior_middle[i]
    total = 0.0
    for i in range(6):
        for j in range(6):
            total += 0.5 * delta[i] * information[i, j] * delta[j]
    if not need:
        return total
    square = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    angle = math.sqrt(square)
    if square < 1e-6:
        k = 1.0 / 12.0
    else:
        half = 0.5 * angle
        # (1 - half cot half) / angle^2; at angle = pi the cotangent is 0
        k = (1.0 - half * math.cos(half) / math.sin(half)) / square
    # the inverse left Jacobian, of the turn; that of the displacement is the identity
    jac = scratch[1:4]
    for i in range(3):
        for j in range(3):
            jac[i, j] = k * phi[i] * phi[j]
        jac[i, i] += 1.0 - k * square
    jac[0, 1] += 0.5 * phi[2]
    jac[0, 2] -= 0.5 * phi[1]
    jac[1, 0] -= 0.5 * phi[2]
    jac[1, 2] += 0.5 * phi[0]
    jac[2, 0] += 0.5 * phi[1]
    jac[2, 1] -= 0.5 * phi[0]
    for i in range(6):
        along = 0.0
        for j in range(6):
            along += information[i, j] * delta[j]
        if i < 3:
            for a in range(3):
                gradient[a] += jac[i, a] * along
        else:
            gradient[i] += along
    turned = scratch[4:7]
    for a in range(3):
        for j in range(3):
            turned[j, a] = jac[0, a] * information[0, j] + jac[1, a] * information[1, j] + jac[2, a] * information[2, j]
    for a in range(3):
        for b in range(a + 1):
            hessian[a, b] += turned[0, a] * jac[0, b] + turned[1, a] * jac[1, b] + turned[2, a] * jac[2, b]
        for b in range(3):
            for i in range(3):
                hessian[3 + b, a] += information[3 + b, i] * jac[i, a]
            if b <= a:
                hessian[3 + a, 3 + b] += information[3 + a, 3 + b]
    return total
