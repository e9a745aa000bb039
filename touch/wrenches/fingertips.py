"""Fingertips of other shapes than spheres: contact point, normal and moment from a wrench, compiled, in batches.

The contact obeys M = p x F + k grad S(p), S(p) = 0 (T1 eq. 2.3; Bicchi, Salisbury and Brock 1993). On an ellipsoid that
is solved by Levenberg-Marquardt. On a cylinder and on the faces of a mesh it has a closed form: a plane n.p = d gives
p = (n x M + d F) / (n.F). A soft layer that gives way by F_n / stiffness moves the surface inwards by as much before
it is solved (small deformations, Liu et al., Autonomous Robots 2015). Sensor frame; newtons, metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.threads import run_chunks
from touch.wrenches.sphere import IntrinsicSettings, sphere_contact

Array = NDArray[np.float64]

# Levenberg-Marquardt on the ellipsoid: steps, and the scaled residual at which it is solved.
STEPS = 40
SOLVED = 1e-10
# A residual above this (shares of |F| and of the fingertip's size) is no contact: the moment fits no point.
NO_CONTACT = 1e-3
# Fixed-point turns of indentation and normal force; each shrinks the error by the indentation over the radius.
SOFT_TURNS = 4
# How far (share of the size) a point may lie outside its face: gaps between the faces of a curved fingertip.
FACE_SLACK = 0.02


@dataclass(frozen=True)
class SoftSkin:
    """A compliant skin. stiffness: N/m of normal force per indentation; thickness: m, the most it can give."""

    stiffness: float
    thickness: float

    @staticmethod
    def parse(entry: dict[str, Any] | None) -> SoftSkin | None:
        """From a sensor's soft_layer; None without a stiffness. Raises InputError for values that are not positive."""
        if entry is None or "stiffness" not in entry:
            return None
        layer = SoftSkin(float(entry["stiffness"]), float(entry.get("thickness", math.inf)))
        if not (layer.stiffness > 0 and layer.thickness > 0):
            raise InputError(f"soft_layer: expected stiffness and thickness above 0, got {entry}")
        return layer


@dataclass(frozen=True)
class TipContacts:
    """points (n, 3) m on the surface as pressed; normals (n, 3) out of the finger; moments (n,) N m about them;
    pressing (n,) N, normal force into the finger; friction (n, 3) N, the force's tangential part; valid (n,).
    """

    points: Array
    normals: Array
    moments: Array
    pressing: Array
    friction: Array
    valid: NDArray[np.bool_]


def tip_contacts(
    force: ArrayLike, torque: ArrayLike, surface: dict[str, dict[str, Any]], soft_layer: SoftSkin | None = None
) -> TipContacts:
    """Contacts of wrenches: force (n, 3) N that the object does to the finger, torque (n, 3) N m about the origin.

    surface as in sensors.json: sphere, ellipsoid, cylinder (along z, with flat ends) or mesh, whose entry holds
    "vertices" (v, 3) and "faces" (f, 3), convex, wound outwards. Not valid: zero and pulling forces, wrenches that no
    press on the surface makes. Raises InputError for other surfaces.
    """
    force = np.ascontiguousarray(np.atleast_2d(np.asarray(force, dtype=np.float64)))
    torque = np.ascontiguousarray(np.atleast_2d(np.asarray(torque, dtype=np.float64)))
    finite = np.isfinite(force).all(axis=1) & np.isfinite(torque).all(axis=1)
    force, torque = np.where(finite[:, None], force, 0.0), np.where(finite[:, None], torque, 0.0)
    indentation = np.zeros(len(force))
    points, normals, valid = _solve(force, torque, surface, indentation)
    if soft_layer is not None:
        for _ in range(SOFT_TURNS):
            pressing = -np.einsum("ni,ni->n", force, normals)
            indentation = np.clip(pressing / soft_layer.stiffness, 0.0, soft_layer.thickness)
            points, normals, valid = _solve(force, torque, surface, indentation)
    pressing = -np.einsum("ni,ni->n", force, normals)
    moments = np.einsum("ni,ni->n", torque - np.cross(points, force), normals)
    settings = IntrinsicSettings()
    valid &= finite & (np.einsum("ni,ni->n", force, force) > settings.smallest_force**2) & (pressing > 0)
    return TipContacts(points, normals, moments, pressing, force + pressing[:, None] * normals, valid)


def _solve(
    force: Array, torque: Array, surface: dict[str, dict[str, Any]], indentation: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points, normals, valid on the surface moved inwards by indentation (n,), m."""
    kind, values = next(iter(surface.items()))
    n = len(force)
    points, normals, valid = np.zeros((n, 3)), np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros(n, dtype=np.bool_)
    if kind == "sphere":
        return _on_sphere(force, torque, float(values["radius"]), indentation)
    if kind == "ellipsoid":
        radii = np.array(values["radii"], dtype=np.float64)

        def work(part: slice) -> None:
            out = points[part], normals[part], valid[part]
            ellipsoid_kernel(force[part], torque[part], radii, indentation[part], *out)

    elif kind == "cylinder":
        radius, length = float(values["radius"]), float(values["length"])

        def work(part: slice) -> None:
            out = points[part], normals[part], valid[part]
            cylinder_kernel(force[part], torque[part], radius, length, indentation[part], *out)

    elif kind == "mesh" and "vertices" in values:
        corners, planes, offsets = _faces(values)
        size = float(np.linalg.norm(corners.reshape(-1, 3), axis=1).max())

        def work(part: slice) -> None:
            out = points[part], normals[part], valid[part]
            mesh_kernel(force[part], torque[part], corners, planes, offsets, size, indentation[part], *out)

    else:
        raise InputError(f"fingertip: expected a sphere, ellipsoid, cylinder or a mesh with its vertices, got {kind}")
    run_chunks(work, n, smallest=200)
    return points, normals, valid


def _on_sphere(
    force: Array, torque: Array, radius: float, indentation: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The closed form of a sphere; wrenches are scaled to one radius, because the answer scales with it."""
    scale = radius / np.maximum(radius - indentation, 1e-9 * radius)
    points, _, valid = sphere_contact(force, torque * scale[:, None], radius)
    return points / scale[:, None], points / radius, valid


def _faces(values: dict[str, Any]) -> tuple[Array, Array, Array]:
    vertices = np.asarray(values["vertices"], dtype=np.float64)
    faces = np.asarray(values["faces"], dtype=np.int64)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    good = length > 1e-14
    normals = cross[good] / length[good, None]
    return np.ascontiguousarray(corners[good]), normals, np.einsum("ni,ni->n", normals, corners[good][:, 0])


@numba.njit(cache=True, nogil=True)
def _solve4(a: Array, b: Array) -> bool:
    """Gauss elimination with pivoting of a (4, 4), b (4,) in place; False when singular."""
    for i in range(4):
        p = i
        for r in range(i + 1, 4):
            if abs(a[r, i]) > abs(a[p, i]):
                p = r
        if abs(a[p, i]) < 1e-300:
            return False
        if p != i:
            for c in range(4):
                a[i, c], a[p, c] = a[p, c], a[i, c]
            b[i], b[p] = b[p], b[i]
        for r in range(i + 1, 4):
            f = a[r, i] / a[i, i]
            for c in range(i, 4):
                a[r, c] -= f * a[i, c]
            b[r] -= f * b[i]
    for i in range(3, -1, -1):
        for c in range(i + 1, 4):
            b[i] -= a[i, c] * b[c]
        b[i] /= a[i, i]
    return True


@numba.njit(cache=True, nogil=True)
def _residuals(x: Array, f: Array, m: Array, d: Array, out: Array) -> float:
    """T1 eq. 2.3, scaled: x = (p, k), unit force f, moment m, ellipsoid sum d_i p_i^2 = 1. Returns the squared norm."""
    out[0] = x[3] * d[0] * x[0] + x[1] * f[2] - x[2] * f[1] - m[0]
    out[1] = x[3] * d[1] * x[1] + x[2] * f[0] - x[0] * f[2] - m[1]
    out[2] = x[3] * d[2] * x[2] + x[0] * f[1] - x[1] * f[0] - m[2]
    out[3] = 0.5 * (d[0] * x[0] * x[0] + d[1] * x[1] * x[1] + d[2] * x[2] * x[2] - 1.0)
    return out[0] * out[0] + out[1] * out[1] + out[2] * out[2] + out[3] * out[3]


@numba.njit(cache=True, nogil=True)
def ellipsoid_kernel(
    force: Array,
    torque: Array,
    radii: Array,
    indentation: Array,
    points: Array,
    normals: Array,
    valid: NDArray[np.bool_],
) -> None:
    """Levenberg-Marquardt on T1 eq. 2.3 for every wrench, from where the line of force enters the ellipsoid."""
    x, trial, r, s = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4)
    jacobian, normal, b = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros(4)
    f, m, d = np.zeros(3), np.zeros(3), np.zeros(3)
    for n in range(force.shape[0]):
        size = math.sqrt(force[n, 0] ** 2 + force[n, 1] ** 2 + force[n, 2] ** 2)
        if size == 0.0:
            continue
        scale = radii.max()
        for i in range(3):
            f[i] = force[n, i] / size
            m[i] = torque[n, i] / (size * scale)
            d[i] = (scale / max(radii[i] - indentation[n], 1e-6 * scale)) ** 2
        # the line of force passes through f x m; where it enters the ellipsoid, or comes nearest to it
        ox, oy, oz = f[1] * m[2] - f[2] * m[1], f[2] * m[0] - f[0] * m[2], f[0] * m[1] - f[1] * m[0]
        qa = d[0] * f[0] * f[0] + d[1] * f[1] * f[1] + d[2] * f[2] * f[2]
        qb = d[0] * ox * f[0] + d[1] * oy * f[1] + d[2] * oz * f[2]
        qc = d[0] * ox * ox + d[1] * oy * oy + d[2] * oz * oz - 1.0
        t = (-qb - math.sqrt(max(qb * qb - qa * qc, 0.0))) / qa
        x[0], x[1], x[2], x[3] = ox + t * f[0], oy + t * f[1], oz + t * f[2], 0.0
        cost = _residuals(x, f, m, d, r)
        damping = 1e-4
        for _ in range(STEPS):
            if cost < SOLVED * SOLVED:
                break
            for i in range(3):
                for j in range(4):
                    jacobian[i, j] = 0.0
                jacobian[i, i] = x[3] * d[i]
                jacobian[i, 3] = d[i] * x[i]
                jacobian[3, i] = d[i] * x[i]
            jacobian[3, 3] = 0.0
            jacobian[0, 1] += f[2]
            jacobian[0, 2] -= f[1]
            jacobian[1, 2] += f[0]
            jacobian[1, 0] -= f[2]
            jacobian[2, 0] += f[1]
            jacobian[2, 1] -= f[0]
            for i in range(4):
                b[i] = 0.0
                for k in range(4):
                    b[i] -= jacobian[k, i] * r[k]
                for j in range(4):
                    normal[i, j] = 0.0
                    for k in range(4):
                        normal[i, j] += jacobian[k, i] * jacobian[k, j]
                normal[i, i] += damping * (normal[i, i] + 1e-9)
            if not _solve4(normal, b):
                damping = max(damping, 1e-8) * 10.0
                continue
            for i in range(4):
                trial[i] = x[i] + b[i]
            new = _residuals(trial, f, m, d, s)
            if new < cost:
                stuck = new > 0.9999 * cost
                x[:] = trial
                r[:] = s
                cost = new
                damping *= 0.1
                if stuck:
                    break
            else:
                damping *= 10.0
                if damping > 1e8:
                    break
        gx, gy, gz = d[0] * x[0], d[1] * x[1], d[2] * x[2]
        length = math.sqrt(gx * gx + gy * gy + gz * gz)
        if length == 0.0:
            continue
        points[n, 0], points[n, 1], points[n, 2] = scale * x[0], scale * x[1], scale * x[2]
        normals[n, 0], normals[n, 1], normals[n, 2] = gx / length, gy / length, gz / length
        valid[n] = cost < NO_CONTACT * NO_CONTACT


@numba.njit(cache=True, nogil=True)
def cylinder_kernel(
    force: Array,
    torque: Array,
    radius: float,
    length: float,
    indentation: Array,
    points: Array,
    normals: Array,
    valid: NDArray[np.bool_],
) -> None:
    """Closed form on a cylinder along z. On the side only p x F has a moment along z, which gives the angle; the moment
    along the circle gives the height. Where that is beyond an end, the end's plane is asked.
    """
    for n in range(force.shape[0]):
        fx, fy, fz = force[n, 0], force[n, 1], force[n, 2]
        mx, my, mz = torque[n, 0], torque[n, 1], torque[n, 2]
        r = max(radius - indentation[n], 1e-6 * radius)
        across = math.sqrt(fx * fx + fy * fy)
        if across * r > abs(mz):
            # r (fy cos a - fx sin a) = mz, on the side where the force presses
            c = mz / (r * across)
            root = math.sqrt(1.0 - c * c)
            ux = (fy * c - fx * root) / across
            uy = (-fx * c - fy * root) / across
            pressing = fx * ux + fy * uy
            z = (-mx * uy + my * ux + r * fz) / pressing if pressing != 0.0 else math.inf
            if abs(z) <= 0.5 * length:
                points[n, 0], points[n, 1], points[n, 2] = r * ux, r * uy, z
                normals[n, 0], normals[n, 1], normals[n, 2] = ux, uy, 0.0
                valid[n] = pressing < 0.0
                continue
        if fz == 0.0:
            continue
        end = -1.0 if fz > 0.0 else 1.0
        z = end * max(0.5 * length - indentation[n], 0.0)
        x, y = (z * fx - my) / fz, (mx + z * fy) / fz
        if x * x + y * y <= radius * radius:
            points[n, 0], points[n, 1], points[n, 2] = x, y, z
            normals[n, 0], normals[n, 1], normals[n, 2] = 0.0, 0.0, end
            valid[n] = True


@numba.njit(cache=True, nogil=True)
def mesh_kernel(
    force: Array,
    torque: Array,
    corners: Array,
    planes: Array,
    offsets: Array,
    size: float,
    indentation: Array,
    points: Array,
    normals: Array,
    valid: NDArray[np.bool_],
) -> None:
    """Closed form on every face that the force presses; the face whose point lies in it, or least outside, is taken."""
    p = np.zeros(3)
    for n in range(force.shape[0]):
        fx, fy, fz = force[n, 0], force[n, 1], force[n, 2]
        mx, my, mz = torque[n, 0], torque[n, 1], torque[n, 2]
        best = FACE_SLACK * size
        for k in range(planes.shape[0]):
            ux, uy, uz = planes[k, 0], planes[k, 1], planes[k, 2]
            pressing = fx * ux + fy * uy + fz * uz
            if pressing >= 0.0:
                continue
            d = offsets[k] - indentation[n]
            p[0] = (uy * mz - uz * my + d * fx) / pressing
            p[1] = (uz * mx - ux * mz + d * fy) / pressing
            p[2] = (ux * my - uy * mx + d * fz) / pressing
            outside = 0.0
            for e in range(3):
                a, b = corners[k, e], corners[k, (e + 1) % 3]
                ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
                # inwards across the edge: plane x edge
                wx, wy, wz = uy * ez - uz * ey, uz * ex - ux * ez, ux * ey - uy * ex
                inside = (wx * (p[0] - a[0]) + wy * (p[1] - a[1]) + wz * (p[2] - a[2])) / math.sqrt(
                    ex * ex + ey * ey + ez * ez
                )
                outside = max(outside, -inside)
            if outside < best:
                best = outside
                for i in range(3):
                    points[n, i] = p[i]
                    normals[n, i] = planes[k, i]
                valid[n] = True
                if outside == 0.0:
                    break
