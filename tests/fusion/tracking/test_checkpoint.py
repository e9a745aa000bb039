"""A tracker's state is all of it, survives as bytes, and is refused when it is not."""

import io
import pickle
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from fusion.tracking.checkpoint import REMADE, digest, restore_tracker, save_tracker
from fusion.tracking.tracker import Tracker
from scenes.errors import InputError
from scenes.recordings.captures import read_capture


@pytest.fixture(scope="module")
def capture(tmp_path_factory, hand):
    from long_recordings import there_and_back

    return read_capture(there_and_back(tmp_path_factory.mktemp("c") / "carried", hand, 10, made=6))


@pytest.fixture(scope="module")
def followed(capture):
    """A tracker after five frames, one of which had no camera."""
    tracker = Tracker(capture.model)
    for index in range(5):
        frame = capture[index]
        tracker.step(frame if index != 3 else frame.without_vision())
    return tracker


def everything(value, seen=None):
    """What can be reached, as text: the twin of the writer, without a word of how it is kept."""
    seen = {} if seen is None else seen
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes()!r}"
    if isinstance(value, (int, float, str, bool, type(None), np.generic)):
        return f"{type(value).__name__} {value!r}"
    if id(value) in seen:
        return f"again {seen[id(value)]}"
    seen[id(value)] = len(seen)
    if isinstance(value, dict):
        return f"{{{', '.join(f'{k}: {everything(v, seen)}' for k, v in value.items())}}}"
    if isinstance(value, (set, frozenset)):
        return f"{type(value).__name__} {sorted(value)}"
    if isinstance(value, (list, tuple, deque)):
        return f"{type(value).__name__} [{', '.join(everything(v, seen) for v in value)}]"
    gone = (*REMADE.get(type(value), ()), "model")
    names = sorted(set(getattr(value, "__dict__", ())) | set(getattr(value, "__dataclass_fields__", ())))
    parts = [f"{name}={everything(getattr(value, name), seen)}" for name in names if name not in gone]
    return f"{type(value).__name__}({', '.join(parts)})"


def test_nothing_is_forgotten(capture, followed):
    """Every attribute of every object, however deep, comes back: a new one that does not fails here."""
    content = save_tracker(followed, capture.hand)
    again = Tracker(capture.model)
    restore_tracker(again, content, capture.hand)
    assert set(vars(again)) == set(vars(followed))
    assert everything(again) == everything(followed)
    assert save_tracker(again, capture.hand) == content
    assert again.model is followed.model


def test_a_restored_tracker_goes_on_to_the_bit(capture, followed):
    content = save_tracker(followed, capture.hand)
    answers = []
    for _ in range(2):
        tracker = Tracker(capture.model)
        restore_tracker(tracker, content, capture.hand)
        answers.append([tracker.step(capture[index]) for index in range(5, 9)])
    whole = Tracker(capture.model)
    restore_tracker(whole, save_tracker(followed, capture.hand), capture.hand)
    for one, other in zip(*answers):
        assert one.pose.tobytes() == other.pose.tobytes()
        assert one.covariance.tobytes() == other.covariance.tobytes()


def test_what_cannot_be_kept_is_named(capture, followed, tmp_path):
    tracker = Tracker(capture.model)
    restore_tracker(tracker, save_tracker(followed))
    tracker.later = [lambda: None]
    with pytest.raises(
        InputError, match=r"tracker\.later\[0\]: expected what a state can keep, got a builtins.function"
    ):
        save_tracker(tracker)
    with (tmp_path / "x").open("w") as tracker.later, pytest.raises(InputError, match=r"tracker\.later: expected"):
        save_tracker(tracker)
    tracker.later = np.array([None])
    with pytest.raises(InputError, match="array of numbers"):
        save_tracker(tracker)
    tracker.later = replace(followed._velocity.settings)
    object.__setattr__(tracker.later, "more", 1)
    with pytest.raises(InputError, match="to have its fields only, got more"):
        save_tracker(tracker)


def test_containers_generators_and_aliases_come_back(capture):
    tracker = Tracker(capture.model)
    rng = np.random.default_rng(3)
    rng.normal(size=5)
    tracker.kept = {1: (2.5, float("nan"), -0.0, "é"), (0, "a"): [np.float32(0.1), np.arange(6).reshape(2, 3).T]}
    tracker.window = deque([np.zeros((0, 3)), {"b", "a"}], maxlen=4)
    tracker.rng, tracker.alias, tracker.field = rng, tracker.kept, capture.model.field
    again = Tracker(capture.model)
    restore_tracker(again, save_tracker(tracker))
    assert again.kept is again.alias
    assert again.field is capture.model.field
    assert again.kept[1][:1] == (2.5,)
    assert np.signbit(again.kept[1][2])
    assert again.kept[(0, "a")][0].dtype == np.float32
    assert again.kept[(0, "a")][1].flags.f_contiguous
    assert again.window.maxlen == 4
    assert again.rng.normal(size=3).tobytes() == rng.normal(size=3).tobytes()


def test_bytes_of_something_else_are_refused(capture, followed):
    content = save_tracker(followed)
    tracker = Tracker(capture.model)
    before = set(vars(tracker))
    for bad in (b"", b"PK\x03\x04 no", content[:2000], content[:-200]):
        with pytest.raises(InputError, match="a tracker's state: "):
            restore_tracker(tracker, bad)
    assert set(vars(tracker)) == before
    for bad in (None, "text"):
        with pytest.raises(InputError, match=r"expected the bytes of save_tracker, got (NoneType|str)"):
            restore_tracker(tracker, bad)


def test_a_track_of_another_object_is_refused(capture, followed):
    from scenes.synthesis.library import make

    tracker = Tracker(make("mug"))
    before = dict(vars(tracker))
    with pytest.raises(InputError, match="a tracker's state: expected that of a track of mug, got one of another mesh"):
        restore_tracker(tracker, save_tracker(followed, capture.hand), capture.hand)
    assert vars(tracker) == before


def test_a_live_tracker_is_pickled_without_its_thread(capture):
    tracker = Tracker(capture.model, live=True)
    for index in range(3):
        tracker.step(capture[index])
    assert tracker._aside is not None
    again = pickle.loads(pickle.dumps(tracker))
    assert again._aside is None
    assert again.step(capture[3]).how == "tracked"


def test_settings_are_alike_when_they_are():
    @dataclass(frozen=True)
    class Alien:
        value: list = field(default_factory=list)

    from fusion.tracking.answer import TrackSettings

    assert digest(TrackSettings()) == digest(TrackSettings())
    assert digest(TrackSettings()) != digest(TrackSettings(coast=31))
    with pytest.raises(InputError, match="expected what a state can keep"):
        digest(Alien())


def edited_state(content, change):
    """The bytes with a change to their JSON."""
    import io
    import json

    with np.load(io.BytesIO(content)) as file:
        arrays = {name: file[name] for name in file.files}
    state = json.loads(arrays["state"].tobytes())
    change(state["tracker"]["parts"])
    arrays["state"] = np.frombuffer(json.dumps(state).encode(), dtype=np.uint8)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda parts: parts.pop("_seed"), "expected _seed, found none: another version"),
        (lambda parts: parts.update(model={"given": "model.nope"}), "expected a part of the model, got 'nope'"),
    ],
    ids=["an attribute is missing", "a part that the model has not"],
)
def test_states_of_another_tracker_are_refused(change, message):
    from scenes.synthesis.library import make

    model = make("box")
    content, tracker = save_tracker(Tracker(model)), Tracker(model)
    before = dict(vars(tracker))
    with pytest.raises(InputError, match=message):
        restore_tracker(tracker, edited_state(content, change))
    assert vars(tracker) == before


@pytest.mark.parametrize(
    "entry",
    [
        '{"given": 5}',
        '{"object": 5}',
        '{"object": "fusion.tracking.tracker:Tracker", "parts": 5}',
        '{"generator": {"bit_generator": "x"}}',
        '{"list": [' * 20_000 + "]}" * 20_000,
    ],
    ids=["given", "object", "parts", "generator", "deep"],
)
def test_crafted_states_are_refused_in_one_line(entry):
    from scenes.synthesis.library import make

    text = f'{{"format": "palpate-tracker", "version": 1, "tracker": {entry}}}'
    out = io.BytesIO()
    np.savez(out, allow_pickle=False, state=np.frombuffer(text.encode(), dtype=np.uint8))
    with pytest.raises(InputError, match="a tracker's state: expected") as error:
        restore_tracker(Tracker(make("box")), out.getvalue())
    assert "\n" not in str(error.value)
