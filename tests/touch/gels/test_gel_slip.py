"""Slip by what presses a gel moving over its skin: known motions of known shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenes.geometry import poses as se3
from scenes.robot.gels import Gel
from touch.gels.patches import patch_of
from touch.gels.skin.heights import indentation_of
from touch.gels.slip import PatchSlipSettings, PatchWatch, patch_motion, sigmas_off

PITCH = 0.0001
SIDE = 160


def gel():
    return Gel(SIDE, SIDE, np.zeros((SIDE, SIDE)), PITCH, thickness=0.003)


def bump(x=0.0, y=0.0, turn=0.0, deep=0.0008, wide=0.0025, narrow=0.0012):
    """Micrometres of an oval bump at x, y (m), turned by `turn` (rad)."""
    v, u = np.indices((SIDE, SIDE))
    px, py = (u - 0.5 * (SIDE - 1)) * PITCH - x, (v - 0.5 * (SIDE - 1)) * PITCH - y
    c, s = np.cos(turn), np.sin(turn)
    along, across = c * px + s * py, -s * px + c * py
    height = deep * np.exp(-0.5 * ((along / wide) ** 2 + (across / narrow) ** 2))
    return np.rint(1e6 * np.where(height > 5e-5, height, 0.0)).astype(np.uint16)


def pressed(**how):
    return indentation_of(bump(**how), GEL)


def patch(**how):
    return patch_of("g", pressed(**how))


GEL = gel()


@pytest.mark.parametrize(
    ("x", "y", "turn"), [(0.0, 0.0, 0.0), (0.0004, -0.0003, 0.0), (0.0, 0.0, 0.1), (0.0015, 0.001, -0.05)]
)
def test_a_known_motion_is_found(x, y, turn):
    found = patch_motion(pressed(), pressed(x=x, y=y, turn=turn))
    np.testing.assert_allclose(found.shift[:2], [x, y], atol=3e-5)
    assert found.shift[2] == pytest.approx(turn, abs=0.01)
    assert np.linalg.eigvalsh(found.covariance)[0] > 0


def test_a_deeper_press_is_no_motion():
    found = patch_motion(pressed(), pressed(deep=0.001))
    assert np.linalg.norm(found.shift[:2]) < 2e-5
    assert found.deeper == pytest.approx(0.0002, abs=5e-5)
    assert sigmas_off(found, np.zeros(3), PatchSlipSettings()) < 1.0


def test_along_a_ridge_nothing_is_known():
    """A ridge across the whole image looks the same wherever along itself it is."""
    v = np.indices((SIDE, SIDE))[0]
    row = 800.0 * np.exp(-0.5 * ((v - 79.5) * PITCH / 0.001) ** 2)
    ridge = indentation_of(np.rint(np.where(row > 50, row, 0)).astype(np.uint16), GEL)
    found = replace(patch_motion(ridge, ridge), explained=1.0)
    across, along = np.sqrt(found.covariance[1, 1]), np.sqrt(found.covariance[0, 0])
    assert along > 20 * across
    assert along > 0.001
    assert sigmas_off(replace(found, shift=np.array([0.001, 0.0, 0.0])), np.zeros(3), PatchSlipSettings()) < 1.5


def test_nothing_and_another_thing_have_no_motion():
    empty = indentation_of(np.zeros((SIDE, SIDE), dtype=np.uint16), GEL)
    assert patch_motion(empty, pressed()) is None
    assert patch_motion(pressed(), empty) is None
    assert patch_motion(pressed(x=-0.006, wide=0.001, narrow=0.001), pressed(x=0.006, wide=0.001, narrow=0.001)) is None


def test_a_slide_is_said_and_a_held_object_is_not():
    watch = PatchWatch()
    held = [watch.step([patch(deep=0.0008 + 0.00003 * np.sin(i))]).slipped for i in range(8)]
    assert not any(held)
    slid = [watch.step([patch(x=0.0004 * i)]).slipped for i in range(5)]
    assert any(slid)
    rest = [watch.step([patch(x=0.0016)]).slipped for _ in range(8)]
    assert not any(rest[2:])


def test_a_gel_that_always_flickers_has_to_say_more():
    """The same slide after a quiet past and after one in which the patch jumped back and forth every third frame."""

    def most(jumps):
        watch = PatchWatch()
        for i in range(14):
            watch.step([patch(x=0.0005 if jumps and i % 3 == 0 else 0.0)])
        return max(watch.step([patch(x=0.0002 * i)]).statistic for i in range(1, 4))

    assert most(jumps=True) < 0.9 * most(jumps=False)


def test_made_and_broken_contacts_are_no_slip():
    watch = PatchWatch()
    nothing = patch_of("g", indentation_of(np.zeros((SIDE, SIDE), dtype=np.uint16), GEL))
    for one in (nothing, patch(), nothing, patch(x=0.003), nothing):
        assert not watch.step([one]).slipped
    assert watch.step([]).statistic == 0.0


def test_an_object_that_stays_in_the_palm_does_not_slip():
    """The finger moves 1.6 mm under it, and it moves over the skin by as much the other way."""
    watch, still = PatchWatch(), PatchWatch()
    said, without = [], []
    for i in range(6):
        moved = 0.0004 * i
        one = patch(x=-moved)
        said.append(watch.step([one.moved(se3.make_pose(None, [moved, 0.0, 0.0]))]).slipped)
        without.append(still.step([one]).slipped)
    assert not any(said)
    assert any(without)


def test_the_same_images_say_the_same():
    first, again = (patch_motion(pressed(), pressed(x=0.0007, turn=0.05)) for _ in range(2))
    np.testing.assert_array_equal(first.shift, again.shift)
    np.testing.assert_array_equal(first.covariance, again.covariance)
