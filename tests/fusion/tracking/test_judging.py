"""A frame is held against a track as the frame has it: where it shows it, by its own answer, as wide as that is."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import recording

from fusion.tracking.answer import TrackSettings
from fusion.tracking.state import GlanceSettings
from fusion.tracking.steps.refining import prefers
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses
from scenes.synthesis import library


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


def test_a_search_is_held_against_the_track_where_the_image_shows_both(mug):
    """A camera whose scale is off shows the object nearer than it is; what solves for that has not missed it."""
    tracker = Tracker(mug, settings=TrackSettings(glance=GlanceSettings(every=1)))
    answer = [tracker.step(frame) for frame in recording(mug, 5)][-1]
    seen, s = replace(tracker._sensed, seen_from=np.eye(4)), tracker.settings
    alone = tracker.estimated(replace(seen.viewed, prior=None), None)
    back = np.eye(4)
    back[:3, 3] = 0.02 * answer.pose[:3, 3]
    shown = answer.pose  # by a depth image two hundredths too short
    found = replace(alone, pose=back @ answer.pose, as_seen=shown)
    assert abs(prefers(answer, found, seen, s)) < 1e-6
    assert prefers(answer, replace(found, as_seen=None), seen, s) > s.hypotheses.missed
    same = replace(answer, pose=back @ answer.pose)
    assert abs(prefers(same, found, replace(seen, seen_from=poses.inverse(back)), s)) < 1e-6
