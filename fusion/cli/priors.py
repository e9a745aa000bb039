"""The text of `--prior`: what it does to a frame before it is estimated. Light at import."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from fusion.cli.options import length_and_angle
from scenes.errors import InputError

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.frames import Frame


def prior_setter(text: str | None, seed: int) -> Callable[[Frame, ObjectModel], Frame]:
    """What `--prior` does to a frame; raises InputError for a text that is none of the three kinds."""
    from dataclasses import replace

    if text is None:
        return lambda frame, model: frame
    if text == "none":
        return lambda frame, model: replace(frame, prior=None)
    if text.startswith("gt"):
        return _truth_plus(text, seed)
    from scenes.files.bop import read_priors
    from scenes.files.problems import refuse

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
        except argparse.ArgumentTypeError as error:
            raise InputError(f"prior: {error}") from error

    def from_truth(frame: Frame, model: ObjectModel) -> Frame:
        truth = frame.camera_from_object_truth
        if truth is None:
            raise InputError(f"{frame.where}: expected ground truth for --prior {text}, found none")
        rng = np.random.default_rng([seed, frame.index])
        return replace(frame, prior=poses.displaced(truth, noise[1], noise[0], model.centroid, rng))

    return from_truth
