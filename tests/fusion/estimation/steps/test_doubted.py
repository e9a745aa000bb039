"""What came with a frame and is contradicted by the rest of it is not believed, and the answer says so."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from fusion import estimate
from fusion.estimation.asked import Asked, believing
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.steps.doubts.doubted import Question, _may_stand
from fusion.estimation.steps.doubts.start import in_doubt
from fusion.estimation.steps.sense import look_once
from fusion.estimation.trace import Trace
from fusion.truth import metrics
from scenes import Contacts
from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.synthesis import library
from vision.contour.evidence import UNREGISTERED

BOTH = ("vision", "touch")


@pytest.fixture(scope="module")
def bare_frame(lab_frame):
    """The frame without its mask, the hand tells what hides the object."""
    return replace(lab_frame, mask=None)


def off(model, frame, answer):
    """ADD-S (m)."""
    return metrics.add_s(answer.pose, frame.camera_from_object_truth, metrics.model_points(model))


def doubt_of(answer):
    return next(stage for stage in answer.trace if stage.name == "doubt")


def is_right(model, frame, answer, said):
    assert answer.verdict == "ok", answer.notes
    assert off(model, frame, answer) < 0.005
    assert any(note.startswith(said) for note in answer.notes), answer.notes


def turned(frame, model, degrees, distance, axis=(0.0, 0.0, 1.0)):
    delta = [*np.deg2rad(degrees) * np.array(axis), *(distance * np.array([0.6, 0.8, 0.0]))]
    return se3.perturb(frame.camera_from_object_truth, delta, model.centroid)


def test_an_honest_frame_is_not_doubted(lab_frame, drill):
    answer = estimate(lab_frame, drill)
    assert answer.verdict == "ok"
    assert not doubt_of(answer).ran
    assert not any("believed" in note or "left out" in note for note in answer.notes)


@pytest.mark.parametrize("use", [BOTH, ("vision",)])
def test_a_mask_of_all_there_is(lab_frame, drill, use):
    everything = replace(lab_frame, mask=np.ones_like(lab_frame.mask))
    answer = estimate(everything, drill, use=use)
    is_right(drill, lab_frame, answer, "the mask is not believed: ")
    again = estimate(everything, drill, use=use)
    assert np.array_equal(again.pose, answer.pose)


def test_a_mask_of_another_thing_only_where_something_tells_which_is_meant(lab_frame, drill):
    mask = np.zeros_like(lab_frame.mask)
    mask[:40, :60] = True
    is_right(drill, lab_frame, estimate(replace(lab_frame, mask=mask), drill), "the mask is not believed: ")
    # by vision alone nothing but the mask says which thing it is
    alone = replace(lab_frame, mask=mask, prior=None, contacts=Contacts.none(), tactile={}, wrenches=())
    assert estimate(alone, drill, use=("vision",)).verdict != "ok"


def test_an_empty_mask_says_of_no_other_thing_that_it_is_meant(lab_frame, drill):
    """Nor is a mask left that lies beside depth as the image does: depth may be what is not in its place."""
    empty = np.zeros_like(lab_frame.mask)
    frame = replace(lab_frame, mask=empty, prior=None, contacts=Contacts.none(), tactile={}, wrenches=())
    first = Question(frame, Asked.of(frame, use=("vision",)))
    bare = Question(replace(frame, mask=None), replace(first.asked, viewed=replace(first.asked.viewed, mask=None)))
    held = look_once(drill, bare.asked, Trace())
    there = replace(estimate(frame, drill, lab_frame.prior, ("vision",)), verdict="ok", contacts=())
    true = replace(there, pose=frame.camera_from_object_truth, as_seen=None)
    away = replace(true, pose=se3.make_pose(translation=[0.2, 0.1, 0.0]) @ true.pose)
    lost = replace(there, verdict="lost")
    assert _may_stand(drill, first, held, bare, lost, true)
    assert not _may_stand(drill, first, held, bare, lost, away)
    assert not _may_stand(drill, first, held, bare, lost, replace(true, notes=(f"colours: {UNREGISTERED}",)))


def test_normals_that_point_into_the_object(bare_frame, drill):
    felt = bare_frame.contacts
    inward = Contacts(felt.points, -felt.normals, felt.sigma_point, felt.sigma_normal, felt.sensors)
    answer = estimate(replace(bare_frame, contacts=inward), drill)
    is_right(drill, bare_frame, answer, "the contacts' normals point into the object")
    assert [contact.outlier for contact in answer.contacts] == [False] * len(inward)


def test_a_start_that_is_too_sure(bare_frame, drill):
    sure = Prior.isotropic(turned(bare_frame, drill, 20.0, 0.02), np.deg2rad(2.0), 0.002)
    for use in (BOTH, ("vision",)):
        is_right(drill, bare_frame, estimate(bare_frame, drill, sure, use), "the start is not as sure as told: ")
    # one who knows it is told what is there
    kept = estimate(bare_frame, drill, sure, settings=believing(EstimateSettings()))
    assert not any("start" in note for note in kept.notes)
    # the same width about the truth is no reason to doubt
    true = Prior.isotropic(bare_frame.camera_from_object_truth, np.deg2rad(2.0), 0.002)
    assert not doubt_of(estimate(bare_frame, drill, true)).ran


def test_a_start_of_another_place(bare_frame, drill):
    # what is felt leads to it all the same
    found = estimate(bare_frame, drill, turned(bare_frame, drill, 60.0, 0.15))
    is_right(drill, bare_frame, found, "the start is wrong: the object is found ")
    # where the start's way round keeps a sure answer the wrong way round, and where it shows nothing
    for degrees, distance in ((180.0, 0.15), (120.0, 0.25)):
        found = estimate(bare_frame, drill, turned(bare_frame, drill, degrees, distance))
        is_right(drill, bare_frame, found, "the start is not believed: the object is found ")


@pytest.mark.parametrize("use", [BOTH, ("vision",), ("touch",)])
def test_a_start_of_another_way_round_keeps_no_sure_answer_there(bare_frame, drill, use):
    """To be elsewhere costs a Gaussian hundreds of nats, and a start may be wrong all the same: told wide or narrow."""
    for axis in np.eye(3):
        other = turned(bare_frame, drill, 180.0, 0.0, axis)
        for start in (other, Prior.isotropic(other, np.deg2rad(3.0), 0.005)):
            found = estimate(bare_frame, drill, start, use)
            assert found.verdict != "ok" or off(drill, bare_frame, found) < 0.005, (axis, found.notes)


def test_an_answer_beside_a_rival_is_half_as_sure_unless_both_are_right(bare_frame, drill):
    answer, asked = estimate(bare_frame, drill), Asked.of(bare_frame)
    first = answer.modes[0]
    for degrees, share in ((180.0, 0.5), (1.0, 1.0)):
        rival = replace(first, pose=turned(bare_frame, drill, degrees, 0.0))
        doubtful = in_doubt(drill, asked, answer, rival, "as it may be turned")
        assert doubtful.verdict == "ambiguous"
        assert doubtful.confidence == min(share * answer.confidence, asked.settings.verdict.most_doubted)
        assert sum(mode.weight for mode in doubtful.modes) == pytest.approx(
            0.5 + 0.5 * sum(m.weight for m in answer.modes)
        )
        assert doubtful.notes[0] == "as it may be turned"


def test_no_start_is_left_for_what_nothing_says_is_meant(bare_frame, drill):
    """Another block may lie there: only the hand, a mask or what is felt say that it is this one."""
    seen, block = replace(plain_view("l_block"), contacts=Contacts.none()), library.make("l_block")
    assert estimate(replace(seen, prior=None), block).verdict == "ok"
    assert estimate(seen, block, turned(seen, block, 60.0, 0.25)).verdict == "lost"
    # nor is a start doubted where no camera can see anything
    assert estimate(bare_frame, drill, se3.make_pose(translation=[0.0, 0.0, -0.5])).verdict == "lost"


def test_contacts_in_another_frame_are_left_out_where_the_hand_is_seen(bare_frame, drill):
    away = se3.make_pose(translation=[0.1, 0.1, 0.0])
    moved = replace(bare_frame, contacts=bare_frame.contacts.moved(away))
    answer = estimate(moved, drill)
    count = len(bare_frame.contacts)
    is_right(drill, bare_frame, answer, f"{count} of {count} contacts left out: farther than 30 mm")
    assert not answer.contacts
    # one of no sensor of the hand may be anywhere
    felt = moved.contacts
    strange = Contacts(felt.points, felt.normals, felt.sigma_point, felt.sigma_normal, ["probe"] * count)
    other = estimate(replace(bare_frame, contacts=strange), drill)
    assert not any("left out" in note for note in other.notes)


def test_a_hand_that_is_not_where_it_is_told(bare_frame, drill):
    away = se3.make_pose(translation=[0.03, 0.04, 0.0])
    moved = replace(bare_frame, world_from_hand=away @ bare_frame.world_from_hand)
    is_right(drill, bare_frame, estimate(moved, drill), "the hand is not believed: ")


def test_two_statements_are_doubted_together(lab_frame, drill):
    felt = lab_frame.contacts
    inward = Contacts(felt.points, -felt.normals, felt.sigma_point, felt.sigma_normal, felt.sensors)
    answer = estimate(replace(lab_frame, mask=np.ones_like(lab_frame.mask), contacts=inward), drill)
    is_right(drill, lab_frame, answer, "the mask is not believed: ")
    is_right(drill, lab_frame, answer, "the contacts' normals point into the object")


def test_a_spent_budget_leaves_no_time_for_doubts(lab_frame, drill):
    everything = replace(lab_frame, mask=np.ones_like(lab_frame.mask))
    assert not doubt_of(estimate(everything, drill, budget_ms=0.0)).ran
