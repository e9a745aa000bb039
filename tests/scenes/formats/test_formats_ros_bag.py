"""Bags as files: cut off, overwritten, without definitions, and without the library that reads them."""

from __future__ import annotations

import sys

import bags
import numpy as np
import pytest
from bags import KINDS, PLAIN, START, converted, plain, write_map
from commands import refused, run


def test_definitions_of_the_map_stand_in_for_those_of_the_bag(tmp_path, monkeypatch, capsys):
    from rosbags.rosbag2 import storage_sqlite3

    # bags of ROS 2 before Iron: the database has no table of definitions
    monkeypatch.setattr(storage_sqlite3.Sqlite3Writer, "add_msgtype", lambda self, connection: None)
    out = plain("sqlite3", 1)
    out.pressures("/pad", START, [1.0, 2.5])
    topics = PLAIN | {"/pad": {"role": "tactile", "sensor": "pad", "field": "cells"}}
    made = write_map(tmp_path / "without.json", topics)
    bag = out.write(tmp_path / "undefined")
    error = refused(capsys, "convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
    assert "/pad: expected the definition of palpate_msgs/msg/Pressures in the topic map, got none" in error
    capture, _ = converted(tmp_path, out, topics, definitions=bags.TYPES)
    assert capture[0].tactile["pad"].tolist() == [1.0, 2.5]


@pytest.mark.parametrize("kind", KINDS)
def test_truncated_bags(tmp_path, capsys, kind):
    out = plain(kind, 20)
    bag = out.write(tmp_path / "bag")
    file = bag if bag.is_file() else next(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
    whole = file.read_bytes()
    made = write_map(tmp_path / "topics.json", PLAIN)
    for share in (0.0, 0.3, 0.6, 0.95):
        file.write_bytes(whole[: int(share * len(whole))])
        message = refused(capsys, "convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
        assert str(bag) in message
        assert not (tmp_path / "c").exists()


def test_overwritten_bytes_are_one_line_or_a_capture(tmp_path, capsys):
    rng = np.random.default_rng(5)
    for kind in KINDS:
        bag = plain(kind, 6).write(tmp_path / kind)
        file = bag if bag.is_file() else next(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))
        whole = np.frombuffer(file.read_bytes(), dtype=np.uint8)
        made = write_map(tmp_path / "topics.json", PLAIN)
        for _ in range(12):
            damaged = whole.copy()
            at = int(rng.integers(0, len(whole) - 40))
            damaged[at : at + 40] = rng.integers(0, 256, 40)
            file.write_bytes(damaged.tobytes())
            code = run("convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
            err = capsys.readouterr().err
            assert (code, err.count("\n")) in ((0, 0), (2, 1)), err


def test_without_rosbags_the_extra_is_named(tmp_path, capsys, monkeypatch):
    bag = plain("mcap", 1).write(tmp_path / "bag")
    made = write_map(tmp_path / "topics.json", PLAIN)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    error = refused(capsys, "convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
    assert "pip install 'palpate[ros]'" in error
