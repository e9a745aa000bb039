"""All that a track remembers from frame to frame, as plain arrays and numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

from fusion.tracking.filter import Belief
from fusion.tracking.hypotheses import Hypotheses
from fusion.tracking.motion import HandState
from fusion.tracking.occluders import Occluders
from fusion.tracking.renewal import Renewal


@dataclass
class TrackState:
    """All that a track remembers of the object; arrays and numbers, so that it can be kept.

    belief: of the leading hypothesis, None before a start; hypotheses: the leader first; hand: at the last frame;
    index: of that; unseen: frames without evidence; lost_for: frames; usual: share of pixels that the pose explains,
    usually; things: what goes with the object and is not it; rigs: levels of shared errors that the first frames were
    taken for; right: chance that the leader is the right one, as last judged; sure: whether the last answer was ok.
    """

    belief: Belief | None = None
    hypotheses: Hypotheses = ()
    hand: HandState | None = None
    index: int = 0
    unseen: int = 0
    lost_for: int = 0
    usual: float | None = None
    things: Occluders = field(default_factory=Occluders)
    rigs: list[float] = field(default_factory=list)
    renewal: Renewal = field(default_factory=Renewal)
    right: float = 0.0
    sure: bool = False
