"""The report of a track: what it costs, what it holds, where the rest is, and that it works from a folder."""

import json
import re
import shutil
import subprocess
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from fusion.estimation.answer import ContactResidual, Mode, Stage
from fusion.results.track import pictures
from fusion.results.track.files import REPORT_FOLDER, GrowingFiles
from fusion.results.track.moments import MOST, moments
from fusion.results.track.pictures import Photographer, every
from fusion.results.track.report import write_track_report
from fusion.results.track.summary import percentiles, read_columns, spans, summary
from fusion.tracking.answer import TrackedEstimate
from fusion.truth.errors import Errors
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Frame
from scenes.synthesis import library

CAMERA = Camera(142.5, 142.5, 79.5, 59.5, 160, 120)
COVARIANCE = np.diag([0.01**2] * 3 + [0.001**2] * 3)


def answer_of(index, **changes):
    pose = poses.make_pose(poses.exp_rotation([0.1, 0.01 * index, 0.0]), [0.0002 * index, 0.0, 0.4])
    given = {
        "frame": index,
        "pose": pose,
        "covariance": COVARIANCE,
        "modes": (Mode(pose, 1.0, 0.0, COVARIANCE),),
        "verdict": "ok",
        "trace": (Stage("look", True, "250 pixels", 3.0, 250), Stage("feel", False, "touch not asked for")),
        "contacts": (ContactResidual("thumb", 0.4, 3.0, False),),
        "visible_fraction": 0.5,
        "notes": ("follows </script><b>it</b>",),
        "hand_from_object": poses.make_pose(np.eye(3), [0.0, 0.0, 0.1]),
        "how": "started" if index == 0 else "tracked",
    }
    return TrackedEstimate(**{**given, **changes})


def write_track(out, count, model, special=None, with_pictures=True, left_out=()):
    """The files of a track of `count` frames; special: changes by frame."""
    out.mkdir(parents=True, exist_ok=True)
    files = GrowingFiles(out, None, with_pictures)
    photographer = Photographer(out / REPORT_FOLDER, model, count) if with_pictures else None
    depth = np.full((120, 160), 0.4, dtype=np.float32)
    for index in range(count):
        if index in left_out:
            files.skipped(index, "behind", "a newer frame had come")
            continue
        answer = answer_of(index, **(special or {}).get(index, {}))
        frame = Frame(index, camera=CAMERA, depth=depth)
        shown = photographer.take(frame, answer, index) if photographer else None
        if shown is not None:
            files.pictured(shown)
        error = Errors(0.001, 0.0005 + 0.00001 * index, 0.01, 0.001, 5.0)
        files.answered(answer, error, {"read_ms": 2.0, "step_ms": 8.0 + index % 7}, 0, 1)
    files.close()


def report(out, count, model, hertz=None):
    columns = read_columns(out, model)
    last = summary(columns, count, hertz, True)
    write_track_report(out, "carried", model, columns, last, tuple(range(count)))
    return columns


SPECIAL = {
    200: {"slip": True, "moved_in_hand": True},
    201: {"slip": True, "moved_in_hand": True},
    300: {"verdict": "lost", "how": "lost"},
    301: {"verdict": "lost", "how": "lost"},
    302: {"how": "re-initialised"},
    400: {"verdict": "ambiguous", "how": "carried", "covariance": 100 * COVARIANCE},
}


@pytest.fixture(scope="module")
def box():
    return library.make("box")


@pytest.fixture(scope="module")
def track(tmp_path_factory, box):
    """A track of 600 frames with something in it, its folder, and what its report has cost (processor s)."""
    out = tmp_path_factory.mktemp("track")
    write_track(out, 600, box, SPECIAL, left_out=(450, 451, 452))
    begin = time.process_time()
    columns = report(out, 600, box)
    return SimpleNamespace(out=out, columns=columns, cost=time.process_time() - begin)


def data_of(page):
    return json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])


def test_six_hundred_frames_take_less_than_five_seconds_and_stay_small(track):
    assert track.cost < 5.0
    assert (track.out / "report.html").stat().st_size < 300_000
    parts = sorted((track.out / REPORT_FOLDER).glob("part_*.js"))
    assert [p.name for p in parts] == [f"part_{i:04d}.js" for i in range(6)]
    assert max(p.stat().st_size for p in parts) < 150_000
    images = list((track.out / REPORT_FOLDER).glob("*.jpg"))
    assert len(images) == 597
    assert sum(p.stat().st_size for p in images) < 597 * 12_000
    assert cv2.imread(str(images[0])).shape[1] <= pictures.WIDE


def test_the_page_has_the_lines_and_the_moments(track):
    page = (track.out / "report.html").read_text()
    data = data_of(page)
    rows = data["rows"]
    assert {len(rows[name]) for name in ("frame", "verdict", "sigma_mm", "step_ms", "error_mm", "missing")} == {597}
    assert len(rows["position"]) == len(rows["turn"]) == len(rows["held_turn"]) == 3
    moved = 1e3 * (track.columns.position[100] - track.columns.position[0])
    assert [axis[100] for axis in rows["position"]] == pytest.approx(moved, abs=0.01)
    assert rows["missing_words"] == ["feel"]
    assert data["skipped"] == [{"first": 450, "last": 452, "cause": "behind", "why": "a newer frame had come"}]
    said = {rows["frame"][m["row"]]: m["why"] for m in data["moments"]}
    assert said[0] == "start"
    assert said[200].startswith("slips, 2 frames")
    assert said[300].startswith("lost, 2 frames")
    assert said[302].startswith("found again")
    assert "least sure" in said[400]
    assert "largest error" in said[599]
    assert "end" in said[599]
    assert [m["row"] for m in data["moments"]] == sorted(m["row"] for m in data["moments"])


def test_nothing_is_fetched_and_no_text_becomes_markup(track):
    page = (track.out / "report.html").read_text()
    assert not re.search(r"https?://(?!www\.w3\.org)", page)
    assert "fetch(" not in page
    assert "XMLHttpRequest" not in page
    assert "<b>it</b>" not in page
    part = (track.out / REPORT_FOLDER / "part_0000.js").read_text()
    entries = json.loads(re.fullmatch(r"palpatePart\(0,(.*)\);\n", part, re.DOTALL)[1])
    assert len(entries) == 100
    assert entries[7]["held"] == pytest.approx([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.1])
    assert entries[7]["others"] == []
    assert entries[0]["notes"] == ["follows </script><b>it</b>"]  # a script of its own: text to the page


def test_a_long_track_is_drawn_in_part_with_every_change(tmp_path, box, monkeypatch):
    monkeypatch.setattr(pictures, "MOST", 50)
    write_track(tmp_path, 600, box, SPECIAL)
    assert every(600) == 12
    report(tmp_path, 600, box)
    data = data_of((tmp_path / "report.html").read_text())
    assert data["every"] == 12
    assert 50 <= len(data["rows"]["frame"]) < 62
    assert {200, 202, 300, 302, 303, 400} <= set(data["rows"]["frame"])
    shown = {int(p.stem) for p in (tmp_path / REPORT_FOLDER).glob("*.jpg")}
    assert shown == set(data["rows"]["frame"])


def test_a_flickering_track_has_few_moments(tmp_path, box):
    flicker = {i: {"verdict": ("ok", "lost")[i % 2], "how": ("tracked", "lost")[i % 2]} for i in range(80)}
    write_track(tmp_path, 80, box, flicker, with_pictures=False)
    columns = report(tmp_path, 80, box)
    assert len(moments(columns, np.arange(80), ())) <= MOST
    assert moments(read_columns(tmp_path / "none", box), np.zeros(0, dtype=np.int64), ()) == []


def test_spans_and_percentiles():
    assert spans([False, True, True, False, True]) == [(1, 2), (4, 4)]
    assert spans([]) == []
    found = percentiles(np.array([1.0, np.nan, 3.0, 2.0]))
    assert found == {"p50": 2.0, "p90": pytest.approx(2.8), "p99": pytest.approx(2.98), "max": 3.0}
    assert percentiles(np.full(3, np.nan))["p99"] is None


PROBE = """
<script>
window.failures = [];
addEventListener("error", (e) => failures.push(e.message || e.target.src), true);
function spaceInk() {  // pixels that the 3-D view has drawn
  const scene = document.getElementById("scene"), flat = document.createElement("canvas");
  flat.width = scene.width; flat.height = scene.height;
  flat.getContext("2d").drawImage(scene, 0, 0);
  const { data } = flat.getContext("2d").getImageData(0, 0, flat.width, flat.height);
  return data.filter((v, i) => i % 4 === 3 && v > 0).length;
}
addEventListener("load", () => setTimeout(() => {
  const where = () => document.getElementById("where").textContent, seen = [where()];
  const slider = document.getElementById("slider");
  slider.value = "250"; slider.dispatchEvent(new Event("input")); seen.push(where());
  const press = (key) => dispatchEvent(new KeyboardEvent("keydown", { key }));
  press("ArrowLeft"); press("ArrowRight"); press("ArrowRight"); seen.push(where());
  for (const button of document.querySelectorAll(".swap button")) button.click();
  setTimeout(() => {
    const canvas = document.getElementById("outline"), pen = canvas.getContext("2d");
    const answer = {
      seen, failures, ink: pen.getImageData(0, 0, canvas.width, canvas.height).data.some((v) => v > 0),
      picture: document.getElementById("picture").naturalWidth,
      overflow: document.documentElement.scrollWidth - innerWidth,
      lanes: document.querySelectorAll(".lane").length, notes: document.getElementById("notes").textContent,
      thumbs: [...document.querySelectorAll(".thumb img")].filter((i) => i.naturalWidth > 0).length,
      scripts: document.querySelectorAll("script[src]").length,
      space: spaceInk(), angles: document.querySelectorAll("#angles button").length,
      way: document.getElementById("spacekey").textContent,
    };
    document.body.replaceChildren(document.createTextNode(`PROBE${JSON.stringify(answer)}PROBE`));
  }, 600);
}, 400));
</script>
"""


@pytest.mark.parametrize("width", [1300, 500])
def test_it_works_from_a_folder_in_a_browser(track, tmp_path, width):
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium on this machine to open the report with")
    folder = tmp_path / "moved"
    shutil.copytree(track.out, folder)
    page = folder / "report.html"
    page.write_text(page.read_text().replace("<style>", PROBE + "<style>", 1))
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run"]
    flags += ["--enable-unsafe-swiftshader"]  # WebGL where there is no graphics card
    flags += [f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},900", "--virtual-time-budget=5000"]
    argv = [chromium, *flags, "--dump-dom", page.as_uri()]
    run = subprocess.run(argv, capture_output=True, text=True, timeout=120, check=False)
    found = re.search(r"PROBE(\{.*\})PROBE", run.stdout.split("<body")[-1])
    assert found, run.stderr[-500:]
    answer = json.loads(found[1].replace("&amp;", "&").replace("&lt;", "<").replace("&gt;", ">"))
    assert answer["failures"] == []
    assert answer["seen"] == ["frame 0 · 1/597", "frame 250 · 251/597", "frame 251 · 252/597"]
    assert answer["ink"]
    assert answer["picture"] > 0
    assert answer["notes"] == "follows </script><b>it</b>"
    assert answer["lanes"] >= 9
    assert answer["thumbs"] >= 6
    assert answer["scripts"] < 6  # what was not looked at is not loaded
    assert answer["overflow"] <= 0
    assert answer["space"] > 1000
    assert answer["angles"] == 4
    assert answer["way"] == "its way in the hand"  # the last button pressed
