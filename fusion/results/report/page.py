"""One self-contained HTML file that shows what the estimator saw, thought and answered.

No network, no library: styles, script, pictures and geometry are inside, and a content security policy keeps it so.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fusion.advice.grasp import GraspAnswer
from fusion.advice.next_touch import NextTouch
from fusion.estimation.answer import Estimate
from fusion.results.report.data import report_data
from fusion.results.report.files import asset, page
from scenes.files.whole import replace_file
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame


def write_report(
    path: str | Path,
    capture_name: str,
    frames: Sequence[Frame],
    model: ObjectModel,
    estimates: Sequence[Estimate],
    comparison: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None = None,
    errors: Mapping[str, Any] | None = None,
    grasps: Sequence[GraspAnswer] | None = None,
    touches: Sequence[Sequence[NextTouch]] | None = None,
) -> None:
    """Write the report of a capture's estimates.

    path: the HTML file; folders are made. frames: those estimated, in the capture's order. estimates: each with the
    index of its frame. comparison: {"rows": [{"method", "frame", "add_s_mm", "rotation_deg", "translation_mm",
    "time_ms", "verdict"}, ...]} or the list of rows. errors: named numbers over all frames, units as name endings
    (_mm, _deg). grasps: how well each frame's object is held. touches: where one more contact
    would tell most, of each estimate; found when not given. Raises InputError for an estimate whose frame is not
    given.
    """
    text = render(report_data(capture_name, frames, model, estimates, comparison, errors, grasps, touches))
    replace_file(Path(path), text.encode())


def render(data: Mapping[str, Any]) -> str:
    """The page's text for the dictionary of `report_data`."""
    # inside <script> only "</" and "<!--" could end the block; the rest of the text reaches the page as text nodes
    packed = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    title = f"{data['object']['name']} · {data['capture']}"
    view = "\n".join(asset(name) for name in ("geometry.js", "webgl.js", "scene.js"))
    scripts = {"SCENE": view, "SCRIPT": asset("report.js")}
    return page("report.html", title, asset("report.css"), {"DATA": packed, **scripts})
