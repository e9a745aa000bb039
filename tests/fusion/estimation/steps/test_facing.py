"""What is printed on an object says which way round it is; what cannot be read changes nothing and is said."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from fusion import estimate
from fusion.benchmarks.camera.prints import unevenly_lit
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.steps import facing
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.texture import Texture, TextureSettings
from scenes.synthesis import library
from scenes.synthesis.recording import synthesize_frames
from scenes.synthesis.staging.prints import ink, with_print
from vision import texture

COUNTS = EstimateSettings(texture=texture.PrintSettings(counts=True))


@pytest.fixture(scope="module", params=["box", "cylinder"])
def held(request, hand):
    """A printed object that a hand half hides, and its model."""
    model = with_print(library.make(request.param))
    return synthesize_frames(model, hand, 1, 0.3, noise="lab", seed=3, scene="print")[0], model


def off(pose, frame):
    """Degrees between a pose and the truth, symmetries or not."""
    turn = pose[:3, :3].T @ frame.camera_from_object_truth[:3, :3]
    return float(np.rad2deg(poses.rotation_angle(turn)))


def stage_of(answer):
    return next(stage for stage in answer.trace if stage.name == "print")


def upside_down(frame, model):
    """The frame with a start at another face."""
    return replace(frame, prior=frame.prior @ model.symmetries.discrete[1])


@pytest.mark.parametrize("start", ["another face", "none"])
def test_the_print_tells_the_face_whatever_the_start(held, start):
    frame, model = held
    asked = upside_down(frame, model) if start == "another face" else replace(frame, prior=None)
    answer = estimate(asked, model, settings=COUNTS)
    assert off(answer.pose, frame) < 20.0
    assert answer.print_share > 0.95
    assert answer.verdict == "ok"
    assert stage_of(answer).ran
    assert not any("rotation" in one for one in answer.unobservable)
    if model.symmetries.axes:  # how sure the turn is, is part of the answer
        axis = answer.pose[:3, :3] @ model.symmetries.axes[0].direction
        assert np.sqrt(axis @ answer.covariance[:3, :3] @ axis) < np.deg2rad(10.0)
    assert np.linalg.eigvalsh(answer.covariance).min() > 0.0
    assert np.array_equal(answer.pose, estimate(asked, model, settings=COUNTS).pose)


@pytest.mark.parametrize(
    "change",
    [
        lambda rgb, rng: np.clip(0.4 * rgb + 30 + rng.normal(0, 8, rgb.shape), 0, 255).astype(np.uint8),
        lambda rgb, rng: cv2.GaussianBlur(rgb, (0, 0), 2.0),
        lambda rgb, rng: np.repeat(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2),
    ],
    ids=["dim and noisy", "blurred", "grey"],
)
def test_light_blur_and_grey_do_not_matter(held, change):
    frame, model = held
    worn = replace(upside_down(frame, model), rgb=change(frame.rgb, np.random.default_rng(0)))
    assert off(estimate(worn, model).pose, frame) < 20.0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rgb: np.zeros_like(rgb), "not seen"),
        (lambda rgb: np.full_like(rgb, 255), "not seen"),
        (lambda rgb: rgb[..., ::-1], "swapped"),
        (lambda rgb: np.roll(rgb, 12, axis=0), "registered"),
    ],
    ids=["black", "white", "swapped", "shifted"],
)
def test_an_image_that_does_not_show_it_changes_nothing_and_is_said(held, change, said):
    frame, model = held
    if said == "registered" and not model.symmetries.axes:
        pytest.skip("faces are told wherever the print is")
    asked = upside_down(frame, model)
    shown = replace(asked, rgb=np.ascontiguousarray(change(frame.rgb)))
    plain, answer = estimate(shown, model.with_texture(None)), estimate(shown, model)
    assert np.array_equal(plain.pose, answer.pose)
    assert np.array_equal(plain.covariance, answer.covariance)
    assert np.isnan(answer.print_share)
    assert any(said in note for note in answer.notes)
    assert estimate(shown, model, settings=COUNTS).verdict == "ambiguous"


def test_a_shift_of_the_image_makes_no_face_another(held):
    frame, model = held
    if not model.symmetries.axes:
        shown = replace(upside_down(frame, model), rgb=np.roll(frame.rgb, 12, axis=0))
        assert off(estimate(shown, model).pose, frame) < 20.0


def test_a_plain_mesh_is_skipped_and_cannot_count(held):
    frame, model = held
    plain = model.with_texture(None)
    assert stage_of(estimate(frame, plain)).why == "nothing is printed on the mesh"
    with pytest.raises(InputError, match="mesh with colours"):
        estimate(frame, plain, settings=COUNTS)
    assert not stage_of(estimate(replace(frame, rgb=None), model)).ran


def test_a_way_round_that_the_shape_nearly_has_is_tried(hand):
    """Nobody declares what a scanned box has: its faces are minima of their own, and a start keeps a search in one."""
    box = library.make("box")
    model = with_print(box)
    frame = synthesize_frames(model, hand, 1, 0.3, noise="lab", seed=3, scene="print")[0]
    unknown = model.with_symmetries(type(box.symmetries).none())
    asked = upside_down(frame, model)
    assert off(estimate(asked, unknown.with_texture(None)).pose, frame) > 90.0
    answer = estimate(asked, unknown, settings=COUNTS)
    assert off(answer.pose, frame) < 20.0
    assert answer.verdict == "ok"
    # the start that the caller gave is reported, not the one that turned with the face
    np.testing.assert_allclose(answer.start, asked.prior, atol=1e-9)


@pytest.mark.parametrize(("seed", "declared"), [(7, True), (2, False), (3, False)])
def test_shadows_highlights_and_clipping_hide_no_face(hand, seed, declared):
    """They leave much of the image unexplained by the right print, and more by any other way round."""
    box = library.make("box")
    model = with_print(box)
    frame = synthesize_frames(model, hand, 1, 0.3, noise="lab", seed=5, scene="print")[0]
    lit = replace(upside_down(frame, model), rgb=unevenly_lit(frame.rgb, np.random.default_rng(seed)))
    asked = model if declared else model.with_symmetries(type(box.symmetries).none())
    answer = estimate(lit, asked)
    assert off(answer.pose, frame) < 20.0
    assert answer.print_share > 0.95


@pytest.mark.parametrize("ways", [2, 4, 24, 72])
def test_a_start_speaks_for_its_face_against_all_others_together(ways):
    costs = np.full(ways, 40.0)
    costs[1] = 0.0
    likely = np.exp(facing._known(costs, 2.0))
    np.testing.assert_allclose(likely.sum(), 1.0)
    odds = (likely[1] - likely[0]) / (ways * likely[0])
    np.testing.assert_allclose(odds, np.exp(2.0), rtol=1e-9)


def test_what_prints_explain_is_least_squares():
    rng = np.random.default_rng(1)
    count = 60
    shades = np.concatenate([np.ones((count, 1)), rng.normal(size=(count, 3))], axis=1)
    shades[:, 1:] -= shades[:, 1:].mean(axis=0)
    prints, values = rng.random((4, count)), rng.normal(size=(5, count))
    found = texture._explained(prints, shades, values)
    for k in range(4):
        design = np.concatenate([np.ones((count, 1)), prints[k][:, None] * shades], axis=1)
        fit = np.linalg.lstsq(design, values.T, rcond=None)[0]
        left = np.mean(np.square(values.T - design @ fit), axis=0)
        expected = np.where(fit[1] > 0.0, left, values.var(axis=1))
        np.testing.assert_allclose(found[k], expected, rtol=1e-3)


@pytest.mark.parametrize("declared", [True, False], ids=["declared", "nearly"])
def test_another_objects_print_does_not_decide(held, declared):
    """A repainted object: some of the print fits somewhere by chance, and far less than the right one explains. Ways
    round that the shape nearly has count among those that are told apart, whether they are declared or not.
    """
    frame, model = held
    points, _ = model.sample_surface(TextureSettings().samples, seed=1)
    other = replace(model, name="repainted") if hasattr(model, "__dataclass_fields__") else model
    other = SimpleNamespace(name="repainted", centroid=model.centroid)
    colours = np.rint(255.0 * ink(points, other))
    repainted = model.with_texture(Texture(points, colours, TextureSettings()))
    if not declared:
        repainted = repainted.with_symmetries(type(model.symmetries).none())
    answer = estimate(replace(frame, prior=None), repainted, settings=COUNTS)
    assert not answer.print_share >= 0.95
    assert answer.verdict == "ambiguous"
