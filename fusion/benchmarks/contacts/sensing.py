"""Intrinsic contact sensing: error of the contact point against force noise, and speed (T1 section 2.2.1)."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Spread, Table
from scenes.geometry import poses as se3
from touch.wrenches.fingertips import SoftSkin, tip_contacts

Array = NDArray[np.float64]

# Radii of the ellipsoid (m): a fingertip; the others are of the same size.
RADII = np.array([0.008, 0.010, 0.014])
# Force noise, per axis (N), at a press of 1 to 3 N; the moment's noise is that force at 3 mm: a Nano17-like sensor
# resolves 3 mN and 16 N um.
NOISES = (0.0, 0.003, 0.01, 0.03, 0.1)
ARM = 0.003
PRESS = (1.0, 3.0)
# N/m: 1 N indents a thin rubber layer by an eighth of a millimetre.
SOFT = SoftSkin(8000.0, 0.002)


def surfaces() -> dict[str, dict[str, dict[str, Any]]]:
    """The fingertips compared, as sensors.json has them."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    vertices = np.array(ball.vertices) * RADII
    return {
        "sphere": {"sphere": {"radius": 0.01}},
        "ellipsoid": {"ellipsoid": {"radii": RADII.tolist()}},
        "cylinder": {"cylinder": {"radius": 0.01, "length": 0.03}},
        "mesh, 1280 faces": {"mesh": {"vertices": vertices, "faces": np.array(ball.faces)}},
    }


def presses(kind: str, count: int, rng: np.random.Generator, soft: SoftSkin | None) -> tuple[Array, Array, Array]:
    """Contact points, forces and torques of presses with friction up to 0.5 and a little torsion."""
    u = se3.random_unit_vectors(count, rng)
    if kind == "cylinder":
        u[:, 2] = 0.0
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        point, normal = 0.01 * u + np.outer(rng.uniform(-0.012, 0.012, count), [0, 0, 1]), u
    elif kind == "sphere":
        point, normal = 0.01 * u, u
    else:
        point, normal = u * RADII, u / RADII
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross(normal, se3.random_unit_vectors(count, rng))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    size = rng.uniform(*PRESS, size=(count, 1))
    force = size * (-normal + 0.5 * rng.uniform(size=(count, 1)) * across)
    if soft is not None:
        point = point - size / soft.stiffness * normal
    moment = size * rng.uniform(-5e-4, 5e-4, size=(count, 1))
    return point, force, np.cross(point, force) + moment * normal


def add_contact_sensing(report: Report, settings: BenchSettings) -> None:
    """The table of errors and the claim of speed."""
    count = settings.count(20_000, 2000)
    count = max(count, 2000)
    columns = [Column("fingertip"), Column("skin"), Column("force noise mN", 0), Column("error um", 1)]
    columns += [Column("median um", 1), Column("valid"), Column("contacts per s, thousands", 0)]
    note = (
        f"Press {PRESS[0]:.0f} to {PRESS[1]:.0f} N, friction up to 0.5, torsion up to 0.5 mm; noise of the "
        "moment: that force at 3 mm. Published: 266 um rigid, 320 um soft, > 800 Hz (force noise not stated)."
        " The mesh is a faceted ellipsoid felt as the smooth one: its error without noise is the facets'. The"
        " soft ellipsoid is solved with shorter radii, the truth is indented along the normal."
    )
    table = Table("Intrinsic contact sensing", columns, note=note)
    rng = np.random.default_rng([settings.seed, 22])
    slowest = np.inf
    for name, surface in surfaces().items():
        for skin, soft in (("rigid", None), ("soft", SOFT)):
            for noise in NOISES:
                point, force, torque = presses(next(iter(surface)), count, rng, soft)
                force = force + noise * rng.normal(size=force.shape)
                torque = torque + noise * ARM * rng.normal(size=torque.shape)
                tip_contacts(force[:10], torque[:10], surface, soft)
                durations = []
                for _ in range(3):
                    begin = time.perf_counter()
                    found = tip_contacts(force, torque, surface, soft)
                    durations.append(time.perf_counter() - begin)
                rate = count / min(durations)
                error = np.linalg.norm(found.points - point, axis=1)[found.valid]
                spread = Spread.of(error, 1e6)
                table.add(name, skin, 1e3 * noise, spread, spread.median, Rate.of(found.valid), 1e-3 * rate)
                if name in ("sphere", "ellipsoid", "cylinder"):
                    slowest = min(slowest, 1e-3 * rate) if soft is None else slowest
                if name == "ellipsoid" and noise == 0.01:
                    target = 266.0 if soft is None else 320.0
                    what = f"{skin} ellipsoid, 10 mN: mean error of the contact, um"
                    report.claims.append(Claim(what, spread.mean, target, False, 0))
    report.tables.append(table)
    report.claims.append(
        Claim("contact sensing, slowest rigid closed shape: thousand a second", slowest, 100.0, True, 0)
    )
