"""Contact by contact: an estimate after every touch, and when to stop touching (T2 section 4.4.6)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.multistart import multistart
from touch.published.particles.memory_unscented_particle_filter import UnscentedParticleFilter, UnscentedSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StoppingSettings:
    """When the index has settled. Values by judgement."""

    # Contacts before which nothing is settled: six meet any surface, and the burn-in of T2 figure 4.14 is ten more.
    fewest: int = 15
    # Contacts over which the trend is judged, and the change over them that is no change: share of the index, metres.
    span: int = 8
    share: float = 0.1
    least: float = 0.5e-3


@dataclass
class StoppingRule:
    """Watches the index I_t: `observe` after every contact, true once more contacts no longer change it."""

    settings: StoppingSettings = field(default_factory=StoppingSettings)
    history: list[float] = field(default_factory=list)

    def observe(self, index: float) -> bool:
        """Take I_t (m); true when its least-squares line over the last contacts is flat and they scatter little."""
        self.history.append(float(index))
        s = self.settings
        if len(self.history) < max(s.fewest, s.span):
            return False
        last = np.array(self.history[-s.span :])
        slope = float(np.polyfit(np.arange(s.span), last, 1)[0])
        bound = max(s.share * float(last.mean()), s.least)
        return bool(abs(slope) * (s.span - 1) <= bound and np.ptp(last) <= 2 * bound)


@dataclass(frozen=True)
class RecursionStep:
    """After `contacts` contacts: pose (4, 4) contacts_frame_from_object; index, mean |distance| of the contacts so far
    (m); seconds that this contact took.
    """

    contacts: int
    pose: Array
    index: float
    time_s: float


def localize_online(
    model: ObjectModel, contacts: Contacts, seed: int = 0, method: str = "mupf", window: int = 36
) -> Iterator[RecursionStep]:
    """An estimate after every contact, in the order given; stop whenever a StoppingRule says so.

    method: "mupf" (recursive, `window` contacts remembered) or "multistart" (anew from all contacts so far).
    """
    if method not in ("mupf", "multistart"):
        raise InputError(f"method: expected mupf or multistart, got {method!r}")
    if len(contacts) == 0:
        raise InputError("localize: expected at least one contact, got none")
    search = UnscentedParticleFilter(model, contacts.points[0], seed, UnscentedSettings(window=window))
    for n in range(len(contacts)):
        begin = time.perf_counter()
        if method == "mupf":
            search.update(contacts.points[n])
            pose = search.estimate()
        else:
            pose = multistart(model, contacts.take(np.arange(n + 1)), seed).pose
        elapsed = time.perf_counter() - begin
        distance = model.surface.closest(se3.apply(se3.inverse(pose), contacts.points[: n + 1]))[0]
        yield RecursionStep(n + 1, pose, float(np.abs(distance).mean()), elapsed)
