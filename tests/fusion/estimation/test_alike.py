"""Modes that are one answer, and what an answer looks like when it is turned."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from fusion.estimation.estimate import estimate
from fusion.estimation.posterior import verdict as posterior
from fusion.estimation.posterior.confidence import ConfidenceSettings, within_of
from fusion.estimation.posterior.spread import spread_of
from fusion.estimation.posterior.whole import told_covariance
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.steps.twins import with_twins
from scenes.evidence.align import Prior
from scenes.evidence.modes import Mode
from scenes.evidence.symmetry.alike import alike, hardly_moves, moved
from scenes.evidence.table import TOUCH, make
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library
from vision.visibility import Visibility

SHARP = np.diag(np.repeat([0.005, 0.0005], 3) ** 2)
SEEN = Visibility(0.9, 0.1, 0.0, 0.0)
TOLERANCE = ConfidenceSettings().tolerance


@pytest.fixture(scope="module")
def scanned():
    """A can as a scanner has it: no turn leaves it exactly where it was, and none is declared."""
    can = trimesh.creation.cylinder(radius=0.033, height=0.1, sections=48)
    can = can.subdivide().subdivide()
    rng = np.random.default_rng(0)
    return ObjectModel.from_mesh(can.vertices + rng.normal(0.0, 2e-4, can.vertices.shape), can.faces, "scanned can")


def turned(model, rotvec, pose=None):
    rotation = se3.exp_rotation(np.array([rotvec]))
    there = se3.make_poses(rotation, model.centroid - rotation @ model.centroid)[0]
    return (np.eye(4) if pose is None else pose) @ there


def place():
    return se3.make_pose(se3.random_rotations(1, np.random.default_rng(4))[0], [0.1, -0.2, 0.7])


def modes_of(model, *rotvecs, weights):
    poses = [place(), *(turned(model, r, place()) for r in rotvecs)]
    return tuple(Mode(pose, weight, 0.0, SHARP) for pose, weight in zip(poses, weights))


def test_slippage_is_what_sampled_points_move_along_their_normals():
    model = library.make("drill")
    points, normals = model.sample_surface(4000)  # other points than its own, and the mesh's normals
    rows = np.concatenate([np.cross(points - model.centroid, normals), normals], axis=1)
    expected = rows.T @ rows / len(rows)
    assert np.allclose(model.slippage, expected, atol=0.06 * np.sqrt(np.outer(*[np.diag(expected)] * 2)))
    assert np.trace(model.slippage[3:, 3:]) == pytest.approx(1.0)


def test_what_slides_along_itself_is_no_spread(scanned):
    about = np.diag([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    over = np.diag([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert spread_of(scanned, np.eye(4), about) < 0.2 * spread_of(scanned, np.eye(4), over)


def test_a_can_upside_down_is_one_answer_and_a_mug_turned_is_not(scanned):
    modes = modes_of(scanned, [np.pi, 0, 0], [0, 0, 1.0], [0.4, 0, 0], weights=(0.4, 0.3, 0.25, 0.05))
    same = alike(scanned, modes, TOLERANCE)
    assert len(same.modes) == 3
    assert same.weight == pytest.approx(0.95)
    assert same.means[0] == 0.0
    assert (same.means[1:] < 0.001).all()
    mug = library.make("mug")
    assert len(alike(mug, modes_of(mug, [0, 0, 1.0], weights=(0.6, 0.4)), TOLERANCE).modes) == 1
    # though its ADD-S is within the tolerance
    assert moved(mug, place(), turned(mug, [0, 0, 1.0], place())[None])[1] < TOLERANCE


def test_the_surface_moves_both_ways(scanned):
    """What leaves the surface is seen from the other surface, too: a shift along an axis moves as far as it is."""
    shift = se3.make_pose(np.eye(3), [0.0, 0.0, 0.02])
    largest, mean = moved(scanned, np.eye(4), shift[None])
    assert largest[0] == pytest.approx(0.02, rel=0.05)
    assert 0.0 < mean[0] < 0.02
    assert np.allclose(moved(scanned, shift, np.eye(4)[None])[0], largest, rtol=0.05)


def test_verdict_and_covariance_of_what_looks_alike(scanned):
    modes = modes_of(scanned, [np.pi, 0, 0], weights=(0.52, 0.48))

    def way_round(modes, word):
        return posterior.way_round(alike(scanned, modes, TOLERANCE), word, TOLERANCE)

    word, why = posterior.verdict(scanned, modes, (), 0.9, SEEN)
    assert word == "ok"
    assert why == "2 modes that look alike hold 100%"
    assert "which way round is not known: in 2 poses" in way_round(modes, "ok")[0]
    assert way_round((*modes[:1], replace(modes[1], weight=0.0)), "ambiguous") == ()
    assert way_round((replace(modes[0], weight=1.0),), "ok") == ()
    assert posterior.verdict(scanned, modes, (), 0.9, SEEN, tolerance=1e-5)[0] == "ambiguous"
    wide = told_covariance(scanned, modes, "ok", 0.99, None)
    apart = se3.difference(modes[1].pose, modes[0].pose, scanned.centroid)
    assert np.allclose(wide, SHARP + 0.48 * np.outer(apart, apart))
    sure = (replace(modes[0], weight=0.97), replace(modes[1], weight=0.03))
    assert np.array_equal(told_covariance(scanned, sure, "ok", 0.99, None), SHARP)
    near = [within_of(scanned, alike(scanned, some, TOLERANCE), TOLERANCE, 0.7) for some in (modes, modes[:1])]
    assert near[0] == pytest.approx(near[1], abs=0.05)


def test_a_turn_that_moves_nothing_far_is_named_and_no_doubt(scanned):
    axis = np.array([0.0, 0.0, 1.0])
    assert hardly_moves(scanned, place(), axis, np.pi, TOLERANCE)
    assert not hardly_moves(scanned, place(), np.array([1.0, 0.0, 0.0]), np.pi, TOLERANCE)
    assert not hardly_moves(library.make("mug"), place(), axis, np.pi, TOLERANCE)
    free = place()[:3, :3] @ axis
    covariance = SHARP + np.pad(np.outer(free, free), (0, 3))
    assert posterior.verdict(scanned, (Mode(place(), 1.0, 0.0, covariance),), (), 0.9, SEEN)[0] == "ok"
    assert posterior.unobservable(scanned, place(), covariance) == ("rotation about z",)
    mug = library.make("mug")
    assert posterior.verdict(mug, (Mode(place(), 1.0, 0.0, covariance),), (), 0.9, SEEN)[0] == "ambiguous"


def test_every_way_round_is_a_mode(scanned):
    points, normals = scanned.sample_surface(30, seed=2)
    rows = make(se3.apply(place(), points), 0.002, TOUCH, normals=normals @ place()[:3, :3].T, sigma_normal=0.2)
    alone = (Mode(place(), 1.0, 0.0, SHARP),)
    found = with_twins(scanned, alone, rows, None, EstimateSettings())
    assert len(found) > 3
    assert np.array_equal(found[0].pose, alone[0].pose)
    assert sum(mode.weight for mode in found) == pytest.approx(1.0)
    ups = [mode.pose[:3, 2] @ place()[:3, 2] for mode in found]
    assert min(ups) < -0.99  # on its head, too
    assert (moved(scanned, place(), np.array([mode.pose for mode in found]))[0] <= TOLERANCE).all()
    assert [mode.cost for mode in found] == sorted(mode.cost for mode in found)
    # a start that knows which way round leaves one
    start = Prior.isotropic(place(), 0.05, 0.01)
    assert with_twins(scanned, alone, rows, start, EstimateSettings()) == alone
    # and a mug has none
    mug = library.make("mug")
    points, normals = mug.sample_surface(30, seed=2)
    rows = make(se3.apply(place(), points), 0.002, TOUCH, normals=normals @ place()[:3, :3].T, sigma_normal=0.2)
    assert len(with_twins(mug, alone, rows, None, EstimateSettings())) <= 2


def test_of_ways_round_only_those_are_predicted_that_roughly_may_be(scanned):
    points, normals = scanned.sample_surface(30, seed=2)
    rows = make(se3.apply(place(), points), 0.002, TOUCH, normals=normals @ place()[:3, :3].T, sigma_normal=0.2)
    alone, asked = (Mode(place(), 1.0, 0.0, SHARP),), []

    def stands(poses):
        asked.append(poses)
        return np.where(poses[:, :3, 2] @ place()[:3, 2] > 0.0, 0.0, 60.0)

    whole = with_twins(scanned, alone, rows, None, EstimateSettings(), stands)
    sifted = with_twins(scanned, alone, rows, None, EstimateSettings(), stands, lambda poses: stands(poses) - 5.0)
    assert len(asked[-1]) < len(asked[0])
    assert (asked[-1][:, :3, 2] @ place()[:3, 2] > 0.0).all()
    assert [mode.weight for mode in sifted] == [mode.weight for mode in whole]


def test_a_handle_that_nothing_touches_may_be_anywhere():
    """Where a mug is felt all around but for its handle, every way round is a mode, and the answer as wide as that."""
    mug = library.make("mug")
    points, normals = mug.sample_surface(400, seed=2)
    away = np.linalg.norm((points - mug.centroid)[:, :2], axis=1)
    body = np.flatnonzero(away < np.quantile(away, 0.6))[:40]
    rows = make(
        se3.apply(place(), points[body]), 0.002, TOUCH, normals=normals[body] @ place()[:3, :3].T, sigma_normal=0.2
    )
    found = with_twins(mug, (Mode(place(), 1.0, 0.0, SHARP),), rows, None, EstimateSettings())
    same = alike(mug, found, TOLERANCE)
    assert len(same.near) > 8 > 3 > len(same.modes)
    assert same.near_weight > 0.9 > same.weight
    wide = told_covariance(mug, found, "ok", 0.99, None)
    assert np.sqrt(np.linalg.eigvalsh(wide[:3, :3])[-1]) > np.deg2rad(45.0)
    assert "not everywhere" in posterior.way_round(same, "ok", TOLERANCE)[0]


def test_a_sure_answer_is_ok_where_it_is_likelier_than_all_others(scanned):
    modes = modes_of(scanned, [1.2, 0, 0], weights=(0.8, 0.2))
    assert posterior.verdict(scanned, modes, (), 0.9, SEEN)[0] == "ambiguous"
    assert posterior.verdict(scanned, modes, (), 0.9, SEEN, sure=True) == ("ok", "first mode holds 80%")
    modes = modes_of(scanned, [1.2, 0, 0], weights=(0.45, 0.55))
    assert posterior.verdict(scanned, modes, (), 0.9, SEEN, sure=True)[0] == "ambiguous"


def test_a_sure_answer_is_ok_whichever_way_round_its_handle_is():
    """Poses in which most of a mug's surface is where it is are likelier than all others together; but what is not sure
    of the surface says which modes there are.
    """
    mug = library.make("mug")
    turned = [place() @ se3.make_pose(se3.exp_rotation(np.array([0, 0, k * 0.7])), np.zeros(3)) for k in range(4)]
    modes = tuple(Mode(pose, 0.25, 0.0, SHARP) for pose in turned)
    same = alike(mug, modes, TOLERANCE)
    assert len(same.modes) == 1
    assert len(same.near) == 4
    assert posterior.verdict(mug, modes, (), 0.9, SEEN)[0] == "ambiguous"
    word, why = posterior.verdict(mug, modes, (), 0.9, SEEN, sure=True)
    assert (word, why) == ("ok", "4 modes in which most of the surface is alike hold 100%")
    # a turn that is not known moves most of the surface no farther
    free = np.diag([1e-4, 1e-4, 1.0, 1e-6, 1e-6, 1e-6])
    wide = (Mode(np.eye(4), 1.0, 0.0, free),)
    assert posterior.verdict(mug, wide, (), 0.9, SEEN)[0] == "ambiguous"
    assert posterior.verdict(mug, wide, (), 0.9, SEEN, sure=True)[0] == "ok"


def test_an_answer_asks_once_which_modes_are_one(lab_frame, drill, monkeypatch):
    """Confidence, verdict, covariance and notes read what was found once."""
    from scenes.evidence.symmetry import alike as module

    asked, moved_by = [], module.moved
    monkeypatch.setattr(module, "moved", lambda *a: asked.append(len(a[2])) or moved_by(*a))
    answer = estimate(replace(lab_frame, prior=None), drill, use=("touch",))
    assert len(answer.modes) > 1
    assert len(asked) == 1
