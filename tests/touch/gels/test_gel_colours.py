"""Calibration by a ball, normals by colours, and what an image tells of its own lamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pressed_gels import BALL, ball_depth, flat_gel

from scenes.errors import InputError
from scenes.synthesis.gels import ball_presses, bridged, lit, lit_digit, photograph_gel
from touch.gels.skin.calibration import DOUBTED, calibrate, largest_ball
from touch.gels.skin.colour import Moved
from touch.gels.skin.heights import heights, indentation_of
from touch.gels.skin.lamps import LampSettings, lamps_of, slopes_of
from touch.gels.skin.photometry import Photometry


def test_an_image_tells_how_its_lamps_mix(digit):
    """Colours of a ball under lamps that mix otherwise than the calibration's: most of the mixture is found."""
    photometry = Photometry.from_json(digit.calibration, "c")
    work = digit.working
    step = digit.working_step
    depth = bridged(ball_depth(digit, 0.006, 0.0012, 120, 160), digit)[::step, ::step]
    by_normal, by_depth = photometry.maps(work)
    change = work.normals(depth) - work.untouched_normals
    mixture = np.array([[1.2, 0.2, 0.0], [0.0, 0.9, -0.1], [0.1, 0.0, 1.1]])
    seen = (np.einsum("hwci,hwi->hwc", by_normal, change) + by_depth * depth[..., None]) @ mixture.T
    inside = depth > 1e-5
    settings = LampSettings()
    found = lamps_of(seen.astype(np.float32), inside, work, photometry, settings)
    assert np.abs(found.mixture - mixture).mean() < 0.7 * np.abs(np.eye(3) - mixture).mean()
    difference = (seen * np.maximum(work.level, photometry.darkest)).astype(np.float32)
    moved, left = Moved(difference, np.ones(3), inside, inside, 1.0), []
    for rounds in (0, settings.rounds):
        fields = slopes_of(moved, inside, work, photometry, replace(settings, rounds=rounds))
        left.append(np.sqrt(np.mean((heights(inside, fields, work) - depth)[inside] ** 2)))
    assert left[1] < 0.75 * left[0]
    assert (found.sigma[:9] < settings.mixed).all()
    # nothing moved: nothing is learnt
    nothing = lamps_of(np.zeros_like(seen, dtype=np.float32), np.zeros_like(inside), work, photometry, settings)
    np.testing.assert_array_equal(nothing.mixture, np.eye(3))


def test_a_wrong_ball_is_refused():
    rng = np.random.default_rng(4)
    gel = lit(flat_gel(200), rng)
    images = ball_presses(gel, BALL, 0.0008, 3, rng)
    assert calibrate(images, gel, BALL).presses == 3
    with pytest.raises(InputError, match=r"press 0: expected the outline of a ball of 2 mm or less"):
        calibrate(images, gel, 0.001)
    with pytest.raises(InputError, match=r"is the radius right"):
        calibrate(images, gel, 0.09)
    with pytest.raises(InputError, match=r"expected a radius from 0.1 to 100 mm"):
        calibrate(images, gel, float("nan"))
    with pytest.raises(InputError, match="press 0: expected a press of the ball, got an image like the background"):
        calibrate([photograph_gel(gel, np.zeros((200, 200)), rng)], gel, BALL)
    with pytest.raises(InputError, match="expected images of presses, got none"):
        calibrate([], gel, BALL)


def test_a_wrong_radius_is_told_by_brightness_or_by_another_calibration(digit):
    """A ball larger with slopes as much less explains how colours change just as well; but the square of that of the
    light would have to shine straight onto the skin. A quarter more is too little to be refused, and doubted.
    """
    rng = np.random.default_rng(50)
    other = lit_digit(rng)
    images = ball_presses(other, BALL, 0.0008, 4, rng)
    like = Photometry.from_json(digit.calibration, "c")
    right, larger = calibrate(images, other, BALL), calibrate(images, other, 1.15 * BALL)
    assert abs(right.misfit - larger.misfit) < 0.02
    assert calibrate(images, other, BALL, like=like).misfit == right.misfit
    assert right.light < DOUBTED < calibrate(images, other, 1.25 * BALL).light
    assert BALL < largest_ball(right) < 1.25 * BALL
    assert largest_ball(larger) == pytest.approx(largest_ball(right), rel=0.05)  # it does not depend on what is said
    assert largest_ball(replace(right, light=0.0)) == np.inf
    for wrong in (1.5, 2.0, 3.0):
        with pytest.raises(InputError, match=r"expected a ball of .* mm or less by the presses' brightness"):
            calibrate(images, other, wrong * BALL)
    for wrong in (0.5 * BALL, 2 * BALL):
        with pytest.raises(InputError, match=r"radius right\?|radius or more, got|ball of .* or less"):
            calibrate(images, other, wrong, like=like)
    with pytest.raises(InputError, match=r"expected presses of a 8 mm ball, got ones of [3-5]\.?\d? mm"):
        calibrate(images, other, 2 * BALL, like=like)
    with pytest.raises(InputError, match="expected one of 240x320 pixels to compare with, got one of 10x10"):
        calibrate(images, other, BALL, like=replace(like, size=(10, 10)))


def test_skin_steeper_than_it_can_be_is_a_ball_too_small():
    rng = np.random.default_rng(4)
    gel = lit(flat_gel(200), rng)
    images = ball_presses(gel, BALL, 0.0012, 3, rng)
    assert calibrate(images, gel, BALL).presses == 3
    with pytest.raises(InputError, match=r"expected a ball of .* mm radius or more, got 2.8 mm.*steeper than skin"):
        calibrate(images, gel, 0.0028)


def test_a_calibration_is_read_back_or_refused(digit):
    entry = dict(digit.calibration)
    again = Photometry.from_json(entry, "c")
    assert again.to_json() == entry
    for key, value in (
        ("format", "x"),
        ("version", 1),
        ("by_normal", [[1.0]]),
        ("by_depth", [[1.0, np.nan, 0.0]] * 3),
        ("darkest", 0.0),
        ("size", "a"),
        ("depths_mm", [np.nan]),
        ("size", [np.inf, 1]),
    ):
        with pytest.raises(InputError, match=r"^c: expected"):
            Photometry.from_json({**entry, key: value}, "c")
    image = photograph_gel(digit, np.zeros((320, 240)), np.random.default_rng(1))
    with pytest.raises(InputError, match="expected a calibration of"):
        indentation_of(image, replace(digit, calibration={**entry, "size": [10, 10]}))
