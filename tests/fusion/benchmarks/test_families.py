"""Families of frames: the split between what is tuned on and what is reported holds, and frames are what they say."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from fusion.benchmarks import strata
from fusion.benchmarks.families import making
from fusion.benchmarks.families.table import FAMILIES, RECORDED, REPORT, TUNED_OBJECTS, TUNING, chosen
from fusion.benchmarks.families.told import beliefs_of
from fusion.benchmarks.frames import faults
from fusion.benchmarks.peers.occlusion import hidden
from fusion.benchmarks.printing.tables import BenchSettings
from fusion.benchmarks.tracking.sequences import recorded
from fusion.cli.main import main
from fusion.truth import compare
from scenes.errors import InputError
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import Beliefs
from scenes.synthesis import library
from scenes.synthesis.hands import HandShape
from scenes.synthesis.noise.depth import DepthNoise
from scenes.synthesis.settings import SynthesisSettings

TUNED, HELD = chosen(TUNING), chosen(REPORT)
MADE = tuple(family for family in HELD if family.name != RECORDED)
# Numbers that define what is measured, or that no error of this principle uses: the same everywhere by their meaning.
NO_ERRORS = {"step", "match_sigma", "match_length"}
SMALL = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)


def numbers(part):
    """Field -> value of every error of a preset's part that is switched on."""
    values = {field.name: getattr(part, field.name) for field in fields(part)}
    return {
        name: value
        for name, value in values.items()
        if isinstance(value, float | int) and not isinstance(value, bool) and value not in (0, np.pi / 2)
    }


def presets(families):
    return [(family, family.preset()) for family in families if family.name != RECORDED and not making.why_not(family)]


def test_every_family_has_one_role():
    assert {family.role for family in FAMILIES.values()} == {TUNING, REPORT}
    assert {family.name for family in TUNED} & {family.name for family in HELD} == set()
    assert len(TUNED) + len(HELD) == len(chosen("all")) == len(chosen(None)) == len(FAMILIES)
    assert all(family.stands_for for family in FAMILIES.values())
    with pytest.raises(InputError, match="neighbours"):
        chosen("kitchen")
    assert [family.name for family in chosen("desk, lab")] == ["lab", "desk"]


def test_report_families_share_no_number_of_any_error_with_tuning_ones():
    for mine, tuned in presets(TUNED):
        for other, held in presets(MADE):
            for part in ("touch", "robot", "depth"):
                a, b = getattr(tuned, part), getattr(held, part)
                assert a is not b
                if isinstance(a, DepthNoise) != isinstance(b, DepthNoise):
                    continue
                if part == "depth" and not isinstance(a, DepthNoise):
                    assert is_dataclass(a)
                    assert a != b
                    continue
                one, two = numbers(a), numbers(b)
                same = {name for name in one.keys() & two.keys() - NO_ERRORS if one[name] == two[name]}
                assert not same, f"{mine.name} and {other.name} share {same} of {part}"


def test_report_families_share_no_object_camera_hand_or_seed_with_tuning_ones():
    def of(families, what):
        return {getattr(family, what) for family in families} - {"", None}

    objects = [{name for family in families for name in family.objects} for families in (TUNED, MADE)]
    assert not objects[0] & objects[1]
    assert not {name.removeprefix("ycb:") for name in objects[1]} & {"mug"}
    for what in ("camera", "lens", "distance", "hand", "mesh_error"):
        assert not of(TUNED, what) & of(MADE, what), what
    scenes = [{(family.scene, family.occluders) for family in families} - {("", None)} for families in (TUNED, MADE)]
    assert not scenes[0] & scenes[1]
    lens = [{x for one in of(families, "lens") for x in (one.fx, one.fy, one.cx, one.cy)} for families in (TUNED, MADE)]
    assert not lens[0] & lens[1]
    assert TUNED[0].seeds.stop == HELD[0].seeds.start
    assert {(family.seeds.start, family.seeds.stop) for family in TUNED} == {(0, 2**30)}
    assert {(family.seeds.start, family.seeds.stop) for family in HELD} == {(2**30, 2**31)}
    usual, stout = HandShape(), making.STOUT
    assert usual.dip_coupling != stout.dip_coupling
    assert not set(usual.finger_radii + usual.thumb_radii) & set(stout.finger_radii + stout.thumb_radii)
    assert not {f.lengths for f in usual.fingers} & {f.lengths for f in stout.fingers}


def test_seeds_of_a_role_stay_in_its_range():
    for family in (*TUNED, *HELD):
        for seed in (0, 1, 2**31 - 1):
            drawn = [making._seed(family, seed, "box", 0.3, trial) for trial in range(5)]
            assert all(one in family.seeds for one in drawn)
            assert len(set(drawn)) == 5


@pytest.mark.parametrize("name", ["loose", "desk", "counter", "neighbours", "gripper", "gripper-unmodelled"])
def test_frames_are_what_the_family_says(name):
    family = replace(FAMILIES[name], lens=SMALL)
    (made,) = making.frames_of(family, family.levels[1], 1, 5, family.objects[-1:])
    frame = made.frame
    assert made.name == family.objects[-1]
    assert (frame.hand is not None) == family.hand_known
    assert frame.mask is None
    assert (len(frame.contacts) > 0) == ("point" in family.touch)
    assert frame.prior is not None
    (again,) = making.frames_of(family, family.levels[1], 1, 5, family.objects[-1:])
    assert np.array_equal(again.frame.depth, frame.depth)
    (other,) = making.frames_of(family, family.levels[1], 1, 6, family.objects[-1:])
    assert not np.array_equal(other.frame.depth, frame.depth)


def test_a_colour_camera_beside_depth_has_its_own_colours_and_a_mesh_with_dents():
    family = replace(FAMILIES["studio"], lens=SMALL)
    (made,) = making.frames_of(family, 0.3, 1, 5, ("box",))
    assert made.frame.rgb.shape == (*made.frame.depth.shape, 3)
    assert np.ptp(made.frame.rgb.astype(int), axis=2).max() > 30
    dents = library.make("box").field.distance(made.model.vertices)
    assert 0.0002 < np.sqrt(np.mean(dents**2)) < 0.0015


def test_a_wrong_mesh_is_what_the_estimator_gets_and_is_judged_on():
    family = replace(FAMILIES["scaled-mesh"], lens=SMALL)
    (made,) = making.frames_of(family, 0.3, 1, 5, ("banana",))
    assert made.model.diameter == pytest.approx(1.01 * library.make("banana").diameter)
    judge = making.judge_for(family, made)
    assert judge.model is made.model
    truth = made.frame.camera_from_object_truth
    assert judge.errors(truth, truth).add_s < 1e-9


def test_a_family_that_cannot_be_made_says_why(monkeypatch, tmp_path):
    absent = replace(FAMILIES["d455"], camera="unheard-of")
    assert making.why_not(absent) == "no camera 'unheard-of' in this version"
    with pytest.raises(InputError, match="no camera 'unheard-of'"):
        list(making.frames_of(absent, 0.3, 1, 0))
    monkeypatch.setenv("PALPATE_DATA", str(tmp_path))
    making.recordings.cache_clear()
    try:
        assert "no recorded frames" in making.why_not(FAMILIES[RECORDED])
        assert "no scanned objects" in making.why_not(FAMILIES["ycb"])
        cells, missing = strata.cells_of(chosen("all"), 1, BenchSettings(quick=True))
    finally:
        making.recordings.cache_clear()
    assert {reason.partition(":")[0] for reason in missing} >= {RECORDED, "ycb"}
    assert {cell.family.name for cell in cells} >= {"lab", "harsh", "neighbours"}
    assert all(cell.level in cell.family.levels for cell in cells)


def test_a_cell_is_answered_by_every_method_with_a_start_and_without(monkeypatch):
    cell = strata.Cell(replace(FAMILIES["loose"], lens=SMALL), 0.3, "drill", 1, 3)
    found = strata.answer_cell(cell)
    assert [(a.start, a.method) for a in found] == [
        *((True, method) for method in strata.WITH_START),
        *((False, method) for method in strata.WITHOUT_START),
    ]
    ours = [a for a in found if a.method != "icp"]
    assert all(0 <= a.share <= 1 and a.per_dof >= 0 and a.verdict for a in ours)
    strip = [replace(a, ms=0.0) for a in found]
    assert [repr(replace(a, ms=0.0)) for a in strata.answer_cell(cell)] == [repr(a) for a in strip]


@pytest.mark.parametrize("family", FAMILIES.values(), ids=lambda family: family.name)
def test_what_is_told_of_a_family_are_its_sizes(family):
    told, usual = beliefs_of(family), Beliefs()
    if family.name == RECORDED:
        assert told == usual
        return
    preset = family.preset()
    assert told.calibration.translation_sigma == pytest.approx(max(preset.robot.camera_translation, 1e-4))
    assert told.calibration.rotation_sigma == pytest.approx(max(preset.robot.camera_rotation, 1e-4))
    if isinstance(preset.depth, DepthNoise):
        assert told.depth.bias_sigma == pytest.approx(max(preset.depth.bias, 1e-4))
        assert told.depth.scale_sigma == pytest.approx(max(preset.depth.scale, 1e-4))
    assert (told.mesh_sigma > usual.mesh_sigma) == (family.mesh_error is not None)


def test_only_who_is_told_knows_the_sizes(monkeypatch):
    """The frames are the same, what is believed of them is not."""
    seen = []
    monkeypatch.setattr(compare, "compare_frame", lambda frame, *_, **__: seen.append(frame) or [])
    cells, _ = strata.cells_of(chosen("lab"), 1, BenchSettings(objects=("mug",), quick=True))
    cells += strata.cells_of(chosen("lab"), 1, BenchSettings(objects=("mug",), quick=True, told=True))[0]
    for cell in cells:
        strata.answer_cell(cell)
    own, _, told, _ = seen
    assert own.beliefs is None
    assert told.beliefs == beliefs_of(FAMILIES["lab"])
    assert np.array_equal(own.depth, told.depth)


def test_sequences_faults_and_fronts_know_families():
    unknown, small = FAMILIES["human-hand"], SynthesisSettings(rgb=False, camera=SMALL)
    model, frames, notes = recorded("kettle", "carry", 2, 0, None, 0.3, small, unknown)
    assert (model.name, len(frames), notes["kind"]) == ("kettle", 2, "carry")
    assert frames[0].hand is None
    assert frames[0].prior is not None
    assert len(frames[0].contacts) == 0
    spoiled = {family.name for family in FAMILIES.values() if faults.usable(family)}
    assert {"lab", "harsh", "gripper", "other-scan"} <= spoiled
    assert not {"loose", "desk", "human-hand", "hand-unmodelled", "neighbours", RECORDED} & spoiled
    assert (hidden(FAMILIES["lab"]), hidden(FAMILIES["gripper"])) == (0.8, 0.4)
    assert np.isnan(hidden(FAMILIES[RECORDED]))


def test_unknown_families_are_refused_before_any_work(capsys):
    assert main(["bench", "calibration", "--family", "kitchen"]) == 2
    error = capsys.readouterr().err
    assert "kitchen" in error
    assert "human-hand" in error


def test_tuned_objects_are_not_among_the_held_out():
    assert not {*TUNED_OBJECTS, *library.tool_names()} & set(library.held_out_names())


def test_occlusion_compares_the_methods_that_are_asked_for():
    from fusion.benchmarks.frames.occlusion import run

    asked = BenchSettings(trials=1, quick=True, family="clean", objects=("box",), methods=("fused",))
    table = run(asked).tables[0]
    assert {row[1] for row in table.rows} == {"fused"}
    with pytest.raises(InputError, match="got 'both'"):
        run(replace(asked, methods=("both",)))
