"""Write docs/gallery.md and its pictures: twelve scenes, the commands that make them, and what each sense made of them.

`python docs/build_gallery.py` (or `make gallery`) does all of it in a folder of its own; with names of scenes it draws
these alone and prints their part of the page.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "gallery.md"
PICTURES = DOCS / "images" / "gallery"
# Pixels of one of a scene's two pictures, and of the gap between them; other poses that are drawn.
WIDE, GAP, MODES = 400, 8, 6

HEAD = """# Gallery: twelve grasps, from easy to hopeless

<!-- written by docs/build_gallery.py -->

Each scene is made and answered by the commands under it, which run as they stand. Left the colour image with the
contacts (pink); right the depth image with the outlines of the answer (teal), of the truth (blue) and, where there are
any, of other poses that fit as well (orange). The tables say what each sense makes of the scene alone and what both
make of it together: the mean distance of the two surfaces (ADD-S), and the standard deviations that the answer claims
in its worst direction. `open` means that nothing sensed tells of some direction, or that several poses fit. The scenes
were chosen to show one thing each: how often an answer is right, and how often one is wrong and `ok`, is in
[the benchmarks](benchmarks/index.md).
"""


@dataclass(frozen=True)
class Scene:
    """name: of its folders and picture; title and words for the page; made: options of `synth`; asked: options of
    `estimate`; more: lines of the shell between the two.
    """

    name: str
    title: str
    words: str
    made: str
    asked: str = ""
    more: tuple[str, ...] = ()

    @property
    def lines(self) -> list[str]:
        """What a reader types."""
        estimate = f"palpate estimate captures/{self.name} {self.asked} --out out/{self.name}"
        return [f"palpate synth captures/{self.name} {self.made}", *self.more, " ".join(estimate.split())]

    @property
    def senses(self) -> list[tuple[str, tuple[str, ...]]]:
        """The senses that are compared, by the name that the table gives them."""
        if "--use" in self.asked:
            (sense,) = self.asked.split("--use ")[1].split()[0].split(",")
            return [(f"{sense} alone", (sense,))]
        return [("vision alone", ("vision",)), ("touch alone", ("touch",)), ("both", ("vision", "touch"))]


SCENES = (
    Scene(
        "can",
        "A can in plain view",
        "Little hides it and the camera is a good one. Vision needs no help; that the can may be turned about its "
        "axis is declared, so nobody asks for it.",
        "--object cylinder --occlusion 0.05 --noise clean --seed 1",
    ),
    Scene(
        "ball",
        "A ball",
        "It looks the same from everywhere: its place is all there is to know, and σ of the rotation means nothing.",
        "--object sphere --occlusion 0.4 --seed 4",
    ),
    Scene(
        "table",
        "A mug on a table, no hand",
        "No hand, nothing felt: a table to be taken away first, and a coarse start.",
        "--object mug --scene table --hand none --occluders none --occlusion 0 --seed 3",
        "--use vision",
    ),
    Scene(
        "box",
        "A box, half hidden",
        "A five-finger hand hides half of it. Five fingertips on flat faces leave the box free to slide: touch alone "
        "cannot say where along its faces it is held.",
        "--object box --occlusion 0.5 --seed 2",
    ),
    Scene(
        "gripper",
        "Two flat fingers",
        "A parallel gripper touches at two places. Alone they say little, but they say it where the camera is blind.",
        "--object l_block --hand gripper --occlusion 0.4 --seed 5",
    ),
    Scene(
        "clutter",
        "Other things touch it",
        "A bottle among neighbours on a table; nobody tells which pixels are the bottle's.",
        "--object bottle --scene table --hand none --occluders neighbours+clutter --occlusion 0.4 --seed 7",
        "--use vision",
    ),
    Scene(
        "gel",
        "Gels that see what they touch",
        "Camera-backed gels on the fingertips: each press is a patch of surface, not a point.",
        "--object bottle --occlusion 0.6 --touch gel --seed 3",
    ),
    Scene(
        "drill",
        "A drill, 80 % hidden",
        "What is left of it is its end. The camera holds that end, the fingers hold the other.",
        "--object drill --occlusion 0.8 --seed 0",
    ),
    Scene(
        "pencil",
        "A pencil, 90 % hidden",
        "Thin, and a few dozen pixels are left of it.",
        "--object pencil --occlusion 0.9 --seed 10",
    ),
    Scene(
        "blind",
        "No camera at all",
        "The same hand on a mug, only its contacts, and no coarse start: several poses fit, and each is listed.",
        "--object mug --occlusion 0.6 --seed 11",
        "--use touch --prior none",
    ),
    Scene(
        "one",
        "One contact",
        "One fingertip on a mug, in the dark. There is nearly nothing to know, and palpate says so.",
        "--object mug --occlusion 0.6 --seed 12",
        "--use touch",
        ("sed -i '3,$d' captures/one/contacts.csv   # the head and the first contact stay",),
    ),
    Scene(
        "lost",
        "Another object",
        "Asked for a wine glass, where a kettle is held: no pose explains what is seen and felt.",
        "--object kettle --occlusion 0.3 --seed 14",
        "--object wine_glass --prior none",
    ),
)


def main(names: list[str]) -> int:
    """Make every scene, or those of the names for a look at their pictures; write the page when it is all of them."""
    wanted = [scene for scene in SCENES if scene.name in names] if names else list(SCENES)
    PICTURES.mkdir(parents=True, exist_ok=True)
    parts = [HEAD]
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for scene in wanted:
                parts.append(_made(scene))
                sys.stdout.write(f"{parts[-1]}\n")
                sys.stdout.flush()
        finally:
            os.chdir(here)
    if len(wanted) == len(SCENES):
        PAGE.write_text("\n".join(parts), encoding="utf-8")
    return 0


def _made(scene: Scene) -> str:
    """Type the scene's lines, draw its picture, and say what came of it."""
    from fusion.estimation.estimate import estimate
    from fusion.results.files import read_result
    from fusion.results.runs import load_object, prior_setter
    from fusion.truth.errors import Judge
    from scenes.recordings.captures import read_capture

    code = [_typed(line) for line in scene.lines][-1]
    capture = read_capture(Path("captures") / scene.name)
    _, (answer,) = read_result(Path("out") / scene.name / "result.json")
    asked = shlex.split(scene.asked)
    model = load_object(asked[asked.index("--object") + 1]) if "--object" in asked else capture.model
    prior = asked[asked.index("--prior") + 1] if "--prior" in asked else None
    frame = prior_setter(prior, 0)(capture[0], model)
    right = model.name == capture.model.name
    if "--use vision" in scene.asked:
        frame = frame.without_touch()  # nothing that is not used is drawn
    _draw(PICTURES / f"{scene.name}.jpg", frame, model, answer, right)
    rows = []
    for name, use in scene.senses:
        one = answer if use == scene.senses[-1][1] else estimate(frame, model, use=use)
        error = Judge(model).errors(one.pose, frame.camera_from_object_truth) if right else None
        rows.append(f"| {name} | {one.verdict} | {_claimed(one, None if error is None else 1e3 * error.add_s)} |")
    lines = [*scene.lines[:-1], scene.lines[-1] + ("  # exit code 1: lost" if code == 1 else "")]
    share = answer.visible_fraction
    seen = "" if share is None or math.isnan(share) else f" The camera sees {100 * share:.0f} % of it."
    reason = "" if answer.verdict == "ok" else f" because: {answer.notes[0]}"
    table = ["| | verdict | ADD-S | σ position | σ rotation |", "|---|---|---|---|---|", *rows]
    return "\n".join(
        [
            f"## {scene.title}",
            "",
            f"![{scene.title}: colour with contacts, depth with outlines](images/gallery/{scene.name}.jpg)",
            "",
            f"{scene.words}{seen} The answer is **{answer.verdict}**{reason}.",
            "",
            *table,
            "",
            "```sh",
            *lines,
            "```",
            "",
        ]
    )


def _typed(line: str) -> int:
    """The exit code of a line of the shell; raises RuntimeError with what it said when that is bad use."""
    from fusion.cli.main import main as palpate

    words = shlex.split(line, comments=True)
    if words[0] != "palpate":
        return subprocess.run(["bash", "-c", line], check=True).returncode
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = palpate(words[1:])
    if code not in (0, 1):
        raise RuntimeError(f"{line}: exit code {code}: {said.getvalue()}")
    return code


def _draw(path: Path, frame: Any, model: Any, answer: Any, right: bool) -> None:
    import numpy as np

    from fusion.results.report import pictures, stills

    left = stills.still(frame, model, answer, WIDE, "colour", truth=right, outlines=False)
    depth = stills.still(frame, model, answer, WIDE, "depth", truth=right, modes=MODES)
    if left is None or depth is None:
        raise RuntimeError(f"{path.stem}: expected an image")
    gap = np.full((len(left), GAP, 3), 255, np.uint8)
    path.write_bytes(pictures.jpeg(np.concatenate([left, gap, depth], axis=1), 82))


def _claimed(answer: Any, error: float | None) -> str:
    """Error and claimed sigmas as cells of a table."""
    from fusion.results.report import words

    rotation, position = words.worst_sigmas(answer.covariance)
    several = answer.verdict != "ok" and (len(answer.modes) > 1 or bool(answer.unobservable))
    unknown = several or not math.isfinite(position)
    sigmas = "open | open" if unknown else f"{1e3 * position:.1f} mm | {_angle(rotation)}"
    return f"{'–' if error is None or not math.isfinite(error) else f'{error:.1f} mm'} | {sigmas}"


def _angle(radians: float) -> str:
    from fusion.results.report.words import FREE_ROTATION

    return f"{math.degrees(radians):.1f}°" if radians <= FREE_ROTATION else "free"


if __name__ == "__main__":
    os.environ.setdefault("PALPATE_THREADS", "1")  # the same bits whatever the machine
    sys.exit(main(sys.argv[1:]))
