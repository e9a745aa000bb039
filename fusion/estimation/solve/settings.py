"""Settings of the joint solution: the rigs that may be the case, and what is not in the tables of evidence."""

from __future__ import annotations

from dataclasses import dataclass

from scenes.errors import InputError, check_above


@dataclass(frozen=True)
class Level:
    """How large shared errors are: factors on what is believed. rig: of the calibration and of the depth's scale; bias:
    of the depth's smooth bias.
    """

    rig: float = 1.0
    bias: float = 1.0


@dataclass(frozen=True)
class Rig:
    """A size of shared errors that may be the case. Tuned on generated captures.

    level: factor on what they are believed to be. share: how usual it is.
    """

    level: float
    share: float

    def __post_init__(self) -> None:
        """Refuse sizes and shares that are none."""
        check_above(self, ("level", "share"))


@dataclass(frozen=True)
class JointSettings:
    """The joint solution. Tuned on generated captures."""

    # Gauss-Newton steps: the start is the minimum of a system that differs by millimetres.
    steps: int = 8
    # A step that promises less than this (nats) is not taken: beyond it rows change sides, not the pose.
    worth: float = 0.04
    # Steps that may be refused because they made it worse: by a nat or so a cost is rough, and no shorter step helps.
    refused: int = 1
    # Sizes of calibration and depth's scale that are tried, and of depth's smooth bias: factors on what is believed,
    # and how usual each is before anything is seen. None, a usual one, a poor one, a bad one; with one between the
    # first two, at 0.2 or 0.4, frames that show little of the hand took it too often, and were too sure. A camera may
    # be flat and its scale be off, or the robot's calibration: while one factor was all three's, pixels near by, which
    # tell of the bias alone, made 18 % of the regions too narrow along the ray where another generator's hands and
    # cameras are in view (91 right answers with a start; 4 % since). Of 0.1 and 0.2 for a rig without errors the second
    # leaves `clean`, which has none, nearer to what it was, and these regions and other families as they are.
    rigs: tuple[Rig, ...] = (Rig(0.25, 0.2), Rig(1.0, 0.62), Rig(2.0, 0.13), Rig(4.0, 0.05))
    biases: tuple[Rig, ...] = (Rig(0.25, 0.1), Rig(1.0, 0.7), Rig(2.0, 0.15), Rig(4.0, 0.05))
    # Near a prior so many biases are solved, with the usual rig; the others end where the last one's Gauss-Newton
    # matrix says, but for those that have at least this share of the mixture. So told, the log evidence of the third
    # was right to 1.2 nats in nine of ten of 335 answers of tuning families, of which a quarter counts; the share of
    # the third was 3 % on average. Without a prior a bias may end elsewhere, and tells how wide an answer is: there all
    # are solved. Other rigs always end where these say, and the likeliest of all is solved.
    solved: int = 2
    counting: float = 0.1
    # Weight of a pixel. Neighbours share what nothing here describes: fingers whose joints are off, flying pixels, the
    # side of a thin wall. Counted as independent, answers were twice as sure as they should have been.
    pixel_weight: float = 0.22
    # Log evidence of a rig counts one in so many (no unit): pixels share more than any rig describes, and tell rigs
    # apart no better than other minima (`pixel_temperature`). In full the evidence of most frames left one rig alone.
    # The log density of the true errors rose in half of 280 answers of the tuning families by 0.1 on average.
    evidence_temperature: float = 4.0
    # Rigs of less than this share of the mixture are left out of it.
    negligible: float = 2e-3
    # Share of a contact's sigma by which its normal may have been felt elsewhere on a bent surface (AlignSettings).
    bend: float = 1.0
    # Modes of a search that are solved. The right one was sixth to tenth in one of 60 frames
    # without a start.
    modes: int = 8
    # Pixels between inducing points of the bias, in correlation lengths, and the most of them.
    spacing: float = 1.2
    most_inducing: int = 80
    # Independent error of the hand's surface (m): joint errors move whole links; and how many of its pixels share it.
    hand_sigma: float = 0.0013
    hand_sharing: float = 6.0
    # Fingers whose contacts hold an object in place: three points. With so many, depth's scale and bias are solved for.
    tying_fingers: int = 3
    # Blocks of the image, as many as this, within which pixels may share errors that no belief describes; none of a
    # shorter side (px), and the fewest that tell how much they disagree. Of a block left out this share goes: what only
    # it tells is not lost altogether.
    groups: float = 16.0
    block: float = 16.0
    least_blocks: int = 6
    leave: float = 0.9
    # Independent places that pixels amount to when they say how good the camera is, from so many pixels on, and how
    # many the belief counts as, more than two.
    places: float = 4.0
    placed_pixels: float = 100.0
    believed_places: float = 3.0
    # Least factor (no unit) by which pixels widen the covariance. Filters take a camera's noise away and leave its
    # errors: of 320 frames of five tuning families that were smoothed afterwards, by two filters that recorders have,
    # 95 % regions of both senses hold 92 % without it and 97 % with it, as of the frames as they came. Of these it
    # widens next to none. It is no cure: of smoothed frames of report families as few hold, 82 %.
    least_misfit: float = 1.0
    # Blocks of the image that the belief on the mesh's own error counts as, beside a frame's (no unit); more than two.
    believed_blocks: float = 8.0
    # Independent parts of what is seen over which a mesh's own error, smooth as it is, is averaged in a pose (no unit):
    # of 1 to 6, and of the leverage of sixteen blocks of the image, what made the true errors of 530 answers of the
    # tuning families likeliest.
    mesh_parts: float = 4.0
    # Of what windows of readings blunt (DepthModel.blunting): its size as a factor, and how far it is alike, in windows
    # (no unit). Of 1 to 1.5 and of 0.5 to 2 these make the true errors of 240 answers to small images of three tuning
    # families' cameras likeliest, and hold most.
    blunt_times: float = 1.5
    blunt_length: float = 0.7
    # Share of what a smooth bias of depth explains that counts as the mesh's own error in the covariance: both are
    # smooth, and nothing in a frame tells them apart. Of 0, 0.3, 0.6 and 1, of which the true errors of 704 answers of
    # tuning families, a third of them from 14 to 26 cm, are as likely, half.
    mesh_share: float = 0.5
    # Least cosine of the incidence of a pixel: cameras read nothing of surfaces steeper than 80 degrees.
    least_cosine: float = 0.17

    def __post_init__(self) -> None:
        """Refuse what leaves nothing to solve: no rigs, no modes, bias that is known at no spacing."""
        above = "modes", "spacing", "places", "groups", "block", "evidence_temperature", "mesh_parts", "blunt_length"
        check_above(self, above)
        for name in ("rigs", "biases"):
            if not getattr(self, name):
                raise InputError(f"{name}: expected one size of shared errors or more, got none")
