"""Is what this frame's sensors say of now, or what they said before?

A driver that hangs repeats what it has beside the robot's reports of now. An image is not looked at that a frame before
had, reading for reading, while what holds the object has moved (`memory.last_image`); contacts are left out that a
frame before had, number for number, while their hand has moved (`memory.last_touch`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.last_image import LastImage
from fusion.tracking.memory.last_touch import LastTouch
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.doubts.lens import through_one_lens
from scenes.recordings.frames import Contacts, Frame


def of_now(
    frame: Frame, state: TrackState, settings: TrackSettings, in_view: bool = False
) -> tuple[Frame, tuple[str, ...]]:
    """The frame, without what came again or was seen through another lens, and notes of that. in_view: images show the
    hand. Raises InputError for what is no frame.
    """
    frame, lens = through_one_lens(frame, state, settings)
    # a frame that comes late may well have something of before
    if state.belief is not None and frame.index <= state.index:
        return frame, lens
    frame, seen = _newly_seen(frame, state, in_view)
    frame, felt = _newly_felt(frame, state)
    return frame, (*lens, *seen, *felt)


def _newly_seen(frame: Frame, state: TrackState, in_view: bool) -> tuple[Frame, tuple[str, ...]]:
    """The frame, without an image that was there before, and a note of that; the state knows the last new one."""
    image = LastImage.of(frame)
    if image is None:
        return frame, ()
    if state.image is not None and state.image.is_again(image, in_view):
        state.image = replace(state.image, hung=True)
        return frame.without_vision(), (f"its image is not looked at: it is that of frame {state.image.index} again",)
    if state.image is None or not np.array_equal(image.readings, state.image.readings):
        state.image = image
    return frame, ()


def _newly_felt(frame: Frame, state: TrackState) -> tuple[Frame, tuple[str, ...]]:
    """The frame, without contacts that were there before, and a note of that; the state knows the last new ones."""
    touch = LastTouch.of(frame)
    if touch is None:
        return frame, ()
    if state.touch is not None and state.touch.is_again(touch):
        state.touch = replace(state.touch, hung=True)
        said = f"its contacts are left out: they are those of frame {state.touch.index} again"
        return replace(frame, contacts=Contacts.none()), (said,)
    if state.touch is None or not np.array_equal(touch.points, state.touch.points):
        state.touch = touch
    return frame, ()
