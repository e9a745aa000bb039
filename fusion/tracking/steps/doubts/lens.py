"""Is this frame's camera the one that the frames before it had?

A field of view does not leap from one frame to the next: intrinsics that do were mistaken for others, and a picture
drawn through them says anything. Such an image is not looked at, until it is plain that it is another camera.
"""

from __future__ import annotations

import numpy as np

from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.state import TrackState
from scenes.recordings.checking.validation import check_is_frame
from scenes.recordings.frames import Frame


def through_one_lens(frame: Frame, state: TrackState, settings: TrackSettings) -> tuple[Frame, tuple[str, ...]]:
    """The frame, without what its camera saw where its focal lengths have leapt, and a note of that; the state knows
    the lens that is used. A part of an image has the lengths (px) of the whole, a smaller image its field of view.
    Raises InputError for what is no frame.
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
    return frame, ()
