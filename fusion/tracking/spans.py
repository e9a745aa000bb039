"""Has the object moved in the hand between two short spans of frames?

A single frame tells a pose to some tenths of a millimetre, and what all frames share drifts by as much while an
object is carried: a slip of a millimetre is lost in either, held against the frame before it or against all before it.
The means of two spans that lie as far apart as a slip lasts differ by the slip and little else (a two-sample test:
Hotelling 1931). Camera frame, metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpanSettings:
    """The two spans. Tuned on 36 sequences of the tuning family `lab` (16 slides, 20 steady motions; five objects): the
    errors are those that make what true answers differ by likeliest.
    """

    # Frames of the later span, between the two (with these a slip of a fifth of a second), and of the earlier one at
    # most and at least.
    after: int = 3
    between: int = 4
    before: int = 8
    fewest: int = 3
    # Squared difference of their means (chi-square, 6 degrees of freedom). Single glances have longer tails than a
    # Gaussian: of 20 sequences in which nothing slips two had a false alarm, as with wider covariances and a limit of
    # 16, with which 8 of 14 slides were said; so 10 are.
    limit: float = 34.0
    # Errors of the means that no covariance speaks of: bent surfaces, other pixels (rad, m).
    floor_angle: float = float(np.deg2rad(0.12))
    floor_distance: float = 0.0001
    # Share (of a standard deviation) of what a wrong calibration makes of the hand's motion: the hand is seen, too.
    drift: float = 0.3
    # Share (of the variance) of what the depth bias changes from where one span is seen to where the other is, for
    # answers go by the mean of what looks have found it to be.
    bias: float = 0.3


class SpanTest:
    """The last frames' own answers, moved on as the object is expected to move."""

    def __init__(self, model: ObjectModel, length: float, settings: SpanSettings | None = None) -> None:
        """length: correlation length of the depth bias in pixels, over which shared errors change."""
        self.model = model
        self.settings = settings or SpanSettings()
        self._length = length
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        # poses (n, 4, 4) where they are by now; of each, covariances (n, 6, 6) of noise, of the depth bias and of
        # what no frame tells, camera axes; noise (n, 6, 6) and drift (n, 6) of the way since; pixels (n, 2)
        self._poses = np.zeros((0, 4, 4))
        self._own, self._biased, self._hidden, self._noise = (np.zeros((0, 6, 6)) for _ in range(4))
        self._drift, self._pixels = np.zeros((0, 6)), np.zeros((0, 2))
        # of what frames of one sense share, and those of another do not
        self._other = np.zeros((0, 6, 6))

    def predict(self, camera_from_camera: Array, delta: Array, noise: Array, drift: Array) -> None:
        """Move with the hand (4, 4) and by what the fingers do (6,), known to noise (6, 6); drift (6,): standard
        deviations of what a wrong calibration makes of the motion, which adds up as the motion goes on.
        """
        if not len(self._poses):
            return
        self._poses = se3.perturb(camera_from_camera @ self._poses, delta, self.model.centroid)
        turn = np.kron(np.eye(2), camera_from_camera[:3, :3])
        self._own, self._biased = turn @ self._own @ turn.T, turn @ self._biased @ turn.T
        self._hidden, self._noise = turn @ self._hidden @ turn.T, turn @ self._noise @ turn.T + noise
        self._other = turn @ self._other @ turn.T
        self._drift = self._drift + drift

    def add(
        self, pose: Array, own: Array, biased: Array, hidden: Array, pixel: Array | None, other: Array
    ) -> tuple[float, Array]:
        """Take a frame's own answer (4, 4) with its covariances (6, 6), seen at pixel (2,), and by how much (6, 6) what
        it shares with frames of its sense is more than what those before it do; the squared difference of the spans
        (chi-square, 0 while there are too few frames), and the difference (6,).
        """
        s = self.settings
        most = s.after + s.between + s.before
        where = np.full(2, np.nan) if pixel is None else pixel

        def longer(kept: Array, new: Array) -> Array:
            return np.concatenate([kept, new[None]])[-most:]

        self._poses, self._pixels = longer(self._poses, pose), longer(self._pixels, where)
        self._own, self._biased = longer(self._own, own), longer(self._biased, biased)
        self._hidden, self._noise = longer(self._hidden, hidden), longer(self._noise, np.zeros((6, 6)))
        self._other = longer(self._other, other)
        self._drift = longer(self._drift, np.zeros(6))
        count = len(self._poses) - s.after - s.between
        if count < s.fewest:
            return 0.0, np.zeros(6)
        delta = se3.difference(self._poses, pose, self.model.centroid)
        step = delta[-s.after :].mean(axis=0) - delta[:count].mean(axis=0)
        wide = self._own[-s.after :].mean(axis=0) / s.after + self._own[:count].mean(axis=0) / count
        wide += s.bias * 2.0 * (1.0 - self._correlation(count)) * self._biased[-s.after :].mean(axis=0)
        wide += self._hidden[-s.after :].mean(axis=0)
        wide += self._noise[:count].mean(axis=0) - self._noise[-s.after :].mean(axis=0)
        # of a sense that more of the one span's frames are of than of the other's
        of_it = self._other.trace(axis1=1, axis2=2) > 0.0
        if of_it.any():
            share = float(of_it[-s.after :].mean() - of_it[:count].mean())
            wide += share**2 * self._other[of_it].mean(axis=0)
        floor = np.repeat([s.floor_angle, s.floor_distance], 3)
        drifted = s.drift * (self._drift[:count].mean(axis=0) - self._drift[-s.after :].mean(axis=0))
        wide += np.diag(floor**2 + drifted**2)
        return float(step @ np.linalg.solve(wide, step)), step

    def _correlation(self, count: int) -> float:
        """Of the depth bias from where the first `count` frames had the object to where the last ones have it."""
        apart = self._pixels[-self.settings.after :].mean(axis=0) - self._pixels[:count].mean(axis=0)
        square = float(np.sum(apart**2))
        return float(np.exp(-0.5 * square / self._length**2)) if np.isfinite(square) else 1.0
