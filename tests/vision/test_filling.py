"""Readings that a recorder put into holes; the compiled loops against NumPy."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from fusion import estimate
from fusion.estimation.steps.judge import judge
from fusion.tracking.tracker import Tracker
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Frame
from scenes.synthesis import library
from scenes.synthesis.noise.presets import PRESETS
from scenes.synthesis.noise.recorder import Recorder
from scenes.synthesis.recording import synthesize_frames
from scenes.synthesis.settings import SynthesisSettings
from vision import filling_kernels as kernels
from vision.filling import FillingSettings, as_measured

S = FillingSettings()


def seen(depth):
    depth = np.asarray(depth, dtype=np.float32)
    height, width = depth.shape
    return Frame(0, depth=depth, camera=Camera(100.0, 100.0, width / 2, height / 2, width, height))


def scene(rng, shadow=12, noise=1e-3):
    """A square before a wall; its shadow to the left, without readings; truth of what is missing."""
    z = np.full((90, 120), 0.9)
    z[25:65, 50:90] = 0.6
    z = z + noise * rng.standard_normal(z.shape)
    lost = np.zeros(z.shape, dtype=bool)
    lost[25:65, 50 - shadow : 50] = True
    return np.where(lost, 0.0, z).astype(np.float32), lost


def filled_from_left(depth):
    out = depth.copy()
    for u in range(1, out.shape[1]):
        out[:, u] = np.where(out[:, u] > 0, out[:, u], out[:, u - 1])
    return out


def rows_by_numpy(depth, stride):
    counts = np.zeros(6, dtype=int)
    for row in depth[::stride]:
        at = np.flatnonzero(row > 0)
        slope = 0.0
        for before, here in pairwise(at):
            change, beside = row[here] - row[before], here - before == 1
            if abs(change) > S.step:
                near = min(row[here], row[before]) <= S.farthest
                counts += [near, near and not beside, 0, 0, 0, 0]
                slope = 0.0
            elif not beside or row[here] > S.farthest:
                slope = 0.0
            else:
                turns = slope != 0 and change != 0
                counts += [0, 0, 1, change == 0, turns, turns and np.sign(change) != np.sign(slope)]
                slope = change if change != 0 else slope
    return tuple(counts)


def runs_by_numpy(depth, longest):
    out = depth.copy()
    for v, row in enumerate(depth):
        cuts = np.flatnonzero(np.diff(row) != 0) + 1
        bounds = np.concatenate([[0], cuts, [len(row)]])
        for begin, end in pairwise(bounds):
            if end - begin < S.run or not row[begin] > 0:
                continue
            sides = [row[begin - 1] if begin else 0.0, row[end] if end < len(row) else 0.0]
            steps = [x > 0 and abs(x - row[begin]) > S.step and min(x, row[begin]) <= S.farthest for x in sides]
            same = [x > 0 and abs(x - row[begin]) <= S.step for x in sides]
            goes_on = (steps[0] and same[1]) or (steps[1] and same[0])
            if (any(steps) and not longest) or (goes_on and end - begin <= longest):
                out[v, begin:end] = 0.0
    return out


@pytest.mark.parametrize("longest", [0, 5])
def test_rows_and_runs_are_those_of_numpy(rng, longest):
    values = np.array([0.0, 0.4, 0.41, 0.405, 0.5, 0.9, 2.0, 2.5], dtype=np.float32)
    for _ in range(30):
        depth = np.repeat(rng.choice(values, (9, 30)), rng.integers(1, 6), axis=1)
        assert kernels.look_at_rows(depth, S.step, S.farthest, 2) == rows_by_numpy(depth, 2)
        out = depth.copy()
        dropped = kernels.drop_runs(depth, S.step, S.farthest, S.run, longest, out)
        expected = runs_by_numpy(depth, longest)
        assert np.array_equal(out, expected)
        assert dropped == ((depth > 0) & (expected == 0)).sum()


def test_what_was_filled_in_beside_edges_is_a_hole_again(rng):
    depth, lost = scene(rng)
    found, notes = as_measured(seen(filled_from_left(depth)))
    assert np.array_equal((found.depth == 0) & lost, lost)
    assert (found.depth[~lost] == 0).sum() <= lost[:, 0].size  # and of each row the reading that it came from
    assert notes == (
        f"the depth image has no holes: {(found.depth == 0).sum()} readings filled in beside edges are not used",
    )
    wide = filled_from_left(depth)
    wide[25:65, 90:] = 0.9  # nothing was seen up to the image's border
    much, _ = as_measured(seen(wide))
    assert (much.depth[25:65, 90:] == 0).all()
    turned, _ = as_measured(seen(filled_from_left(depth).T))
    assert (turned.depth.T[lost] == 0).all()
    again, nothing = as_measured(found)
    assert again is found
    assert nothing == ()


def test_images_with_holes_and_rendered_ones_are_left_alone(rng):
    for depth in (scene(rng)[0], scene(rng, shadow=0)[0], scene(rng, shadow=0, noise=0.0)[0], np.zeros((40, 40))):
        frame = seen(depth)
        found, notes = as_measured(frame)
        assert found is frame
        assert notes == ()
    endless = np.where(scene(rng)[1], np.inf, scene(rng)[0])  # some recorders' word for no reading
    assert kernels.look_at_rows(endless.astype(np.float32), S.step, S.farthest, 1)[1] > 30
    blind = Frame(0)
    assert as_measured(blind) == (blind, ())


def test_a_face_that_is_all_one_value_stays():
    """Boxes that face the camera, rendered without noise, and planes that slope along columns."""
    v = np.mgrid[:90, :120][0]
    depth = np.where((v > 30) & (v < 60), 0.5, 0.5 + 1e-3 * v + 0.3)
    depth[:, 30:70] = 0.6 + 5e-4 * v[:, 30:70]
    frame = seen(depth)
    assert as_measured(frame)[0] is frame


@pytest.fixture(scope="module")
def filled():
    """A frame by a camera that sees shadows, whose recorder filled its holes."""
    settings = SynthesisSettings(camera=Camera(285.0, 285.0, 159.5, 119.5, 320, 240))
    depth = replace(PRESETS["lab"].depth, shadow=True)
    noise = replace(PRESETS["lab"], depth=depth, recorder=Recorder(fill="farthest"))
    return synthesize_frames(library.make("mug"), None, 1, 0.3, noise=noise, seed=2, settings=settings)[0]


def test_answers_say_that_holes_were_filled(filled):
    model = library.make("mug")
    answer = estimate(filled, model)
    assert sum("filled in beside edges" in note for note in answer.notes) == 1
    truth = filled.camera_from_object_truth
    judged = [judge(one, model, truth[None]).costs[0] for one in (filled, as_measured(filled)[0])]
    assert judged[0] == judged[1]  # given poses are judged by the same picture
    track = Tracker(model)
    assert any("filled in beside edges" in note for note in track.step(filled).notes)
    assert not any("filled in" in note for note in track.step(replace(filled, index=1)).notes)
    assert not any("filled in" in note for note in estimate(filled, model, use="touch").notes)
