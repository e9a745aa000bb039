"""Slips told by the patterns of arrays: of one array over frames, of a hand beside the poses, and by a whole track."""

from dataclasses import replace

import numpy as np
import pytest

from fusion.benchmarks.arrays import grasps
from fusion.tracking.filter import Belief, Measurement
from fusion.tracking.slip import SlipWatch, Watched
from fusion.tracking.tracker import Tracker
from scenes.geometry import poses as se3
from scenes.robot.gels import Gel
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames
from touch.arrays.readings import Reading
from touch.arrays.slip import PatternSettings, PatternWatch
from touch.gels.patches import patch_of
from touch.gels.skin.heights import indentation_of

FLAT = grasps.pad(8, 3, 0.0032, None)
LAYER = grasps.LAYER


def pattern(x=0.0, y=0.0, force=1.0, rng=None, name="pad", wide=(0.006, 0.004)):
    """A smooth pressure pattern with its middle at (x, y) metres."""
    pressure = 4e4 * force * np.exp(-(((FLAT[:, 0] - x) / wide[0]) ** 2) - ((FLAT[:, 1] - y) / wide[1]) ** 2)
    pressure = pressure if rng is None else pressure + 400.0 * rng.normal(size=24)
    return Reading(name, FLAT, np.where(pressure < LAYER.threshold, 0.0, pressure), LAYER, np.eye(4))


def alarms(frames, settings=None):
    watch = PatternWatch(settings)
    return [i for i, readings in enumerate(frames) if watch.step(readings).slipped]


def test_a_held_pattern_says_nothing_for_a_thousand_frames():
    rng = np.random.default_rng(0)
    assert not alarms([[pattern(rng=rng), pattern(0.004, name="other", rng=rng)] for _ in range(1000)])
    # faint ones neither: three taxels near their threshold come and go
    faint = PatternSettings().faint * LAYER.threshold
    weak = [pattern(force=0.06, rng=rng) for _ in range(300)]
    assert max(one.pressure.sum() for one in weak) < faint
    assert not alarms([[one] for one in weak])


@pytest.mark.parametrize("step", [0.0002, 0.0005, 0.001])
def test_a_slip_fast_or_slow_is_said_in_time_and_only_then(step):
    rng = np.random.default_rng(1)
    along = np.concatenate([np.zeros(20), step * np.arange(1, 7), np.full(15, 6 * step)])
    said = alarms([[pattern(x, rng=rng), pattern(y=0.5 * x, rng=rng, name="other")] for x in along])
    assert said
    assert 20 <= said[0] <= 26
    assert said[-1] < 30  # where it has come to rest is where it is held


def test_force_made_and_broken_contacts_are_no_slips():
    rng = np.random.default_rng(2)
    swelling = 1.0 + 0.4 * np.sin(np.arange(60) / 5.0)
    assert not alarms([[pattern(force=f, rng=rng)] for f in swelling])
    hopping = [pattern(force=f, x=0.004 * (i > 30), rng=rng) for i, f in enumerate([1.0] * 30 + [0.0] * 5 + [1.0] * 20)]
    assert not alarms([[one] for one in hopping])


def test_a_finger_that_rolls_alone_needs_a_whole_limit():
    rng = np.random.default_rng(3)
    shift = 0.65 * PatternSettings().slip.share * 0.0032
    still = [[pattern(shift * (i > 20), rng=rng), pattern(name="other", rng=rng)] for i in range(40)]
    both = [[pattern(shift * (i > 20), rng=rng), pattern(-shift * (i > 20), name="other", rng=rng)] for i in range(40)]
    assert not alarms(still)
    assert alarms(both)


def test_patterns_and_poses_are_watched_together():
    model = library.make("mug")
    watch, own = SlipWatch(model, 40.0), 1e-6 * np.eye(6)
    belief = Belief(np.eye(4), own, 0 * own)
    words = []
    for i in range(16):
        felt = watch.feel([pattern(0.002 * (i >= 8))])
        words.append(watch.step(Measurement(np.eye(4), own, 0 * own), belief, None, felt))
    assert not any(one.slip or one.moved for one in words[:8])
    assert words[8].slip
    assert words[8].moved
    assert words[8].statistic > 1.0
    assert "patterns" in words[8].by
    assert not words[-1].slip
    # a pose that jumps is a slip without arrays, too
    jumped = se3.perturb(np.eye(4), [0.0, 0.0, 0.0, 0.02, 0.0, 0.0], model.centroid)
    said = watch.step(Measurement(jumped, own, 0 * own), belief, None, Watched())
    assert said.slip
    assert "poses" in said.by


def test_a_track_says_what_the_arrays_feel():
    """The second half of a carried sequence with every pad's rows moved by one: nothing else tells of it."""
    small = SynthesisSettings(camera=SynthesisSettings().camera.scaled(0.25), rgb=False)
    model = library.make("mug")
    frames = synthesize_frames(
        model, five_finger_hand(), 9, 0.4, ("point", "array"), "clean", 3, settings=small, taxels="pad", motion="carry"
    )
    moved = [replace(f, tactile={k: np.roll(v, 3) for k, v in f.tactile.items()}) for f in frames[6:]]
    tracker = Tracker(model)
    answers = [tracker.step(frame) for frame in (*frames[:6], *moved)]
    assert not any(a.slip for a in answers[:6])
    assert answers[6].slip
    assert answers[6].moved_in_hand
    assert any("patterns" in note for note in answers[6].notes)
    bare = Tracker(model)
    assert not any(bare.step(replace(frame, tactile={})).slip for frame in (*frames[:6], *moved))


def test_patches_and_poses_are_watched_together():
    """An oval that moves over a gel by 0.4 mm a frame, while the pose stays."""
    side, pitch = 120, 0.0001
    gel = Gel(side, side, np.zeros((side, side)), pitch)
    v, u = np.indices((side, side))

    def patch(x):
        away = (u * pitch - 0.006 - x) ** 2 / 0.002**2 + (v * pitch - 0.006) ** 2 / 0.001**2
        return patch_of("g", indentation_of(np.rint(800 * np.exp(-0.5 * away)).astype(np.uint16), gel))

    watch = SlipWatch(library.make("mug"), 40.0)
    still = [watch.feel([], [patch(0.0)]) for _ in range(6)]
    slid = [watch.feel([], [patch(0.0004 * i)]) for i in range(1, 5)]
    assert not any(one.slip for one in still)
    assert slid[-1].slip
    assert "gels" in slid[-1].by
    watch.let_go()
    assert not watch.feel([], [patch(0.0)]).slip
