"""Files and folders appear whole; errors name what was asked for; the dead leave nothing behind."""

from __future__ import annotations

import csv
import errno
import os
import subprocess
import sys

import numpy as np
import pytest
from commands import refused
from made_frames import some_frame

from fusion.results.batch import Job, Outcome, error_row
from fusion.results.batch_files import write_all
from scenes.files import tables
from scenes.files.problems import refuse
from scenes.files.tables import harmless
from scenes.files.whole import _host, draft_folder, put, replace_file, sweep
from scenes.recordings import bop
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.frames import Contacts
from scenes.synthesis.library import make

FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def dead() -> int:
    """The number of a process that is no more."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_full_disk_names_the_file_and_leaves_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "poses.csv"
    bop.write_poses(path, [bop.PoseRow(0, 0, 1, 1.0, np.eye(4), 0.1)])
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise FULL

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space left") as error:
        bop.write_poses(path, [])
    assert error.value.filename == str(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["poses.csv"]


def test_a_full_disk_names_the_place_in_the_folder_asked_for(tmp_path):
    out = tmp_path / "capture"
    with pytest.raises(OSError, match="No space left") as error, draft_folder(out) as draft:
        raise OSError(errno.ENOSPC, "No space left on device", str(draft / "depth/000003.png"))
    assert error.value.filename == str(out / "depth/000003.png")
    with pytest.raises(OSError, match="No space left") as error, draft_folder(out):
        raise FULL
    assert error.value.filename == str(out)
    assert os.listdir(tmp_path) == []


def test_what_the_dead_left_is_cleared_and_what_the_living_make_is_not(tmp_path, dead):
    out = tmp_path / "results"
    for pid in (dead, os.getpid()):
        (tmp_path / f".results.draft-{_host()}-{pid}-abc_1").mkdir()
        (tmp_path / f".results.draft-{_host()}-{pid}-abc_1/half.csv").write_text("1")
    (tmp_path / f".results.draft-elsewhere-{dead}-abc").mkdir()
    (tmp_path / f".other.draft-{_host()}-{dead}-abc").mkdir()
    with draft_folder(out) as draft:
        (draft / "a").write_text("a")
        put(draft, out)
    kept = [f".other.draft-{_host()}-{dead}-abc", f".results.draft-elsewhere-{dead}-abc"]
    assert sorted(os.listdir(tmp_path)) == sorted([*kept, f".results.draft-{_host()}-{os.getpid()}-abc_1", "results"])


def test_a_result_moved_aside_comes_back(tmp_path, dead):
    aside = tmp_path / f".results.old-{_host()}-{dead}-abc/kept"
    aside.mkdir(parents=True)
    (aside / "poses.csv").write_text("1")
    sweep(tmp_path / "results")
    assert (tmp_path / "results/poses.csv").read_text() == "1"
    assert os.listdir(tmp_path) == ["results"]


def test_a_file_of_a_dead_writer_goes_with_the_next(tmp_path, dead):
    (tmp_path / f".result.json.draft-{_host()}-{dead}-abc").write_text("{")
    replace_file(tmp_path / "result.json", b"{}")
    assert os.listdir(tmp_path) == ["result.json"]


@pytest.mark.parametrize("where", ["/proc/x.json", "/proc/1/x.json"])
def test_where_nothing_can_be_written_is_said_before_the_work(where, capsys):
    if not os.path.isdir("/proc"):
        pytest.skip("no /proc")
    assert "cannot be written" in refused(capsys, "validate", "nothing", "--json", where)


NAMES = ["=1+1", "+a", "-b", "@c", "'=d", "plain", "'quoted", "\tx"]


def test_names_are_no_formulas_and_read_back(tmp_path):
    for name in NAMES[:4]:
        assert harmless(name) == f"'{name}"
    assert harmless("plain") == "plain"
    model, names = make("box"), ["=cmd", "@tip"]
    frame = some_frame(0)
    felt = Contacts(-np.abs(frame.contacts.points[:2]), sensors=names)
    folder = write_capture(tmp_path / "c", [type(frame)(0, contacts=felt)], model)
    text = (folder / "contacts.csv").read_text()
    assert ",'=cmd,-" in text  # the name is made harmless, the number is not touched
    assert read_capture(folder)[0].contacts.sensors == names
    column = (tables.CsvColumn("name", "text"),)
    tables.write_table(tmp_path / "t.csv", column, [[name] for name in NAMES])
    assert tables.read_table(tmp_path / "t.csv", column, refuse).texts["name"] == NAMES


def test_the_table_of_a_batch_runs_nothing(tmp_path):
    job = Job("p", "=HYPERLINK(1)", str(tmp_path / "o"))
    write_all(tmp_path, "t", [Outcome(job, "error", [error_row(job, "-oops")])])
    (row,) = csv.DictReader((tmp_path / "results.csv").read_text().splitlines())
    assert row["capture"] == "'=HYPERLINK(1)"
    assert row["error"] == "'-oops"
