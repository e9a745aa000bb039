"""What things look like in infra-red light: reflectance, its texture, gloss; per thing, the same in every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Names of grounds (walls, tables): paint and wood are bright in infra-red.
GROUNDS = ("background", "table", "wall")


@dataclass(frozen=True)
class Material:
    """A surface in infra-red light."""

    # Share of light sent back, evenly in all directions (Lambert; no unit).
    albedo: float = 0.5
    # Uneven share: standard deviation over the mean, and size of the spots (m).
    texture: float = 0.0
    grain: float = 0.01
    # Gloss: strength of the lobe about the mirror's direction (Blinn-Phong, normalised; no unit) and its exponent.
    gloss: float = 0.0
    sharpness: float = 20.0


def draw_material(name: str, seed: int) -> Material:
    """The material that the thing of this name has in a recording of this seed."""
    rng = np.random.default_rng([seed, *name.encode()])
    ground = name in GROUNDS
    albedo = rng.uniform(0.35, 0.85) if ground else 0.1 * 8.0 ** rng.uniform()
    texture, grain = rng.uniform(0.01, 0.1 if ground else 0.25), 0.002 * 10.0 ** rng.uniform()
    gloss = 0.0 if ground else 0.15 * rng.uniform() ** 2
    return Material(float(albedo), float(texture), float(grain), float(gloss), float(rng.uniform(8.0, 60.0)))


def material_table(names: Sequence[str], seed: int, given: Mapping[str, Material] | None = None) -> Array:
    """(k, 5) albedo, texture, grain, gloss, sharpness of the named things, drawn where none is given."""
    chosen = [(given or {}).get(name) or draw_material(name, seed) for name in names]
    return np.array([astuple(material) for material in chosen], dtype=np.float64).reshape(-1, 5)
