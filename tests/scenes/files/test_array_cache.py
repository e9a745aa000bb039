"""Arrays kept on disk: made once for what they were made from, and again when a file is no good."""

import numpy as np
import pytest

from scenes.cache import are_triangles, cache_folder, remembered, remembered_of_file

CONTENT = (np.arange(6.0).reshape(2, 3), np.array([[0, 1, 2]]))


class Maker:
    """Counts how often it is asked."""

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return {"values": np.arange(12, dtype=np.float32).reshape(3, 4), "width": np.array(0.5)}


def sound(arrays):
    return arrays["values"].shape == (3, 4) and arrays["width"].shape == ()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("PALPATE_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    return tmp_path


def test_made_once_and_the_same_afterwards(folder):
    make = Maker()
    first, second = (remembered("kind", 1, CONTENT, make, sound) for _ in range(2))
    assert make.calls == 1
    for name, array in first.items():
        assert second[name].dtype == array.dtype
        assert second[name].shape == array.shape
        assert (second[name] == array).all()
    assert [path.name.startswith("kind-") for path in folder.iterdir()] == [True]


@pytest.mark.parametrize(
    ("settings", "content"),
    [
        (2, CONTENT),
        (1, (CONTENT[0] + 1e-12, CONTENT[1])),
        (1, (CONTENT[0].reshape(3, 2), CONTENT[1])),
        (1, (CONTENT[0].astype(np.float32), CONTENT[1])),
        (1, CONTENT[::-1]),
        (1, CONTENT[:1]),
    ],
)
def test_other_settings_or_content_are_other_arrays(folder, settings, content):
    make = Maker()
    remembered("kind", 1, CONTENT, make, sound)
    remembered("kind", settings, content, make, sound)
    assert make.calls == 2
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("damage", ["empty", "text", "cut", "other names", "objects"])
def test_a_file_that_is_no_good_is_made_again(folder, damage):
    make = Maker()
    remembered("kind", 1, CONTENT, make, sound)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    if damage == "other names":
        np.savez(path, wrong=np.zeros(3))
    elif damage == "objects":
        np.savez(path, values=np.array([None]), width=np.array(0.5))
    else:
        path.write_bytes({"empty": b"", "text": b"no arrays\n", "cut": whole[: len(whole) // 2]}[damage])
    again = remembered("kind", 1, CONTENT, make, sound)
    assert make.calls == 2
    assert sound(again)
    remembered("kind", 1, CONTENT, make, sound)
    assert make.calls == 2


def test_what_objects_and_hands_keep_is_read_back_the_same(folder, monkeypatch):
    """A second process, as it were: nothing is made again, and nothing differs."""
    from scenes import cache as array_cache
    from scenes.evidence.symmetry.near_symmetries import near_symmetries
    from scenes.geometry.objects import ObjectModel
    from scenes.robot import hands
    from scenes.synthesis import library
    from scenes.synthesis.hands import five_finger_hand

    def everything():
        hands._surface_samples.cache_clear()
        made, hand = library.make("box"), five_finger_hand()
        box = ObjectModel("box", made.vertices, made.faces, made.symmetries)  # the library's own has its field by now
        field = box.field
        samples = hand.surface_samples(0.008)
        return [field.values, field.origin, np.array(field.spacing), near_symmetries(box), *samples]

    first = everything()
    assert len(list(folder.iterdir())) == 3

    def never(path, arrays):
        raise AssertionError(f"made again: {path}")

    monkeypatch.setattr(array_cache, "_write", never)
    for one, other in zip(first, everything()):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)


def test_a_file_is_known_by_its_bytes_wherever_it_lies(folder, tmp_path):
    first, copied, other = (tmp_path / name for name in ("a/mesh.ply", "b/copy.ply", "b/mesh.stl"))
    for path in (first, copied, other):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"the same")
    make = Maker()
    for path, calls in ((first, 1), (copied, 1), (other, 2)):
        remembered_of_file("kind", 1, path, make, sound)
        assert make.calls == calls, path
    first.write_bytes(b"not the same")
    remembered_of_file("kind", 1, first, make, sound)
    assert make.calls == 3
    beside = tmp_path / "scene.gltf"  # its vertices may lie in a file beside it
    beside.write_bytes(b"{}")
    for calls in (4, 5):
        remembered_of_file("kind", 1, beside, make, sound)
        assert make.calls == calls


@pytest.mark.parametrize(
    "damage",
    [
        {"faces": np.array([[0, 1, 3]])},
        {"faces": np.array([[0, 1, -1]])},
        {"faces": np.zeros((0, 3), dtype=np.int64)},
        {"faces": np.array([[0.0, 1.0, 2.0]])},
        {"vertices": np.full((3, 3), np.nan)},
        {"vertices": np.eye(3, dtype=np.float32)},
        {"vertices": np.eye(3)[:, :2]},
    ],
)
def test_stored_triangles_are_looked_at(damage):
    whole = {"vertices": np.eye(3), "faces": np.array([[0, 1, 2]])}
    assert are_triangles(whole)
    assert not are_triangles({**whole, **damage})
