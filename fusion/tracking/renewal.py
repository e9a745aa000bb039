"""When a track looks at a frame as if it knew nothing, and what it makes of what it then finds.

A track that follows a wrong pose agrees with itself for ever. Single frames searched without the track's memory do not
share its mistake: they are asked soon after a start, ever more rarely while they agree, and often again when they do
not or when something else gives cause for doubt. The rate is bounded on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RenewalSettings:
    """How often single frames are searched. By judgement: a search costs as much as some thirty tracked frames."""

    # Frames from a start, or from a doubt, to the next search; the wait doubles with each that brings nothing new, up
    # to the longest (30 = a second).
    soonest: int = 3
    longest: int = 30
    # Frames from one search to the next, at least, when answers come and go about the limit of what is called ok.
    hurried: int = 10


@dataclass
class Renewal:
    """due: frame index of the next search; wait: frames from one to the next; last: frame index of the last."""

    due: int = 0
    wait: int = 1
    last: int = 0

    def restart(self, index: int, settings: RenewalSettings) -> None:
        """A track has begun in this frame."""
        self.due, self.wait, self.last = index + settings.soonest, settings.soonest, index

    def found(self, index: int, agrees: bool | None, settings: RenewalSettings) -> None:
        """A search in this frame agrees with the track, contradicts it, or tells nothing (None)."""
        self.wait = settings.soonest if agrees is False else min(2 * self.wait, settings.longest)
        self.due, self.last = index + self.wait, index

    def hurry(self, index: int, settings: RenewalSettings) -> None:
        """An answer is no longer ok: search soon, if the last search was not just now."""
        soon = max(index + settings.soonest, self.last + settings.hurried)
        if soon < self.due:
            self.due, self.wait = soon, settings.soonest
