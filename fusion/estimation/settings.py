"""The settings of an estimate: each stage's own are nested. Metres, radians.

What sensors are worth is not here: see `scenes.recordings.beliefs`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from fusion.estimation.posterior.confidence import ConfidenceSettings
from fusion.estimation.posterior.moments import MomentSettings
from fusion.estimation.posterior.turns import TurnSettings
from fusion.estimation.posterior.verdict import VerdictSettings
from fusion.estimation.search.modes import PlanSettings
from fusion.estimation.search.pool_settings import PoolSettings
from fusion.estimation.search.proposals import ProposalSettings
from fusion.estimation.solve.settings import JointSettings
from fusion.estimation.steps.another import AnotherSettings
from fusion.estimation.steps.doubts.settings import DoubtSettings
from fusion.estimation.steps.picture import PictureMeanSettings
from scenes.evidence.modes import ModeSettings
from touch.arrays.ranking import RankingSettings
from touch.contacts import TouchSettings
from vision.contour.evidence import ContourSettings
from vision.look.look import LookSettings
from vision.picture.settings import PredictionSettings
from vision.plausibility import PlausibilitySettings
from vision.sight import SightSettings
from vision.texture import PrintSettings


@dataclass(frozen=True)
class EstimateSettings:
    """The whole estimate."""

    # Width of a coarse start given without one, per axis: T1's 16 degrees and 33 mm in a random direction.
    prior_angle: float = float(np.deg2rad(10.0))
    prior_distance: float = 0.02
    # Nats of the pixels' joint cost that tell two minima apart as one should: hundreds of pixels share what a lattice
    # and a mesh leave out of a surface. Of 81 pairs of a right and a wrong minimum (384 frames without a start, not
    # those that are reported) the wrong one cost up to 8 nats less in 26.
    pixel_temperature: float = 4.0
    # Nats by which the picture may speak more against a joint solution than against where it began: it moves by what
    # calibration and depth are off, which the picture does not know; most of those up to here were
    # nearer to the truth than where they began (54 solutions of tuning families).
    most_worse: float = 35.0
    # Share of that difference which a solution costs more than where it began, where no hand ties calibration and
    # depth. Of many places in clutter some agree by chance, and lose it where the rows end: a wrong one lost 3 to 10
    # nats, the right one none (frames of another generator, held by hands that nobody has a model of: with 0, three
    # right answers of 60 fewer; with 1, one fewer; on the tuning families all three are the same).
    settled_share: float = 0.5
    look: LookSettings = field(default_factory=LookSettings)
    touch: TouchSettings = field(default_factory=TouchSettings)
    proposals: ProposalSettings = field(default_factory=ProposalSettings)
    prediction: PredictionSettings = field(default_factory=PredictionSettings)
    pool: PoolSettings = field(default_factory=PoolSettings)
    plan: PlanSettings = field(default_factory=PlanSettings)
    sight: SightSettings = field(default_factory=SightSettings)
    modes: ModeSettings = field(default_factory=ModeSettings)
    # Of the modes that are told, with a picture and by touch alone. Laplace's weights are wrong for the first: pixels
    # share errors, so that half of a cost counts; and what a minimum lacks in width it has in rows that agree, since
    # those that do not are bounded, so that a narrow one is the likelier. Of 99 answers to frames of tuning families
    # of which some modes are right and some are not, the right ones' share has a mean logarithm of -0.40, of -0.56 by
    # the cost alone, of -1.59 by Laplace's method; by touch alone, of 68, -0.42 by either, -0.56 by Laplace's. The
    # likeliest by them of those that were solved is the answer. Solutions that are one mode and lie apart widen it:
    # 2280 answers to eleven tuning families are 0.003 nats likelier each, of which that changed a third.
    told: ModeSettings = field(default_factory=lambda: ModeSettings(temper=0.5, width=-0.5, scatter=1.0))
    felt: ModeSettings = field(default_factory=lambda: ModeSettings(temper=0.85, width=0.0))
    joint: JointSettings = field(default_factory=JointSettings)
    moments: MomentSettings = field(default_factory=MomentSettings)
    turns: TurnSettings = field(default_factory=TurnSettings)
    picture_mean: PictureMeanSettings = field(default_factory=PictureMeanSettings)
    contour: ContourSettings = field(default_factory=ContourSettings)
    # Nats by which touch and the picture of depth together may speak more against a pose moved to the image's outline:
    # of 76 answers of the tuning family `d435` it was 5 at most but for one that rightly moved at 8.
    most_worse_outlined: float = 12.0
    texture: PrintSettings = field(default_factory=PrintSettings)
    verdict: VerdictSettings = field(default_factory=VerdictSettings)
    another: AnotherSettings = field(default_factory=AnotherSettings)
    confidence: ConfidenceSettings = field(default_factory=ConfidenceSettings)
    doubt: DoubtSettings = field(default_factory=DoubtSettings)
    plausibility: PlausibilitySettings = field(default_factory=PlausibilitySettings)
    # How the patterns of taxel arrays tell several modes apart; None leaves it to their rows.
    patterns: RankingSettings | None = field(default_factory=RankingSettings)


@cache
def usual_settings() -> EstimateSettings:
    """The settings where nobody asks for others: made once."""
    return EstimateSettings()
