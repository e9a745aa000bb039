"""The shipped schemas hold what palpate writes, tell of every key of it, and refuse what its readers refuse."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from commands import run
from jsonschema import Draft202012Validator
from made_frames import plain_view, some_frame

from scenes.errors import PalpateError
from scenes.files.schema import NAMES, complaints, kind_of, schema
from scenes.formats.ros.topics import ROLES, read_map
from scenes.recordings.captures import write_capture
from scenes.recordings.checking.validation import validate
from scenes.robot.sensors import read_sensors
from scenes.robot.tactile import with_arrays
from scenes.synthesis.hands import TIPS, HandShape, five_finger_hand
from scenes.synthesis.library import make


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    hand = with_arrays(five_finger_hand())
    return write_capture(tmp_path_factory.mktemp("c") / "held", [some_frame(0, hand)], make("box"), hand)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What estimate and track write: of a frame, of one where touch alone is left, of one with nothing."""
    folder = tmp_path_factory.mktemp("r")
    whole = plain_view()
    frames = [
        whole,
        replace(whole, index=1, depth=None, prior=None),
        replace(whole, index=2, depth=None, contacts=None),
    ]
    capture = write_capture(folder / "c", [frames[0]], make("box"))
    few = write_capture(folder / "few", [replace(f, camera=None) for f in frames[1:]][:1], make("box"))
    for command, source in (("estimate", capture), ("track", capture), ("estimate", few)):
        run(command, source, "--out", folder / f"{command}-{source.name}", "--no-report")
    return sorted(folder.glob("*/result.json"))


def described(content, part, place="") -> list[str]:
    """Places of the content that its schema says nothing of."""
    options = [part, *part.get("anyOf", ())]
    if isinstance(content, dict):
        missing = []
        for key, value in content.items():
            known = next((o["properties"][key] for o in options if key in o.get("properties", {})), None)
            free = next((o["additionalProperties"] for o in options if o.get("additionalProperties")), None)
            if known is None and free is None:
                whole = any(o.get("type") == "object" and "properties" not in o for o in options)
                missing += [] if whole else [f"{place}.{key}"]
            else:
                missing += described(value, known if known is not None else free, f"{place}.{key}")
        return missing
    if isinstance(content, list):
        items = next((o["items"] for o in options if "items" in o), {})
        return [line for value in content for line in described(value, items, f"{place}[]")]
    return []


@pytest.mark.parametrize("name", NAMES)
def test_the_schemas_are_schemas(name):
    Draft202012Validator.check_schema(schema(name))
    assert schema(name)["title"].startswith(f"{name}.json: ")


def test_results_are_as_their_schema_says(results):
    assert len(results) == 3
    for path in results:
        content = json.loads(path.read_text())
        assert complaints(content, "result") == []
        assert sorted(set(described(content, schema("result")))) == [], "tell of these keys in result.schema.json"
        assert kind_of(content) == "result"
        assert run("validate", path) == 0


def test_captures_are_as_their_schemas_say(held, tmp_path):
    for name, path in (("capture", held / "capture.json"), ("sensors", held / "hand/sensors.json")):
        content = json.loads(path.read_text())
        assert complaints(content, name) == []
        assert described(content, schema(name)) == []
        assert kind_of(content) == name
    for tip in TIPS:
        five_finger_hand(HandShape(tip=tip)).save(tmp_path / tip)
        assert complaints(json.loads((tmp_path / tip / "sensors.json").read_text()), "sensors") == []


TOPICS = {
    "format": "palpate-topics",
    "version": 1,
    "topics": {
        "/depth": {"role": "depth", "depth_scale": 1.0},
        "/info": {"role": "camera_info", "rectified": True},
        "/joints": {"role": "joints", "names": {"a": "b"}},
        "/touch": {"role": "contacts", "points": "contacts[].position", "sigma_point": 0.001},
    },
    "frames": {"camera": "camera_link"},
}


def test_the_roles_of_topics_are_the_readers():
    rules = schema("topics")["properties"]["topics"]["additionalProperties"]["allOf"]
    told = {rule["if"]["properties"]["role"]["const"]: rule["then"] for rule in rules}
    assert set(told) == set(ROLES)
    for role, keys in ROLES.items():
        assert set(told[role]["properties"]) - {"role"} == {key.rstrip("!") for key in keys}
        assert set(told[role]["required"]) - {"role"} == {key.rstrip("!") for key in keys if key.endswith("!")}


def _changed(content, *path_and_value):
    *path, last, value = path_and_value
    out = copy.deepcopy(content)
    place = out
    for key in path:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return out


@pytest.mark.parametrize(
    "change",
    [
        ("format", "palpate"),
        ("version", 2),
        ("topics", {}),
        ("world", "moon"),
        ("topic", 1),
        ("tolerance_s", -1),
        ("frames", {"cam": "x"}),
        ("required", ["depths"]),
        ("topics", "/depth", "role", "dept"),
        ("topics", "/depth", "depth_scale", 0),
        ("topics", "/info", "rectified", "yes"),
        ("topics", "/joints", "names", ["a"]),
        ("topics", "/touch", "points", None),
        ("topics", "/touch", "sensors", "x"),
        ("topics", "/marker", {"role": "marker", "index": -1}),
        ("intrinsics", {"fx": 500.0}),
        ("static_frames", [{"parent": "a"}]),
        ("marker", {"camera_from_tracker": 3}),
    ],
)
def test_maps_that_the_reader_refuses_are_refused(tmp_path, change):
    path = tmp_path / "topics.json"
    path.write_text(json.dumps(TOPICS))
    read_map(path)
    assert complaints(TOPICS, "topics") == []
    wrong = _changed(TOPICS, *change)
    path.write_text(json.dumps(wrong))
    with pytest.raises(PalpateError):
        read_map(path)
    assert complaints(wrong, "topics")


GOOD = {"s": {"link": "a", "kind": "point", "link_from_sensor": np.eye(4).ravel().tolist()}}


@pytest.mark.parametrize(
    "entry",
    [
        {"link": 3},
        {"kind": "ultrasound"},
        {"link_from_sensor": [1, 2]},
        {"kind": "array"},
        {"taxels": [[1, 2, 3]]},
        {"surface": {"torus": {}}},
        {"surface": {"sphere": {}}},
        {"surface": {"sphere": {"radius": -1}}},
        {"surface": {"mesh": {"file": 3}}},
        {"soft_layer": 3},
        {"soft_layer": {"thicknes": 0.002}},
        {"soft_layer": {"thickness": 2.0}},
        {"soft_layers": {"thickness": 0.002}},
        {"kind": "gel"},
        {"gel": 3},
        {"gel": {"size": [20, 10]}},
        {"gel": {"size": [20, 4], "mm_per_pixel": 0.1}},
        {"gel": {"size": [20, 10], "mm_per_pixel": 0.1, "camera": {"cam_K": [1] * 9, "distance": 0.02}}},
        {"gel": {"size": [20, 10], "mm_per_pixel": 0.1, "thickness": 1}},
        {"gel": {"size": [20, 10], "mm_per_pixel": 0.1, "surface": "bent"}},
    ],
)
def test_sensors_that_the_reader_refuses_are_refused(tmp_path, entry):
    assert complaints(GOOD, "sensors") == []
    wrong = {"s": GOOD["s"] | entry}
    (tmp_path / "sensors.json").write_text(json.dumps(wrong))
    with pytest.raises(PalpateError):
        read_sensors(tmp_path / "sensors.json")
    assert complaints(wrong, "sensors")


def test_validate_says_where(held, results, tmp_path, capsys):
    content = json.loads(results[0].read_text())
    content["frames"][0]["verdict"] = "perhaps"
    del content["frames"][0]["trace"]
    path = tmp_path / "result.json"
    path.write_text(json.dumps(content))
    assert run("validate", path, "--json", tmp_path / "v.json") == 1
    printed = capsys.readouterr().out
    assert f"{path}: frames[0]: 'trace' is a required property" in printed
    assert "frames[0].verdict: 'perhaps' is not one of" in printed
    assert json.loads((tmp_path / "v.json").read_text())["schema"] == "result"
    assert "--json" not in str(validate(held))
    before = validate(held)
    told = json.loads((held / "capture.json").read_text())
    (held / "capture.json").write_text(json.dumps(told | {"notes": 3}))
    after = validate(held)
    (held / "capture.json").write_text(json.dumps(told))
    assert [p.message for p in after if p not in before] == ["notes: 3 is not of type 'object'"]
