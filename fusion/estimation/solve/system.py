"""The system of one solution: the joint problem whitened for one size of shared errors, about (delta, xi, s, b).

Built once where a solution starts and not changed after: which way the surface faces each pixel, and what a pixel
weighs, are held while it is solved. Camera frame, metres, radians.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve import newton_kernels as kernels
from fusion.estimation.solve.considered_kernels import field_spread
from fusion.estimation.solve.kernels import blocks_off, number_blocks, prior_row, surface_met, vision_rows
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.settings import Level
from scenes.evidence.align import Prior, align
from scenes.geometry import poses as se3
from vision.look.hand.hand import prior_spread

Array = NDArray[np.float64]

POSE, XI, SCALE = slice(0, 6), slice(6, 12), 12
FIXED = 13


class System:
    """Cost, gradient and Gauss-Newton matrix of a JointProblem about (delta, whitened xi, s, b)."""

    def __init__(self, problem: JointProblem, pose: Array, level: Level, facing: System | None = None) -> None:
        """Pose (4, 4): where it is solved from. level: how large shared errors are. facing: a system of the same
        problem that knows from near there which way the surface faces each pixel.
        """
        self.problem = problem
        self.size = FIXED + len(problem.bias)
        middle = pose[:3, :3] @ problem.model.centroid + pose[:3, 3]
        self.centre = problem.hand.centre if problem.hand is not None else middle
        # whitening: unknown = scale * whitened, prior of the whitened is the identity
        self.white = np.ones(self.size)
        # a cloud has no camera to turn about: the calibration is wrong where the hand is
        lever = self.centre if problem.camera is not None else np.zeros(3)
        spread = prior_spread(problem.beliefs.calibration, lever)
        self.white_xi = level.rig * spread if problem.has_robot else 1e-9 * np.eye(6)
        told = len(problem.seen) and problem.camera is not None
        self.white[SCALE] = level.rig * problem.beliefs.depth.scale_sigma if told else 1e-9
        self.white[FIXED:] = level.bias * problem.beliefs.depth.bias_sigma
        self.seen_white = problem.seen_basis * self.white[FIXED:]
        self.width = np.zeros(self.size)
        self.width[POSE] = np.array([1.0] * 3 + [problem.model.radius] * 3) ** -2.0
        self._hand_white = self._whitened_hand() if problem.hand is not None else None
        self.normals: Array
        self.slope: Array
        self.normals, self.slope = self._facing(pose) if facing is None else (facing.normals, facing.slope)
        # where `terms` last was: what the vision rows cost, how many count, and what blocks of the image are off by
        self.seen_cost, self._used = 0.0, 0
        self._at: tuple[Array, Array] | None = None
        # stands for this system where its problem remembers it: a reference back would keep both from being let go
        self._own = object()
        self._off: tuple[Array, Array] | None = None

    def start(self, pose: Array) -> Array:
        """The unknowns (size,) as first guessed from pose (4, 4): the calibration as the hand is seen; without it, if
        it costs less, as contacts have it together. Each by itself, all would be taken for false ones where a rig
        is off by more than they are said to be, and a false one pulls at nothing.
        """
        unknown = np.zeros(self.size)
        if self.problem.hand is not None:
            unknown[XI] = np.linalg.solve(self.white_xi, self.problem.hand.xi)
            return unknown
        felt = self.problem.felt
        if not (self.problem.has_robot and self.problem.camera is not None and felt.on.any()):
            return unknown
        root = np.linalg.inv(self.white_xi)
        rigid = Prior(pose, np.asarray(root.T @ root, dtype=np.float64))
        widened = felt.widened(float(np.sqrt(np.square(self.white_xi[3:]).sum() / 3.0)))
        model = self.problem.model
        moved = align(model, widened, pose[None], rigid).poses[0]
        together = unknown.copy()
        together[XI] = np.linalg.solve(self.white_xi, -se3.difference(moved, pose, model.centroid))
        return together if self.terms(pose, together)[0] < self.terms(pose, unknown)[0] else unknown

    @property
    def _arguments(self) -> tuple:
        """The system as the kernels take it: see newton_kernels.terms."""
        p, nothing = self.problem, (0.0, np.zeros(0), np.zeros((0, 0)))
        sees, considered = p.camera is not None, not p.pixels_tell
        scene = p.lattice, p.prior_parts, p.no_prior, p.settings.least_cosine, sees, p.settings.bend, considered
        rows = p.seen.rows, p.floors, p.is_pixel, p.sigma, p.weight, self.normals, self.slope
        touch = p.felt_rows, self.white_xi, self.centre
        hand = nothing if self._hand_white is None else self._hand_white
        return scene, (*rows, self.seen_white, float(self.white[SCALE])), touch, hand, p.room

    def _place(self, pose: Array) -> tuple[Array, Array]:
        """Rotation (3, 3) and place of the centroid (3,) at pose (4, 4)."""
        return pose[:3, :3].copy(), pose[:3, :3] @ self.problem.model.centroid + pose[:3, 3]

    def terms(self, pose: Array, unknown: Array) -> tuple[float, Array, Array]:
        """Cost, gradient and Gauss-Newton matrix about (delta, whitened xi, s, b)."""
        normal, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        cost, self.seen_cost, self._used = kernels.terms(  # type: ignore[call-arg]
            *self._arguments, *self._place(pose), unknown, normal, gradient
        )
        self._filled((pose, unknown))
        return cost, gradient, normal

    def _filled(self, at: tuple[Array, Array] | None) -> None:
        """The problem's room has been filled, at a pose (4, 4) and unknowns (size,), or nobody asks where."""
        self.problem.filled_by, self._at, self._off = self._own, at, None

    def stand(self, pose: Array, unknown: Array) -> None:
        """Let the problem's room be filled at pose (4, 4) and unknowns (size,), as `terms` does; nothing is worked out
        again where these are the arrays of where it was filled last.
        """
        was = self._at if self.problem.filled_by is self._own else None
        if was is None or was[0] is not pose or was[1] is not unknown:
            scene, seen, _, _, room = self._arguments
            self.seen_cost, self._used = kernels.lay(scene, seen, room, *self._place(pose), unknown)
            self._filled((pose, unknown))

    def descend(self, pose: Array, unknown: Array, free: int) -> tuple[Array, Array, float, Array, float]:
        """Where Gauss-Newton on the first `free` unknowns ends: pose (4, 4), unknowns (size,), cost, Gauss-Newton
        matrix (size, size), and log determinant of what was solved for.
        """
        s, model = self.problem.settings, self.problem.model
        normal, gradient, there = np.zeros((self.size, self.size)), np.zeros(self.size), unknown.copy()
        rotation, middle = self._place(pose)
        limits = free, s.steps, s.worth, s.refused, model.radius
        cost, log_det, self.seen_cost, self._used, is_there = kernels.descend(  # type: ignore[call-arg]
            *self._arguments, limits, self.width, rotation, middle, there, normal, gradient
        )
        rotation = se3.straightened(rotation)
        end = se3.make_pose(rotation, middle - rotation @ model.centroid)
        self._filled((end, there) if is_there else None)
        return end, there, cost, normal, log_det

    def _facing(self, pose: Array) -> tuple[Array, Array]:
        """Which way (n, 3) the surface looks where each pixel meets it at `pose`, object frame, and how much more noise
        (n,) a slope has there. What lies beside a pixel, and what the mesh leaves out, counts along the ray.
        """
        problem, rows = self.problem, self.problem.seen.rows
        normals, slope, cosines = np.zeros((len(rows), 3)), np.ones(len(rows)), np.zeros(len(rows))
        pixels = np.flatnonzero(problem.is_pixel)
        if problem.camera is None or not len(pixels):
            return normals, slope
        surface_met(problem.lattice, rows, problem.is_pixel, *self._place(pose), normals, cosines)
        cosine = np.maximum(cosines[pixels], problem.settings.least_cosine)
        noise = problem.beliefs.depth.sloping_sigma(rows[pixels, 2], cosine, problem.camera.fx)
        slope[pixels] = np.hypot(noise, problem.beliefs.mesh_sigma / cosine) / problem.sigma[pixels]
        return normals, slope

    def misfit(self) -> float:
        """By how much (a factor of variance) pixels are farther off, where `terms` last was, than their sigmas say: 1
        of rows that are no pixels, and not less (`least_misfit`) of those that are better than believed.

        What is believed of a camera is one of many cameras; how large this one's errors are, the frame itself says.
        That is the mean of an inverse gamma distribution, whose prior counts as some of the pixels' independent places,
        so that few of them leave wide tails (Gelman et al., Bayesian Data Analysis, section 2.6; in metrology the Birge
        ratio).
        """
        problem, k = self.problem, self._used
        s = problem.settings
        if problem.camera is None or not k:
            return 1.0
        index, _, _, residual, information, _ = (part[:k] for part in problem.room)
        mine = problem.on[index]
        width = (problem.sigma * self.slope)[index]
        weight = float((information * width**2)[mine].sum())
        if weight <= 0.0:
            return 1.0
        square = float((information * residual**2)[mine].sum()) / weight
        # a frame of few pixels has fewer places, too
        places = s.places * min(1.0, float(mine.sum()) / s.placed_pixels)
        found = (s.believed_places + places * square) / (s.believed_places + places - 2.0)
        return max(found, s.least_misfit)

    def mesh_variance(self) -> float:
        """Square (m^2) of how far the surface is off, smoothly, from where the mesh says, where `terms` last was.

        A scan that is bent, or of another copy of the product, leaves whole blocks of the image off together, whatever
        the pose. What is believed of meshes is the prior, an inverse gamma as for the pixels (`misfit`); what
        independent noise leaves in a block's mean is taken off, and six blocks' worth goes into the pose.
        """
        if self._off is None:
            (index, _, _, residual, information, _), k = self.problem.room, self._used
            self._off = self._blocks_off(index[:k], residual[:k], information[:k])
        return self._mesh_variance(*self._off)

    def _mesh_variance(self, mean: Array, weight: Array) -> float:
        """`mesh_variance` by how far (b,) m blocks of the image are off, and their weights (b,) 1/m^2."""
        s, believed = self.problem.settings, self.problem.beliefs.mesh_sigma**2
        if not len(mean):
            return believed
        square = float(np.maximum(np.square(mean) - 1.0 / weight, 0.0).sum())
        free = max(float(len(weight)) - 6.0, 0.0)
        # fewer blocks than unknowns: they are all taken up by the pose
        square *= min(1.0, free / 6.0)
        return ((s.believed_blocks - 2.0) * believed + square) / (s.believed_blocks + free - 2.0)

    def mesh_or_bias(self, pose: Array, unknown: Array) -> float:
        """`mesh_variance` at pose (4, 4) and unknowns (size,), if the smooth bias of depth there is the mesh's, too."""
        (lattice, _, _, least_cosine, sees, *_), (*rows, _, scale), *_ = self._arguments
        unbiased, room = np.zeros(len(self.problem.seen)), self.problem.rows_room()
        held = least_cosine, sees, *self._place(pose), scale * unknown[SCALE], unbiased
        _, k = vision_rows(lattice, *rows, *held, *room)
        index, _, _, residual, information = room
        return self._mesh_variance(*self._blocks_off(index[:k], residual[:k], information[:k]))

    def _blocks_off(self, index: NDArray[np.int64], residual: Array, information: Array) -> tuple[Array, Array]:
        """How far (b,) m blocks of the image are off on average, and their weights (b,) 1/m^2, by rows `index` (n,),
        residuals (n,) m and their information (n,) 1/m^2; none where no pixel tells.
        """
        problem, s = self.problem, self.problem.settings
        if problem.camera is None:
            return np.zeros(0), np.zeros(0)
        off, weight = blocks_off(problem.pixels, problem.on, index, residual, information, s.groups, s.block)
        return off, weight

    def _blocks(self, index: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
        """(n,) block of the image of each of the rows `index` (n,), and how many there are."""
        s, out = self.problem.settings, np.zeros(len(index), dtype=np.int64)
        return out, number_blocks(self.problem.pixels, index, s.groups, s.block, out)

    def excess_spread(self, whole: Array, misfit: float) -> Array:
        """(6, 6) by how much the pose would move with other pixels, beyond what their sigmas say, where `terms` last
        was. whole (m, m): the information on the first m unknowns, all that is solved for; misfit: factor on the
        variance of a pixel.

        Neighbours share errors that no belief describes: of the mesh, of the camera, of what was taken for the object.
        Pixels are put into blocks of the image, as large as leave a few of them; the answer without each of them, one
        Gauss-Newton step away, says how much they disagree (the delete-a-group jackknife: Wolter, Introduction to
        Variance Estimation, chapter 4; against a sum of outer products of pulls it knows of leverage). What exceeds the
        rows' own information counts.
        """
        problem = self.problem
        if problem.camera is None or not self._used:
            return np.zeros((6, 6))
        free = len(whole)
        index, _, _, residual, information, design = (part[: self._used] for part in problem.room)
        group, groups = self._blocks(index)
        if groups < problem.settings.least_blocks:
            return np.zeros((6, 6))
        columns = np.concatenate([np.arange(6), np.arange(SCALE, self.size)])
        own, moved = np.zeros((free, free)), np.zeros((groups, 6))
        rows = design, information, residual, group, groups, columns
        if not kernels.left_out(*rows, np.ascontiguousarray(whole), problem.settings.leave, own, moved):
            return np.zeros((6, 6))
        spread = moved.T @ moved * ((groups - 1.0) / groups)
        inverse = np.linalg.solve(whole, np.eye(free)[:, :6])
        said = misfit * (inverse.T @ own @ inverse)
        return exceeding(spread, said)

    def field_spread(self, whole: Array, length: float) -> Array:
        """(6, 6) what a smooth error of 1 m along the pixels' residuals, of that correlation length (m), makes of the
        pose where `terms` last was. whole (m, m): the information on the first m unknowns, all that is solved for.

        It is considered, not solved for (Schmidt 1966): contacts and the prior hold against it as they are told, and
        what little is seen of an object turns it farther.
        """
        (index, _, _, _, information, design), free = (part[: self._used] for part in self.problem.room), len(whole)
        mine = self.problem.on[index]
        columns = np.concatenate([np.arange(6), np.arange(SCALE, self.size)])
        solved = columns < free
        inverse = np.linalg.solve(whole, np.eye(free)[:, :6])
        pull = design[mine][:, : len(columns)][:, solved] * information[mine, None]
        out = np.zeros((6, 6))
        field_spread(self.problem.seen.points[index[mine]], pull @ inverse[columns[solved]], length, out)
        return out

    def believed(self, pose: Array) -> Array:
        """(6, 6) what the prior tells of the pose."""
        information = np.zeros((6, 6))
        prior_row(*self._place(pose), self.problem.prior_parts, information, np.zeros(6))
        return information

    def _whitened_hand(self) -> tuple[float, Array, Array]:
        """Terms of the hand's pixels about x = 0 in the whitened unknowns (xi, s, b)."""
        assert self.problem.hand is not None
        scale = self.white[6:]
        normal, gradient = self.problem.hand_normal.copy(), self.problem.hand_gradient.copy()
        # linear about xi_seen: shift to xi = 0
        step = self.problem.hand.xi
        constant = 0.5 * float(self.problem.hand_weight @ self.problem.hand.residual**2)
        constant += 0.5 * float(step @ normal[:6, :6] @ step) - float(gradient[:6] @ step)
        gradient = gradient - normal[:, :6] @ step
        normal[:6] = self.white_xi.T @ normal[:6]
        normal[:, :6] = normal[:, :6] @ self.white_xi
        gradient[:6] = self.white_xi.T @ gradient[:6]
        return constant, gradient * scale, normal * (scale * scale[:, None])


def exceeding(spread: Array, said: Array) -> Array:
    """(6, 6) what a covariance `spread` (6, 6) has beyond another, `said`: along the directions in which they differ.

    `said` is what large numbers leave of one another, and may be singular: what is below a millionth of it counts as
    that.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(said), 1e-300))
    squares, axes = np.linalg.eigh(said * scale * scale[:, None])
    width = np.sqrt(np.maximum(squares, 1e-6))
    lower, upper = axes * width / scale[:, None], axes / width * scale[:, None]
    white = upper.T @ spread @ upper
    values, vectors = np.linalg.eigh(0.5 * (white + white.T))
    root = lower @ vectors * np.sqrt(np.maximum(values - 1.0, 0.0))
    return np.asarray(root @ root.T, dtype=np.float64)
