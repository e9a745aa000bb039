"""The outline as evidence of a pose: gradient and Gauss-Newton matrix in its tangent space, like any other rows.

A place of the predicted outline moves across the image with the pose; where the colours change on the line through it
says how far, and once it is near, the step in brightness there says it to a tenth of a pixel. What all lines share is
solved for with them and left out of what they tell: the image may be shifted against depth (registration), the whole
outline may be seen too fat (blur, the mesh), and rounded edges fade into what is darker behind them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.contour import edge_kernels, kernels
from vision.contour.edges import EdgeSettings, edges_near
from vision.contour.lines import Lines, LineSettings, lines_across
from vision.contour.outline import Outline, OutlineSettings, bends, inner_depths, outline_near, outline_of
from vision.look.pixels import median
from vision.picture.predictor import Predictor

Array = NDArray[np.float64]  # What an outline far beside depth's may tell of, in words.
UNREGISTERED = "image and depth may not be registered"

# Of a squared standard normal, one over its median.
BY_MEDIAN = 2.198

# Which of what all lines share says how fat the outline is, after a shift along both axes; and which, how early rounded
# edges end, before what bends it.
FATTER, FADING = 2, 3

# Share of what is believed of common errors that is left in while the frame is asked for them: keeps what it does not
# tell from being divided by zero.
UNTIED = 1e-3


@dataclass(frozen=True)
class ColouredSettings:
    """What `ContourSettings` is for the image of another camera than depth's. It is shifted, turned, scaled and bent
    against depth: steps in brightness are sharper than that is known.

    Tuned before there were steps, on `d435`, `lab` and `desk`. With steps `lab` gains 3 to 5 % of ADD-S, `studio` 2 and
    `counter` nothing; they took a drill of the nine recorded frames from 1.3 to 1.9 mm off its surface.
    """

    # Times that the outline is drawn and read, and the move (px) from which it is drawn anew.
    rounds: int = 3
    anew: float = 0.7
    # Standard deviations (px) of steps in brightness: none are used.
    sharp: tuple[float, ...] = ()
    # Standard deviations (px) of an outline that is fatter than predicted and of one that is bent, which a frame that
    # shows more widens; blocks that stand for a mesh's own error; the factor on the variance of all else; and how much
    # stronger edges must be elsewhere (see there). At true poses the image bends outlines by 0.2 px on `lab`, 0.5 on
    # `counter`, 0.9 on `studio`, and 1.0 on the two recorded frames whose truth is known. With 0.5, and 0.85 for the
    # factor instead of 1, `lab`, `desk`, `studio` and `counter` are 1 to 2 % farther off, those two 6 to 19 % nearer.
    fatter: float = 0.2
    bent: float = 0.5
    believed_blocks: float = 8.0
    others: float = 0.85
    shift_gain: float = 1.3


@dataclass(frozen=True)
class ContourSettings:
    """What an outline is worth. Tuned on the tuning family `d435`."""

    # Whether any image is asked, and one that is registered with depth as its own is.
    used: bool = True
    own: bool = True
    # Standard deviation (px) of a shift against depth up to which an image is as good as depth's own: steps in
    # brightness are read to 0.2 to 0.8 px. By judgement.
    as_own: float = 0.5
    # Times that the outline is drawn and read, anew only where the last time moved it by more than this (px); and
    # Gauss-Newton steps of each.
    rounds: int = 4
    anew: float = 0.35
    steps: int = 4
    # Standard deviations (px) of a step in brightness beyond its fit, one for each Gauss-Newton step that ends the last
    # round: the pose is off by a pixel when they are fitted, and what the first ones leave tells edges from others.
    sharp: tuple[float, ...] = (0.8, 0.5, 0.3, 0.2)
    # Where steps scatter by this factor more than their fits say (variance, by the median), the image has a pattern of
    # its own, a projector's dots on every line, or the mesh another outline, and steps are not used.
    most_scatter: float = 3.0
    # Standard deviations (px) of a shift of the image against depth, as is believed of the image (`of`); of an outline
    # that is fatter than predicted, and of a line beyond what its colours say.
    shift: float = 0.25
    fatter: float = 0.4
    floor: float = 0.25
    # Standard deviation (px, see `bends`) of how far the image has the outline turned, stretched and sheared, each; 0
    # where depth's own image cannot.
    bent: float = 0.0
    # A rounded edge turns away from the light, so that one that is brighter than what is behind it seems to end early:
    # measured at true poses, by 0.2 px on `d435` and by 1.7 px on `dots`, where a face that ends at a sharp edge is off
    # by 0.1 px. Mean and standard deviation (px) of that where it turns away altogether, for all lines together (none
    # can end late; of means of 0, 1 and 2 the last two gain 3 % of ADD-S on `dots`, nothing elsewhere), and for each
    # step by itself.
    early: float = 1.0
    rounded: float = 2.0
    rounded_each: float = 1.0
    # Lines within this distance (px) of each other say the same: measured, neighbours 4 px apart correlate by a half.
    apart: float = 8.0
    # Side (px) of the blocks of the image within which lines may share more than that; and as how many blocks that
    # show how far blocks disagree the belief counts, that of the mesh's own error: as in the covariance.
    block: float = 24.0
    believed_blocks: float = 3.0
    # Share of lines that are wrong, and the standard deviation (px) of the Gaussian within which a line is read.
    outliers: float = 0.2
    window: float = 2.5
    # Of that Gaussian in the first Gauss-Newton step, where a pose leaves the outline less sure: as many standard
    # deviations of its places, half as many in each step that follows. Of 0, 1 and 2 the last leaves `d435` least off
    # across the ray (vision, 0.55 to 0.38 mm) and changes no other tuning family for the worse.
    wide: float = 2.0
    # Fewer open lines than this tell nothing, nor do they where less than this share of them is clear: what is read
    # there is noise. At 0 to 60 % hidden 25 % of the lines are clear at least, on `dots`, on the other tuning families
    # 32 %; 4 % where a drill lies in its hand's shade.
    least: int = 10
    clear: float = 0.15
    # Places across the outline (px, inside negative) where nothing may be in front of it, and those inside at which the
    # object's own depth is looked up, for it bulges towards the camera.
    looked: tuple[float, ...] = (-6.0, -3.0, 0.0, 3.0, 6.0)
    bulge: tuple[float, ...] = (-3.0, -6.0, -9.0)
    # Depth (m) behind the object up to which something beside it may lie over it, where nobody knows the hand: a finger
    # that holds a handle is no nearer than the handle by more than depth is wrong. Tuned on `stranger`. With a mask,
    # too: where a table meets the object is a shade. Known poses of recorded frames are 0.46 mm off so, otherwise 0.52.
    touching: float = 0.03
    # Where the image's edges lie on the outline only when it is shifted as a whole by more than this (px), and by more
    # than the pose's covariance explains (standard deviations), image and depth may not be registered: edges must be
    # stronger there by this factor than anywhere nearer. Of 1.3, 1.5 and 1.7 the first is passed by 8 % of the frames
    # of `dots` and 4 % of `d435` whose images are right, the others by 1 % at most; of `d435` moved by 7 to 9 px 62, 40
    # and 23 % pass them.
    most_shift: float = 3.0
    most_sigmas: float = 4.0
    shift_gain: float = 1.5
    # Whether the shift is believed to be larger where a frame shows more. By judgement off for an image that is as good
    # as depth's own: of stereo without a projector the image's outline is right and depth's is not.
    learned: bool = False
    # Share of how far errors that depth shares leave distance and tilt open, as it is weighed against the outline: both
    # change an outline by as little as light and blur do. Of 1 the outline took the depth of recorded frames from 1.24
    # to 1.82 mm off the surface, of 0.3 it leaves it at that with the same overlap with masks; `d435` gains by it.
    distance_share: float = 0.3
    # Factor on the variance of all else, as it is weighed against the outline. At true poses of the tuning families the
    # chi-square of lines is a quarter of what they say, that of all else twice as much: of 1, 1.5, 2 and 3 the first
    # gives away what lines know of `d435`, the last follows the dots of `dots`. Of 1.5 and 2 the second gains 2 % more
    # of `d435` (geometric mean of 120 frames), whose 95 % regions hold 2 % more, and as much of `dots`.
    others: float = 2.0
    # Probability that the lines together read another outline than the object's (a finger's, a shade's), which moves
    # the covariance alone: of 0, 0.02, 0.05 and 0.1 what made the true errors of 214 answers of the tuning families
    # likeliest, as a Student distribution whose degrees of freedom it raised.
    another: float = 0.05
    # And by how much more (a factor) where none of the lines were clear, in proportion to those that are not: what is
    # read there may be of something else. Of 0, 0.2 and 0.4 what makes 95 % regions of `dots` by vision hold 90 % (of
    # 83), and leaves those of `d435` at 98.
    unclear: float = 0.4
    # A pose is not moved by more than this (chi-square of six degrees of freedom; 22.5 is passed once in a thousand).
    most_moved: float = 22.5
    outline: OutlineSettings = field(default_factory=OutlineSettings)
    lines: LineSettings = field(default_factory=LineSettings)
    edges: EdgeSettings = field(default_factory=EdgeSettings)
    coloured: ColouredSettings = field(default_factory=ColouredSettings)

    def of(self, shift: float) -> ContourSettings:
        """These for an image that may be shifted against depth by so much (px, standard deviation): one as good as
        depth's own, or else another camera's, for which `coloured` has other numbers.
        """
        if shift <= self.as_own:
            return replace(self, shift=shift)
        c = self.coloured
        return replace(
            self,
            shift=shift,
            learned=True,
            rounds=c.rounds,
            anew=c.anew,
            sharp=c.sharp,
            fatter=c.fatter,
            bent=c.bent,
            believed_blocks=c.believed_blocks,
            others=c.others,
            shift_gain=c.shift_gain,
        )


class ContourEvidence:
    """What the lines across the outline at `pose` (4, 4) camera_from_object say of poses near it.

    why_not: why they say nothing; "" when they do.
    """

    def __init__(
        self,
        frame: Frame,
        model: ObjectModel,
        predictor: Predictor,
        pose: Array,
        mesh_sigma: float,
        settings: ContourSettings | None = None,
        before: tuple[Outline, Array] | None = None,
    ) -> None:
        """predictor: the frame's, which knows what hides the object. mesh_sigma (m): what a mesh leaves out. before:
        `drawn` of a pose nearby.
        """
        self.settings = s = settings or ContourSettings()
        self.lines: Lines | None = None
        self.why_not = ""
        # the whole outline, hidden or not, and the pose it is of
        self.drawn: tuple[Outline, Array] | None = None
        if frame.rgb is None or frame.camera is None or not predictor.sees:
            self.why_not = "no colour image" if frame.rgb is None else "no depth image beside the colours"
            return
        camera = frame.camera
        known, rounded = (model, camera, pose), np.zeros(0)
        outline = outline_of(*known, s.outline) if before is None else outline_near(*known, before, s.outline)
        self.drawn = outline, pose
        if len(outline):
            inner = inner_depths(model, camera, pose, outline, s.bulge)
            is_open = ~_hidden(outline, inner, predictor, s)
            rounded = _rounded(outline, inner[0], camera.fx, -s.bulge[0])[is_open]
            outline = outline.take(is_open)
        if len(outline) < s.least:
            self.why_not = f"only {len(outline)} places of the outline in view"
            return
        self.lines = lines_across(frame.rgb, outline, s.lines)
        self.why_not = self.lines.why_not
        if not self.why_not and self.lines.clear < s.clear * len(outline):
            self.why_not = f"the outline is clear on {self.lines.clear} of {len(outline)} lines only"
        place, normal, focal = outline.points, outline.normals, np.array([camera.fx, camera.fy])
        z = place[:, 2]
        # how far a place moves along its normal (px) when the surface's point moves (m)
        slope = np.concatenate([normal * focal, -((normal * focal * place[:, :2]).sum(axis=1) / z)[:, None]], axis=1)
        slope /= z[:, None]
        centre = pose[:3, :3] @ model.centroid + pose[:3, 3]
        self.jacobian = np.concatenate([se3.cross(place - centre, slope), slope], axis=1)
        self._fades = np.where(_brighter(self.lines), rounded, 0.0) if s.sharp else np.zeros(len(place))
        bent = bends(outline) if s.bent > 0.0 else np.zeros((len(place), 0))
        self.common = np.concatenate([normal, np.ones((len(place), 1)), self._fades[:, None], bent], axis=1)
        self._rows = np.concatenate([self.jacobian, self.common], axis=1)
        self._scale = float(median(camera.fx / z))
        self._mesh = mesh_sigma * self._scale
        fatter = np.hypot(s.fatter, self._mesh)
        self.believed = np.array([s.shift, s.shift, fatter, s.rounded, *[s.bent] * bent.shape[1]]) ** 2.0
        self.common_information = np.diag(1.0 / self.believed)
        alone = np.zeros(len(place))
        kernels.neighbours(outline.places, 0.5 * s.apart, alone)
        self.alone = 1.0 / alone
        self.share = self.alone.copy()
        blocks = np.floor(outline.places / s.block).astype(np.int64)
        blocks -= blocks.min(axis=0)
        self._block = blocks[:, 0] * (int(blocks[:, 1].max()) + 1) + blocks[:, 1]
        self._blocks = int(self._block.max()) + 1
        self._common, self._apart = np.zeros(len(self.believed)), 0.0
        self._edges, self._sharp, self._scatter = np.zeros((0, 2)), 0.0, 1.0

    @property
    def beside(self) -> float:
        """By how much (m) whole blocks of the outline are off beyond what their lines say, as a standard deviation, as
        the frame alone shows it where `terms` last learned it; 0 before.
        """
        return float(np.sqrt(self._apart)) / self._scale if self.lines is not None else 0.0

    @property
    def count(self) -> int:
        """Lines that are open."""
        return 0 if self.lines is None else len(self.lines)

    def terms(
        self, delta: Array, others: tuple[Array, Array] | None = None, sharp: float = 0.0, window: float = 0.0
    ) -> tuple[Array, Array]:
        """Gradient (6,) and Gauss-Newton matrix (6, 6) of the lines' cost (nats) at the pose moved by delta (6,).

        What the lines share is marginalised. Each line is the Gaussian that stands for it where it is expected, with
        the probability that it is none of the wrong ones as its weight. others: gradient and matrix of all else there;
        where they are given, what the lines are worth in all is learned first (see `_register` and `_temper`). sharp:
        standard deviation (px) of the steps in brightness that are next to where the lines are read the first time that
        it is not 0, beyond their fits; they stand for their lines. window: standard deviation (px) of the Gaussian
        within which lines are read, where it is not that of the settings.
        """
        self._sharp = sharp
        if sharp > 0.0 and not len(self._edges):
            self._edges = self._steps(delta)
        left, weight = self._weighted(delta, window)
        if others is not None:
            self._register(left, weight, *others)
            self._temper(left, weight)
        early = np.zeros(len(self.believed))
        early[FADING] = self.common_information[FADING, FADING] * self.settings.early
        gradient, hessian, self._common = np.zeros(6), np.zeros((6, 6)), np.zeros(len(self.believed))
        known = self.common_information, early
        kernels.marginalise(self._rows, weight, left, *known, gradient, hessian, self._common)
        return gradient, hessian

    def _summed(self, left: Array, weight: Array) -> tuple[Array, Array]:
        """Gauss-Newton matrix (10, 10) and gradient (10,) of lines that are off by left (n,) px with weight (n,), by a
        pose's move and what all lines share.
        """
        size = self._rows.shape[1]
        whole, pull = np.zeros((size, size)), np.zeros(size)
        kernels.sum_up(self._rows, weight, left, whole, pull)
        return whole, pull

    def _temper(self, left: Array, weight: Array) -> None:
        """Make all lines less sure, weight (n,) in place, by as much as their pulls scatter more than they should, by
        the median of the lines; and those of a block of the image together no surer than whole blocks disagree: the
        mesh's own error, patterns, shades and a projector's dots are shared beyond neighbours. By how much, is believed
        of meshes and seen here.

        Steps by themselves: of a projector's dots they are fitted as well as of an edge, and are then off by far more.
        """
        off = left + self.common @ self._common
        if self._sharp > 0.0:
            found_edge = np.isfinite(self._edges[:, 1])
            if found_edge.sum() >= self.settings.least:
                squares = np.square(off[found_edge]) / self._variance()[found_edge]
                self._scatter = max(1.0, BY_MEDIAN * float(median(squares)))
        found, information = np.zeros(3), np.zeros(self._blocks)
        prior = self._mesh**2, float(self.settings.believed_blocks)
        # a pose and the lines' common errors fit five of an outline's blocks, about
        kernels.temper(off, weight, self.share, self.alone, self._block, 5, prior, found, information)
        self._apart = float(found[1])

    def _register(self, left: Array, weight: Array, gradient: Array, information: Array) -> None:
        """Widen what another camera's shift against depth may be, and what bends the outline, to what this frame shows
        of either, where all else has gradient (6,) and information (6, 6): the likeliest variance (empirical Bayes),
        no less than is believed.
        """
        if not self.settings.learned:
            return
        hessian, pull = self._summed(left, weight)
        hessian[:6, :6] += information
        pull[:6] += gradient
        hessian[6:, 6:] += UNTIED * np.diag(1.0 / self.believed)
        inverse = np.linalg.inv(hessian)
        found, spread = -(inverse @ pull)[6:], np.diag(inverse)[6:]
        squares, believed = np.square(found) - spread, self.believed.copy()
        for some in (slice(0, FATTER), slice(FADING + 1, None)):
            believed[some] = np.maximum(believed[some], squares[some].mean() if len(squares[some]) else 0.0)
        self.common_information = np.diag(1.0 / believed)

    def _weighted(self, delta: Array, window: float = 0.0) -> tuple[Array, Array]:
        """How far (n,) px each predicted place, moved by delta (6,), is from what its line says, what all share left
        in; and the line's weight (n,). window (px): as in `terms`.
        """
        assert self.lines is not None
        s = self.settings
        left, weight = np.zeros(len(self.lines)), np.zeros(len(self.lines))
        wrong = s.outliers / (1.0 - s.outliers) / self.lines.log_p.shape[1]
        widths = window or s.window, s.floor, wrong
        given = self.lines.log_p, self.lines.lowest, self._rows, np.concatenate([delta, self._common])
        kernels.weigh(*given, widths, self.share, left, weight)
        if self._sharp > 0.0 and self._scatter <= s.most_scatter:
            variance = self._scatter * self._variance()
            edge_kernels.weigh(self._edges, variance, *given[2:], wrong, self.share, left, weight)
        return left, weight

    def _steps(self, delta: Array) -> Array:
        """(n, 2) the step next to where each line is read at the pose moved by delta (6,) (see `edges_near`)."""
        assert self.lines is not None
        expected = self._rows @ np.concatenate([delta, self._common])
        mean, precision = np.zeros(len(self.lines)), np.zeros(len(self.lines))
        kernels.sites(self.lines.log_p, self.lines.lowest, expected, self.settings.window, mean, precision)
        return edges_near(self.lines, np.where(precision > 0.0, mean, np.nan), self.settings.edges)

    def _variance(self) -> Array:
        """(n,) of the steps (px^2), were their scatter what it is said to be; inf where a line has none."""
        each = self.settings.rounded_each * self._fades
        return np.asarray(np.square(self._edges[:, 1]) + self._sharp**2 + np.square(each))

    def uncertain(self, covariance: Array) -> str:
        """Why a pose with this covariance (6, 6) about the centroid is known too little for the lines to be read where
        its outline is; "" when it is not: they reach so far only.
        """
        assert self.lines is not None
        spread = self.spread_of(covariance)
        if spread <= self.settings.lines.reach:
            return ""
        return f"the outline is known to {spread:.0f} px only, and is looked for within {self.settings.lines.reach} px"

    def spread_of(self, covariance: Array) -> float:
        """How far (px, root mean square) a pose with covariance (6, 6) about the centroid may shift the outline."""
        return float(np.sqrt(np.mean(np.einsum("ij,jk,ik->i", self.jacobian, covariance, self.jacobian))))

    @property
    def unclear(self) -> float:
        """Share of the lines whose own samples do not look like their sides."""
        return 0.0 if self.lines is None else 1.0 - self.lines.clear / max(len(self.lines), 1)

    def farthest(self, delta: Array) -> float:
        """How far (px) a move by delta (6,) shifts the line across itself that it shifts most."""
        return float(np.abs(self.jacobian @ delta).max())

    def shift_of(self, delta: Array) -> float:
        """How far (px, root mean square) a move by delta (6,) shifts the outline across itself."""
        return float(np.sqrt(np.mean(np.square(self.jacobian @ delta))))

    def beside_depth(self, covariance: Array) -> Array:
        """By how much (2,) px the outline in the image is shifted against where the pose has it, by more than the
        pose's covariance (6, 6) about the centroid explains; zeros where it is not. Image or pose is off then.
        """
        assert self.lines is not None
        s, most = self.settings, self.settings.lines.reach
        scores = np.zeros((2 * most + 1, 2 * most + 1))
        kernels.shift_scores(self.lines.edges, -float(most), self.lines.outline.normals, most, 0.0, scores)
        row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
        shift = np.array([column - most, row - most], dtype=np.float64)
        steps = np.arange(-most, most + 1)
        near = np.hypot(steps[:, None], steps[None]) <= s.most_shift
        if float(np.linalg.norm(shift)) <= s.most_shift or scores[row, column] < s.shift_gain * scores[near].max():
            return np.zeros(2)
        # how the pose's own error moves the outline as a whole
        fit = np.linalg.lstsq(self.lines.outline.normals, self.jacobian, rcond=None)[0]
        spread = fit @ covariance @ fit.T + s.shift**2 * np.eye(2)
        explained = float(shift @ np.linalg.solve(spread, shift)) <= s.most_sigmas**2
        return np.zeros(2) if explained else shift


def _hidden(outline: Outline, inner: Array, predictor: Predictor, settings: ContourSettings) -> NDArray[np.bool_]:
    """(n,) whether something is in front of the outline's places, or beside them nearer than the object, whose depth
    (m) inside of them is inner (k, n).
    """
    nearest = np.minimum(inner.min(axis=0), outline.points[:, 2])
    across = np.array(settings.looked)[:, None, None] * outline.normals[None]
    # what touches the object on the outer side may lie over it, or in its shade, whatever a mask says, unless it is the
    # robot's own hand, which is drawn
    room = np.zeros(len(across)) if predictor.knows_hand else settings.touching * (np.array(settings.looked) > 0.0)
    beyond = (nearest[None] + room[:, None]).ravel()
    hides = predictor.hides((outline.places[None] + across).reshape(-1, 2), beyond)
    return np.asarray(hides.reshape(len(across), -1).any(axis=0))


def _rounded(outline: Outline, inner: Array, focal: float, inside: float) -> Array:
    """(n,) how far the surface has turned away at the outline's places: one less the cosine of its incidence between
    them and `inside` (px) of them, where its depth is inner (n,) m. 0 for a face that ends at a sharp edge and faces
    the camera.
    """
    there = np.isfinite(inner)
    fall = np.where(there, outline.points[:, 2] - np.where(there, inner, 0.0), 0.0)
    slope = fall * focal / (inside * outline.points[:, 2])
    return np.asarray(1.0 - 1.0 / np.sqrt(1.0 + np.square(slope)))


def _brighter(lines: Lines) -> NDArray[np.bool_]:
    """(n,) whether the image is brighter inside of an outline than beyond it, by the levels of eight pixels each."""
    middle = lines.samples.shape[1] // 2
    levels = lines.samples[:, middle - 8 : middle + 9].sum(axis=2, dtype=np.int64)
    return np.asarray(levels[:, :8].sum(axis=1) > levels[:, 9:].sum(axis=1))
