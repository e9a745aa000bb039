"""Faults are what they say: a camera so far off, contacts that lie and are known to."""

import numpy as np

from fusion.benchmarks.frames import faults


def test_a_moved_camera_moves_all_that_the_robot_reports(exact_frame):
    off, lying = faults.moved_camera(0.01)(exact_frame, np.random.default_rng(0))
    shift = off.world_from_hand[:3, 3] - exact_frame.world_from_hand[:3, 3]
    assert np.isclose(np.linalg.norm(shift), 0.01)
    assert np.allclose(off.contacts.points - exact_frame.contacts.points, shift)
    assert not lying.any()
    assert (off.depth == exact_frame.depth).all()


def test_lying_fingers_are_as_many_and_as_far_as_said(exact_frame):
    spoiled, lying = faults.lying_fingers(2)(exact_frame, np.random.default_rng(0))
    moved = np.linalg.norm(spoiled.contacts.points - exact_frame.contacts.points, axis=1)
    assert lying.sum() == 2
    assert np.allclose(moved[lying], faults.ASTRAY)
    assert (moved[~lying] == 0).all()
    assert (spoiled.contacts.sigma_point == exact_frame.contacts.sigma_point).all()
    everyone, all_lie = faults.lying_fingers(99)(exact_frame, np.random.default_rng(0))
    assert all_lie.all()
    assert len(everyone.contacts) == len(exact_frame.contacts)


def test_depth_is_scaled(exact_frame):
    off, _ = faults.scaled_depth(1.02)(exact_frame, np.random.default_rng(0))
    seen = exact_frame.depth > 0
    assert np.allclose(off.depth[seen] / exact_frame.depth[seen], 1.02, atol=1e-5)
