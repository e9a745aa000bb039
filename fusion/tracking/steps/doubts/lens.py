"""Is this frame's camera the one that the frames before it had, and its image a new one?

A field of view does not leap from one frame to the next: intrinsics that do were mistaken for others, and a picture
drawn through them says anything. Such an image is not looked at, until it is plain that it is another camera. Nor is
one that a frame before had, reading for reading, while what holds the object has moved (`memory.last_image`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.last_image import LastImage
from fusion.tracking.memory.state import TrackState
from scenes.recordings.checking.validation import check_is_frame
from scenes.recordings.frames import Frame


def through_one_lens(
    frame: Frame, state: TrackState, settings: TrackSettings, in_view: bool = False
) -> tuple[Frame, tuple[str, ...]]:
    """The frame, without what its camera saw where its focal lengths have leapt or that is what it saw before, and a
    note of that; the state knows the lens that is used. A part of an image has the lengths (px) of the whole, a smaller
    image its field of view. in_view: images show the hand. Raises InputError for what is no frame.
    """
    check_is_frame(frame)
    frame = state.before_its_camera(frame)
    camera = frame.camera
    if camera is None or frame.depth is None:
        return frame, ()
    lens = np.array([camera.fx, camera.fy, camera.fx / camera.width, camera.fy / camera.height])
    known, state.lens_for = state.lens, state.lens_for + 1
    if known is not None and state.lens_for <= settings.other_lens:
        leap = np.abs(np.log(lens / known)).reshape(2, 2).max(axis=1).min()
        if leap > np.log(1.0 + settings.zoom):
            focal = f"{camera.fx:.5g}, {camera.fy:.5g} px, expected about {known[0]:.5g}, {known[1]:.5g} as before"
            return frame.without_vision(), (f"its image is not looked at: focal lengths of {focal}",)
    state.lens, state.lens_for = lens, 0
    return _if_new(frame, state, in_view)


def _if_new(frame: Frame, state: TrackState, in_view: bool) -> tuple[Frame, tuple[str, ...]]:
    """The frame, without an image that was there before, and a note of that; the state knows the last new one. A frame
    that comes late may well have one of before.
    """
    if state.belief is not None and frame.index <= state.index:
        return frame, ()
    image = LastImage.of(frame)
    if image is not None and state.image is not None and state.image.is_again(image, in_view):
        state.image = replace(state.image, hung=True)
        return frame.without_vision(), (f"its image is not looked at: it is that of frame {state.image.index} again",)
    if image is not None and (state.image is None or not np.array_equal(image.readings, state.image.readings)):
        state.image = image
    return frame, ()
