"""What a live track does late for the first time, done before its first frame counts.

A kernel is compiled, or read from the disk, when it is first called; tables of an object are built when they are first
asked for. A search that first comes in the twelfth frame would keep a camera waiting for seconds there.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from scenes.errors import InputError, PalpateError
from scenes.evidence.align import Prior

if TYPE_CHECKING:
    from fusion.tracking.tracker import Tracker
    from scenes.recordings.frames import Frame

# Frames that are tracked: one begins, one is looked at in full, one is glanced at.
STEPS = 3


def rehearse(new_tracker: Callable[[], Tracker], frame: Frame) -> None:
    """Track the frame by a tracker that is thrown away, and search it as a track will now and then: by itself and
    around what it believes. `new_tracker` makes one as it will be used. Takes a second, on a machine that has not
    compiled yet one or two minutes. Raises what the first step of a track of this frame would raise, and InputError for
    a tracker in place of what makes one.
    """
    if not callable(new_tracker):
        made = type(new_tracker).__name__
        raise InputError(f"new_tracker: expected what makes one (lambda: Tracker(model)), got {made}")
    tracker = new_tracker()
    answer = tracker.step(frame)
    with contextlib.suppress(PalpateError):  # what comes later is not what this frame is asked
        for ahead in range(1, STEPS):
            tracker.step(replace(frame, index=frame.index + ahead))
        alone, s = replace(frame, prior=None), tracker.settings
        around = Prior.isotropic(answer.pose, s.near_angle, s.near_distance)
        for prior in (None, around):
            tracker.estimated(alone, prior)
