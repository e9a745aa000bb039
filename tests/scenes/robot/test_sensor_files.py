"""What sensors.json may say: places on a hand, directions, materials, cameras of gels; and what it may not."""

import json

import numpy as np
import pytest

from scenes.errors import InputError
from scenes.files.merged import read_toml
from scenes.robot.sensors import Sensor, read_sensors
from scenes.robot.tactile import SoftLayer

GOOD = {"link": "a", "kind": "point", "link_from_sensor": np.eye(4).ravel().tolist()}
K = [300.0, 0.0, 24.0, 0.0, 300.0, 18.0, 0.0, 0.0, 1.0]


def _gel(k):
    return GOOD | {"kind": "gel", "gel": {"size": [48, 36], "camera": {"cam_K": k, "distance": 0.02}}}


def _moved(x):
    pose = np.eye(4)
    pose[0, 3] = x
    return GOOD | {"link_from_sensor": pose.ravel().tolist()}


def _taxels(*rows):
    return GOOD | {"kind": "array", "taxels": [list(row) for row in rows]}


def _read(tmp_path, entry, start=b""):
    path = tmp_path / "sensors.json"
    path.write_bytes(start + json.dumps({"s": entry}).encode())
    return read_sensors(path)["s"]


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        (_taxels([0, 0, 0.01, 0, 0, 0]), r"taxels: expected outward normals, got row 0 = \[0\.0, 0\.0, 0\.0\]"),
        (_taxels([0, 0, 0.01, 0, 0, 1], [0, 0, 10, 0, 0, 1]), r"within 0\.5 m, got row 1 = .*: mm read as m\?"),
        (_moved(25.0), r"link_from_sensor: expected a sensor within 1 m of its link, got one 25 m off"),
        (GOOD | {"surfaces": None}, "expected keys of link, .*, got 'surfaces': did you mean surface"),
        (GOOD | {"soft_layer": {"thicknes": 0.002}}, "soft_layer: .* got 'thicknes': did you mean thickness"),
        (GOOD | {"soft_layer": {"thickness": 2.0}}, r"soft_layer: thickness: .* to 0\.1, got 2\.0: mm read as m\?"),
        (GOOD | {"soft_layer": {"saturation": 0}}, "soft_layer: saturation: expected a number from"),
        (GOOD | {"soft_layer": {"modulus": True}}, "soft_layer: modulus: expected a number from"),
        (_gel(np.reshape(K, (3, 3)).T.ravel().tolist()), r"cam_K: .* last row is 0 0 1, .*: is it transposed\?"),
        (_gel([3e7, *K[1:]]), "cam_K: expected fx in pixels, got 3e\\+07 for 48x36 pixels"),
        (_gel([*K[:2], 900.0, *K[3:]]), "cam_K: expected cx near the image, got 900 for 48 pixels"),
        (GOOD | {"kind": "gel", "gel": {"size": [48, 36], "mm_per_pixel": 1, "thick": 1}}, "gel: .* got 'thick'"),
    ],
)
def test_what_no_hand_has_is_refused(tmp_path, entry, told):
    with pytest.raises(InputError, match=told) as error:
        _read(tmp_path, entry)
    assert "\n" not in str(error.value)


def test_normals_are_directions(tmp_path):
    long = [[0, 0, 0.01, 0, 0, 5], [0, 0, 0.01, 0.6, 0, 0.8]]
    found = _read(tmp_path, _taxels(*long)).taxels
    np.testing.assert_allclose(found[:, 3:], [[0, 0, 1], [0.6, 0, 0.8]], atol=1e-15)
    made = Sensor("s", "a", "array", np.eye(4), taxels=np.array(long, dtype=float))
    np.testing.assert_array_equal(made.taxels, found)
    with pytest.raises(InputError, match="sensor 's': taxels: expected outward normals, got row 0"):
        Sensor("s", "a", "array", np.eye(4), taxels=np.zeros((1, 6)))


def test_good_sensors_are_read_as_ever(tmp_path):
    assert _read(tmp_path, _gel(K)).gel.distance == 0.02
    layer = SoftLayer().to_json()
    assert _read(tmp_path, GOOD | {"soft_layer": layer}).soft_layer == layer
    assert SoftLayer.from_json({"stiffness": 800.0}) == SoftLayer()
    with pytest.raises(InputError, match="expected a threshold below the saturation"):
        SoftLayer.from_json({"threshold": 3e5})


def test_a_byte_order_mark_is_no_content(tmp_path):
    mark = b"\xef\xbb\xbf"
    assert _read(tmp_path, GOOD, mark).link == "a"
    (tmp_path / "c.toml").write_bytes(mark + b"[estimate]\n")
    assert read_toml(tmp_path / "c.toml") == {"estimate": {}}
