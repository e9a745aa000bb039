"""What contacts of one finger are off by together, in how unsure an answer is."""

from dataclasses import replace

import numpy as np

from fusion.estimation.estimate import estimate
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.steps.drawn import drawn_by_touch
from fusion.estimation.steps.fingers import with_fingers
from scenes.evidence.align import Prior, align, terms
from scenes.evidence.modes import Mode
from scenes.evidence.table import NO_GATE
from scenes.geometry import poses
from scenes.recordings.frames import Contacts, Frame
from touch.contacts import TouchSettings, feel

FINGERS, TAXELS, SHARED = 4, 16, 1.1e-3
ALONE = Mode(np.eye(4), 1.0, 0.0, 1e-8 * np.eye(6))


def touched(model, rng, shared=SHARED):
    """Contacts of patches, as fingers report them that are each off as a whole; and the pose (4, 4) of the object."""
    points, _ = model.sample_surface(4000, 1)
    near = [np.argsort(np.linalg.norm(points - at, axis=1))[:TAXELS] for at in points[rng.choice(4000, FINGERS)]]
    felt = points[np.concatenate(near)] + np.repeat(shared * rng.normal(size=(FINGERS, 3)), TAXELS, axis=0)
    truth = poses.exp(np.concatenate([0.03 * rng.normal(size=3), 0.003 * rng.normal(size=3)]))
    felt = poses.apply(truth, felt + 3e-4 * rng.normal(size=felt.shape))
    names = [f"finger {i // TAXELS}" for i in range(len(felt))]
    return Contacts(felt, sigma_point=3e-4, sensors=names), truth


def test_an_answer_by_touch_is_as_unsure_as_its_fingers_places(drill):
    rng = np.random.default_rng(0)
    prior = Prior(np.eye(4), np.diag([0.05**-2.0] * 3 + [0.005**-2.0] * 3))
    nees = []
    for _ in range(30):
        contacts, truth = touched(drill, rng)
        felt = feel(Frame(0, contacts=contacts), np.eye(4), beside_vision=False)
        found = align(drill, felt.rows, np.eye(4)[None], prior).poses[0]
        alone = Mode(found, 1.0, 0.0, np.linalg.inv(terms(drill, felt.rows, found, prior)[2]))
        told = with_fingers(drill, felt, alone, prior)
        off = poses.difference(found, truth, drill.centroid)
        nees.append([off @ np.linalg.solve(mode.covariance, off) for mode in (alone, told)])
    before, after = np.median(nees, axis=0)
    assert before > 20.0
    assert 3.0 < after < 9.0


def test_what_fingers_add_is_symmetric_to_the_last_digit(drill, rng):
    """Also where next to nothing is known, so that large numbers cancel."""
    contacts, _ = touched(drill, rng)
    few = contacts.take(range(TAXELS))
    mode = with_fingers(drill, feel(Frame(0, contacts=few), np.eye(4), beside_vision=False), ALONE)
    assert np.array_equal(mode.covariance, mode.covariance.T)
    assert mode.covariance[0, 0] > ALONE.covariance[0, 0]


def test_rows_that_say_it_are_left_alone(drill, rng):
    contacts, _ = touched(drill, rng)
    mode = Mode(np.eye(4), 1.0, 0.0, 1e-6 * np.eye(6))
    assert with_fingers(drill, feel(Frame(0, contacts=contacts), np.eye(4)), mode) is mode
    each = contacts.take([0, TAXELS, 2 * TAXELS])
    assert with_fingers(drill, feel(Frame(0, contacts=each), np.eye(4), beside_vision=False), mode) is mode


def test_an_estimate_by_touch_alone_tells_of_its_fingers(drill, rng):
    together, truth = touched(drill, rng)
    # 4 mm and more between neighbours: as if so many fingers had reported one each
    apart = Contacts(together.points, sigma_point=3e-4, sensors=[f"{i}" for i in range(len(together))])
    widths = [
        np.linalg.slogdet(estimate(Frame(0, contacts=felt), drill, prior=truth).modes[0].covariance)[1]
        for felt in (together, apart)
    ]
    assert widths[0] > widths[1] + 2.0


def test_a_finger_that_touched_something_else_does_not_outvote_the_image(exact_frame, drill):
    """Contacts that say no sigma: nothing but what the camera shows tells which of them is false."""
    felt = exact_frame.contacts.points
    aside = felt.mean(axis=0) + np.array([0.08, 0.0, 0.04])
    frame = replace(exact_frame, contacts=Contacts(np.vstack([felt, aside])), wrenches=(), tactile={})
    truth = frame.camera_from_object_truth
    trusting = EstimateSettings(touch=TouchSettings(unknown_gate=NO_GATE))
    off = [
        np.linalg.norm(poses.difference(estimate(frame, drill, settings=how).pose, truth, drill.centroid)[3:])
        for how in (None, trusting)
    ]
    assert off[0] < 0.002
    assert off[1] > 0.005


def test_draws_of_what_contacts_allow_know_of_their_fingers(drill, rng):
    """Sixteen taxels a finger that are off together allow more than as many fingers that touch by one each."""
    together, truth = touched(drill, rng)
    apart = Contacts(together.points, sigma_point=3e-4, sensors=[f"{i}" for i in range(len(together))])
    prior = Prior(truth, np.diag([0.05**-2.0] * 3 + [0.005**-2.0] * 3))
    mode = Mode(truth, 1.0, 0.0, 1e-6 * np.eye(6))
    wide, narrow = (
        drawn_by_touch(
            drill, feel(Frame(0, contacts=felt), np.eye(4), beside_vision=False), 0.0, (mode,), prior, 0, 5e-3
        )
        for felt in (together, apart)
    )
    assert np.linalg.slogdet(wide[1])[1] > np.linalg.slogdet(narrow[1])[1] + 2.0
