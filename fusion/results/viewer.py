"""A live 3-D view of a capture in the browser, with the answers of a result when there is one. Camera frame, metres."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.results.runs import reporting
from scenes.errors import InputError, PalpateError
from scenes.files.problems import Problem
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.captures import Capture
from scenes.recordings.frames import Frame
from vision.look.points import all_points

Array = NDArray[np.float64]

LAYERS = ("cloud", "object", "truth", "hand", "contacts", "modes", "ellipsoid")
COLOURS = {
    "cloud": (150, 152, 160),
    "object": (60, 168, 158),
    "truth": (110, 140, 230),
    "hand": (206, 184, 168),
    "contacts": (200, 40, 140),
    "modes": (230, 150, 60),
    "ellipsoid": (230, 200, 70),
}
# Points of a frame that a browser draws without delay, and what is near enough to the object to matter (radii).
MOST_POINTS = 60_000
REACH = 6.0
# Length (m) of a contact's normal, and frames a second of playing.
NORMAL = 0.02
RATE = 10.0
# The first view: the hand counts up to so many of the object's radii from its middle; the camera looks from so far
# (rad) beside and above the real one's direction, as in the report's tilted view, and leaves this share as a margin.
HELD = 2.0
ASIDE, ABOVE = 0.5, 0.42
MARGIN = 1.15
# The browser's camera's vertical angle (rad): little distortion at a hand's distance.
FIELD = 0.8
# The ellipsoid holds 99 % of a Gaussian in three dimensions.
SIGMAS = 3.37


class Viewer:
    """Serves one capture until it is stopped. shown: the names of the nodes of the frame that is on view."""

    def __init__(
        self,
        capture: Capture,
        model: ObjectModel,
        answers: Sequence[Estimate] = (),
        port: int = 8080,
        tell: Callable[[str], None] = lambda problem: None,
    ) -> None:
        """Start the server on this machine alone. tell: hears once of each problem of a frame's files, which is shown
        without what is broken. Raises InputError without viser or for a port that is taken.
        """
        try:
            import viser
        except ImportError as error:
            raise InputError("view needs viser, which is not installed: pip install 'palpate[viewer]'") from error
        self.capture, self.model = capture, model
        self.answers = {answer.frame: answer for answer in answers}
        self.shown: dict[str, Any] = {}
        self._tell, self._told = tell, set[str]()
        self._lock = threading.Lock()
        try:
            self.server = viser.ViserServer(host="127.0.0.1", port=port, label=capture.name, verbose=False)
        except OSError as error:
            raise InputError(f"port: expected a free one, {port} is not: {error}") from error
        self.server.scene.set_up_direction("-y")
        self._framed = (np.zeros(3), 1.0)
        self._build_gui()
        self.show(0)
        self.server.initial_camera.fov = FIELD
        self.server.initial_camera.look_at = self._framed[0]
        self.server.initial_camera.position = self._eye(FIELD, 1.0)
        self.server.on_client_connect(self._frame)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://127.0.0.1:{self.server.get_port()}"

    def _build_gui(self) -> None:
        gui, last = self.server.gui, len(self.capture) - 1
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="small")
        gui.set_panel_label(self.capture.name)
        self.words = gui.add_markdown("")
        self.slider: Any = gui.add_slider("Frame", 0, max(1, last), 1, 0, visible=last > 0)
        self.playing = gui.add_checkbox("Play", False, visible=last > 0)
        # folded, for on a phone the panel lies over the picture
        with gui.add_folder("Layers", expand_by_default=False):
            self.toggles = {layer: gui.add_checkbox(layer.capitalize(), layer != "truth") for layer in LAYERS}
            again: Any = gui.add_button("Frame the object")
        self.slider.on_update(lambda _: self.show(int(self.slider.value)))
        for toggle in self.toggles.values():
            toggle.on_update(lambda _: self._apply_toggles())
        again.on_click(lambda _: self._frame_all())

    def _frame_all(self) -> None:
        for client in self.server.get_clients().values():
            self._frame(client)

    def _frame(self, client: Any) -> None:
        """Turn a browser's camera to the object and what holds it, whatever its window's shape."""
        camera = client.camera
        with client.atomic():
            camera.position = self._eye(camera.fov, camera.aspect)
            camera.look_at = self._framed[0]
            camera.up_direction = (0.0, -1.0, 0.0)

    def _eye(self, fov: float, aspect: float) -> Array:
        """Where a camera of that vertical angle (rad) and width over height sees the ball that is framed."""
        middle, radius = self._framed
        narrow = min(fov, 2.0 * np.arctan(np.tan(0.5 * fov) * aspect))
        away = MARGIN * radius / max(np.sin(0.5 * narrow), 1e-3)
        # y is down: the camera goes up and aside
        way = np.array([-np.sin(ASIDE) * np.cos(ABOVE), -np.sin(ABOVE), -np.cos(ASIDE) * np.cos(ABOVE)])
        return middle + away * way

    def show(self, position: int) -> None:
        """Draw the frame at that position of the capture, without what is broken of it."""
        with self._lock:
            number = self.capture.frame_ids[min(position, len(self.capture) - 1)]
            frame, problems = self._read(number)
            answer = self.answers.get(number)
            for handle in self.shown.values():
                handle.remove()
            self.shown = {}
            self._framed = self._ball(frame, answer)
            self._draw_seen(frame, answer)
            self._draw_answer(answer)
            self.words.content = "\n\n".join([_words(frame, answer), *problems])
        self._apply_toggles()
        for problem in problems:
            if problem not in self._told:
                self._told.add(problem)
                self._tell(problem)

    def _read(self, number: int) -> tuple[Frame, tuple[str, ...]]:
        """The frame of that number and what is wrong with its files; one of nothing where nothing can be read."""
        found: list[Problem] = []
        try:
            with reporting(self.capture, found.append):
                frame = self.capture.frame(number)
        except PalpateError as error:
            return Frame(number), (str(error),)
        return frame, tuple(dict.fromkeys(map(str, found)))

    def _ball(self, frame: Frame, answer: Estimate | None) -> tuple[Array, float]:
        """Centre and radius of a ball around the object, where it is thought to be, and the hand near it; around all
        points where nothing is known of it.
        """
        pose = _where(frame, answer)
        if pose is None:
            parts = all_points(frame)
        else:
            parts = se3.apply(pose, self.model.vertices)
            held = self._hand(frame)
            if held is not None:
                middle = se3.apply(pose, self.model.centroid[None])[0]
                near = np.linalg.norm(held[0] - middle, axis=1) < HELD * self.model.radius
                parts = np.concatenate([parts, held[0][near]])
        parts = parts[np.isfinite(parts).all(axis=1)]
        if not len(parts):
            return np.array([0.0, 0.0, 1.0]), 0.5
        middle = 0.5 * (parts.min(axis=0) + parts.max(axis=0))
        return middle, float(max(np.linalg.norm(parts - middle, axis=1).max(), 1e-3))

    def _hand(self, frame: Frame) -> tuple[Array, NDArray[np.int64]] | None:
        """The hand's vertices in the camera's frame, and its faces."""
        if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
            return None
        vertices, faces, _ = frame.hand.mesh(frame.joints)
        return se3.apply(frame.camera_from_world @ frame.world_from_hand, vertices), faces

    def _draw_seen(self, frame: Frame, answer: Estimate | None) -> None:
        """Cloud, true pose, hand and contacts."""
        scene = self.server.scene
        points = all_points(frame)
        where = _where(frame, answer)
        if where is not None:
            middle = se3.apply(where, self.model.centroid[None])[0]
            points = points[np.linalg.norm(points - middle, axis=1) < REACH * self.model.radius]
        points = points[:: max(1, len(points) // MOST_POINTS)]
        if len(points):
            self.shown["cloud"] = scene.add_point_cloud(
                "/cloud", points.astype(np.float32), COLOURS["cloud"], point_size=0.0006
            )
        if frame.camera_from_object_truth is not None:
            self.shown["truth"] = self._placed("/truth", frame.camera_from_object_truth, "truth", wireframe=True)
        held = self._hand(frame)
        if held is not None:
            self.shown["hand"] = scene.add_mesh_simple("/hand", *held, color=COLOURS["hand"], opacity=0.5)
        contacts = frame.contacts.moved(frame.camera_from_world)
        if len(contacts):
            normals = np.nan_to_num(contacts.normals)
            segments = np.stack([contacts.points, contacts.points + NORMAL * normals], axis=1)
            self.shown["contacts"] = scene.add_point_cloud(
                "/contacts", contacts.points, COLOURS["contacts"], point_size=0.004, point_shape="circle"
            )
            self.shown["contacts/normals"] = scene.add_line_segments(
                "/normals", segments, COLOURS["contacts"], thickness=0.001
            )

    def _draw_answer(self, answer: Estimate | None) -> None:
        """The estimate, its other modes, and how sure its place is."""
        if answer is None or not np.isfinite(answer.pose).all():
            return
        self.shown["object"] = self._placed("/object", answer.pose, "object", opacity=0.9)
        for k, mode in enumerate(answer.modes[1:], start=1):
            self.shown[f"modes/{k}"] = self._placed(
                f"/modes/{k}", mode.pose, "modes", opacity=0.15 + 0.5 * float(np.clip(mode.weight, 0, 1))
            )
        spread = np.asarray(answer.covariance)[3:, 3:]
        if np.isfinite(spread).all():
            vertices, faces = ellipsoid(spread)
            middle = se3.apply(answer.pose, self.model.centroid[None])[0]
            self.shown["ellipsoid"] = self.server.scene.add_mesh_simple(
                "/ellipsoid", vertices + middle, faces, color=COLOURS["ellipsoid"], opacity=0.6
            )

    def _placed(self, name: str, pose: Array, layer: str, **options: Any) -> Any:
        return self.server.scene.add_mesh_simple(
            name,
            self.model.vertices,
            self.model.faces,
            color=COLOURS[layer],
            wxyz=se3.to_quaternion(pose[:3, :3]),
            position=pose[:3, 3],
            **options,
        )

    def _apply_toggles(self) -> None:
        with self._lock:
            for name, handle in self.shown.items():
                handle.visible = bool(self.toggles[name.partition("/")[0]].value)

    def run(self) -> None:
        """Serve, and play when asked, until interrupted."""
        while True:
            time.sleep(1.0 / RATE)
            if self.playing.value:
                self.slider.value = (int(self.slider.value) + 1) % len(self.capture)

    def stop(self) -> None:
        """End the server."""
        self.server.stop()


def ellipsoid(covariance: Array) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (n, 3) and faces (m, 3) of the ellipsoid about the origin that holds 99 % of a Gaussian."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3)
    values, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = axes * (SIGMAS * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(ball.vertices) @ root.T, np.asarray(ball.faces, dtype=np.int64)


def _where(frame: Frame, answer: Estimate | None) -> Array | None:
    """Where the object is thought to be: the answer's pose, else the truth's, else the prior's."""
    told = (None if answer is None else answer.pose, frame.camera_from_object_truth, frame.prior)
    return next((pose for pose in told if pose is not None and np.isfinite(pose).all()), None)


def _words(frame: Frame, answer: Estimate | None) -> str:
    if answer is None:
        return f"frame {frame.index}: no answer"
    modes = f", {len(answer.modes)} poses fit" if len(answer.modes) > 1 else ""
    return f"frame {frame.index}: **{answer.verdict}**{modes}"
