"""Batches: one bad capture, a worker that is killed, a run that is stopped: nothing else is lost."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from browser import in_browser
from made_frames import plain_view

from fusion.cli.main import main
from fusion.results.batch import (
    COLUMNS,
    MARKER,
    THUMBNAIL,
    Cluster,
    Job,
    Outcome,
    Processes,
    error_row,
    find_captures,
    finished,
    run_jobs,
)
from fusion.results.batch_files import write_all
from fusion.results.summary import summary_of
from scenes.errors import InputError
from scenes.recordings.captures import write_capture
from scenes.synthesis.library import make

ROOT = Path(__file__).resolve().parents[3]


def job(folder: Path, name: str) -> Job:
    return Job(str(folder / name), name, str(folder / "out" / name))


def light_work(task: Job) -> list[dict]:
    """What a job's name says: fail, die once, die always, or answer with the process's number."""
    if task.name.startswith("bad"):
        raise InputError("expected something else, got this")
    flag = Path(task.path + ".died")
    if task.name.startswith("killer") or (task.name.startswith("unlucky") and not flag.exists()):
        flag.touch()
        time.sleep(0.2)
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return [dict.fromkeys(COLUMNS) | {"capture": task.name, "status": "done", "verdict": "ok", "contacts": os.getpid()}]


def results(outcomes) -> dict[str, str]:
    outcomes = list(outcomes)
    assert len({o.job.name for o in outcomes}) == len(outcomes)  # each once
    return {o.job.name: o.status for o in outcomes}


# ---- the runner


def test_a_bad_capture_is_a_row_and_the_rest_goes_on(tmp_path):
    jobs = [job(tmp_path, name) for name in ("a", "bad", "b", "c")]
    outcomes = {o.job.name: o for o in run_jobs(jobs, Processes(2), light_work)}
    assert {name: o.status for name, o in outcomes.items()} == {"a": "done", "bad": "error", "b": "done", "c": "done"}
    assert outcomes["bad"].rows[0]["error"] == "expected something else, got this"
    assert outcomes["a"].rows[0]["contacts"] != os.getpid()


def test_a_worker_that_dies_is_survived(tmp_path):
    names = ["a", "killer", "b", "unlucky", "c", "d"]
    found = {o.job.name: o for o in run_jobs([job(tmp_path, n) for n in names], Processes(2), light_work)}
    assert set(found) == set(names)
    assert {name for name, o in found.items() if o.status == "error"} == {"killer"}
    assert "died" in found["killer"].rows[0]["error"]


def deaf_to_interrupts(task: Job) -> list[dict]:
    """Whether Ctrl-C is held back and ignored in the worker, as a verdict."""
    held = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, set())
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return [dict.fromkeys(COLUMNS) | {"capture": task.name, "verdict": f"{held} {ignored}"}]


def test_a_worker_never_hears_ctrl_c(tmp_path):
    before = signal.pthread_sigmask(signal.SIG_BLOCK, set())
    (outcome,) = run_jobs([job(tmp_path, "a")], Processes(1), deaf_to_interrupts)
    assert outcome.rows[0]["verdict"] == "True True"  # held from the first instruction on, ignored once it can
    assert signal.pthread_sigmask(signal.SIG_BLOCK, set()) == before


def test_an_abandoned_run_leaves_no_process(tmp_path):
    import multiprocessing

    running = run_jobs([job(tmp_path, f"a{i}") for i in range(20)], Processes(2), light_work)
    next(running)
    with pytest.raises(KeyboardInterrupt):
        running.throw(KeyboardInterrupt)
    # the pool's own thread may have waited for one that has ended, and not yet have said so: a join returns at once
    until = time.monotonic() + 30.0
    while multiprocessing.active_children() and time.monotonic() < until:
        time.sleep(0.01)
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_loses_nothing(tmp_path):
    distributed = pytest.importorskip("distributed")
    # found by its workers, too
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster:
        backend = Cluster(cluster.scheduler_address)
        names = ["a", "unlucky", "b", "bad", "c", "d"]
        found = results(run_jobs([job(tmp_path, n) for n in names], backend, light_work))
        backend.close()
    assert found == {name: "error" if name == "bad" else "done" for name in names}


def test_no_scheduler_there_is_one_line(tmp_path, capsys):
    pytest.importorskip("distributed")
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "capture.json").write_text("{}")
    assert main(["batch", str(tmp_path), "--scheduler", "nonsense://x", "--out", str(tmp_path / "o")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


# ---- what is done and what is not


def test_only_whole_results_of_the_same_question_count(tmp_path):
    task = job(tmp_path, "a")
    assert finished(task) is None
    out = Path(task.out)
    out.mkdir(parents=True)
    for name in ("poses.csv", "result.json", "report.html"):
        (out / name).write_text("")
    (out / MARKER).write_text(json.dumps({"fingerprint": task.fingerprint, "rows": [{"capture": "a"}]}))
    assert finished(task) == [{"capture": "a"}]
    assert finished(replace(task, seed=1)) is None
    assert finished(replace(task, name="b")) is not None  # a folder that was renamed is the same question
    (out / "report.html").unlink()
    assert finished(task) is None  # what it wrote is gone
    quick = replace(task, report=False)
    for text in ('{"fingerprint":', json.dumps({"fingerprint": quick.fingerprint}), "[]"):
        (out / MARKER).write_text(text)
        assert finished(quick) is None


@pytest.mark.parametrize("changed", ["capture", "mesh", "start"])
def test_what_was_changed_since_is_another_question(tmp_path, changed):
    (tmp_path / "a" / "out").mkdir(parents=True)
    files = {"capture": tmp_path / "a" / "depth.png", "mesh": tmp_path / "m.ply", "start": tmp_path / "p.json"}
    for path in files.values():
        path.write_text("before")
    task = replace(job(tmp_path, "a"), object=str(files["mesh"]), prior=str(files["start"]))
    inside = replace(task, out=str(tmp_path / "a" / "out"))
    before = task.fingerprint, inside.fingerprint
    (tmp_path / "a" / "out" / "poses.csv").write_text("results that lie in a capture are not read")
    assert inside.fingerprint == before[1]
    files[changed].write_text("after that")
    assert task.fingerprint != before[0]
    assert replace(task, path=str(tmp_path / "b"), object=None, prior=None).fingerprint  # one that is not there


def test_captures_are_found_however_deep(tmp_path):
    for name in ("b", "x/a", "x/a/inner", ".hidden"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "capture.json").write_text("{}")
    (tmp_path / ".hidden" / "empty").mkdir()
    assert [p.relative_to(tmp_path).as_posix() for p in find_captures(tmp_path)] == ["b", "x/a"]
    with pytest.raises(InputError, match="expected captures"):
        find_captures(tmp_path / ".hidden" / "empty")
    with pytest.raises(InputError, match="expected a folder"):
        find_captures(tmp_path / "nowhere")


def test_tables_and_page(tmp_path):
    good, bad = job(tmp_path, "a<b>"), job(tmp_path, "bad")
    row = dict.fromkeys(COLUMNS) | {"capture": "a<b>", "frame": 0, "status": "done", "verdict": "ok", "add_s_mm": 1.5}
    Path(good.out).mkdir(parents=True)
    (Path(good.out) / "report.html").write_text("")
    outcomes = [Outcome(good, "done", [row]), Outcome(bad, "error", [error_row(bad, "<script>\nno")])]
    summary = summary_of(outcomes)
    assert (summary["captures"], summary["failed"], summary["frames"]) == (2, 1, 1)
    assert summary["median_add_s_mm"] == 1.5
    files = write_all(tmp_path / "out", "title", outcomes)
    assert {path.name for path in files} >= {"results.csv", "index.html"}
    rows = list(csv.DictReader((tmp_path / "out" / "results.csv").open()))
    assert [r["status"] for r in rows] == ["done", "error"]
    page = (tmp_path / "out" / "index.html").read_text()
    assert 'href="a%3Cb%3E/report.html"' in page
    assert "&lt;script&gt; no" in page
    assert "{{" not in page
    assert 'name="viewport"' in page
    assert ">ok 1<" in page
    assert ">failed 1<" in page


INDEX_PROBE = """
<script>
window.failures = [];
addEventListener("error", (e) => failures.push(e.message));
addEventListener("load", () => {
  const cells = () => [...document.querySelectorAll("tbody tr:not([hidden]) .name")];
  const names = () => cells().map((cell) => cell.textContent).join(" ");
  const seen = [names()], press = (selector) => { document.querySelector(selector).click(); seen.push(names()); };
  const head = (name) => [...document.querySelectorAll("th button")].find((b) => b.textContent === name);
  head("ADD-S mm").click(); seen.push(names());
  head("ADD-S mm").click(); seen.push(names());
  press("[data-verdict=lost]");
  press("[data-verdict='']");
  const words = document.getElementById("words");
  words.value = "why"; words.dispatchEvent(new Event("input")); seen.push(names());
  const sorted = document.querySelector("[aria-sort]").textContent, order = document.getElementById("order").value;
  const shown = document.querySelector("td.look img").naturalWidth;
  const overflow = document.documentElement.scrollWidth - innerWidth;
  const answer = JSON.stringify({ failures, seen, sorted, order, shown, overflow });
  document.body.replaceChildren(document.createTextNode(`PROBE${answer}PROBE`));
});
</script>
"""


@pytest.mark.parametrize("width", [1400, 500])
def test_the_page_sorts_and_filters_in_a_browser(tmp_path, width):
    outcomes = []
    for name, verdict, error in (("a", "ok", 2.0), ("b", "lost", 30.0), ("c", "ok", 1.0)):
        one = job(tmp_path, name)
        Path(one.out).mkdir(parents=True)
        cv2.imwrite(str(Path(one.out) / THUMBNAIL), np.zeros((144, 192, 3), np.uint8))
        row = dict.fromkeys(COLUMNS) | {"capture": name, "frame": 0, "status": "done", "verdict": verdict}
        outcomes.append(Outcome(one, "done", [row | {"add_s_mm": error}]))
    bad = job(tmp_path, "d")
    outcomes.append(Outcome(bad, "error", [error_row(bad, "why not")]))
    write_all(tmp_path / "out", "title", outcomes)
    page = (tmp_path / "out" / "index.html").read_text().replace('loading="lazy"', "")
    result = in_browser(page, INDEX_PROBE, tmp_path / "out", width)
    assert result["failures"] == []
    assert result["seen"] == ["a b c d", "c a b d", "b a c d", "b", "b a c d", "d"]
    assert (result["sorted"], result["order"], result["shown"]) == ("ADD-S mm", "4 1", 192)
    assert result["overflow"] <= 0


def test_parquet_holds_the_same_rows(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    task = job(tmp_path, "a")
    row = dict.fromkeys(COLUMNS) | {"capture": "a", "frame": 3, "status": "done", "verdict": "ok", "time_ms": 2.5}
    write_all(tmp_path / "out", "t", [Outcome(task, "done", [row]), Outcome(task, "error", [error_row(task, "why")])])
    table = parquet.read_table(tmp_path / "out" / "results.parquet").to_pylist()
    assert table[0] == row
    assert table[1]["error"] == "why"


# ---- the command


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two captures and a broken one."""
    folder = tmp_path_factory.mktemp("batch") / "many"
    for i in range(2):
        write_capture(folder / f"box{i}", [plain_view(seed=i)], make("box"))
    shutil.copytree(folder / "box0", folder / "broken")
    (folder / "broken" / "depth" / "000000.png").write_bytes(b"no image")
    return folder


def test_batch_resumes(folder, tmp_path, capfd):
    out, told = tmp_path / "o", tmp_path / "b.json"
    argv = ["batch", str(folder), "--out", str(out), "--workers", "2", "--no-report", "--json", str(told)]
    assert main(argv) == 1  # one is broken
    printed = capfd.readouterr()
    assert "broken: failed" in printed.out
    assert "Traceback" not in printed.err
    found = json.loads(told.read_text())
    assert found["summary"]["captures"] == 3
    assert found["summary"]["failed"] == 1
    assert found["summary"]["median_add_s_mm"] < 1.0
    assert (out / "box0" / "poses.csv").is_file()
    assert not (out / "broken").exists()
    assert not [p for p in out.iterdir() if p.name.startswith(".")]
    before = (out / "box0" / "result.json").stat().st_mtime_ns
    (out / "box1" / MARKER).unlink()
    shutil.rmtree(out / "box1")  # as if it had been stopped before
    shutil.rmtree(folder / "broken")
    assert main(argv) == 0
    assert json.loads(told.read_text())["summary"]["kept"] == 1
    assert (out / "box0" / "result.json").stat().st_mtime_ns == before
    assert "from an earlier run" in capfd.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("whole_group", [False, True], ids=["only the parent", "the group, as a terminal does"])
@pytest.mark.parametrize("later", [0.0, 0.3, 1.0])
def test_interrupted_it_ends_at_once_and_leaves_nothing_running(folder, tmp_path, later, whole_group):
    command = [sys.executable, "-m", "fusion.cli.main", "batch", str(folder), "--out", str(tmp_path / "o")]
    run = subprocess.Popen([*command, "--workers", "2"], cwd=ROOT, stderr=subprocess.PIPE, start_new_session=True)
    for _ in range(600):  # until the workers are asked for
        if (tmp_path / "o").exists():
            break
        time.sleep(0.1)
    time.sleep(later)  # while they start, import, compute
    (os.killpg if whole_group else os.kill)(run.pid, signal.SIGINT)
    _, err = run.communicate(timeout=120)
    assert run.returncode == 130
    assert err.decode() == "palpate: interrupted\n"
    for _ in range(200):  # the last of them may still be on their way out
        # not those that have ended and wait for someone to read their exit code
        command = ["pgrep", "-g", str(run.pid), "-r", "R,S,D,T"]
        left = subprocess.run(command, capture_output=True, text=True, check=False).stdout.split()
        if not left:
            break
        time.sleep(0.1)
    assert left == []


def test_a_frame_that_cannot_be_used_is_a_row_and_the_others_are_answered(tmp_path, capsys):
    folder, out, told = tmp_path / "many", tmp_path / "o", tmp_path / "b.json"
    write_capture(folder / "two", [plain_view(seed=0), replace(plain_view(seed=1), index=1)], make("box"))
    (folder / "two" / "depth" / "000001.png").write_bytes(b"no image")
    argv = ["batch", str(folder), "--out", str(out), "--workers", "1", "--json", str(told)]
    assert main(argv) == 1
    assert "two: left out: " in capsys.readouterr().out
    found = json.loads(told.read_text())
    assert (found["summary"]["failed"], found["summary"]["left_out"], found["summary"]["frames"]) == (0, 1, 1)
    assert [row["status"] for row in found["rows"]] == ["done", "left out"]
    assert "000001.png" in found["rows"][1]["error"]
    assert json.loads((out / "two" / "result.json").read_text())["left_out"][0]["frame"] == 1
    assert "1 left out" in (out / "index.html").read_text()
    assert main(argv) == 1  # an earlier run's frame that was left out is no success, either


def test_bad_use_is_one_line(tmp_path, capsys):
    for argv in (["batch", str(tmp_path / "x")], ["batch", str(tmp_path)], ["batch", str(tmp_path), "--workers", "0"]):
        assert main(argv) == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("flags", [["--no-outline"], ["--print"], []], ids=["--no-outline", "--print", "neither"])
def test_flags_of_settings_reach_the_jobs(folder, tmp_path, monkeypatch, flags):
    """Without --config, too; the usual settings are no settings, so that earlier results still count."""
    found = []

    def noted(jobs, backend, work=None):
        found.extend(jobs)
        return iter([Outcome(one, "error", [error_row(one, "not tried")]) for one in jobs])

    monkeypatch.setattr("fusion.results.batch.run_jobs", noted)
    main(["batch", str(folder), "--out", str(tmp_path / "o"), *flags])
    assert found
    for one in found:
        if not flags:
            assert one.settings is None
            continue
        assert one.settings.contour.used is ("--no-outline" not in flags)
        assert one.settings.look.colour.used is ("--no-outline" not in flags)
        assert one.settings.texture.counts is ("--print" in flags)
        assert one.fingerprint != replace(one, settings=None).fingerprint


def test_linked_captures_are_found_once_and_linked_results_are_shown(tmp_path):
    many, elsewhere, out = tmp_path / "many", tmp_path / "elsewhere", tmp_path / "o"
    for place in (many / "a", elsewhere / "b"):
        place.mkdir(parents=True)
        (place / "capture.json").write_text("{}")
    (many / "linked").symlink_to(elsewhere / "b")
    (many / "circle").symlink_to(many)
    assert [p.relative_to(many).as_posix() for p in find_captures(many)] == ["a", "linked"]
    (elsewhere / "results").mkdir()
    (elsewhere / "results" / "report.html").write_text("<p>")
    out.mkdir()
    (out / "a").symlink_to(elsewhere / "results")
    row = dict.fromkeys(COLUMNS) | {"capture": "a", "frame": 0, "status": "done", "verdict": "ok", "contacts": 0}
    outcomes = [Outcome(job(tmp_path, "a"), "done", [row])]
    outcomes = [replace(one, job=replace(one.job, out=str(out / "a"))) for one in outcomes]
    write_all(out, "o", outcomes)
    assert 'href="../elsewhere/results/report.html"' in (out / "index.html").read_text()
