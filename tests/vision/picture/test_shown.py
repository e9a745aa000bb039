"""Rows of what a camera saw of a pose: the compiled kernel against plain arrays, and what the rows say."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from scenes.evidence import table as tables
from scenes.evidence.search import thin
from scenes.evidence.table import GATE_ABOVE, VISION
from scenes.geometry import poses
from scenes.recordings.beliefs import DepthModel
from scenes.synthesis import library
from vision.look.look import look
from vision.look.looked import RowSettings, free_space_rows, surface_rows
from vision.look.pixels import Pixels
from vision.picture.columns import HIT, NEAR
from vision.picture.predictor import Predictor
from vision.picture.shown import shown_rows

LEAST = 25


def by_arrays(predictor, looked, pose, side, free, rows):
    """The same rows by array operations: pixels inside the outline, thinned as any pixels are, and emptiness."""
    s, camera, view = predictor.settings, predictor.camera, predictor.view(pose[None], side)
    core, near = view.has(HIT).reshape(side, side), view.has(NEAR)[0]
    inside = np.zeros_like(core)
    inside[1:-1, 1:-1] = core[:-2, 1:-1] & core[2:, 1:-1] & core[1:-1, :-2] & core[1:-1, 2:]
    good = (core & inside).ravel() & near
    good = near if good.sum() < s.thin_share * near.sum() else good

    def points(where, depth):
        uv = view.at(where)
        x, y = (uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy
        return uv, np.stack([x, y, np.ones(len(x))], axis=1)[:, None] * depth[..., None]

    where = np.flatnonzero(good)
    uv, seen = points(where, view.seen[0, where, None])
    area = max(abs(np.linalg.det(view.step[0].reshape(2, 2))), 1.0)
    mine = replace(looked, pixels=Pixels(uv, seen[:, 0], area), told_apart=True)
    on = surface_rows(mine, predictor.belief, rows) if len(where) >= LEAST else tables.empty()
    past = np.flatnonzero((view.past[0] == 1.0) & (view.seen[0] > view.expected[0]))
    share = min(1.0, (predictor.side / side) ** 2)
    count = max(1, round(len(past) * share))
    past = past[(np.arange(count) * len(past)) // count] if len(past) else past
    depth = view.expected[0, past, None] + np.array(s.empty_depths)
    empty = points(past, depth)[1][depth < view.seen[0, past, None] - s.empty_clearance]
    beyond = tables.outside(empty, s.empty_sigma, VISION, gate=s.empty_gate)
    hits = view.has(HIT).sum() * share
    return tables.stack(on, free, beyond.reweighted(s.cells / max(hits, 1.0) / len(s.empty_depths)))


@pytest.mark.parametrize("side", [16, 24, 40])
@pytest.mark.parametrize("off", [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.01, 0.01], [0.3, 0.0, 0.0]])
def test_the_kernel_makes_the_rows_that_plain_arrays_make(lab_frame, drill, side, off):
    pose = poses.make_pose(None, off) @ lab_frame.camera_from_object_truth
    looked, rows = look(replace(lab_frame, mask=None), drill, start=pose), RowSettings()
    found = Predictor(lab_frame, drill, DepthModel(), hand=looked.seen_hand)
    free = free_space_rows(looked, rows)
    expected = by_arrays(found, looked, pose, side, free, rows)
    for most in (0, 160, 40):
        (made,) = shown_rows(found, pose[None], free, rows, LEAST, side, most)
        plain = thin(expected, most) if most else expected
        np.testing.assert_allclose(made.rows, plain.rows, rtol=1e-12, atol=1e-15)
        assert (made.sense == plain.sense).all()


def test_poses_together_say_what_each_says_alone(lab_frame, drill, rng):
    truth = lab_frame.camera_from_object_truth
    candidates = poses.perturb(truth, rng.normal(size=(4, 6)) * 0.02, drill.centroid)
    found, rows = Predictor(lab_frame, drill, DepthModel()), RowSettings()
    together = shown_rows(found, candidates, tables.empty(), rows, LEAST, 24)
    for pose, mine in zip(candidates, together):
        np.testing.assert_array_equal(shown_rows(found, pose[None], tables.empty(), rows, LEAST, 24)[0].rows, mine.rows)


def test_a_finer_look_where_few_pixels_show_it(lab_frame, drill, monkeypatch):
    truth = lab_frame.camera_from_object_truth[None]
    found, rows = Predictor(lab_frame, drill, DepthModel()), RowSettings()
    coarse, fine = found.settings.sides_rows
    on = {side: len(found.shown(truth[0], side)) for side in (coarse, fine)}
    assert on[coarse] < found.settings.enough_rows < on[fine]
    views, seen = found.view, []
    monkeypatch.setattr(found, "view", lambda one, side: seen.append(side) or views(one, side))
    (asked,) = shown_rows(found, truth, tables.empty(), rows, LEAST)
    assert coarse not in seen  # few rays tell that they would be too few
    (finer,) = shown_rows(found, truth, tables.empty(), rows, LEAST, fine)
    np.testing.assert_array_equal(asked.rows, finer.rows)


def test_what_is_seen_past_is_empty():
    frame, model = plain_view("box"), library.make("box")
    frame = replace(frame, depth=np.where(frame.depth > 0, frame.depth, 1.5).astype(np.float32))
    truth = frame.camera_from_object_truth
    shifted = poses.make_pose(None, [0.03, 0.0, 0.0]) @ truth
    found = Predictor(frame, model, DepthModel())
    at_truth, rows = (
        rows.take(rows.rows[:, GATE_ABOVE] == 0)
        for rows in shown_rows(found, np.array([truth, shifted]), tables.empty(), RowSettings(), LEAST, 40)
    )
    assert len(rows) > 10
    assert (model.field.distance(poses.apply(poses.inverse(truth), rows.points)) > 0).all()
    assert model.field.distance(poses.apply(poses.inverse(shifted), rows.points)).min() < 0
    assert len(at_truth) < 0.2 * len(rows)
