"""The answer moved to where the image shows its outline, as far as everything else lets it. Camera frame, metres.

The joint solution leaves a Gaussian of the pose, all else marginalised; the lines across the outline add theirs to it
and are read anew where it leads, and where that ends in a depth camera's own image, the steps next to them. What else
was sensed weighs less there than its model says, by a constant. How wrong it may be beyond its model (pulls that
scatter more than they should) is part of the covariance, but no weight: estimated from a few patches of an image, it is
too uncertain to be one. Distance and tilt are mostly left to depth: what an outline seems to tell of them is how fat it
looks. So the covariance follows the gain that was used, optimal or not (Joseph form).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.search.pool import Pool
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.solve.joint import JointResult, mesh_spread
from scenes.evidence.align import costs
from scenes.evidence.modes import Mode
from scenes.evidence.solver_kernels import eliminate
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from vision.contour.evidence import UNREGISTERED, ContourEvidence, ContourSettings
from vision.contour.lines import is_grey

Array = NDArray[np.float64]

# Share of what a moved pose may cost more below which rough costs say that it does not: of 119 moves they were off by 3
# nats (standard deviation).
CLEARLY = 0.5


@dataclass(frozen=True)
class Outlined:
    """mode: with what the outline says. solved: the joint solution, its calibration moved with the pose. lines: that
    were open; why: a word on what was found. beside (m): by how much whole blocks of the outline are off, beyond what
    their lines say.
    """

    mode: Mode
    solved: JointResult
    lines: int
    why: str
    beside: float = 0.0
    elsewhere: Array | None = None


def shift_of(image: NDArray[np.uint8], beliefs: Beliefs) -> float:
    """Standard deviation (px) of how far an image (h, w, 3) is believed to lie beside depth."""
    return beliefs.image.sigma(is_grey(image[::4, ::4]))


def asks_for(image: NDArray[np.uint8], beliefs: Beliefs, settings: ContourSettings) -> bool:
    """Whether an image (h, w, 3) is to say where the outline is."""
    return settings.used or (settings.own and shift_of(image, beliefs) <= settings.as_own)


def outlined(
    frame: Frame, pool: Pool, solved: JointResult, mode: Mode, beliefs: Beliefs, settings: EstimateSettings
) -> Outlined:
    """The mode, and the joint solution it is from, with what the image says of the outline; as they were where it says
    nothing, is not registered with depth, or wants what everything else speaks against.

    beliefs: of how far the image lies beside depth, and of what the mesh leaves out of the object. The mode may be
    wider than its solution: as sampled.
    """
    assert frame.rgb is not None
    model, how, mesh_sigma = pool.model, settings.contour.of(shift_of(frame.rgb, beliefs)), beliefs.mesh_sigma
    wider = _positive(mode.covariance - solved.covariance)
    lateral = _across(mode.pose, model.centroid, how.distance_share)
    known = solved.independent + lateral @ solved.shared @ lateral.T + wider
    information = np.asarray(np.linalg.inv(how.others * known), dtype=np.float64)
    hessian, lines = np.zeros((6, 6)), 0
    at, reach, drawn = mode.pose, how.lines.reach, None
    for turn in range(how.rounds):
        evidence = ContourEvidence(frame, model, pool.predictor, at, mesh_sigma, how, drawn)
        drawn = evidence.drawn
        why_not = evidence.why_not
        if turn == 0:
            first = evidence
            why_not = why_not or evidence.uncertain(mode.covariance)
            shift = np.zeros(2) if why_not else evidence.beside_depth(mode.covariance)
            if shift.any():
                elsewhere = _shifted(frame.camera, solved.as_seen, model.centroid, shift)
                return Outlined(mode, solved, 0, _beside(shift), elsewhere=elsewhere)
        if why_not:
            return Outlined(mode, solved, 0, why_not)
        lines = evidence.count
        before = se3.difference(at, mode.pose, model.centroid)
        delta = np.zeros(6)
        wide = how.wide * evidence.spread_of(known) if turn == 0 else 0.0
        for step in range(how.steps):
            others = information @ (before + delta)
            window = max(how.window, wide * 0.5**step)
            gradient, hessian = evidence.terms(delta, (others, information) if step > 0 else None, window=window)
            delta = delta - _solved(information + hessian, gradient + others)
        last = turn == how.rounds - 1 or evidence.shift_of(delta) < how.anew
        for sharp in how.sharp if last else ():
            others = information @ (before + delta)
            gradient, hessian = evidence.terms(delta, (others, information), sharp)
            delta = delta - _solved(information + hessian, gradient + others)
        at = se3.perturb(at, delta, model.centroid)
        if last:
            break
    moved = se3.difference(at, mode.pose, model.centroid)
    farthest = first.farthest(moved)
    if farthest > reach:
        # walked there, round by round, from edge to edge: a handle along itself
        why = f"the outline would move by {farthest:.0f} px, and is looked for within {reach} px"
        return Outlined(mode, solved, 0, why)
    tension = float(moved @ np.linalg.solve(mode.covariance, moved))
    as_seen = se3.perturb(solved.as_seen, moved, model.centroid)
    worse = _worse(pool, (mode.pose, at), (solved.as_seen, as_seen), settings.most_worse_outlined)
    if tension > how.most_moved or worse > settings.most_worse_outlined:
        why = f"outline and depth disagree (chi-square {tension:.0f}, {worse:.0f} nats worse)"
        return Outlined(mode, solved, 0, why, elsewhere=as_seen)
    inverse = np.linalg.inv(information + hessian)
    kept = np.eye(6) - inverse @ hessian
    # the mesh's own error is in both, and no evidence takes it away
    mesh = mesh_spread(model, mesh_sigma**2, settings.joint)
    spread = kept @ _positive(mode.covariance - mesh) @ kept.T + inverse @ hessian @ inverse + mesh
    # or it was another outline that was read: then the pose is as unknown as before, and off by the move, too
    another = min(1.0, how.another + how.unclear * evidence.unclear)
    spread = (1.0 - another) * spread + another * (mode.covariance + np.outer(moved, moved))
    why = f"{lines} lines across it, moved by {1e3 * float(np.linalg.norm(moved[3:])):.1f} mm, {worse:+.1f} nats"
    calibrated = replace(solved, xi=solved.xi + solved.follows @ moved)
    moved_mode = replace(mode, pose=at, covariance=0.5 * (spread + spread.T))
    return Outlined(moved_mode, calibrated, lines, why, evidence.beside)


def _beside(shift: Array) -> str:
    """That the image shows the outline shifted by (2,) px."""
    size = float(np.linalg.norm(shift))
    return f"the image's outline is {size:.0f} px beside where depth has it: {UNREGISTERED}"


def _shifted(camera: Camera | None, pose: Array, centroid: Array, shift: Array) -> Array:
    """A pose (4, 4) moved across the ray to the object's centroid, which moves in the image by shift (2,) px."""
    assert camera is not None
    z = float(pose[2, :3] @ centroid + pose[2, 3])
    across = np.array([shift[0] / camera.fx, shift[1] / camera.fy, 0.0]) * z
    return se3.perturb(pose, np.concatenate([np.zeros(3), across]), centroid)


def _solved(matrix: Array, vector: Array) -> Array:
    """What a positive matrix (6, 6) takes to a vector (6,); both are spent. NumPy takes five times as long."""
    eliminate(matrix, vector)
    return vector


def _worse(pool: Pool, poses: tuple[Array, Array], as_seen: tuple[Array, Array], most: float) -> float:
    """Nats that touch and the prior have against the second of two poses (4, 4) more than against the first, and the
    picture of depth against where it has them: roughly where that is far from `most`.
    """
    picture, seen = pool.predictor, np.array(as_seen)
    felt = costs(pool.model, pool.felt, np.array(poses), pool.prior)
    about = felt + picture.rough_costs(seen)
    if about[1] - about[0] > CLEARLY * most:
        about = felt + picture.costs(seen)
    return float(about[1] - about[0])


def _across(pose: Array, centroid: Array, share: float) -> Array:
    """(6, 6) that leaves of a small motion of the object at pose (4, 4) what an outline tells best, moves across the
    ray to its centroid and turns about it, and of the others only a share.
    """
    centre = pose[:3, :3] @ centroid + pose[:3, 3]
    ray = centre / max(float(np.linalg.norm(centre)), 1e-9)
    along = np.outer(ray, ray)
    kept = np.zeros((6, 6))
    kept[:3, :3], kept[3:, 3:] = along, np.eye(3) - along
    return np.asarray(kept + share * (np.eye(6) - kept))


def _positive(matrix: Array) -> Array:
    """A symmetric matrix (6, 6) without its negative part."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
