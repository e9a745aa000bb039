"""What an answer looks like when it is turned: the poses that nearly all of its surface cannot tell from it.

A can that was scanned declares no symmetry, and turned on its head it is the same to a millimetre; a mug whose handle
is out of sight may have it anywhere that is hidden. A search finds one of such poses, or a few, as chance has it; which
of them is the right one it does not know, so all that what was sensed leaves are modes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.settings import EstimateSettings
from scenes.evidence.align import AlignSettings, Prior, align, costs
from scenes.evidence.modes import Mode, displaced
from scenes.evidence.search import thin
from scenes.evidence.symmetry.near_symmetries import near_symmetries
from scenes.evidence.table import VISION, Evidence, empty
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Rows and steps by which a turned pose is laid onto what was sensed: it is within the tolerance of where it ends.
ROWS, STEPS = 200, 6
# Nats by which rough costs may have a pose costlier beside the first than those by rays: one in a thousand more.
ROUGHLY = 15.0


def with_twins(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    rows: Evidence,
    prior: Prior | None,
    settings: EstimateSettings,
    picture: Callable[[Array], Array] | None = None,
    rough: Callable[[Array], Array] | None = None,
) -> tuple[Mode, ...]:
    """The modes and what the first looks like when it is turned, with weights by what rows (frame_from_object,
    corrected), the prior and the picture say of each beside the first; the first stays the first.

    picture: costs (n,) of poses (n, 4, 4) by what must be seen of each, in place of the pixels' rows, which are of the
    first's outline. Without one these tell poses of one shape apart no better than other minima (see
    pixel_temperature). rough: about as picture, for less: what it has far costlier is not asked about.
    """
    most = settings.felt if picture is None else settings.told
    first, turns = modes[0], near_symmetries(model)
    if not len(turns) or not len(rows):
        return modes
    turned = first.pose @ turns
    if prior is not None:
        both = costs(model, empty(), np.concatenate([first.pose[None], turned]), prior)
        turned = turned[both[1:] <= both[0] + most.cost_margin]
        if not len(turned):
            return modes
    laid = align(model, thin(rows, ROWS), turned, prior, AlignSettings(iterations=STEPS)).poses
    kept = [first.pose, *(mode.pose for mode in modes[1:])]
    least = most.merge_share * model.radius
    # most slide back to where they were turned from: nothing is asked about these
    laid = laid[[_apart(model, kept, pose) >= least for pose in laid]]
    if not len(laid):
        return modes
    poses = np.concatenate([first.pose[None], laid])
    pixels, rest = rows.of(VISION), rows.take(rows.sense != VISION)
    total = costs(model, rest, poses, prior)
    if rough is not None:
        about = total + rough(poses)
        near = about <= about[0] + most.cost_margin + ROUGHLY
        poses, total = poses[near], total[near]
    total = total + (costs(model, pixels, poses) / settings.pixel_temperature if picture is None else picture(poses))
    # a twin cannot be likelier than the one that was solved with everything
    more = np.maximum(total[1:] - total[0], 0.0)
    found = list(modes)
    for pose, nats in zip(poses[1:], more.tolist()):
        if len(found) >= most.most or nats > most.cost_margin:
            continue
        if _apart(model, kept, pose) < least:
            continue
        kept.append(pose)
        weight = first.weight * float(np.exp(-most.temper * nats))
        found.append(Mode(pose, weight, first.cost + nats, first.covariance))
    total_weight = sum(mode.weight for mode in found)
    if len(found) == len(modes) or not total_weight > 0.0:
        return modes
    ordered = [found[0], *sorted(found[1:], key=lambda mode: mode.cost)]
    return tuple(replace(mode, weight=mode.weight / total_weight) for mode in ordered)


def _apart(model: ObjectModel, kept: list[Array], pose: Array) -> float:
    """Metres by which a point at the object's radius moves from pose (4, 4) to the nearest of those kept (4, 4)."""
    return float(displaced(model, np.array(kept), pose).min())
