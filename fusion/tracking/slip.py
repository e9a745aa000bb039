"""Has the object moved in the hand? What a track's poses say, and what the patterns on the fingertips say.

Three tests beside one another: against an object that goes along with the fingers, against one that keeps its place in
the palm, and, where fingertips have taxel arrays or gels, whether their patterns and patches have moved over the skin.
The first two need frames that tell the pose well; a pattern moves by less than a pose can be known to, whatever the
camera sees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.filter import Belief, Measurement, SlipTest, TrackSlipSettings
from fusion.tracking.motion import InHand
from scenes.geometry.objects import ObjectModel
from touch.arrays.readings import Reading
from touch.arrays.slip import PatternSettings, PatternWatch
from touch.gels.patches import Patch
from touch.gels.slip import PatchSlipSettings, PatchWatch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WatchSettings:
    """When an object that should be held has moved in the hand."""

    poses: TrackSlipSettings = field(default_factory=TrackSlipSettings)
    patterns: PatternSettings = field(default_factory=PatternSettings)
    patches: PatchSlipSettings = field(default_factory=PatchSlipSettings)


@dataclass(frozen=True)
class Watched:
    """What one frame says. slip: otherwise than the fingers; moved: against the palm, or a slip; statistic: above 1 is
    a slip; by: who says so, in words, empty without a slip; by_skin: what presses arrays or gels says so, too.
    """

    slip: bool = False
    moved: bool = False
    statistic: float = 0.0
    by: str = ""
    by_skin: bool = False


class SlipWatch:
    """All tests of one track."""

    def __init__(self, model: ObjectModel, length: float, settings: WatchSettings | None = None) -> None:
        """length: correlation length of the depth bias in pixels, over which shared errors change."""
        settings = settings or WatchSettings()
        self._fingers = SlipTest(model, length, settings.poses)
        # against the palm; none while no finger has moved since both began, and the two would be the same
        self._palm: SlipTest | None = None
        self._patterns = PatternWatch(settings.patterns)
        self._patches = PatchWatch(settings.patches)
        # a slip that the skins have said goes on for as long as one that the poses have
        self._lasts = settings.poses.lasts
        self._quiet, self._said = self._lasts + 1, ""

    def restart(self) -> None:
        """Forget where the poses had the object in the hand. Patterns do not depend on what is believed of it."""
        self._fingers.restart(None, None)
        self._palm = None

    def let_go(self) -> None:
        """Forget the patterns, too."""
        self.restart()
        self._patterns.restart()
        self._patches.restart()
        self._quiet, self._said = self._lasts + 1, ""

    @property
    def going_on(self) -> bool:
        """Whether its poses have just said that the object moves in the hand."""
        return self._fingers.going_on or (self._palm is not None and self._palm.going_on)

    @property
    def settling(self) -> bool:
        """Whether the object has just come to rest again."""
        return self._fingers.settling or (self._palm is not None and self._palm.settling)

    def predict(self, motion: Array, expected: InHand, drift: Array) -> None:
        """Move with the hand by motion (4, 4), and as the fingers do; drift (6, 6): of a wrong calibration."""
        if self._palm is None and (expected.motion.any() or expected.sliding):
            self._palm = self._fingers.copied()
        self._fingers.predict(motion, expected.motion, expected.sticking, expected.sliding, drift)
        if self._palm is not None:
            self._palm.predict(motion, np.zeros(6), expected.still, drift=drift)

    def carry(self, motion: Array) -> None:
        """Move with the hand by motion (4, 4): a late frame's lesson comes to the present."""
        for test in (self._fingers, self._palm):
            if test is not None:
                test.predict(motion, np.zeros(6), np.zeros((6, 6)))

    def feel(self, readings: Sequence[Reading], patches: Sequence[Patch] = ()) -> Watched:
        """What the arrays and the gels of the next frame say; patches in the palm's frame."""
        pattern, patch = self._patterns.step(readings), self._patches.step(patches)
        said = ("the fingertips' patterns have moved",) * pattern.slipped
        said += ("what presses the gels has moved over them",) * patch.slipped
        self._quiet = 0 if said else self._quiet + 1
        self._said = " and ".join(said) or self._said
        slip = self._quiet <= self._lasts
        statistic = max(pattern.statistic, patch.statistic)
        return Watched(slip, slip, statistic, self._said if slip else "", by_skin=slip)

    def step(self, measured: Measurement, belief: Belief, pixel: Array | None, felt: Watched) -> Watched:
        """What a frame's own answer says, and what its skins said; belief: the tracker's own, to start from."""
        slip = self._fingers.step(measured, belief, pixel)
        moved = (self._palm is not None and self._palm.step(measured, belief, pixel)) or slip
        by = " and ".join(word for word in ("its poses do not go with the hand" if slip else "", felt.by) if word)
        statistic = max(self._fingers.statistic, felt.statistic)
        return Watched(slip or felt.slip, moved or felt.slip, statistic, by, felt.by_skin)

    def follow(self, belief: Belief, pixel: Array | None) -> None:
        """After a slip the object is held as `belief` has it."""
        self._fingers.restart(belief, pixel)
