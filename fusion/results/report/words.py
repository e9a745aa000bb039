"""What an estimate says, in words that need no manual."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.advice.next_touch import NextTouch
from fusion.estimation.answer import Estimate

Array = NDArray[np.float64]

# Beyond this standard deviation a rotation is as good as unknown.
FREE_ROTATION = float(np.deg2rad(60.0))
# Share of the posterior from which another mode is counted among those that fit.
WORTH_COUNTING = 0.01


def worst_sigmas(covariance: Array) -> tuple[float, float]:
    """Largest standard deviation over directions of a (6, 6) covariance: rotation (rad), translation (m).

    NaN where the covariance is not finite.
    """

    def worst(block: Array) -> float:
        if not np.isfinite(block).all():
            return float("nan")
        return float(np.sqrt(max(0.0, np.linalg.eigvalsh(0.5 * (block + block.T))[-1])))

    return worst(covariance[:3, :3]), worst(covariance[3:, 3:])


def headline(estimate: Estimate) -> str:
    """The verdict in two or three words."""
    return {"ok": "Found", "ambiguous": "Ambiguous", "lost": "Lost"}.get(estimate.verdict, estimate.verdict)


def sentence(estimate: Estimate) -> str:
    """One sentence: how well the pose is known, or why it is not."""
    rotation, translation = worst_sigmas(np.asarray(estimate.covariance, dtype=np.float64))
    known = _known(rotation, translation)
    why = estimate.notes[0] if estimate.notes else ""  # the verdict's reason
    if estimate.verdict == "lost":
        return f"The pose shown must not be used: {why or 'no pose explains what was sensed'}."
    if estimate.verdict == "ambiguous":
        others = sum(mode.weight >= WORTH_COUNTING for mode in estimate.modes[1:])
        if others:
            share = estimate.modes[0].weight
            return f"{others + 1} poses fit alike; the one shown has {share:.0%} of the weight. {known}"
        if why and not estimate.unobservable:
            return f"It is not to be relied on: {why}. {known}"
        return f"The data leave some motion free. {known}"
    return known


def _known(rotation: float, translation: float) -> str:
    if not np.isfinite(translation):
        return "How sure it is cannot be told."
    where = f"Its position is known to {1e3 * translation:.2g} mm"
    if not np.isfinite(rotation):
        return f"{where}."
    if rotation > FREE_ROTATION:
        return f"{where}, its orientation not in every direction."
    return f"{where}, its orientation to {np.rad2deg(rotation):.2g}° (one sigma, worst direction)."


def contribution_rows(estimate: Estimate) -> list[list[str]]:
    """[source, rows, sigma of the position without it -> with it, the same of the rotation] for a table."""

    def change(without: float, all_: float, unit: str) -> str:
        return f"{without:.2g} → {all_:.2g} {unit}"

    return [
        [
            c.source,
            str(c.rows) if c.rows else "",
            change(1e3 * c.position_without, 1e3 * c.position_with, "mm"),
            change(float(np.rad2deg(c.rotation_without)), float(np.rad2deg(c.rotation_with)), "°"),
        ]
        for c in estimate.contributions
    ]


def next_touch(touch: NextTouch, estimate: Estimate) -> str:
    """Where, what it would leave of the estimate's own sigmas (now → then), and which finger is nearest."""
    rotation, translation = worst_sigmas(np.asarray(estimate.covariance, dtype=np.float64))
    x, y, z = (f"{1e3 * float(v):.0f}" for v in touch.point)
    text = (
        f"at ({x}, {y}, {z}) mm of the object: {1e3 * translation:.2g} → {1e3 * touch.sigma_position:.2g} mm,"
        f" {np.rad2deg(rotation):.2g} → {np.rad2deg(touch.sigma_rotation):.2g}°"
    )
    if touch.between_modes > 0.1:
        text += f", {touch.between_modes / max(touch.gain, 1e-9):.0%} of its worth is telling poses apart"
    if touch.finger is not None and touch.finger_distance is not None:
        text += f"; nearest is {touch.finger.replace('_', ' ')}, {1e2 * touch.finger_distance:.0f} cm away"
    return text


def symmetry(model_axes: int, discrete: int, spherical: bool) -> str:
    """An object's symmetries in words, empty for none."""
    if spherical:
        return "a ball: orientation has no meaning"
    parts = []
    if model_axes:
        parts.append("turns freely about an axis")
    if discrete > 1:
        parts.append(f"{discrete} discrete symmetries")
    return " and ".join(parts)
