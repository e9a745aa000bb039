"""When something that came with a frame is doubted. Metres, radians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DoubtSettings:
    """When a statement is doubted. By judgement, but where it says otherwise."""

    # Squared distance (in standard deviations, six of them) of an answer from its start beyond which the start's own
    # sigmas are contradicted: one in a hundred of those that are right is as far. No start is doubted at inf.
    start: float = 16.8
    # Nats by which an answer without a start must be likelier, by all but the start, than a sure one that is so far
    # from it: what explains the senses as well is no reason to leave it. As `PoolSettings.as_likely`.
    likelier: float = 3.0
    # Turned poses among which one likelier than an answer by all but the start is looked for: 12 found 36 of the 38
    # that all did in frames of another generator, in half the time. And so many are fitted: one did as well as all.
    turned: int = 12
    turned_fitted: int = 1
    # Normals (rad) farther than this from the surface's are the other way round; so many of a frame's (share), of so
    # many fingers at least, are not turned by a wrong pose.
    inward: float = float(np.deg2rad(140.0))
    most_inward: float = 0.75
    fewest_inward: int = 2
    # A contact farther than this (m) from the surface tells nothing of its side.
    near_surface: float = 0.006
    # Contacts of a hand's sensors that are farther than this (m) from the hand, where it is seen, are of another frame,
    # another time or another hand: no fingertip has so thick a skin, no joints are so far off while the hand is seen.
    astray: float = 0.03
    # Standard deviations of the camera's depth (of its scale and its bias) by which a hand may be seen before or behind
    # where it is told, and be doubted all the same: beyond, the camera may be wrong. Of three frames whose depth was
    # scaled by 2 and 3 %, answers without the hand were sure and 10 to 14 mm off.
    along: float = 2.0
    # Share of the object's own outline within the mask from which an answer is where the mask has it, if badly.
    within_mask: float = 0.1
    # Least distance (m) of an object from the seen hand that holds it: what is doubted may not lead to another thing.
    in_hand: float = 0.02
