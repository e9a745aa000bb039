"""The report: what it is made of, that nothing in a capture can break out of it, and that it works in a browser."""

import base64
import dataclasses
import json
import re

import cv2
import numpy as np
import pytest
import trimesh
from browser import in_browser

from fusion.estimation.answer import ContactResidual, Estimate, Mode, Stage
from fusion.results.report import pictures, stills, words
from fusion.results.report.data import MODEL_FACES, report_data
from fusion.results.report.outline import silhouette
from fusion.results.report.page import render, write_report
from fusion.results.report.rows import comparison_rows, summary_rows
from fusion.truth.errors import Judge
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame

CAMERA = Camera(300.0, 300.0, 159.5, 119.5, 320, 240)


@pytest.fixture(scope="module")
def ring():
    """A torus: its silhouette has a hole."""
    mesh = trimesh.creation.torus(0.04, 0.012, major_sections=48, minor_sections=24)
    return ObjectModel("ring", mesh.vertices, mesh.faces)


@pytest.fixture(scope="module")
def renderer(ring):
    return Renderer({"object": (ring.vertices, ring.faces)})


def make_frame(ring, renderer, index=0, **changes):
    truth = poses.make_pose(poses.exp_rotation([0.3, 0.2, 0.1 * index]), [0.01, 0.0, 0.5])
    depth = renderer.render(CAMERA, {"object": truth}).depth
    depth[depth == 0] = 0.9
    points, normals = ring.sample_surface(3, seed=index)
    given = {
        "index": index,
        "where": f"frame {index}",
        "camera": CAMERA,
        "depth": depth,
        "contacts": Contacts(points, normals, sensors=["thumb", "index", "middle"]).moved(truth),
        "prior": poses.perturb(truth, [0.1, 0.1, 0, 0.01, 0, 0.01], ring.centroid),
        "camera_from_object_truth": truth,
    }
    return Frame(**{**given, **changes})


def make_estimate(frame, verdict="ok", **changes):
    pose = frame.camera_from_object_truth
    pose = poses.perturb(pose, [0.01, 0, 0, 0.001, 0, 0], np.zeros(3))
    covariance = np.diag([0.01**2] * 3 + [0.0005**2] * 3)
    given = {
        "frame": frame.index,
        "pose": pose,
        "covariance": covariance,
        "modes": (Mode(pose, 1.0, 0.0, covariance),),
        "verdict": verdict,
        "trace": (Stage("vision", True, "the camera sees it", 12.5, 900), Stage("touch", False, "not needed")),
        "contacts": tuple(ContactResidual(name, 0.4, 3.0, name == "index") for name in frame.contacts.sensors),
        "visible_fraction": 0.5,
    }
    return Estimate(**{**given, **changes})


def rows_for(frames):
    return [
        {"frame": f.index, "method": m, "add_s_mm": 1.5 * k + 0.5, "rotation_deg": 1.0, "time_ms": 9.0, "verdict": "ok"}
        for f in frames
        for k, m in enumerate(("fused", "icp"))
    ]


class TestOutline:
    def test_follows_the_mask_hole_included(self, ring, renderer):
        pose = poses.make_pose(translation=[0.0, 0.0, 0.4])
        polygons = silhouette(renderer, "object", CAMERA, pose)
        assert len(polygons) == 2
        painted = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
        cv2.fillPoly(painted, [np.rint(p * 16).astype(np.int32) for p in polygons], 1, shift=4)
        mask = renderer.render(CAMERA, {"object": pose}).mask("object")
        both, either = (painted.astype(bool) & mask).sum(), (painted.astype(bool) | mask).sum()
        assert both / either > 0.93

    def test_reaches_where_the_rim_projects(self, ring, renderer):
        polygons = silhouette(renderer, "object", CAMERA, poses.make_pose(translation=[0.02, -0.01, 0.4]))
        corners = np.concatenate(polygons)
        expected = CAMERA.project(ring.vertices + np.array([0.02, -0.01, 0.4]))[0]
        assert corners.min(axis=0) == pytest.approx(expected.min(axis=0), abs=1.0)
        assert corners.max(axis=0) == pytest.approx(expected.max(axis=0), abs=1.0)

    @pytest.mark.parametrize(
        "pose",
        [np.full((4, 4), np.nan), poses.make_pose(translation=[0, 0, -1.0]), poses.make_pose(translation=[9, 0, 1])],
    )
    def test_nothing_to_see_has_no_outline(self, renderer, pose):
        assert silhouette(renderer, "object", CAMERA, pose) == []


class TestPictures:
    @pytest.mark.parametrize("corner", [(0, 0), (319, 239), (160, 120)])
    def test_a_crop_stays_inside_the_image(self, corner):
        crop = pictures.choose_crop(np.array([corner, corner], float) + np.array([[-20.0], [20.0]]), (320, 240))
        assert crop.left >= 0
        assert crop.top >= 0
        assert crop.left + crop.width <= 320
        assert crop.top + crop.height <= 240
        assert crop.width / crop.height == pytest.approx(4 / 3, abs=0.02)

    def test_without_points_it_is_the_image(self):
        crop = pictures.choose_crop(np.zeros((0, 2)), (320, 240))
        assert (crop.left, crop.top, crop.width, crop.height) == (0, 0, 320, 240)

    def test_near_is_light_and_no_reading_dark(self):
        depth = np.full((240, 320), 0.5, np.float32)
        depth[:, 160:] = 0.9
        depth[120:, :] = np.nan
        picture = pictures.data_uri(pictures.depth_image(depth, pictures.Crop(0, 0, 320, 240, 1.0), 0.5, 0.9))
        image = cv2.imdecode(np.frombuffer(base64.b64decode(picture.split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
        near, far, none = image[60, 60].mean(), image[60, 260].mean(), image[200, 60].mean()
        assert near > 200
        assert none < far < 60


class TestStills:
    def test_the_outline_is_around_the_object(self, ring, renderer):
        frame = make_frame(ring, renderer)
        image = stills.still(frame, ring, make_estimate(frame), 320)
        assert image.shape == (240, 320, 3)
        rows, columns = np.nonzero((np.abs(image.astype(int) - stills.AFTER).max(axis=2)) < 40)
        assert len(rows) > 100
        assert abs(np.mean([rows.min(), rows.max()]) - 120) < 40
        assert abs(np.mean([columns.min(), columns.max()]) - 160) < 40

    def test_the_thumbnail_is_of_the_worst_answer_and_needs_an_image(self, ring, renderer, tmp_path):
        frames = [make_frame(ring, renderer, i) for i in range(2)]
        answers = [make_estimate(frames[0]), make_estimate(frames[1], "lost", pose=np.full((4, 4), np.nan))]
        stills.write_thumbnail(tmp_path / "both.jpg", frames, ring, answers)
        stills.write_thumbnail(tmp_path / "lost.jpg", frames[1:], ring, answers[1:])
        assert (tmp_path / "both.jpg").read_bytes() == (tmp_path / "lost.jpg").read_bytes()
        blind = Frame(index=0, contacts=frames[0].contacts)
        stills.write_thumbnail(tmp_path / "none.jpg", [blind], ring, answers[:1])
        stills.write_thumbnail(tmp_path / "none.jpg", [], ring, [])
        assert not (tmp_path / "none.jpg").exists()


class TestWords:
    def test_each_verdict_has_its_words(self, ring, renderer):
        frame = make_frame(ring, renderer)
        assert words.headline(make_estimate(frame)) == "Found"
        assert "0.5 mm" in words.sentence(make_estimate(frame))
        assert "must not be used" in words.sentence(make_estimate(frame, "lost"))
        nothing = "no evidence: no pixel of the object and no contact"
        assert words.sentence(make_estimate(frame, "lost", notes=(nothing,))).endswith(f"{nothing}.")
        unsure = make_estimate(frame, "ambiguous", notes=("only 93% sure to be within 5 mm",))
        assert words.sentence(unsure).startswith("It is not to be relied on: only 93% sure")
        turns = ("rotation about z",)
        free = make_estimate(frame, "ambiguous", notes=("rotation about z unknown",), unobservable=turns)
        assert words.sentence(free).startswith("The data leave some motion free.")
        two = (Mode(np.eye(4), 0.7, 0.0, np.eye(6)), Mode(np.eye(4), 0.3, 0.0, np.eye(6)))
        assert "2 poses" in words.sentence(make_estimate(frame, "ambiguous", modes=two))
        assert "cannot be told" in words.sentence(make_estimate(frame, covariance=np.full((6, 6), np.nan)))

    def test_worst_direction_is_not_the_diagonal(self):
        covariance = np.zeros((6, 6))
        covariance[3:, 3:] = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0]]) * 1e-6
        assert words.worst_sigmas(covariance) == pytest.approx((0.0, np.sqrt(2) * 1e-3))


class TestData:
    def test_numbers_agree_with_the_metrics(self, ring, renderer):
        frame = make_frame(ring, renderer)
        estimate = make_estimate(frame)
        pose, truth = estimate.pose, frame.camera_from_object_truth
        data = report_data("capture", [frame], ring, [estimate])
        figures = {n["label"]: float(n["value"]) for n in data["frames"][0]["numbers"]}
        assert figures["Surface error"] == pytest.approx(1e3 * Judge(ring).errors(pose, truth).add_s, abs=0.01)
        assert figures["Position error"] == pytest.approx(1.0, abs=0.01)
        assert figures["Rotation error"] == pytest.approx(np.rad2deg(0.01), abs=0.01)
        assert figures["σ position"] == pytest.approx(0.5, abs=0.01)
        assert figures["Visible"] == 50

    def test_the_geometry_decodes_to_the_model_at_the_pose(self, ring, renderer):
        frame = make_frame(ring, renderer)
        estimate = make_estimate(frame)
        data = report_data("capture", [frame], ring, [estimate])
        shorts = np.frombuffer(base64.b64decode(data["mesh"]["v"]), "<i2").reshape(-1, 3)
        faces = np.frombuffer(base64.b64decode(data["mesh"]["f"]), "<u2").reshape(-1, 3)
        assert len(faces) <= MODEL_FACES
        assert faces.max() < len(shorts)
        entry = data["frames"][0]
        pose = np.array(entry["poses"]["after"]).reshape(3, 4)
        placed = (shorts / 1e4) @ pose[:, :3].T + 1e-3 * pose[:, 3] - 1e-3 * np.array(entry["camera"])
        inside = poses.apply(poses.inverse(estimate.pose), placed)
        assert np.abs(ring.field.distance(inside)).max() < 1.5e-3
        away = np.frombuffer(base64.b64decode(entry["cloud"]["d"]), np.uint8)
        assert np.median(away[away < 60]) < 20

    def test_an_estimate_without_its_frame_is_refused(self, ring, renderer):
        frame = make_frame(ring, renderer)
        with pytest.raises(InputError, match="frame 7"):
            report_data("capture", [frame], ring, [dataclasses.replace(make_estimate(frame), frame=7)])

    def test_what_is_missing_is_left_out(self, ring, renderer):
        full = make_frame(ring, renderer)
        cloud = CAMERA.back_project(full.depth)[::50]
        bare = Frame(index=0, cloud=cloud, contacts=full.contacts)
        entry = report_data("c", [bare], ring, [make_estimate(full, contacts=())])["frames"][0]
        assert entry["image"] is None
        assert set(entry["poses"]) == {"after"}
        assert entry["contacts"][0]["mm"] is None
        assert "Position error" not in {n["label"] for n in entry["numbers"]}

    def test_contacts_of_other_sensors_stand_beside_the_recorded_ones(self, ring, renderer):
        frame = make_frame(ring, renderer)
        recorded = make_estimate(frame).contacts
        pushed = ContactResidual("ring_finger", 1.5, 2.0, True)
        entry = report_data("c", [frame], ring, [make_estimate(frame, contacts=(*recorded, pushed))])["frames"][0]
        assert [one["sensor"] for one in entry["contacts"]] == ["thumb", "index", "middle", "ring_finger"]
        assert [one["mm"] for one in entry["contacts"]] == [0.4, 0.4, 0.4, 1.5]
        assert [one["outlier"] for one in entry["contacts"]] == [False, True, False, True]
        assert entry["contacts"][3]["p"] is None

    def test_a_lost_pose_of_nan_makes_a_page(self, ring, renderer):
        frame = make_frame(ring, renderer)
        lost = make_estimate(frame, "lost", pose=np.full((4, 4), np.nan), covariance=np.full((6, 6), np.nan))
        entry = report_data("c", [frame], ring, [lost])["frames"][0]
        assert "after" not in entry["poses"]
        json.dumps(entry, allow_nan=False)

    def test_comparison_rows_read_their_usual_shapes(self):
        row = {"method": "icp", "add_s_mm": 2.0, "time_ms": float("nan")}
        expected = {"frame": None, "method": "icp", "name": "ICP, usual crop", "adds_mm": 2.0, "ms": None}
        for shape in ([row], {"rows": [row]}, {"methods": {"icp": row}}):
            assert comparison_rows(shape)[0].items() >= expected.items()
        assert comparison_rows(None) == []
        assert summary_rows({"add_s_mm": 1.23456, "flag": True, "inner": {}}) == [["add s", "1.235 mm"]]


def test_the_page_holds_everything_and_no_markup_of_a_capture(ring, renderer, tmp_path):
    evil = "</script><script>alert(1)</script>{{DATA}}<img src=x onerror=alert(2)>"
    frame = make_frame(ring, renderer)
    frame = dataclasses.replace(frame, contacts=Contacts(frame.contacts.points[:1], sensors=[evil]))
    estimate = make_estimate(frame, notes=(evil,), unobservable=(evil,), trace=(Stage(evil, True, evil),))
    path = tmp_path / "deep" / "report.html"
    write_report(path, evil, [frame], ring, [estimate], rows_for([frame]))
    page = path.read_text()
    assert len(re.findall(r"<script", page)) == 3
    assert "<img src=x" not in page
    assert not re.search(r"(src|href)\s*=\s*[\"']?(https?:)?//", page)
    assert "{{STYLE}}" not in page
    packed = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert json.loads(packed[1])["capture"] == evil
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


def test_thirty_frames_stay_small(ring, renderer, hand):
    coarse = np.random.default_rng(0).integers(0, 255, (24, 32, 3)).astype(np.uint8)
    frame = make_frame(ring, renderer, rgb=cv2.resize(coarse, (320, 240)))
    frame = dataclasses.replace(
        frame, hand=hand, joints=dict.fromkeys(hand.joint_names, 0.0), world_from_hand=frame.camera_from_object_truth
    )
    page = render(report_data("c", [frame] * 30, ring, [make_estimate(frame)] * 30))
    assert len(page) < 2e6


PROBE = """
<script>
window.failures = [];
addEventListener("error", (e) => failures.push(e.message));
addEventListener("load", () => {
  const position = () => document.getElementById("position").textContent, seen = [position()];
  const slider = document.getElementById("slider");
  slider.value = "2"; slider.dispatchEvent(new Event("input")); seen.push(position());
  const press = (key) => dispatchEvent(new KeyboardEvent("keydown", { key }));
  press("ArrowLeft"); seen.push(position());
  press("ArrowRight"); press("ArrowRight"); seen.push(position());
  for (const button of document.querySelectorAll("#controls button, .swap button")) button.click();
  const canvas = document.getElementById("scene"), gl = canvas.getContext("webgl2");
  scene.paint();
  const drawn = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, drawn);
  const ink = drawn.some((v) => v > 0) && gl.getError() === 0;
  const overflow = document.documentElement.scrollWidth - innerWidth;
  const outlines = document.querySelectorAll("#overlay path").length;
  const answer = JSON.stringify({ seen, failures, outlines, ink, overflow });
  document.body.replaceChildren(document.createTextNode(`PROBE${answer}PROBE`));
});
</script>
"""


# Two sheets that cross: left the first is nearer, right the second, whichever is drawn last.
DEPTH_PROBE = """
<script>
window.failures = [];
addEventListener("error", (e) => failures.push(e.message));
addEventListener("load", () => {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const brush = new Painter(canvas), gl = brush.gl;
  const sheet = (left, right, colour) => {
    const at = [-9, -9, left, 9, -9, right, 9, 9, right, -9, -9, left, 9, 9, right, -9, 9, left];
    const repeated = (three) => Array.from({ length: 18 }, (_, i) => three[i % 3]);
    return brush.load({ at: [at, 3], normal: [repeated([0, 0, -1]), 3], tint: [repeated(colour), 3] });
  };
  const red = sheet(-5, 5, [1, 0, 0]), green = sheet(5, -5, [0, 1, 0]), seen = [];
  for (const order of [[red, green], [green, red]]) {
    brush.begin([1, 0, 0, 0, 1, 0, 0, 0, 1], 2, 100);
    order.forEach((one) => brush.solid(one));
    for (const x of [24, 40]) {
      const pixel = new Uint8Array(4);
      gl.readPixels(x, 32, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      seen.push(pixel[0] > pixel[1] ? "red" : "green");
    }
  }
  document.body.replaceChildren(document.createTextNode(`PROBE${JSON.stringify({ failures, seen })}PROBE`));
});
</script>
"""


ABSENT_PROBE = """
<script>
window.failures = [];
addEventListener("error", (e) => failures.push(e.message));
const whole = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : whole.call(this, kind, ...rest);
};
addEventListener("load", () => {
  document.getElementById("next").click();
  for (const button of document.querySelectorAll("#controls button")) button.click();
  document.querySelector("[data-contact]").dispatchEvent(new Event("mouseenter"));
  const said = document.querySelector(".absent").textContent, cards = document.querySelectorAll(".card").length;
  const answer = JSON.stringify({ failures, said, cards, position: document.getElementById("position").textContent });
  document.body.replaceChildren(document.createTextNode(`PROBE${answer}PROBE`));
});
</script>
"""


BARE_PROBE = """
<script>
window.failures = [];
addEventListener("error", (e) => failures.push(e.message));
addEventListener("load", () => {
  const hidden = document.getElementById("photo")?.hidden, cards = document.querySelectorAll(".card").length;
  document.body.replaceChildren(document.createTextNode(`PROBE${JSON.stringify({ failures, hidden, cards })}PROBE`));
});
</script>
"""


@pytest.mark.parametrize("width", [1400, 500])
def test_it_works_in_a_browser(ring, renderer, tmp_path, width):
    frames = [make_frame(ring, renderer, i) for i in range(3)]
    estimates = [make_estimate(f, v) for f, v in zip(frames, ("ok", "ambiguous", "lost"))]
    page = render(report_data("capture", frames, ring, estimates, rows_for(frames), {"auc": 0.9}))
    result = in_browser(page, PROBE, tmp_path, width)
    assert result["failures"] == []
    assert result["seen"] == [f"frame {i} · {i + 1}/3" for i in (0, 2, 1, 2)]
    assert result["ink"]
    assert result["outlines"] > 0
    assert result["overflow"] <= 0


def test_what_is_nearer_hides_what_is_farther_at_every_pixel(ring, renderer, tmp_path):
    frame = make_frame(ring, renderer)
    page = render(report_data("c", [frame], ring, [make_estimate(frame)]))
    result = in_browser(page, DEPTH_PROBE, tmp_path)
    assert result == {"failures": [], "seen": ["red", "green"] * 2}


def test_without_webgl_the_rest_is_whole_and_the_page_says_so(ring, renderer, tmp_path):
    frames = [make_frame(ring, renderer, i) for i in range(2)]
    page = render(report_data("c", frames, ring, [make_estimate(f) for f in frames], rows_for(frames)))
    result = in_browser(page, ABSENT_PROBE, tmp_path)
    assert result["failures"] == []
    assert "no WebGL" in result["said"]
    assert result["cards"] >= 5
    assert result["position"] == "frame 1 · 2/2"


def test_a_lone_cloud_without_truth_works_in_a_browser(ring, renderer, tmp_path):
    full = make_frame(ring, renderer)
    bare = Frame(index=0, cloud=CAMERA.back_project(full.depth)[::50], contacts=full.contacts)
    rows = [{"method": "fused", "frame": 0, "cloud_mm": 1.2, "contacts_mm": 0.7, "time_ms": 3.0, "verdict": "ok"}]
    page = render(report_data("c", [bare], ring, [make_estimate(full)], rows))
    result = in_browser(page, BARE_PROBE, tmp_path)
    assert result["failures"] == []
    assert result["hidden"]
    assert result["cards"] >= 5


def test_a_capture_of_nothing_works_in_a_browser(ring, tmp_path):
    assert in_browser(render(report_data("c", [], ring, [])), BARE_PROBE, tmp_path)["failures"] == []


def test_a_number_is_the_same_wherever_it_is_told(lab_frame, drill):
    """Headline, what each source added and the next touch start from the one covariance of the answer; the terminal's
    contacts are those of result.json.
    """
    from fusion.cli.commands.answers.estimate import _contacts_mm
    from fusion.estimation.estimate import estimate

    answer = estimate(lab_frame, drill, lab_frame.camera_from_object_truth)
    (made,) = report_data("lab", [lab_frame], drill, [answer])["frames"]
    rotation, position = words.worst_sigmas(answer.covariance)
    told = {one["label"]: one["value"] for one in made["numbers"]}
    assert float(told["σ position"]) == pytest.approx(1e3 * position, rel=0.01)
    assert f"{1e3 * position:.2g} mm" in made["sentence"]
    assert len(made["contributions"]) == 3
    for _, _, moved, turned in made["contributions"]:
        assert moved.endswith(f"→ {1e3 * position:.2g} mm")
        assert turned.endswith(f"→ {np.rad2deg(rotation):.2g} °")
    for touch in made["next"]:
        assert f"{1e3 * position:.2g} →" in touch["text"]
    listed = [abs(one["residual_mm"]) for one in answer.to_json()["contacts"]]
    reported = Judge(drill).agreement(lab_frame, answer.pose)
    assert _contacts_mm(answer, reported) == pytest.approx(np.mean(listed))
    untouched = dataclasses.replace(answer, contacts=())
    assert _contacts_mm(untouched, reported) == pytest.approx(1e3 * reported.contacts)
