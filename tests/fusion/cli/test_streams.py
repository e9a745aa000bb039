"""Output that nobody reads, is closed, or is closed on the way: the exit code is the result's; tables are whole."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from made_frames import plain_view

from fusion.cli.main import main
from fusion.cli.options import show_table
from scenes.recordings.captures import write_capture
from scenes.synthesis.library import make

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """One that is as it must be, and one of which hundreds of lines must be said."""
    folder = tmp_path_factory.mktemp("streams")
    good = write_capture(folder / "good", [plain_view()], make("box"))
    bad = write_capture(folder / "bad", [plain_view()], make("box"))
    rows = "".join(f"0,s{i},nan,0,0\n" for i in range(3000))
    (bad / "contacts.csv").write_text("frame,sensor,x,y,z\n" + rows)
    return good, bad


def shell(line: str, *words: object) -> subprocess.CompletedProcess[str]:
    """What `bash` makes of a line in which `palpate` is the command and $1, $2, … are words."""
    script = f'palpate() {{ "{sys.executable}" -m fusion.cli.main "$@"; }}; {line}'
    argv = ["bash", "-c", script, "bash", *map(str, words)]
    return subprocess.run(argv, capture_output=True, text=True, cwd=ROOT, check=False)


def test_a_reader_that_has_enough_does_not_change_the_exit_code(captures):
    good, bad = captures
    ended = shell('palpate validate "$1" | head -1; exit ${PIPESTATUS[0]}', bad)
    assert (ended.returncode, ended.stderr) == (1, "")
    assert ended.stdout.count("\n") == 1
    ended = shell('palpate validate "$1" | true; exit ${PIPESTATUS[0]}', good)
    assert (ended.returncode, ended.stderr) == (0, "")
    ended = shell("palpate synth --help | true; exit ${PIPESTATUS[0]}")
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_table_that_nobody_reads_to_its_end(captures, tmp_path):
    poses = captures[0] / "poses.csv"
    poses.write_text("scene_id,im_id,obj_id,score,R,t,time\n0,0,1,1,1 0 0 0 1 0 0 0 1,0 0 500,-1\n")
    ended = shell('palpate evaluate "$1" "$2" | true; exit ${PIPESTATUS[0]}', poses, captures[0])
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams_cost_nothing_but_what_they_would_have_shown(captures, closed):
    good, bad = captures
    for capture, code in ((good, 0), (bad, 1)):
        ended = shell(f'palpate validate "$1" {closed}', capture)
        assert ended.returncode == code
        assert ended.stderr == ""
    assert shell(f'palpate validate "$1" {closed}', good / "nothing").returncode == 2


def test_a_file_does_not_get_the_number_of_a_closed_stream(captures, tmp_path):
    """Whatever a library printed to it would be in that file."""
    assert shell('palpate validate "$1" --json "$2" >&- 2>&-', captures[0], tmp_path / "v.json").returncode == 0
    assert (tmp_path / "v.json").read_text().startswith("{")


def test_streams_are_put_back(capsys):
    before = sys.stdout, sys.stderr
    with pytest.raises(SystemExit):
        main(["--help"])
    assert (sys.stdout, sys.stderr) == before
    assert "Exit codes" in capsys.readouterr().out


def test_what_is_closed_in_a_process_of_another_s(monkeypatch, captures):
    handles = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").is_dir() else None
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    assert main(["validate", str(captures[0])]) == 0
    assert main(["validate", str(captures[0] / "nothing")]) == 2
    assert sys.stdout is None
    if handles is not None:
        assert len(os.listdir("/proc/self/fd")) <= handles + 1


def test_tables_are_whole_in_a_pipe_however_long_a_cell_is(capsys):
    long = ", ".join(["translation along (0.10, 0.20, 0.97)"] * 6)
    show_table(("frame", "verdict", "not known"), [["1", "ambiguous", long]])
    (line,) = [one for one in capsys.readouterr().out.splitlines() if "ambiguous" in one]
    assert long in line


def test_letters_that_a_terminal_lacks_are_replaced(captures, tmp_path):
    poses = tmp_path / "poses.csv"
    poses.write_text("scene_id,im_id,obj_id,score,R,t,time\n0,0,1,1,1 0 0 0 1 0 0 0 1,0 0 500,-1\n")
    ended = shell('PYTHONIOENCODING=ascii palpate evaluate "$1" "$2"', poses, captures[0])
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "?" in ended.stdout
    ended = shell('PYTHONIOENCODING=ascii palpate validate "$1"', tmp_path / "Ж")
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1


def test_streams_of_whoever_calls_are_as_before(capfd):
    with open(os.devnull, "w", encoding="ascii") as stream, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert main(["validate", "nowhere"]) == 2
        assert stream.errors == "strict"


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_help_onto_a_full_disk_is_no_success(captures, unbuffered):
    for words in ("--help", "--version", "synth --help", 'validate "$1"'):
        ended = shell(f"PYTHONUNBUFFERED={unbuffered} palpate {words} > /dev/full", captures[0])
        assert (ended.returncode, ended.stderr) == (2, "palpate: No space left on device\n")


def test_python_without_docstrings_runs_commands(captures):
    argv = [sys.executable, "-OO", "-m", "fusion.cli.main"]
    for words in (["validate", str(captures[0])], ["--help"]):
        ended = subprocess.run([*argv, *words], capture_output=True, text=True, cwd=ROOT, check=False)
        assert (ended.returncode, ended.stderr) == (0, "")
        assert ended.stdout


def test_of_a_copy_that_finds_no_room_the_full_disk_is_named(captures, tmp_path, monkeypatch, capsys):
    def full(source, target):
        # as shutil.copyfile tells of it
        raise OSError(errno.ENOSPC, "No space left on device", str(source), None, str(target))

    monkeypatch.setattr("scenes.formats.bop.scene.shutil.copyfile", full)
    assert main(["convert", str(captures[0]), str(tmp_path / "bop"), "--to", "bop"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"palpate: {tmp_path / 'bop'}")
    assert line.endswith("No space left on device")
