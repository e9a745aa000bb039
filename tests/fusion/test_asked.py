"""What no estimate can be made of is refused in one line that says what was expected."""

import numpy as np
import pytest

from fusion.estimation.estimate import estimate
from fusion.tracking.tracker import Tracker
from scenes.errors import CaptureError, InputError
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from touch.localization import localize
from touch.recognition import identify

SEEDS = [-1, 1.5, "a", None, True]


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


@pytest.fixture(scope="module")
def frame():
    return Frame(0, contacts=Contacts(0.03 * np.eye(3)))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_seed_is_a_whole_number_from_0(mug, frame, seed):
    with pytest.raises(InputError, match="seed: expected a whole number from 0, got"):
        estimate(frame, mug, seed=seed)
    with pytest.raises(InputError, match="seed: expected a whole number from 0, got"):
        Tracker(mug, seed=seed)


@pytest.mark.parametrize("seed", SEEDS)
def test_so_is_that_of_touch_alone(mug, frame, seed):
    with pytest.raises(InputError, match="seed: expected a whole number from 0, got"):
        localize(mug, frame.contacts, seed=seed)
    with pytest.raises(InputError, match="seed: expected a whole number from 0, got"):
        identify([mug], frame.contacts, seed=seed)


@pytest.mark.parametrize(
    ("models", "expected"),
    [(None, "models: expected a list of ObjectModel, got NoneType"), ([None], "model: expected ObjectModel")],
)
def test_what_was_touched_is_one_of_some_models(frame, models, expected):
    with pytest.raises(InputError, match=expected):
        identify(models, frame.contacts)


def test_any_integer_type_is_a_seed(mug, frame):
    one, same = (estimate(frame, mug, seed=seed) for seed in (3, np.int64(3)))
    np.testing.assert_array_equal(one.pose, same.pose)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ({"tolerance": 5}, "tolerance: expected metres and radians above 0, got 5"),
        ({"tolerance": ("a", 1.0)}, "tolerance: expected metres and radians above 0, got"),
        ({"tolerance": (0.001,)}, "tolerance: expected metres and radians above 0, got"),
        ({"budget_ms": "x"}, "budget: expected milliseconds from 0, got 'x'"),
        ({"budget_ms": float("nan")}, "budget: expected milliseconds from 0, got nan"),
        ({"tolerance": (1, 2)}, "tolerance: expected metres up to the object's diameter .*, got 1 m: mm read as m"),
        ({"tolerance": (0.001, 6)}, "tolerance: expected radians up to half a turn, got 6: degrees read as rad"),
        ({"sure_within": 5}, "sure_within: expected metres up to the object's diameter .*, got 5 m: mm read as m"),
        ({"sure_within": "5 mm"}, "sure_within: expected metres above 0, got '5 mm'"),
        ({"use": 3}, "use: expected vision, touch or both, got 3"),
        ({"use": None}, "use: expected vision, touch or both, got None"),
        ({"use": ()}, "use: expected vision, touch or both, got nothing"),
        ({"prior": "there"}, "prior: expected a 4x4 transform of numbers"),
        ({"settings": {}}, "settings: expected EstimateSettings, got dict"),
        ({"beliefs": {}}, "beliefs: expected Beliefs, like .*, got dict"),
    ],
)
def test_what_was_expected_and_what_came(mug, frame, said, expected):
    with pytest.raises(InputError, match=expected):
        estimate(frame, mug, **said)


def test_an_estimate_is_of_a_frame_and_a_model(mug, frame):
    with pytest.raises(InputError, match=r"frame: expected Frame .*, got NoneType"):
        estimate(None, mug)
    with pytest.raises(InputError, match=r"model: expected ObjectModel .*, got NoneType"):
        estimate(frame, None)


def test_a_track_is_of_frames_and_a_model(mug):
    with pytest.raises(InputError, match=r"model: expected ObjectModel .*, got str"):
        Tracker("mug")
    with pytest.raises(InputError, match="settings: expected TrackSettings, got dict"):
        Tracker(mug, settings={})
    with pytest.raises(InputError, match=r"frame: expected Frame .*, got NoneType"):
        Tracker(mug).step(None)


@pytest.mark.parametrize(("budget", "said"), [(0.0, True), (1e9, False), (None, False)])
def test_an_exceeded_budget_is_said_once(budget, said):
    from made_frames import plain_view

    frame, model = plain_view("box"), library.make("box")
    notes = [note for note in estimate(frame, model, budget_ms=budget).notes if "time budget" in note]
    assert len(notes) == said
    assert all(note.startswith("the time budget of 0 ms was exceeded: ") for note in notes)


def test_contacts_in_centimetres_are_refused_and_far_ones_are_lost(mug):
    points = mug.sample_surface(12, seed=0)[0]
    with pytest.raises(CaptureError, match=r"contacts: expected sizes that agree, .*: cm read as m"):
        localize(mug, Contacts(100.0 * points), seed=0)
    with pytest.raises(InputError, match=r"sure_within: expected metres up to the object's diameter .*, got 5 m"):
        localize(mug, Contacts(points), seed=0, sure_within=5)
    assert localize(mug, Contacts(5.0 * points), seed=0).verdict == "lost"
