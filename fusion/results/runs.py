"""A recording's frames with their answers, as the shell asks for them: the object by name, the prior by text.

Light at import: everything heavy is imported by the function that needs it.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from scenes.errors import InputError, unknown

if TYPE_CHECKING:
    from fusion.estimation.answer import Estimate
    from fusion.estimation.settings import EstimateSettings
    from scenes.files.problems import Report
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.captures import Capture
    from scenes.recordings.frames import Frame
    from scenes.recordings.telling import Told

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
ANGLES = {"deg": math.pi / 180.0, "rad": 1.0}


def length_and_angle(text: str) -> tuple[float, float]:
    """`33mm,16deg` or `33,16` (mm and degrees are understood) as metres and radians; raises InputError."""
    parts = text.split(",")
    if len(parts) == 2:
        length, angle = _quantity(parts[0], LENGTHS, "mm"), _quantity(parts[1], ANGLES, "deg")
        if length is not None and angle is not None:
            return length, angle
    raise InputError(f"expected a length and an angle like 33mm,16deg, got {text!r}")


def _quantity(text: str, units: dict[str, float], default: str) -> float | None:
    match = re.fullmatch(r"\s*([0-9.]+(?:e-?[0-9]+)?)\s*([a-z]*)\s*", text)
    if match is None or (match.group(2) or default) not in units:
        return None
    try:
        value = float(match.group(1)) * units[match.group(2) or default]
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def load_object(name: str, unit: str = "m") -> ObjectModel:
    """A generated object by its name, else a mesh file. Raises PalpateError listing the names when it is neither."""
    from scenes.geometry.objects import ObjectModel
    from scenes.synthesis import library

    known = [*library.names(), *library.tool_names(), *library.held_out_names()]
    if name in known and not Path(name).is_file():
        return library.make(name)
    if not Path(name).exists():
        raise unknown("object", name, known, "a mesh file or one of")
    return ObjectModel.load(name, unit=unit)


@contextmanager
def reporting(capture: Capture, report: Report) -> Iterator[None]:
    """Meanwhile `report` hears of what is wrong with the files of the capture's frames."""
    before = capture.report
    capture.report = report
    try:
        yield
    finally:
        capture.report = before


def frame_setter(prior: str | None, seed: int, told: Sequence[Told] = ()) -> Callable[[Frame, ObjectModel], Frame]:
    """What the shell makes of a frame before it is used: `--prior`, and the tables of beliefs over the frame's own.

    Raises InputError for a prior that is none, and for beliefs that are none.
    """
    from dataclasses import replace

    with_prior = prior_setter(prior, seed)
    if not told:
        return with_prior
    from scenes.recordings.telling import believed

    believed(None, told)
    return lambda frame, model: replace(with_prior(frame, model), beliefs=believed(frame.beliefs, told))


def prior_setter(text: str | None, seed: int) -> Callable[[Frame, ObjectModel], Frame]:
    """What `--prior` does to a frame; raises InputError for a text that is none of the three kinds."""
    from dataclasses import replace

    if text is None:
        return lambda frame, model: frame
    if text == "none":
        return lambda frame, model: replace(frame, prior=None)
    if text.startswith("gt"):
        return _truth_plus(text, seed)
    from scenes.files.problems import refuse
    from scenes.recordings.bop import read_priors

    if not Path(text).is_file():
        raise InputError(f"prior: expected none, gt+NOISE like gt+33mm,16deg, or a file, got {text!r}")
    priors = read_priors(text, refuse)

    def from_file(frame: Frame, model: ObjectModel) -> Frame:
        if frame.index not in priors:
            raise InputError(f"{text}: expected a prior of frame {frame.index}, found none")
        return replace(frame, prior=priors[frame.index])

    return from_file


def _truth_plus(text: str, seed: int) -> Callable[[Frame, ObjectModel], Frame]:
    from dataclasses import replace

    import numpy as np

    from scenes.geometry import poses

    noise = (0.0, 0.0)
    if text != "gt":
        try:
            noise = length_and_angle(text.removeprefix("gt").removeprefix("+"))
        except InputError as error:
            raise InputError(f"prior: {error}") from error

    def from_truth(frame: Frame, model: ObjectModel) -> Frame:
        truth = frame.camera_from_object_truth
        if truth is None:
            raise InputError(f"{frame.where}: expected ground truth for --prior {text}, found none")
        rng = np.random.default_rng([seed, frame.index])
        return replace(frame, prior=poses.displaced(truth, noise[1], noise[0], model.centroid, rng))

    return from_truth


def estimates(
    capture: Capture,
    numbers: Iterable[int],
    model: ObjectModel,
    prepare: Callable[[Frame, ObjectModel], Frame],
    use: tuple[str, ...],
    seed: int,
    tolerance: tuple[float, float] | None = None,
    budget_ms: float | None = None,
    settings: EstimateSettings | None = None,
    leave_out: Callable[[int, str], None] | None = None,
) -> Iterator[tuple[Frame, Estimate]]:
    """Each of the capture's frames of these numbers as `prepare` has it, and its answer. The first is estimated twice:
    that loads the compiled kernels, and a frame's time should tell of the frame.

    leave_out: is told of a frame that no estimate should be made of, by number and why, and the others are answered.
    Raises CaptureError for the first such frame without it, and where it was told of all of them.
    """
    from fusion.estimation.estimate import estimate
    from scenes.errors import CaptureError
    from scenes.recordings.checking.validation import usable

    log = logging.getLogger(__name__)

    def answered(frame: Frame, tolerance: tuple[float, float] | None) -> Estimate:
        return estimate(frame, model, None, use, tolerance, budget_ms, seed, settings)

    warm, refused = False, None
    for number in numbers:
        try:
            frame = usable(capture, number, model, prepare, vision="vision" in use)
            if not warm:
                answered(frame, None)
                warm = True
            answer = answered(frame, tolerance)
        except CaptureError as error:
            if leave_out is None:
                raise
            leave_out(number, str(error))
            refused = refused or error
            continue
        log.info("frame %d: %s in %.0f ms: %s", frame.index, answer.verdict, answer.time_ms, "; ".join(answer.notes))
        yield frame, answer
    if refused is not None and not warm:
        raise refused
