"""A report's part about the grasp: figures, places for another finger, and the map that colours the object."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.advice.grasp import GraspAnswer, GraspMap, Place
from fusion.estimation.answer import Estimate
from scenes.geometry.objects import ObjectModel
from scenes.words import counted

Array = NDArray[np.float64]

# A vertex takes the mean of so many places around it, the nearer ones more.
NEIGHBOURS = 4
# The map's byte: 255 is no place for a finger, 0 to 254 the gain from none to the map's largest.
NO_PLACE = 255


def add_grasps(
    frames: list[dict[str, Any]],
    model: ObjectModel,
    estimates: Sequence[Estimate],
    grasps: Sequence[GraspAnswer],
    vertices: Array,
) -> None:
    """Give each of the page's frames its "grasp", None where there is none. vertices (n, 3): of the mesh that is drawn,
    object frame.
    """
    by_frame = {grasp.frame: grasp for grasp in grasps}
    for entry, estimate in zip(frames, estimates):
        grasp = by_frame.get(estimate.frame)
        entry["grasp"] = None if grasp is None else _entry(grasp, model, estimate, vertices)


def _entry(grasp: GraspAnswer, model: ObjectModel, estimate: Estimate, vertices: Array) -> dict[str, Any]:
    quality = grasp.quality
    rows = [
        ["ε at the estimate", f"{quality.epsilon:.3f} N"],
        [
            "ε, median and 5 to 95 %",
            f"{grasp.epsilon.median:.3f} ({grasp.epsilon.low:.3f} to {grasp.epsilon.high:.3f}) N",
        ],
        ["Volume", f"{quality.volume:.3g} N⁶"],
        ["Volume, 5 to 95 %", f"{grasp.volume.low:.3g} to {grasp.volume.high:.3g} N⁶"],
        ["Closed in", f"{100 * grasp.closure_probability:.0f} % of {counted(max(grasp.samples, 1), 'pose')}"],
        ["Contacts", f"{len(grasp.points)}" + (f", {len(grasp.left_out)} left out" if grasp.left_out else "")],
    ]
    out: dict[str, Any] = {
        "closure": quality.closure,
        "verdict": quality.verdict,
        "why": "; ".join((quality.why, *grasp.notes)),
        "rows": rows,
        "places": [_place(place, model, estimate.pose) for place in grasp.places],
        "map": None,
    }
    if grasp.map is not None and np.isfinite(grasp.map.gain).any():
        shades, largest = vertex_shades(grasp.map, vertices)
        out["map"] = base64.b64encode(shades.tobytes()).decode()
        out["largest"] = round(largest, 3)
    return out


def _place(place: Place, model: ObjectModel, pose: Array) -> dict[str, Any]:
    x, y, z = (f"{1e3 * float(v):.0f}" for v in place.point)
    text = f"at ({x}, {y}, {z}) mm of the object: {place.told}"
    text += f", {place.information:.1f} nats about the pose"
    if place.finger is not None and place.finger_distance is not None:
        text += f"; nearest is {place.finger.replace('_', ' ')}, {1e2 * place.finger_distance:.0f} cm away"
    moved = pose[:3, :3] @ (place.point - model.centroid)
    return {
        "p": [round(1e3 * float(v), 2) for v in moved],
        "n": [round(float(v), 3) for v in pose[:3, :3] @ place.normal],
        "text": text,
    }


def vertex_shades(map_: GraspMap, vertices: Array) -> tuple[NDArray[np.uint8], float]:
    """A byte per vertex (n, 3): 255 where no fingertip can be, else the gain as a share of the largest; and the largest
    gain (N).
    """
    from scipy.spatial import cKDTree

    count = min(NEIGHBOURS, len(map_.points))
    distance, index = cKDTree(map_.points).query(vertices, k=count)
    distance, index = distance.reshape(len(vertices), count), index.reshape(len(vertices), count)
    gain = map_.gain[index]
    known = np.isfinite(gain)
    weight = np.where(known, 1.0 / np.maximum(distance, 1e-4), 0.0)
    total = weight.sum(axis=1)
    value = (weight * np.nan_to_num(gain)).sum(axis=1) / np.maximum(total, 1e-300)
    largest = max(float(np.nanmax(map_.gain)), 0.0)
    shade = np.clip(np.rint(254.0 * value / max(largest, 1e-12)), 0, 254)
    # the nearest place says whether a finger can be here
    return np.where(known[:, 0], shade, NO_PLACE).astype(np.uint8), largest
