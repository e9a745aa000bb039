"""Which way round an object is, told by what is printed on it. Camera frame, metres; colours as shares of white.

A shape may be the same turned by half, and its print is not. At each way that the object may be turned, the print's
colours are predicted at the pixels that show it, and regressed on the image: every channel has a gain, one that may
shade off with the surface's normal, and an offset of its own, so brightness, white balance and lamps do not matter. How
much better the image is explained than by shades alone says how likely that way is (the profile likelihood of a
Gaussian of unknown variance), where the pixels' worth is that of patches, for errors are shared by neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.contour.lines import is_grey
from vision.picture.predictor import Predictor

Array = NDArray[np.float64]

# Shares of red, green and blue in what is seen as brightness (ITU-R BT.601).
LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class PrintSettings:
    """What a print tells. Tuned on printed boxes and cans of the lab's errors (scenes of `print`)."""

    # Whether the print of a model that has one is looked at.
    used: bool = True
    # Whether an answer is right only when the print is the right way round: then one that does not know is no `ok`.
    counts: bool = False
    # Rays along each side of the object's box, half as many again where they show less than `enough` pixels; the most
    # pixels that are compared, and the fewest that tell anything.
    side: int = 24
    enough: int = 100
    most_pixels: int = 120
    least_pixels: int = 50
    # Pixels within this distance (px) of each other say the same, and the image is averaged over so many pixels more
    # than the rays are apart: image and depth, and the pose, are off by so much.
    apart: float = 8.0
    blur: float = 2.0
    # Standard deviation (share of white) of what no print explains, at least.
    floor: float = 0.02
    # Share of the image's variance (beyond shades) that the best way explains for the print to be seen at all, and the
    # posterior share from which it decides.
    explained: float = 0.3
    decides: float = 0.95
    # The share explained at which a print is as likely the object's own as another one (a repainted object, another
    # mesh's print: some of it fits somewhere by chance), and the step over which that changes by e: of 12 frames with
    # the right print it was 0.78 to 0.93, of 36 with another at most 0.73.
    own_at: float = 0.70
    own_step: float = 0.025
    # Or how much less the best way leaves unexplained than any other does (log of the ratio of variances) at which that
    # is so, and its step: all ways of another's print fit by chance alone, whatever light, shadows and blur leave
    # unexplained of the right one. Tuned on printed boxes and cans of `lab`, as they are and lit unevenly, clipped,
    # shifted and compressed: of 269 with another's print, seen another way round, 2 pass 0.6, of 108 others 102.
    apart_at: float = 0.45
    apart_step: float = 0.05
    # Most nats by which a print speaks for one way against another, and by which a start does for its own way against
    # all others together: that knows roughly where the object is, but may be of another face of it.
    most: float = 30.0
    most_start: float = 2.0
    # A way round that the shape only nearly has is fitted unless the print speaks against it by more nats than to be
    # unfitted costs, taken when the print then prefers it by so many, and kept when what is seen and felt speaks
    # against it by at most so many (by judgement).
    unfitted: float = 6.0
    prefers: float = 6.0
    most_worse: float = 12.0
    # Turns about an axis that are tried, and again around the best of each face, in steps of which refinement halves.
    turns: int = 36
    halvings: int = 3
    # Turns nearer than this (rad) are one way round; a tracked object's turn about its own axis is left as it is where
    # the print has it nearer than that (rad, by judgement: what one frame tells of it scatters by 1 to 3 degrees).
    same: float = float(np.deg2rad(20.0))
    least_turn: float = float(np.deg2rad(4.0))
    # Steps, and their length (px), by which the image is shifted each way to see whether it fits depth better there: by
    # this factor (nats), for poses that are not solved yet are some pixels off themselves. Shifted by 10 px it was 2.3
    # to 12 on eight frames, in place 0.4 to 1.2.
    shifts: int = 3
    shift_step: int = 4
    shift_gain: float = 1.5
    # Share of the image explained from which its channels are in order for sure: below, red and blue may be swapped,
    # and are when that explains it better by `prefers`.
    sure_of_channels: float = 0.9


@dataclass(frozen=True)
class SeenPrint:
    """The pixels that show an object: colours (n, c), c 1 for a grey image or 3; points (n, 3) of its surface there and
    their normals (n, 3), camera frame; size (m) of what one averages over; patches: how many pixels' worth they are;
    beside (m, n, c): the colours that many pixels away, from everywhere that the image may be shifted to.
    """

    model: ObjectModel
    colours: Array
    points: Array
    normals: Array
    size: float
    patches: float
    beside: Array
    settings: PrintSettings

    def predicted(self, poses: Array) -> Array:
        """(k, n, c) colours of the print at the pixels when the object is at poses (k, 4, 4)."""
        assert self.model.texture is not None
        inverse = se3.inverse(poses)
        local = self.points @ np.swapaxes(inverse[:, :3, :3], -1, -2) + inverse[:, None, :3, 3]
        found = self.model.texture.at(local.reshape(-1, 3), self.size).reshape(*local.shape)
        open_ = np.isnan(found[..., :1])
        if open_.any():  # where the texture has no colour it says nothing: the mean of what it has
            count = np.maximum((~open_).sum(axis=1, keepdims=True), 1)
            mean = np.where(open_, 0.0, found).sum(axis=1, keepdims=True) / count
            found = np.where(open_, mean, found)
        return found if self.colours.shape[1] == 3 else (found @ LUMA)[..., None]

    def left(self, prints: Array, swapped: bool = False) -> Array:
        """Variance (k, c) that is left in each channel when predicted colours (k, n, c) explain it. swapped: with the
        image's channels in the other order.
        """
        colours = self.colours[:, ::-1] if swapped else self.colours
        plain = self.plain[::-1] if swapped else self.plain
        count = colours.shape[1]
        left = [_explained(prints[..., c], self.shades, colours[None, :, c])[:, 0] for c in range(count)]
        return np.minimum(np.stack(left, axis=1) + self.settings.floor**2, plain)

    def shifted(self, prints: Array) -> tuple[Array, Array]:
        """(k,) nats by which predicted colours (k, n, c) explain the image better than shades do where it is shifted
        so that they explain it best, and the variances (k, c) that they leave there.
        """
        floor, count = self.settings.floor**2, self.colours.shape[1]
        left = np.stack([_explained(prints[..., c], self.shades, self.beside[..., c]) for c in range(count)], axis=-1)
        left = np.minimum(left + floor, self.plain)
        nats = 0.5 * self.patches * np.log(self.plain / left).mean(axis=-1)
        best = np.argmax(nats, axis=1)
        each = np.arange(len(prints))
        return nats[each, best], left[each, best]

    @cached_property
    def shades(self) -> Array:
        """(n, 4) what light does to a surface by how it faces: a constant, and its normals about their mean."""
        return np.concatenate([np.ones((len(self.points), 1)), self.normals - self.normals.mean(axis=0)], axis=1)

    @cached_property
    def plain(self) -> Array:
        """(c,) variance of each channel that shades leave."""
        found = np.linalg.lstsq(self.shades, self.colours, rcond=None)[0]
        return np.asarray(np.mean(np.square(self.colours - self.shades @ found), axis=0) + self.settings.floor**2)

    def nats(self, left: Array, swapped: bool = False) -> Array:
        """(k,) by how much colours that leave variances (k, c) explain the image better than shades do."""
        plain = self.plain[::-1] if swapped else self.plain
        return np.asarray(0.5 * self.patches * np.log(plain / left).mean(axis=1))

    def gains(self, poses: Array) -> Array:
        """(k,) nats by which the print at poses (k, 4, 4) explains the image better than shades do."""
        return self.nats(self.left(self.predicted(poses)))

    def own(self, explained: float, another: float) -> float:
        """Probability that the print is the object's own, when it explains that share of the image the best way round
        and `another` the second best: as little as chance explains, were it another's.
        """
        s, left = self.settings, max(1.0 - explained, 1e-3)
        less = float(np.log(max(1.0 - max(another, 0.0), left) / left))
        off = max((explained - s.own_at) / s.own_step, (less - s.apart_at) / s.apart_step)
        return float(1.0 / (1.0 + np.exp(-np.clip(off, -30.0, 30.0))))

    def explained(self, left: Array) -> float:
        """Share of the image's variance beyond shades that is explained where variances (c,) are left."""
        return float(1.0 - left.sum() / self.plain.sum())


def see_print(
    frame: Frame, model: ObjectModel, predictor: Predictor, pose: Array, settings: PrintSettings | None = None
) -> SeenPrint | str:
    """What the image shows of the object at pose (4, 4), as depth has it; or why that tells nothing of its print."""
    import cv2

    s = settings or PrintSettings()
    if model.texture is None or frame.rgb is None or frame.camera is None or not predictor.sees:
        return "nothing is printed on the mesh" if model.texture is None else "no colours beside depth"
    pixels = predictor.shown(pose, s.side)
    if len(pixels) < s.enough:
        pixels = predictor.shown(pose, 3 * s.side // 2)
    pixels = pixels.thinned(s.most_pixels)
    if len(pixels) < s.least_pixels:
        return f"only {len(pixels)} pixels of the object in view"
    camera, uv = frame.camera, pixels.uv
    rays = np.stack([(uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy, np.ones(len(uv))], axis=1)
    inverse = se3.inverse(pose)
    depth = model.surface.cast(np.broadcast_to(inverse[:3, 3], rays.shape), rays @ inverse[:3, :3].T)
    met = np.isfinite(depth)
    if met.sum() < s.least_pixels:
        return f"only {int(met.sum())} pixels of the object in view"
    points, uv = rays[met] * depth[met, None], uv[met]
    normals = model.field.normals(se3.apply(inverse, points)) @ pose[:3, :3].T
    low, high = np.maximum(uv.min(axis=0) - 16, 0), uv.max(axis=0) + 17
    part = np.ascontiguousarray(frame.rgb[low[1] : high[1], low[0] : high[0]])
    step = float(np.sqrt(pixels.area))
    around = round(step + s.blur)
    part = np.asarray(cv2.blur(part, (around, around)), dtype=np.uint8)
    row, column = (uv - low).T[::-1]
    shifts = np.arange(-s.shifts, s.shifts + 1) * s.shift_step
    shifts = np.array([(v, u) for v in shifts for u in shifts if max(abs(v), abs(u)) > s.shift_step])
    rows = np.clip(row + shifts[:, :1], 0, part.shape[0] - 1)
    columns = np.clip(column + shifts[:, 1:], 0, part.shape[1] - 1)
    colours, beside = (part[v, u].astype(np.float64) / 255.0 for v, u in ((row, column), (rows, columns)))
    if is_grey(frame.rgb[::4, ::4]):
        colours, beside = colours[:, :1], beside[..., :1]
    size = around * float(np.median(points[:, 2])) / camera.fx
    patches = len(points) * min(pixels.area / s.apart**2, 1.0)
    return SeenPrint(model, colours, points, normals, size, patches, beside, s)


def _explained(prints: Array, shades: Array, values: Array) -> Array:
    """(k, m) mean square that an offset and prints (k, n), each times a gain that shades (n, 4) off, leave of values
    (m, n); all of their variance where the gain would be negative.
    """
    count, width = shades.shape
    matrix = np.zeros((len(prints), width + 1, width + 1))
    matrix[:, 0, 0] = count
    matrix[:, 0, 1:] = matrix[:, 1:, 0] = prints @ shades
    pairs = (shades[:, :, None] * shades[:, None]).reshape(count, -1)
    matrix[:, 1:, 1:] = (prints**2 @ pairs).reshape(-1, width, width)
    centred = values - values.mean(axis=1, keepdims=True)
    right = np.zeros((len(prints), width + 1, len(values)))
    right[:, 1:] = (prints @ (shades[:, :, None] * centred.T[:, None]).reshape(count, -1)).reshape(
        -1, width, len(values)
    )
    # a print that is all alike under the pixels tells nothing: held by a hair instead of divided by zero
    matrix += 1e-6 * count * np.eye(width + 1)
    found = np.linalg.solve(matrix, right)
    square = np.mean(centred**2, axis=1)
    left = np.maximum(square - (found * right).sum(axis=1) / count, 0.0)
    return np.asarray(np.where(found[:, 1] > 0.0, left, square))
