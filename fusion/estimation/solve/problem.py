"""The joint problem of one frame: its rows, what is believed of its sensors, and what can be laid out once.

Camera frame, metres, radians.
"""

from __future__ import annotations

from dataclasses import InitVar, dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve.depth_bias import DepthBias
from fusion.estimation.solve.kernels import hand_rows
from fusion.estimation.solve.settings import JointSettings
from scenes.evidence import row_kernels
from scenes.evidence.align import Prior, lattice_of, prior_of
from scenes.evidence.table import FACING, SIGMA, WEIGHT, Evidence
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from vision.look.hand.hand import HandView

Array = NDArray[np.float64]


@dataclass
class JointProblem:
    """Everything but the pose: rows, beliefs and what can be computed once per frame.

    seen: vision rows as measured; felt: touch rows as the robot reports them, of so many fingers. camera None: the
    rows are a cloud without pixels, its bias stays in the rows' sigmas. has_robot False: touch and vision were recorded
    in one frame. pixels_tell: the object's pixels tell of depth's scale and bias by all that they are off, and not only
    by what a pose explains as well; None: where a hand in view says more of it than they do. Contacts alone tie depth
    as well as the calibration is known: an outline that is fattened would be explained by a scale. beside: a problem of
    the same frame and beliefs, about another pose: what would be laid out as there is taken from it.
    """

    model: ObjectModel
    seen: Evidence
    felt: Evidence
    fingers: int
    prior: Prior | None
    hand: HandView | None
    beliefs: Beliefs
    camera: Camera | None
    has_robot: bool = True
    settings: JointSettings = field(default_factory=JointSettings)
    pixels_tell: bool | None = None
    beside: InitVar[JointProblem | None] = None

    @staticmethod
    def of(
        model: ObjectModel,
        frame: Frame,
        seen: Evidence,
        felt: Evidence,
        fingers: int,
        prior: Prior | None,
        hand: HandView | None,
        beliefs: Beliefs,
        settings: JointSettings,
        beside: JointProblem | None = None,
    ) -> JointProblem:
        """From a frame's evidence. A cloud and its contacts were recorded in one frame, as were contacts without a
        camera: no calibration between them. With a camera the pose is asked for where that is, whether it sees or not.
        """
        has_image = frame.depth is not None
        has_robot = has_image or (frame.camera is not None and frame.cloud is None)
        return JointProblem(
            model,
            seen,
            felt,
            fingers,
            prior,
            hand,
            beliefs,
            frame.camera if has_image else None,
            has_robot=has_robot,
            settings=settings,
            beside=beside,
        )

    def __post_init__(self, beside: JointProblem | None) -> None:
        """Lay the inducing pixels and the hand's constant block."""
        # without touch, too: the hand's pixels have the object's depth errors, and its shape is known
        self.hand = self.hand if self.has_robot and self.hand is not None and len(self.hand.points) else None
        hand_points = self.hand.points if self.hand is not None else np.zeros((0, 3))
        if self.pixels_tell is None:
            self.pixels_tell = self.hand is not None or self.camera is None or not len(self.seen)
        depth = self.beliefs.depth
        seen = self.seen.points if self.camera is not None and len(self.seen) else np.zeros((0, 3))
        reach = np.concatenate([seen, hand_points]) if len(seen) else seen
        known = None if beside is None else beside.bias
        self.bias: DepthBias = DepthBias.over(
            self.camera, reach, depth, self.settings.spacing, self.settings.most_inducing, known
        )
        self.seen_basis = self.bias.basis(self.seen.points)
        rows = self.seen.rows
        self.on = self.seen.on
        self.is_pixel = (rows[:, FACING] > 0) & (self.camera is not None)
        self.sigma = rows[:, SIGMA].copy()
        if self.camera is not None:
            independent = depth.independent_sigma(rows[:, 2])
            self.sigma = np.where(self.on, np.hypot(independent, self.beliefs.mesh_sigma), self.sigma)
        # a cloud keeps the weights of its rows
        self.weight = rows[:, WEIGHT].copy()
        if self.camera is not None:
            self.weight[self.on] = self.settings.pixel_weight
        self.hand_weight: Array
        self.hand_normal: Array
        self.hand_gradient: Array
        if beside is not None and self.hand is beside.hand and self.bias is beside.bias and self.hand is not None:
            self.hand_weight, self.hand_normal = beside.hand_weight, beside.hand_normal
            self.hand_gradient = beside.hand_gradient
        else:
            self._lay_hand(hand_points)
        self.lattice = lattice_of(self.model)
        self.floors = row_kernels.loss_floors(rows)
        # what newton_kernels.terms fills, and what stands for the system that did so last
        self.filled_by: object = None
        self.room = *self.rows_room(), np.zeros((len(rows), 7 + len(self.bias)))
        self.felt_rows = row_kernels.prepare(np.ascontiguousarray(self.felt.rows), 0.0, 0.0)
        self.prior_parts, self.no_prior = prior_of(self.model, self.prior), prior_of(self.model, None)

    def rows_room(self) -> tuple:
        """What kernels.vision_rows fills."""
        count = len(self.seen)
        return np.zeros(count, dtype=np.int64), np.zeros((count, 7)), *np.zeros((3, count))

    @cached_property
    def pixels(self) -> Array:
        """(n, 2) of the vision rows, before a camera."""
        assert self.camera is not None
        return self.camera.project(self.seen.points)[0]

    @property
    def ties_depth(self) -> bool:
        """Whether something of known shape and place says how wrong depth is: the hand in view, or contacts that hold
        the object; a cloud's points are as they are.
        """
        held = self.fingers >= self.settings.tying_fingers
        return self.hand is not None or self.camera is None or held

    def _lay_hand(self, points: Array) -> None:
        """The hand's pixels, linear in (xi, s, b): their constant part, for unit sigmas of s and b."""
        if self.hand is None:
            return
        sigma = np.hypot(self.beliefs.depth.independent_sigma(points[:, 2]), self.settings.hand_sigma)
        # All that agree count in full: weights that fall towards the gate would hide how large the bias is
        self.hand_weight = 1.0 / sigma**2 / self.settings.hand_sharing
        jac = np.zeros((len(points), 7 + len(self.bias)))
        hand_rows(points, self.hand.directions, self.hand.centre, self.bias.basis(points), jac)
        weighted = jac * self.hand_weight[:, None]
        self.hand_normal = weighted.T @ jac
        self.hand_gradient = weighted.T @ self.hand.residual
