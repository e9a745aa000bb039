"""The report of a track: a page with its time lines and the frames that matter, and files beside it for the rest.

The page holds what is drawn at once; what belongs to one frame (picture, trace, contacts) is in report/ and loaded when
that frame is looked at, as images and scripts, so it works from a folder without any server. It is made from the files
that the track has left, so its cost is theirs and no frame is read again.
"""

from __future__ import annotations

import base64
import html
import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.results.report.files import asset
from fusion.results.track.files import PICTURES, REPORT_FOLDER, lines
from fusion.results.track.moments import moments
from fusion.results.track.pictures import every
from fusion.results.track.summary import Columns, timed_entries
from fusion.truth.errors import json_number
from scenes._open3d import open3d
from scenes.files.whole import replace_file
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]
Json = dict[str, Any]

PAGE = "report.html"
# Frames whose details are in one file: some 100 KB.
PART = 100
# Triangles of the mesh whose outline is drawn over the pictures.
FACES = 1200
# Share of the posterior of another pose that is drawn beside the track's.
SHOWN_WEIGHT = 0.01
# Spans of frames left out that are drawn.
MOST_SPANS = 2000


def write_track_report(
    out: Path, capture_name: str, model: ObjectModel, columns: Columns, last: Json, recorded: tuple[int, ...]
) -> None:
    """Write OUT/report.html and the parts beside it. last: the track's summary; recorded: frames of the recording."""
    rows = _shown(columns)
    pictures = {int(entry["frame"]): entry for entry in lines(out / PICTURES)}
    data = {
        "capture": capture_name,
        "object": {"name": model.name, "diameter_mm": round(1e3 * model.diameter, 1)},
        "mesh": _mesh(model),
        "summary": last,
        "every": every(len(columns)),
        "rows": _rows(columns, rows),
        "moments": [
            {"row": int(np.searchsorted(rows, i)), "why": why} for i, why in moments(columns, rows, pictures.keys())
        ],
        "skipped": _skipped(columns, recorded),
        "range": [recorded[0], recorded[-1]] if recorded else [0, 0],
        "part": PART,
        "folder": REPORT_FOLDER,
    }
    _write_parts(out, set(columns.frame[rows].tolist()), pictures)
    title = f"{model.name} · {capture_name}"
    replace_file(out / PAGE, _page(title, json_number(data)).encode())


def _shown(columns: Columns) -> NDArray[np.int64]:
    """Rows that are drawn: of a long track those evenly spread and those in which something changes."""
    step = every(len(columns))
    verdict, how, slip = columns.verdict, columns.how, columns.slip

    def changes(i: int) -> bool:
        return verdict[i] != verdict[i - 1] or how[i] != how[i - 1] or bool(slip[i] != slip[i - 1])

    return np.array([i for i in range(len(columns)) if i % step == 0 or changes(i)], dtype=np.int64)


def _rows(columns: Columns, rows: NDArray[np.int64]) -> Json:
    """Columns as lists, millimetres and degrees; what is not known is null."""

    def listed(values: Array, digits: int) -> list[float | None]:
        return [round(float(x), digits) if np.isfinite(x) else None for x in values[rows]]

    def three(values: Array, factor: float) -> list[list[float | None]]:
        return [listed(factor * values[:, axis], 2) for axis in range(3)]

    def relative(values: Array) -> Array:
        known = values[np.isfinite(values).all(axis=1)]
        return values - known[0] if len(known) else values

    words = sorted(set(columns.missing))
    degrees = float(np.rad2deg(1.0))
    return {
        "frame": columns.frame[rows].tolist(),
        "verdict": [columns.verdict[i] for i in rows],
        "how": [columns.how[i] for i in rows],
        "slip": [int(columns.slip[i]) for i in rows],
        "moved": [int(columns.moved[i]) for i in rows],
        "position": three(relative(columns.position), 1e3),
        "turn": three(columns.turn, degrees),
        "held_position": three(relative(columns.held[:, 3:]), 1e3),
        "held_turn": three(columns.held[:, :3], degrees),
        "sigma_mm": listed(1e3 * columns.sigma[:, 1], 3),
        "sigma_deg": listed(degrees * columns.sigma[:, 0], 3),
        "confidence": listed(columns.confidence, 3),
        "error_mm": listed(columns.errors["add_s_mm"], 3),
        "step_ms": listed(columns.step, 2),
        "latency_ms": listed(columns.latency, 2),
        "missing": [words.index(columns.missing[i]) for i in rows],
        "missing_words": words,
    }


def _skipped(columns: Columns, recorded: tuple[int, ...]) -> list[Json]:
    """Frames without an answer, those that follow one another for the same cause as one."""
    after = dict(pairwise(recorded))
    out: list[Json] = []
    for frame, cause, why in columns.skipped:
        if out and out[-1]["cause"] == cause and after.get(out[-1]["last"]) == frame:
            out[-1]["last"] = frame
        else:
            out.append({"first": frame, "last": frame, "cause": cause, "why": why})
    return out[:MOST_SPANS]


def _mesh(model: ObjectModel) -> Json:
    """The model with at most FACES triangles: float32 metres and uint16 triangles as base64, object frame, and its
    centroid.
    """
    o3d = open3d()
    vertices, faces = model.vertices, model.faces
    if len(faces) > FACES:
        corners = o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(np.asarray(faces, dtype=np.int32))
        small = o3d.geometry.TriangleMesh(*corners).simplify_quadric_decimation(FACES)
        vertices, faces = np.asarray(small.vertices), np.asarray(small.triangles)
    middle = [round(float(x), 7) for x in model.centroid]
    return {"v": _base64(vertices.astype("<f4")), "f": _base64(faces.astype("<u2")), "c": middle}


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _write_parts(out: Path, shown: set[int], pictures: dict[int, Json]) -> None:
    """Details of the frames shown, PART of them a script."""
    folder = out / REPORT_FOLDER
    folder.mkdir(exist_ok=True)
    part: list[Json] = []
    number = 0
    for entry in timed_entries(out):
        if entry["frame"] not in shown:
            continue
        part.append(_details(entry, pictures.get(entry["frame"])))
        if len(part) == PART:
            number = _write_part(folder, number, part)
    if part:
        _write_part(folder, number, part)


def _write_part(folder: Path, number: int, part: list[Json]) -> int:
    text = json.dumps(part, allow_nan=False, separators=(",", ":"))
    replace_file(folder / f"part_{number:04d}.js", f"palpatePart({number},{text});\n".encode())
    part.clear()
    return number + 1


def _details(entry: Json, picture: Json | None) -> Json:
    """What the page says of one frame beside its row."""
    held = entry["hand_from_object"]
    others = [mode for mode in entry["modes"][1:] if mode["weight"] >= SHOWN_WEIGHT]
    return {
        "frame": entry["frame"],
        "pose": _twelve(entry["camera_from_object"]),
        "held": None if held is None else _twelve(held),
        "others": [[round(mode["weight"], 4), *_twelve(mode["pose"])] for mode in others],
        "picture": None if picture is None else {"window": picture["window"], "camera": picture["camera"]},
        "notes": entry["notes"],
        "unobservable": entry["unobservable"],
        "trace": [[s["stage"], s["ran"], s["why"], round(s["ms"], 2), s["rows"]] for s in entry["trace"]],
        "contacts": [[c["sensor"], c["residual_mm"], c["normal_deg"], c["outlier"]] for c in entry["contacts"]],
        "modes": [round(m["weight"], 4) for m in entry["modes"]],
        "visible": entry["visible_fraction"],
    }


def _twelve(pose: list[list[float]]) -> list[float]:
    """The upper three rows of a pose, one after the other."""
    return [round(x, 7) for row in pose[:3] for x in row]


def _page(title: str, data: Json) -> str:
    # inside <script> only "</" and "<!--" could end the block; the rest of the text reaches the page as text nodes
    packed = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    style = asset("report.css") + asset("track.css")
    view = "\n".join(asset(name) for name in ("geometry.js", "webgl.js", "scene.js", "track_scene.js"))
    parts = {"TITLE": html.escape(title), "STYLE": style, "DATA": packed, "SCENE": view, "SCRIPT": asset("track.js")}
    # one pass, so that a capture named like a placeholder stays a name
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda match: parts[match[1]], asset("track.html"))
