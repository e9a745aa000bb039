"""Steps in brightness next to an outline: found to a tenth of a pixel, and left out where they are none."""

from dataclasses import replace
from math import erf

import numpy as np
import pytest
from made_frames import plain_view

from scenes.geometry.appearance.rendering import Renderer, shade
from scenes.recordings.beliefs import DepthModel
from scenes.synthesis import library
from vision.contour import edge_kernels
from vision.contour.edges import EdgeSettings, edges_near
from vision.contour.evidence import ContourEvidence
from vision.contour.lines import lines_across
from vision.contour.outline import outline_of
from vision.picture.predictor import Predictor

OFFSETS = np.arange(-17, 18)
NOTHING = np.zeros(6), 1e-6 * np.eye(6)


def smeared_step(at, smear, inner=180.0, outer=60.0):
    """A profile over OFFSETS that falls from one level to the other at `at` (px)."""
    reached = np.array([0.5 * (1.0 + erf((offset - at) / (smear * np.sqrt(2.0)))) for offset in OFFSETS])
    return inner + (outer - inner) * reached


def plain_profiles(samples, places, normals, reach, alike):
    """NumPy twin of `edge_kernels.profiles`."""
    out, half = np.zeros(samples.shape[:2]), samples.shape[1] // 2
    for i in range(len(samples)):
        near = (np.linalg.norm(places - places[i], axis=1) < reach) & (normals @ normals[i] >= alike)
        change = samples[near][:, :half].sum(axis=(0, 1)) - samples[near][:, -half:].sum(axis=(0, 1))
        out[i] = np.median(samples[near] @ (change / np.linalg.norm(change)), axis=0)
    return out


@pytest.mark.parametrize("channels", [1, 3])
def test_profiles_agree_with_their_twin(rng, channels):
    samples = rng.integers(0, 256, (20, 9, channels)).astype(np.uint8)
    places, angles = rng.uniform(0.0, 15.0, (20, 2)), rng.uniform(0.0, 2.0, 20)
    normals, values = np.stack([np.cos(angles), np.sin(angles)], axis=1), np.zeros((20, 9))
    edge_kernels.profiles(samples, places, normals, 6.0, 0.8, values)
    np.testing.assert_allclose(values, plain_profiles(samples.astype(np.float64), places, normals, 6.0, 0.8), atol=1e-9)


def plain_step(values, at, smear, window):
    """NumPy twin of one Gauss-Newton step of `edge_kernels.steps`: where it leads, and the standard deviation."""
    near = np.abs(OFFSETS - at) <= window
    reached = np.array([0.5 * (1.0 + erf((offset - at) / (smear * np.sqrt(2.0)))) for offset in OFFSETS[near]])
    levels = np.stack([np.ones(near.sum()), reached], axis=1)
    found, *_ = np.linalg.lstsq(levels, values[near], rcond=None)
    slope = -found[1] * np.exp(-0.5 * ((OFFSETS[near] - at) / smear) ** 2) / (smear * np.sqrt(2.0 * np.pi))
    slope = slope - levels @ np.linalg.lstsq(levels, slope, rcond=None)[0]
    off = values[near] - levels @ found
    deviation = np.sqrt(max(float(off @ off) / max(near.sum() - 3, 1), 1.0) / float(slope @ slope))
    return at + np.clip(float(slope @ off) / float(slope @ slope), -1.0, 1.0), deviation, -found[1]


def test_a_step_agrees_with_its_twin(rng):
    values = np.array([smeared_step(at, 1.0) for at in rng.uniform(-2.0, 2.0, 12)]) + rng.normal(0.0, 6.0, (12, 35))
    start, edges = rng.uniform(-1.5, 1.5, 12), np.zeros((12, 3))
    edge_kernels.steps(values, -17.0, start, 0.8, 3.5, 1.0, 1, edges)
    twin = np.array([plain_step(row, at, 0.8, 3.5) for row, at in zip(values, start, strict=True)])
    np.testing.assert_allclose(edges, twin, rtol=1e-6, atol=1e-9)


def test_steps_are_found_to_a_tenth_of_a_pixel_whatever_smears_them():
    at = np.linspace(-3.0, 3.0, 13)
    for smear in (0.5, 0.8, 1.2):
        values, edges = np.array([smeared_step(one, smear) for one in at]), np.zeros((13, 3))
        edge_kernels.steps(values, -17.0, at + 0.8, 0.8, 3.5, 1.0, 8, edges)
        np.testing.assert_allclose(edges[:, 0], at, atol=0.1)
        assert (edges[:, 2] > 90.0).all()


def test_where_no_step_is_looked_for_or_there_is_none_none_is_found():
    values, edges = np.array([smeared_step(0.0, 1.0), smeared_step(16.5, 1.0), np.full(35, 70.0)]), np.zeros((3, 3))
    edge_kernels.steps(values, -17.0, np.array([np.nan, 16.5, 0.0]), 0.8, 3.5, 1.0, 6, edges)
    assert not np.isfinite(edges[:2, 1]).any()
    assert not np.isfinite(edges[2, 1]) or abs(edges[2, 2]) < 1e-6


def test_steps_stand_for_their_lines_as_by_numpy(rng):
    edges, variance = rng.normal(size=(15, 2)), rng.uniform(0.1, 1.0, 15)
    edges[::4, 1] = np.inf
    rows, moved, share = rng.normal(size=(15, 10)), 0.3 * rng.normal(size=10), rng.uniform(0.1, 1.0, 15)
    left, weight = np.full(15, 7.0), np.full(15, 9.0)
    edge_kernels.weigh(edges, variance, rows, moved, 0.01, share, left, weight)
    off = edges[:, 0] - rows @ moved
    odds = 0.01 * np.sqrt(2.0 * np.pi * variance) * np.exp(0.5 * off**2 / variance)
    there = np.isfinite(edges[:, 1])
    np.testing.assert_allclose(left, np.where(there, rows[:, :6] @ moved[:6] - edges[:, 0], 7.0))
    np.testing.assert_allclose(weight, np.where(there, share / variance / (1.0 + odds), 9.0))


def photographed(name, pattern=None, ground=142.0):
    """A plain view with an image of it in which a pixel is the mean of nine rays and edges are smeared, and the model;
    ground: grey of what is behind it.
    """
    import cv2

    frame, model, size = plain_view(name), library.make(name), 3
    camera, truth = frame.camera, frame.camera_from_object_truth
    wide = replace(
        camera,
        fx=size * camera.fx,
        fy=size * camera.fy,
        cx=size * camera.cx + 0.5 * (size - 1),
        cy=size * camera.cy + 0.5 * (size - 1),
        width=size * camera.width,
        height=size * camera.height,
    )
    seen = Renderer({"object": (model.vertices, model.faces)}).render(wide, {"object": truth})
    rgb = shade(seen, {"object": (206, 116, 58)}).astype(np.float64)
    rgb[~seen.mask("object")] = ground
    rgb = rgb.reshape(camera.height, size, camera.width, size, 3).mean(axis=(1, 3))
    rgb = cv2.GaussianBlur(rgb, (0, 0), 0.7) + np.random.default_rng(3).normal(0.0, 3.0, rgb.shape)
    if pattern is not None:
        rgb = pattern(rgb)
    return replace(frame, rgb=np.clip(rgb, 0, 255).astype(np.uint8)), model


def test_edges_of_an_image_are_where_the_outline_is_nearer_than_its_colours_say():
    frame, model = photographed("box")
    outline = outline_of(model, frame.camera, frame.camera_from_object_truth)
    lines = lines_across(frame.rgb, outline)
    edges = edges_near(lines, np.zeros(len(outline)), EdgeSettings())
    there = np.isfinite(edges[:, 1])
    assert there.mean() > 0.9
    assert np.median(np.abs(edges[there, 0])) < 0.15
    # a step that is not next to where the colours have the border is another
    far = edges_near(lines, np.full(len(outline), 4.0), EdgeSettings())
    assert np.isfinite(far[:, 1]).mean() < 0.2


def read(frame, model, rounds):
    """The evidence at the true pose after Gauss-Newton steps of lines alone, and the move that they make."""
    pose = frame.camera_from_object_truth
    evidence = ContourEvidence(frame, model, Predictor(frame, model, DepthModel()), pose, 1e-4)
    assert not evidence.why_not
    delta = np.zeros(6)
    for sharp in rounds:
        gradient, hessian = evidence.terms(delta, (NOTHING[1] @ delta, NOTHING[1]), sharp)
        delta = delta - np.linalg.solve(hessian + 1e3 * np.eye(6), gradient)
    return evidence, delta


def test_steps_know_the_pose_better_than_colours():
    frame, model = photographed("drill")
    coarse, by_colours = read(frame, model, (0.0, 0.0, 0.0, 0.0))
    fine, by_steps = read(frame, model, (0.0, 0.0, 0.8, 0.4, 0.2, 0.2))
    assert fine.shift_of(by_steps) < max(0.2, coarse.shift_of(by_colours))
    assert fine._scatter < 3.0


def test_a_pattern_of_dots_is_no_edge():
    def dotted(rgb):
        rng = np.random.default_rng(5)
        out = rgb.copy()
        for v, u in rng.uniform(0, 1, (9000, 2)) * (rgb.shape[0] - 4, rgb.shape[1] - 4):
            out[int(v) : int(v) + 3, int(u) : int(u) + 3] += 90.0
        return out

    clean, _ = read(*photographed("drill"), (0.0, 0.0, 0.8, 0.4, 0.2))
    dots, _ = read(*photographed("drill", pattern=dotted), (0.0, 0.0, 0.8, 0.4, 0.2))
    assert dots._scatter > 3.0 > clean._scatter
    _, told = clean.terms(np.zeros(6), None, 0.2)
    _, left = dots.terms(np.zeros(6), None, 0.2)
    assert np.trace(left[3:, 3:]) < np.trace(told[3:, 3:])


def test_rounded_edges_that_are_brighter_than_the_ground_may_end_early():
    ball, box = (photographed(name, ground=10.0) for name in ("sphere", "box"))
    dark = photographed("sphere", ground=240.0)
    rounded, sharp, darker = (read(*one, (0.0,))[0]._fades for one in (ball, box, dark))
    assert np.median(rounded) > 0.5
    assert np.median(sharp) < np.median(rounded)
    assert np.median(darker) == 0.0


def test_rounded_edges_are_believed_to_end_early_where_nothing_tells():
    """An image in which lines weigh nothing leaves what is believed; one that tells moves it to what is seen."""
    frame, model = photographed("sphere", ground=10.0)
    pose = frame.camera_from_object_truth
    evidence = ContourEvidence(frame, model, Predictor(frame, model, DepthModel()), pose, 1e-4)
    evidence.share = 1e-12 * evidence.alone
    evidence.terms(np.zeros(6))
    assert evidence._common == pytest.approx([0.0, 0.0, 0.0, -evidence.settings.early], abs=1e-3)
    evidence.share = evidence.alone
    for _ in range(4):
        gradient, _ = evidence.terms(np.zeros(6))
    off = evidence.common @ evidence._common
    # what all lines share says how far the image's border is inside, whatever is believed of rounded edges
    assert np.median(off) < 0.0
    assert np.isfinite(gradient).all()
