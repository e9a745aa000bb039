"""Our metrics against BOP's, on the same files: poses.csv, scene_gt.json, models, depth images.

bop_toolkit is on no package index, so the values below come from tests/helpers/bop_reference.py, code of its own that
follows bop_toolkit's definitions and uses nothing of palpate: `python tests/helpers/bop_reference.py FOLDER` prints
them.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from bop_reference import DELTA, MODELS, SCENE, TAUS, reference, write_dataset
from commands import run

from fusion.truth import metrics
from scenes.geometry.symmetries import Symmetries
from scenes.recordings.bop import read_poses
from scenes.recordings.captures import read_capture

# millimetres, pixels, shares; "image object"
BOP = {
    "0 1": {
        "add": 6.240765846739468,
        "adi": 6.240765846739468,
        "mssd": 7.783349251230249,
        "mspd": 0.7173935725720373,
        "vsd": 0.2571428571428572,
    },
    "0 2": {
        "add": 41.31882973781883,
        "adi": 13.832461165977309,
        "mssd": 24.608129390616842,
        "mspd": 2.596456655287255,
        "vsd": 0.5763157894736842,
    },
    "0 3": {
        "add": 14.962636823713716,
        "adi": 14.962636823713716,
        "mssd": 24.177149158105074,
        "mspd": 2.8954585379793865,
        "vsd": 0.4903846153846154,
    },
    "1 1": {
        "add": 108.31327215662957,
        "adi": 7.646780847476383,
        "mssd": 11.341396274273844,
        "mspd": 1.3104201707723935,
        "vsd": 0.24558823529411758,
    },
    "1 2": {
        "add": 22.925378547732365,
        "adi": 13.65362942771727,
        "mssd": 29.857371364899247,
        "mspd": 3.8217881794734905,
        "vsd": 0.54321608040201,
    },
    "1 3": {
        "add": 114.44602722166486,
        "adi": 81.28869763254787,
        "mssd": 187.9787599644453,
        "mspd": 14.723170450155804,
        "vsd": 1.0,
    },
}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The data set's folder, its renderings, the capture of each object, the estimates."""
    folder = tmp_path_factory.mktemp("bop") / "set"
    pictures = write_dataset(folder)
    captures = {}
    for number in MODELS:
        assert run("convert", folder / SCENE, folder / f"capture{number}", "--object-id", number) == 0
        captures[number] = read_capture(folder / f"capture{number}")
    return folder, pictures, captures, read_poses(folder / "poses.csv")


def test_the_stored_values_are_those_of_the_script(data):
    folder, pictures, _, _ = data
    found = reference(folder, pictures)
    assert found.keys() == BOP.keys()
    for key, values in found.items():
        assert values == pytest.approx(BOP[key], rel=1e-9)


def test_add_adi_mssd_mspd_and_vsd_are_those_of_bop(data):
    _, pictures, captures, rows = data
    assert len(rows) == len(BOP)
    for row in rows:
        capture, expected = captures[row.obj_id], BOP[f"{row.im_id} {row.obj_id}"]
        frame, model = capture.frame(row.im_id), capture.model
        truth, points = frame.camera_from_object_truth, model.vertices
        members = metrics.bop_symmetries(model.symmetries)
        estimate_depth, truth_depth = (1e-3 * pictures[row.im_id, row.obj_id, name] for name in ("est", "gt"))
        taus = [tau * model.diameter for tau in TAUS]
        found = {
            "add": 1e3 * metrics.add(row.pose, truth, points),
            "adi": 1e3 * metrics.add_s(row.pose, truth, points),
            "mssd": 1e3 * metrics.mssd(row.pose, truth, points, members),
            "mspd": metrics.mspd(row.pose, truth, points, frame.camera, members),
            "vsd": metrics.vsd(estimate_depth, truth_depth, frame.depth, frame.camera, taus, 1e-3 * DELTA),
        }
        assert found == pytest.approx(expected, rel=1e-9), (row.im_id, row.obj_id)


def test_the_best_turn_is_less_by_half_a_step_at_most(data):
    _, _, captures, rows = data
    for row in (row for row in rows if row.obj_id == 2):
        capture = captures[2]
        frame, model = capture.frame(row.im_id), capture.model
        exact = 1e3 * metrics.mssd(row.pose, frame.camera_from_object_truth, model.vertices, model.symmetries)
        bop = BOP[f"{row.im_id} 2"]["mssd"]
        assert bop - 0.005 * 1e3 * model.diameter <= exact <= bop + 1e-9


def test_bop_symmetries_of_nothing_and_of_half_turns():
    assert np.array_equal(metrics.bop_symmetries(Symmetries.none()), np.eye(4)[None])
    members = metrics.bop_symmetries(Symmetries.about_axis((0, 0, 1), (0.1, 0, 0), flip=True))
    assert members.shape == (2 * 315, 4, 4)


def test_evaluate_prints_what_bop_would(data, tmp_path):
    folder, _, captures, _ = data
    for number, capture in captures.items():
        table = tmp_path / f"poses{number}.csv"
        lines = (folder / "poses.csv").read_text().splitlines()
        table.write_text("\n".join([lines[0], *(line for line in lines[1:] if line.split(",")[2] == str(number)), ""]))
        assert run("evaluate", table, capture.path, "--json", tmp_path / "e.json") == 0
        for found in json.loads((tmp_path / "e.json").read_text())["frames"]:
            expected = BOP[f"{found['frame']} {number}"]
            assert found["mssd_mm"] == pytest.approx(expected["mssd"], rel=1e-9)
            assert found["mspd_px"] == pytest.approx(expected["mspd"], rel=1e-9)
            # another renderer decides a few pixels of the silhouettes otherwise
            assert found["vsd"] == pytest.approx(expected["vsd"], abs=0.01)
