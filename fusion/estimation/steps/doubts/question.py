"""A frame and what is asked about it: what doubts leave out, and what is asked again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked
from fusion.estimation.steps.sense import Sensed
from scenes.recordings.frames import Frame


@dataclass(frozen=True)
class Question:
    """A frame and what is asked about it; said: of what is not believed in it any more, in words, at an answer."""

    frame: Frame
    asked: Asked
    said: Callable[[Estimate], str] = lambda answer: ""


# What is answered, and what that is from.
Ask = Callable[[Question], tuple[Estimate, Sensed]]
Change = Callable[[Question], Question]
