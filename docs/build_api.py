"""Write docs/api.md from the docstrings: `python docs/build_api.py`. Reads the sources, imports nothing of palpate."""

from __future__ import annotations

import ast
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "api.md"
Definition = ast.FunctionDef | ast.ClassDef

HEAD = """# Python API

Made from the docstrings by `python docs/build_api.py`; a test holds it to them. Metres, radians, newtons, seconds;
transforms are 4x4 arrays named `target_from_source`; covariances are 6x6, rotation before translation, about the
object's centroid in camera axes; the camera's axes are OpenCV's. Everything that a user can do wrong raises a
`PalpateError`.

`scenes` is the world and its recordings, `vision` the camera, `touch` the fingers, `fusion` both and the answer. What
is listed first in each section is what its package exports by itself.
"""

# Rooms in the order of reading: a word on each, and what is public beyond `__all__` of the package, by module.
ROOMS: dict[str, tuple[str, dict[str, tuple[str, ...]]]] = {
    "fusion": (
        "One answer from both senses, frame by frame or tracked; how good it is; what to touch next.",
        {
            "fusion.estimation.answer": ("Stage", "ContactResidual", "Contribution"),
            "fusion.results.files": ("read_result", "answer_of", "write_results", "result_json"),
            "fusion.results.report.page": ("write_report",),
            "fusion.results.report.stills": ("still",),
            "fusion.truth.errors": ("Judge", "Errors"),
            "fusion.truth.metrics": (
                *("model_points", "add", "add_s", "mssd", "mspd", "vsd", "rotation_error", "translation_error"),
                *("pose_error", "nees", "auc", "recall"),
            ),
            "fusion.advice.next_touch": ("next_touches", "NextTouch"),
            "fusion.advice.grasp": ("assess", "GraspAnswer", "GraspAdviceSettings"),
        },
    ),
    "touch": (
        "Where an object is, and which, from contacts alone; contacts from wrenches.",
        {
            "touch.wrenches.intrinsic": ("wrench_contacts",),
            "touch.wrenches.sphere": ("sphere_contact",),
            "touch.wrenches.fingertips": ("tip_contacts", "SoftSkin"),
            "touch.grasp_quality": ("grasp_quality", "Quality", "WrenchSettings"),
        },
    ),
    "vision": (
        "The camera's part by itself: what is the object's in an image, registration, tracking without touch.",
        {
            "vision.look.look": ("look",),
            "vision.look.looked": ("Looked",),
            "vision.look.mask.mask": ("object_mask",),
            "vision.look.hand.hand": ("view_hand", "HandView"),
            "vision.published.icp": ("icp", "IcpResult"),
            "vision.published.registration": ("register",),
            "vision.tracking.by_vision": ("track_by_vision",),
            "vision.visibility": ("visibility", "Visibility"),
        },
    ),
    "scenes": (
        "Objects, hands, cameras and recordings; poses; simulated captures.",
        {
            "scenes.errors": ("MeshError", "CaptureError", "InputError", "SystemLibraryError"),
            "scenes.recordings.captures": ("Capture",),
            "scenes.recordings.frames": ("EmptyRegions", "Wrench"),
            "scenes.recordings.beliefs": ("Beliefs", "DepthModel", "CalibrationModel", "TouchModel", "ImageModel"),
            "scenes.recordings.telling": ("believed", "depth_camera"),
            "scenes.recordings.checking.validation": ("validate", "check_usable"),
            "scenes.geometry.cameras": ("Camera",),
            "scenes.robot.hands": ("Hand",),
            "scenes.robot.sensors": ("Sensor",),
            "scenes.geometry.symmetries": ("Symmetries", "Axis"),
            "scenes.evidence.symmetry.symmetry_detection": ("detect_symmetries",),
            "scenes.evidence.align": ("Prior",),
            "scenes.evidence.modes": ("Mode",),
            "scenes.geometry.poses": (
                *("check_pose", "project_to_rotation", "make_pose", "inverse", "apply", "exp_rotation", "log_rotation"),
                *("rotation_angle", "to_quaternion", "from_quaternion", "exp", "log", "perturb", "difference"),
                *("turned_covariance", "shifted_covariance"),
            ),
            "scenes.geometry.appearance.rendering": ("Renderer", "Rendering"),
            "scenes.synthesis.library": ("names", "make"),
            "scenes.synthesis.hands": ("five_finger_hand",),
            "scenes.synthesis.recording": ("synthesize", "synthesize_frames"),
            "scenes.synthesis.settings": ("SynthesisSettings",),
        },
    ),
}


class Module:
    """A source file: its text and its definitions by name."""

    def __init__(self, name: str) -> None:
        """name: dotted."""
        path = ROOT.joinpath(*name.split("."))
        self.path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        self.text = self.path.read_text(encoding="utf-8")
        self.lines = self.text.splitlines()
        self.tree = ast.parse(self.text)
        self.definitions = {n.name: n for n in self.tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef)}

        self.imported = {
            alias.name: node.module or ""
            for node in ast.walk(self.tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }

    def exported(self) -> list[str]:
        """The names of `__all__`; none without one."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                return list(ast.literal_eval(node.value))
        return []

    def source(self, first: int, last: int) -> str:
        """Lines first to last, from 1, both included, without their indentation."""
        return textwrap.dedent("\n".join(self.lines[first - 1 : last]))

    def head(self, node: Definition) -> str:
        """What comes before the docstring: decorators and the signature as it is written."""
        first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
        return self.source(first, node.body[0].lineno - 1).rstrip()

    def fields(self, node: ast.ClassDef) -> str:
        """The fields of a dataclass with the comments above them; empty for other classes."""
        if not any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list):
            return ""
        fields = [n for n in node.body if isinstance(n, ast.AnnAssign)]
        if not fields:
            return ""
        first = fields[0].lineno
        while self.lines[first - 2].lstrip().startswith("#"):
            first -= 1
        return self.source(first, fields[-1].end_lineno or first)


def described(module: Module, name: str, importable_from: str) -> str:
    """The entry of one public name, wherever the module has it from."""
    while name not in module.definitions:
        module = Module(module.imported[name])
    node = module.definitions[name]
    parts = [f"### {name}", f"`from {importable_from} import {name}`"]
    if isinstance(node, ast.FunctionDef):
        return "\n\n".join([*parts, code(module.head(node)), prose(node)]) + "\n"
    methods = [n for n in node.body if isinstance(n, ast.FunctionDef)]
    fields = module.fields(node)
    made = next((m for m in methods if m.name == "__init__"), None)
    if fields:
        parts += [prose(node), code(fields)]
    else:
        parts += [*([code(module.head(made))] if made else []), prose(node)]
    for method in methods:
        if not method.name.startswith("_") and ast.get_docstring(method):
            parts += [f"#### {name}.{method.name}", code(module.head(method)), prose(method)]
    return "\n\n".join(parts) + "\n"


def code(text: str) -> str:
    """A block of Python that is there to be read."""
    return f"```py\n{text}\n```"


def prose(node: Definition) -> str:
    """The docstring as Markdown: angle brackets and stars stand for themselves, indented lines are code already."""
    lines = (ast.get_docstring(node) or "").splitlines()
    escaped = (line.replace("<", "&lt;").replace("*", "\\*") for line in lines)
    return "\n".join(line if line.startswith("    ") else shown for line, shown in zip(lines, escaped, strict=True))


def build() -> str:
    """The whole page."""
    parts = [HEAD]
    for room, (summary, more) in ROOMS.items():
        parts.append(f"## {room}\n\n{summary}\n")
        package = Module(room)
        parts += [described(package, name, room) for name in package.exported()]
        for home, names in more.items():
            module = Module(home)
            parts += [described(module, name, home) for name in names]
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(build(), encoding="utf-8")
