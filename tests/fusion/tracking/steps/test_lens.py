"""A camera whose intrinsics leap within a track."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.doubts.lens import through_one_lens
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Frame

SETTINGS = TrackSettings()


def frame(scale: float = 1.0, size: float = 1.0, crop: float = 1.0) -> Frame:
    """An image of a lens `scale` times as long, `size` times as fine, of which the share `crop` is kept."""
    width, height = round(160 * size * crop), round(120 * size * crop)
    camera = Camera(140.0 * scale * size, 140.0 * scale * size, 0.5 * width, 0.5 * height, width, height)
    return Frame(0, camera=camera, depth=np.full((height, width), 0.5))


def test_an_image_of_a_lens_that_leaps_is_not_looked_at():
    state = TrackState()
    assert through_one_lens(frame(), state, SETTINGS)[1] == ()
    left, notes = through_one_lens(frame(100.0), state, SETTINGS)
    assert left.depth is None
    assert "focal lengths of 14000, 14000 px, expected about 140, 140" in notes[0]
    again = frame()
    assert through_one_lens(again, state, SETTINGS) == (again, ())


@pytest.mark.parametrize("change", [{"scale": 1.05}, {"size": 2.0}, {"crop": 0.5}, {"size": 0.5, "crop": 0.5}])
def test_zooms_other_sizes_and_parts_of_an_image_are_as_before(change):
    state = TrackState()
    through_one_lens(frame(), state, SETTINGS)
    if change != {"size": 0.5, "crop": 0.5}:
        assert through_one_lens(frame(**change), state, SETTINGS)[1] == ()
    else:  # neither the lengths nor the field of view are the same
        assert through_one_lens(frame(**change), state, SETTINGS)[1] != ()


def test_another_camera_is_believed_when_it_stays():
    state = TrackState()
    through_one_lens(frame(), state, SETTINGS)
    noted = [bool(through_one_lens(frame(1.5), state, SETTINGS)[1]) for _ in range(8)]
    assert noted == [True] * SETTINGS.other_lens + [False] * (8 - SETTINGS.other_lens)
    bare = replace(frame(9.0), depth=None)
    assert through_one_lens(bare, state, SETTINGS) == (bare, ())


@pytest.mark.parametrize("kind", [np.uint8, np.uint32, np.int64])
def test_numbers_of_fixed_size_count_as_all_do(kind):
    told = through_one_lens(replace(frame(), index=kind(7)), TrackState(), SETTINGS)[0]
    assert type(told.index) is int
    assert told.index == 7
