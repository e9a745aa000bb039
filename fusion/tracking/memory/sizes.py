"""How large are the errors that all frames of this recording share? What each look leaves unexplained tells, together.

A single frame cannot say how good a robot's calibration, a camera or a mesh is; what it believes of them is right on
average over what there are. But these are the same in all frames of a recording, and each look in full leaves three
signs of them: how far calibration, scale and bias had to be moved, in units of what is believed of them, beside how
much of them it could tell (the ratio is their variance as MacKay re-estimates it, Neural Computation 4, 1992); how far
contacts are off beyond that; and how far whole blocks of the image are. Means over looks make what frames share wider
or narrower in what a track says of itself; the filter's gains do not ask for it. Where nothing tells what hides the
object nothing is learned: what is left unexplained there may be another thing's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fusion.estimation.answer import ContactResidual
from fusion.estimation.solve.joint import JointResult
from fusion.tracking.filter import Belief, Measurement, surplus
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel


@dataclass(frozen=True)
class SizeSettings:
    """By how much (a factor of variance) shared errors are otherwise than a look has them: a factor, and powers of
    what looks leave unexplained. Tuned on 308 sequences of all tuning families with a hand, each family as heavy as
    another: what makes the errors of `ok` frames likeliest, as a Student distribution of 40 degrees of freedom. They
    are 0.3 nats a sequence likelier than without, and 0.16 in families that are left out.
    """

    # The factor where all three signs are 1.
    usual: float = 1.35
    # Of the mean square of how far contacts are off, in their own standard deviations, held below the second number,
    # and no less than the third: what no contact tells is not known to be nothing.
    by_touch: float = 0.77
    most_off: float = 3.0
    least_touch: float = 0.1
    # Of the mesh's own variance as blocks of the image have it, in units of the second number (m), what scans are
    # usually off by.
    by_mesh: float = 0.33
    usual_mesh: float = 0.6e-3
    # Of the squares of what was moved over how many of them were told (no unit); both have the second number before
    # anything is seen. The third: the logarithm of that ratio where no look can tell them.
    by_strain: float = 0.69
    least_told: float = 0.5
    untold: float = -0.5
    # Looks (no unit) as which the belief counts against what looks leave unexplained: one alone may be lucky. Of 0 and
    # 2 the second makes the errors of 2329 `ok` frames of four tuning families 0.02 nats likelier.
    believed_looks: float = 2.0
    # Bounds of the whole factor: what `crude` looks leave unexplained asks for 1.4 to 8 (nine in ten); other families
    # are no likelier with more.
    narrowest: float = 0.25
    widest: float = 4.5
    # Looks as which those count after which the object was found elsewhere: calibration, camera and mesh are the same.
    kept_looks: float = 2.0
    # The factor of what frames do not share where the innovations are as wide as believed, and the power of their mean
    # square; bounds of the whole factor. They make the errors of 347 sequences of the tuning families 0.14 nats
    # likelier; so would 1.8 and 2.7, which are too wide for `lab`.
    usual_jump: float = 1.5
    by_jump: float = 2.5
    least_jump: float = 0.5
    most_jump: float = 12.0
    # Squared innovation (chi-square over its degrees of freedom, no unit) that counts at most: one in two hundred.
    farthest: float = 3.3
    # Share of their weight that frames until now keep when another comes, and the frames as which the belief counts.
    jump_memory: float = 0.9
    believed_frames: float = 3.0


@dataclass(frozen=True)
class Sizes:
    """What the looks of a track left unexplained, summed. looks: in full, those before another place was found as
    fewer; mesh (m^2): their meshes' variances; felt: looks with contacts; off: mean squares of these, in standard
    deviations; strain: squares of the shared errors that were solved for, in units of what is believed of them; told:
    how many of them the looks could tell.
    """

    looks: float = 0.0
    mesh: float = 0.0
    felt: float = 0.0
    off: float = 0.0
    strain: float = 0.0
    told: float = 0.0

    def learned(
        self, solved: JointResult, residuals: Sequence[ContactResidual], settings: SizeSettings, anew: bool = False
    ) -> Sizes:
        """After a look that was solved so and left its contacts so far off; anew: it is the first of another pose."""
        if anew:
            return self.faded(settings).learned(solved, residuals, settings)
        if not solved.mesh_variance > 0.0:
            return self  # nothing was seen
        off = [
            min(abs(one.residual_mm) / one.sigma_mm, settings.most_off) ** 2
            for one in residuals
            if math.isfinite(one.sigma_mm) and one.sigma_mm > 0.0
        ]
        after = replace(self, looks=self.looks + 1, mesh=self.mesh + solved.mesh_variance)
        after = replace(after, strain=self.strain + solved.strain, told=self.told + solved.told)
        return replace(after, felt=self.felt + 1, off=self.off + sum(off) / len(off)) if off else after

    def faded(self, settings: SizeSettings) -> Sizes:
        """Where the object turns out to be elsewhere: what was left unexplained was so in part for that."""
        share = min(1.0, settings.kept_looks / max(self.looks, 1.0))
        return Sizes(*(share * getattr(self, one.name) for one in fields(self)))

    def factor(self, settings: SizeSettings) -> float:
        """On the variance of what frames share (no unit); 1 before any look."""
        s = settings
        if not self.looks:
            return 1.0
        touch = math.log(self.off / self.felt + s.least_touch) if self.felt else 0.0
        mesh = math.log(self.mesh / self.looks / s.usual_mesh**2)
        strain = math.log((self.strain + s.least_told) / (self.told + s.least_told)) if self.told > 0.0 else s.untold
        by = s.usual * math.exp(s.by_touch * touch + s.by_mesh * mesh + s.by_strain * strain)
        by **= self.looks / (self.looks + s.believed_looks)
        return min(max(by, s.narrowest), s.widest)

    def told_of(self, belief: Belief, settings: SizeSettings) -> Belief:
        """A belief as wide as it is to be told: what frames share is as large as they have shown."""
        return replace(belief, shared=self.factor(settings) * belief.shared)


@dataclass(frozen=True)
class Jumps:
    """How far the last frames' own answers were from what was predicted. squares: over their degrees of freedom and in
    units of what was believed of them, summed; frames: how many, those of long ago less.
    """

    squares: float = 0.0
    frames: float = 0.0

    def learned(self, model: ObjectModel, predicted: Belief, measured: Measurement, settings: SizeSettings) -> Jumps:
        """After a frame that was expected at `predicted`, and in which the object does not slip."""
        s = settings
        step = se3.difference(measured.pose, predicted.pose, model.centroid)
        wide, count = predicted.own + measured.own + surplus(model, measured, predicted.shared), 6.0
        if not model.symmetries.is_trivial:
            known = model.symmetries.quotient(measured.pose[:3, :3], model.centroid)
            free = np.eye(6) - known  # a turn about its own axis tells nothing
            step, wide, count = known @ step, wide + free @ free.T, float(np.trace(known))
        square = min(float(step @ np.linalg.solve(wide, step)) / count, s.farthest)
        return Jumps(s.jump_memory * self.squares + square, s.jump_memory * self.frames + 1.0)

    def factor(self, settings: SizeSettings) -> float:
        """On the variance of what frames do not share (no unit); 1 before any frame."""
        s = settings
        if not self.frames:
            return 1.0
        mean = (self.squares + s.believed_frames) / (self.frames + s.believed_frames)
        return min(max(s.usual_jump * mean**s.by_jump, s.least_jump), s.most_jump)

    def told_of(self, belief: Belief, settings: SizeSettings) -> Belief:
        """A belief as wide as it is to be told: what frames do not share is as large as they have shown."""
        return replace(belief, own=self.factor(settings) * belief.own)
