"""Files and folders appear whole; errors name what was asked for; the dead leave nothing behind."""

from __future__ import annotations

import csv
import errno
import json
import os
import stat
import subprocess
import sys

import numpy as np
import pytest
from commands import refused, run
from made_frames import some_frame

from fusion.results.batch import Job, Outcome, error_row
from fusion.results.batch_files import write_all
from scenes.files.formats import tables
from scenes.files.formats.tables import harmless
from scenes.files.problems import refuse
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


@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_and_what_it_leads_to_is_written(tmp_path, there):
    real, link = tmp_path / "elsewhere" / "real.json", tmp_path / "link.json"
    real.parent.mkdir()
    if there:
        real.write_text("old")
    link.symlink_to(real)
    replace_file(link, b"new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert os.listdir(tmp_path / "elsewhere") == ["real.json"]
    assert sorted(os.listdir(tmp_path)) == ["elsewhere", "link.json"]


def test_a_link_to_a_folder_stays_and_that_is_replaced(tmp_path):
    real, link = tmp_path / "elsewhere" / "c", tmp_path / "c"
    real.mkdir(parents=True)
    link.symlink_to(real)
    for index in range(2):  # an empty folder, then a capture
        write_capture(link, [some_frame(index)], make("box"))
    assert link.is_symlink()
    assert read_capture(real).frame_ids == (1,)
    assert os.listdir(tmp_path / "elsewhere") == ["c"]


def test_a_pipe_stays_and_its_reader_has_all_once(tmp_path, capsys):
    """Whoever tries first whether it can be written must not open it: the reader would see it end."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    write_capture(tmp_path / "c", [some_frame(0)], make("box"))
    reader = subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE)
    assert run("validate", tmp_path / "c", "--json", pipe) == 0
    told = json.loads(reader.communicate(timeout=20)[0])
    assert told["valid"] is True
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_device_is_written_to(tmp_path):
    link = tmp_path / "nothing"
    link.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as error:
        replace_file(link, b"some")
    assert error.value.filename == str(link)
    assert link.is_symlink()
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


@pytest.mark.parametrize("piped", [True, False])
def test_standard_output_is_written_to_in_turn(tmp_path, piped):
    """Through a link, for who replaces /dev/stdout itself takes it from every other program."""
    link, file = tmp_path / "out", tmp_path / "said.txt"
    link.symlink_to("/proc/self/fd/1")
    code = (
        "import sys; from pathlib import Path; from scenes.files.whole import replace_file;"
        " sys.stdout.write('before\\n'); replace_file(Path(sys.argv[1]), b'{}\\n'); sys.stdout.write('after\\n')"
    )
    command = [sys.executable, "-c", code, link]
    if piped:
        said = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    else:
        with file.open("w") as opened:
            subprocess.run(command, stdout=opened, check=True)
        said = file.read_text()
    assert said == "before\n{}\nafter\n"
    assert link.is_symlink()


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
