"""Pieces of the image by depth and colour: what hangs together in depth, parted where its colour changes.

A hand and what it holds, a box on a table of its height, two boxes side by side are one smooth surface to a depth
camera. Colour parts them: graph-based segmentation (Felzenszwalb and Huttenlocher, IJCV 59, 2004; OpenCV's), on hue and
saturation rather than brightness, which light changes. A print parts the object as well, so the parts say what belongs
together at most, never that a thing ends there. Nobody's colours are known beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vision.look.mask.piece_kernels import are_near
from vision.look.pixels import median

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class PartingSettings:
    """When colour parts pieces of the image. Tuned on `desk`, `loose` and `borrowed`, and looked at on recorded frames:
    their prints must not fall into pieces too small to be proposed.
    """

    # Whether colours are asked at all.
    used: bool = True
    # Of CIELAB: weight of brightness L, and of a and b as shares of it, beside which so much (L) is added, because the
    # hue of what is dark is noise.
    brightness: float = 0.1
    chroma: float = 60.0
    dark: float = 15.0
    # Of the segmentation: standard deviation of its blur (cells of the pieces' grid), how little parts (its k, in units
    # of the weighted colours: the larger the fewer), and its smallest part (cells).
    smooth: float = 0.3
    little: float = 60.0
    smallest: int = 12
    # Parts whose mean colours differ by less (weighted), with no more than this between them (m), are seen of one thing
    # through what hides it. So many of the largest are asked.
    alike: float = 8.0
    between: float = 0.03
    asked: int = 24
    # Points of each that distances are told from.
    points: int = 40
    # Nothing is told: by a brightness (of 255) of the brightest twentieth below this; by a share of the image at the
    # bright end of the scale above this; where the widest tenths of the weighted colours differ by less than this.
    darkest: float = 30.0
    clipped: float = 0.6
    contrast: float = 4.0
    # Cells of which every so manieth is looked at for these.
    every: int = 7
    # Or where of the clearest changes of colour over four cells less than this share is within one: blurred.
    sharp: float = 0.35
    # Or where depth's own edges fit the image's better when it is shifted by more than so many cells, by this factor
    # (colour cameras are 1 to 3 px beside depth, a cell is 3 px), up to so many cells.
    shifted: float = 2.0
    shift_gain: float = 1.1
    farthest: int = 5
    # Cells along depth's edges that are asked, at most.
    edges: int = 800


@dataclass(frozen=True)
class Coloured:
    """numbers (h, w): of the parts, from 0, at every so many pixels, -1 where no piece is; what is too small for a part
    has a number from `count` on, one for each piece. groups: which parts may be one thing, each an array of their
    numbers, largest first. why_not: why colour parts nothing; "" when it does.
    """

    numbers: Numbers
    count: int = 0
    groups: tuple[Numbers, ...] = ()
    why_not: str = ""


def parted_by_colour(
    rgb: NDArray[np.uint8],
    points: Array,
    pieces: Numbers,
    settings: PartingSettings | None = None,
    box: tuple[int, int, int, int] | None = None,
    grouped: bool = True,
) -> Coloured:
    """Pieces (h, w) of surfaces with points (h, w, 3), m, at every so many pixels of an image, parted by its colours.

    pieces: numbers from 0, -1 for none. rgb (height, width, 3): the image, whose every k-th pixel they are. box: pixels
    (u0, v0, u1, v1) in which they are parted, what is outside is left out; default everywhere. grouped: whether it is
    asked which parts may be one thing.
    """
    s = settings or PartingSettings()
    step = -(-rgb.shape[0] // pieces.shape[0])
    if not s.used:
        return Coloured(pieces, why_not="not asked for")
    given = pieces
    if box is not None:
        pieces = np.full_like(given, -1)
        near = slice(box[1] // step, -(-box[3] // step)), slice(box[0] // step, -(-box[2] // step))
        pieces[near] = given[near]
    rows, columns = np.flatnonzero((pieces >= 0).any(axis=1)), np.flatnonzero((pieces >= 0).any(axis=0))
    if not len(rows):
        return Coloured(given, why_not="nothing stands out in depth")
    # only where something is, and as far around it as a shift and the changes beside it reach
    room = s.farthest + 2
    top, left = max(int(rows[0]) - room, 0), max(int(columns[0]) - room, 0)
    down, right = min(int(rows[-1]) + room + 1, len(pieces)), min(int(columns[-1]) + room + 1, pieces.shape[1])
    part = slice(top, down), slice(left, right)
    image = rgb[top * step : down * step, left * step : right * step]
    colours, why_not = _colours(image, step, pieces[part].shape, s)
    why_not = why_not or _blurred(colours, s) or _unregistered(colours, points[part][..., 2], pieces[part], s)
    if why_not:
        return Coloured(given, why_not=why_not)
    return _parted(colours, points[part], pieces, part, s, grouped)


def _colours(
    rgb: NDArray[np.uint8], step: int, shape: tuple[int, ...], settings: PartingSettings
) -> tuple[NDArray[np.float32], str]:
    """(h, w, 3) weighted colours at every `step` pixels; and why they tell nothing, "" when they do."""
    import cv2

    s = settings
    # medians: means across an edge are of a third colour, which would be a part of its own
    few = np.ascontiguousarray(cv2.medianBlur(np.ascontiguousarray(rgb), 3)[::step, ::step])
    few = np.asarray(cv2.medianBlur(few, 3), dtype=np.uint8)[: shape[0], : shape[1]]
    none = np.zeros((*few.shape[:2], 3), dtype=np.float32)
    red, green, blue = few[..., 0], few[..., 1], few[..., 2]
    if bool((red == green).all()) and bool((red == blue).all()):
        return none, "the image has no colours"
    brightest = np.maximum(np.maximum(red, green), blue)
    if float(np.percentile(brightest.ravel()[:: s.every], 95)) < s.darkest:
        return none, "the image is dark"
    if float((np.minimum(np.minimum(red, green), blue) == 255).mean()) > s.clipped:
        return none, "the image is overexposed"
    lab = np.asarray(cv2.cvtColor(few.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB), dtype=np.float32)
    light = lab[..., :1]
    found = np.concatenate([s.brightness * light, s.chroma * lab[..., 1:] / (light + s.dark)], axis=2)
    spread = np.percentile(found.reshape(-1, 3)[:: s.every], [5, 95], axis=0)
    if float((spread[1] - spread[0]).max()) < s.contrast:
        return none, "the image is of one colour"
    return np.ascontiguousarray(found, dtype=np.float32), ""


def _sum(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w) sums over three channels (h, w, 3): numpy is slow along an axis of three."""
    return np.asarray(values[..., 0] + values[..., 1] + values[..., 2])


def _blurred(colours: NDArray[np.float32], settings: PartingSettings) -> str:
    """Why the image is too blurred; "" when it is not: of a sharp edge most is within a cell, wherever it lies."""
    if colours.shape[1] < 5:
        return ""
    few = colours[::3]
    change = _sum(np.square(few[:, 1:] - few[:, :-1]))
    far = _sum(np.square(few[:, 4:] - few[:, :-4]))
    clear = far >= np.percentile(far, 98)
    steepest = np.max([change[:, k : k + far.shape[1]][clear] for k in range(4)], axis=0)
    share = float(np.sqrt(np.median(steepest / np.maximum(far[clear], 1e-9))))
    return "" if share >= settings.sharp else f"the image is blurred: {share:.0%} of an edge within 3 px"


def _unregistered(colours: NDArray[np.float32], z: Array, pieces: Numbers, settings: PartingSettings) -> str:
    """Why the image may not be of the same place as depth: colours change beside where pieces end; "" when not."""
    s, most = settings, settings.farthest
    edge = np.zeros(pieces.shape, dtype=bool)
    edge[:, 1:] |= (pieces[:, 1:] != pieces[:, :-1]) & (np.minimum(z[:, 1:], z[:, :-1]) > 0.0)
    edge[1:] |= (pieces[1:] != pieces[:-1]) & (np.minimum(z[1:], z[:-1]) > 0.0)
    # specks of noise have no place in the image
    size = np.bincount(pieces[pieces >= 0], minlength=1)
    large = np.concatenate([size >= 4 * s.smallest, [False]])[pieces]
    edge &= large | np.roll(large, 1, axis=0) | np.roll(large, 1, axis=1)
    row, column = np.nonzero(edge)
    if len(row) < 4 * s.smallest:
        return ""
    thin = slice(None, None, -(-len(row) // s.edges))
    row, column = row[thin], column[thin]
    change = np.zeros(pieces.shape)
    change[:, 1:-1] += _sum(np.abs(colours[:, 2:] - colours[:, :-2]))
    change[1:-1] += _sum(np.abs(colours[2:] - colours[:-2]))
    change /= change + float(np.percentile(change[::3], 90)) + 1e-6
    steps = np.arange(-most, most + 1)
    padded = np.pad(change, most)
    shifted = padded[
        (row + most)[:, None, None] + steps[:, None], (column + most)[:, None, None] + steps[None, None, :]
    ]
    scores = shifted.mean(axis=0)
    scores = np.maximum(scores - np.median(scores), 0.0)  # what any place of the image has
    best = np.unravel_index(int(np.argmax(scores)), scores.shape)
    size_of = np.hypot(steps[:, None], steps[None])
    away = float(size_of[best])
    if away <= s.shifted or scores[best] < s.shift_gain * scores[size_of <= s.shifted].max():
        return ""
    return "colours change beside where depth does: image and depth may not be registered"


def _parted(
    colours: NDArray[np.float32],
    points: Array,
    pieces: Numbers,
    box: tuple[slice, slice],
    settings: PartingSettings,
    grouped: bool,
) -> Coloured:
    """Pieces (h, w), of which the box has colours and points, parted where these change."""
    import cv2

    s, own = settings, pieces[box].ravel()
    graph = cv2.ximgproc.segmentation.createGraphSegmentation(s.smooth, s.little, s.smallest)
    label = np.asarray(graph.processImage(colours), dtype=np.int64).ravel()
    there = np.flatnonzero(own >= 0)
    # a part is a piece's cells of one label; what is too small for one is left over of its piece
    key = own[there] * (int(label.max()) + 1) + label[there]
    counts = np.bincount(key)
    size = counts[counts > 0]
    part = (np.cumsum(counts > 0) - 1)[key]
    large = size >= s.smallest
    count = int(large.sum())
    numbers = np.where(large, np.cumsum(large) - 1, -1)[part]
    left = numbers < 0
    numbers[left] = count + np.unique(own[there][left], return_inverse=True)[1]
    out = np.full(pieces.shape, -1, dtype=np.int64)
    inside = np.full(len(own), -1, dtype=np.int64)
    inside[there] = numbers
    out[box] = inside.reshape(pieces[box].shape)
    seen = colours.reshape(-1, 3)[there], points.reshape(-1, 3)[there]
    return Coloured(out, count, _groups(numbers, size[large], *seen, s) if grouped else ())


def _groups(
    numbers: Numbers, size: Numbers, colours: NDArray[np.float32], points: Array, settings: PartingSettings
) -> tuple[Numbers, ...]:
    """Parts 0, 1, ... with size (k,) of cells with numbers (n,), colours (n, 3) and points (n, 3), by what may be one
    thing seen through what hides it, largest first.
    """
    s = settings
    asked = np.argsort(-size, kind="stable")[: s.asked]
    order = np.argsort(numbers, kind="stable")
    ends = np.cumsum(size)
    cells = [order[ends[one] - size[one] : ends[one]] for one in asked]
    few = [points[own[:: max(1, len(own) // s.points)]] for own in cells]
    mean = np.array([median(colours[own]) for own in cells]).reshape(-1, 3)
    alike = np.square(mean[:, None] - mean[None]).sum(axis=2) < s.alike**2
    leader = np.arange(len(asked))
    for a, b in np.argwhere(np.tril(alike, -1)):
        if leader[a] != leader[b] and are_near(few[a], few[b], s.between):
            leader[leader == leader[a]] = leader[b]
    groups = [asked[leader == one] for one in np.unique(leader)]
    return tuple(sorted(groups, key=lambda group: -int(size[group].sum())))
