"""Recorded frames behind fingers: the recorded depth as it is, and fingers that nobody knows drawn before the object.

Recorded frames with a pose show an object in full; a hand hides most of one. Round fingers come from one side, some
centimetres nearer than the object, until a given share of its pixels is hidden; their borders are unread here and
there, as depth cameras leave them. What is felt are three points of the reference's surface below the fingers, a
millimetre off: fingers and touch are simulated here, and nothing else. Answers are judged by the reference pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table, own_seed
from fusion.benchmarks.real.frames import Recorded
from fusion.benchmarks.real.trials import NO_START, STARTS, Start
from fusion.truth.compare import Row, compare_frame
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.recordings.frames import Contacts, Frame

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Shares of the object's pixels that are hidden; the one of a quick run; draws of each.
LEVELS, QUICK_LEVELS, TRIALS, QUICK_TRIALS = (0.3, 0.6, 0.8), (0.6,), 2, 1
# Without a start, and from what a detector leaves.
FROM = (NO_START, STARTS[2])
# Radius (m) of a finger, how far before the object's middle its own lies (m), most of them.
RADIUS, BEFORE, MOST = (0.008, 0.012), (0.015, 0.035), 60
# By how much fingers lean along the image (m over the object's half extent), and turn from the first (rad).
LEAN, TURNED = (-0.02, 0.006), 0.25
# Noise of a finger's depth (m), share of its border's pixels that are unread.
NOISE, UNREAD = 0.0008, 0.6
# Contacts, and how far off each coordinate of one is (m).
TOUCHED, FELT_NOISE = 3, 0.001
# ADD-S (m) of a right answer: of `RealSettings` where the pose is true. An ICP's end is itself a millimetre off.
RIGHT, ICP_END = 0.005, 0.001


@dataclass(frozen=True)
class Behind:
    """A frame behind fingers: with the mask of what is left to see, without contacts; felt (TOUCHED, 3) m, camera
    frame, None where too little of the object is below the fingers; share of the object's pixels that is hidden.
    """

    frame: Frame
    felt: Array | None
    share: float


def behind_fingers(one: Recorded, share: float, rng: np.random.Generator) -> Behind:
    """Fingers before the object until `share` of the mask's pixels with depth is hidden, or `MOST` of them are."""
    frame, camera = one.frame, one.frame.camera
    assert camera is not None
    assert frame.depth is not None
    assert frame.mask is not None
    assert one.reference is not None
    shown = frame.mask & (frame.depth > 0)
    depth = frame.depth.astype(np.float64)
    shade = np.zeros(depth.shape)
    hidden = np.zeros(depth.shape, dtype=bool)
    v, u = np.nonzero(shown)
    middle, extent = np.array([u.mean(), v.mean()]), max(1.0, 0.5 * float(np.hypot(np.ptp(u), np.ptp(v))))
    away, first = float(np.median(depth[shown])), rng.uniform(0.0, 2.0 * np.pi)
    for _ in range(MOST):
        drawn, height = _finger(camera, middle, extent, away, first, rng)
        put = np.isfinite(drawn) & ((depth <= 0) | (drawn < depth))
        depth, shade, hidden = np.where(put, drawn, depth), np.where(put, height, shade), hidden | put
        if (hidden & shown).sum() >= share * shown.sum():
            break
    border = (hidden ^ np.roll(hidden, 1, 0)) | (hidden ^ np.roll(hidden, 1, 1))
    depth[border & (rng.random(depth.shape) < UNREAD)] = 0.0
    rgb = None if frame.rgb is None else _coloured(frame.rgb, hidden, shade, rng)
    left = replace(frame, depth=depth.astype(frame.depth.dtype), rgb=rgb, mask=frame.mask & ~hidden)
    return Behind(left, _felt(one, hidden, rng), float((hidden & shown).sum() / max(int(shown.sum()), 1)))


def _finger(
    camera: Camera, middle: Array, extent: float, away: float, first: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Depth (h, w) m of a round finger with a round tip, infinite beside it, and how high it is there (0 to 1).

    middle (2,), extent: the object's in the image (px); away (m): its depth; first (rad): where fingers come from.
    """
    turned = first + rng.normal(0.0, TURNED)
    along = np.array([np.cos(turned), np.sin(turned)])
    across = np.array([-along[1], along[0]])
    tip = middle + extent * (rng.uniform(-0.8, 0.8) * across + rng.uniform(-0.8, 0.6) * along)
    wide = rng.uniform(*RADIUS) * camera.fx / away
    v, u = np.mgrid[: camera.height, : camera.width]
    beyond = (u - tip[0]) * along[0] + (v - tip[1]) * along[1]
    beside = (u - tip[0]) * across[0] + (v - tip[1]) * across[1]
    off = np.where(beyond >= 0.0, np.abs(beside), np.hypot(beyond, beside)) / wide
    height = np.sqrt(np.maximum(1.0 - off**2, 0.0))
    lean = rng.uniform(*LEAN) * np.clip(beyond / extent, 0.0, 2.0)
    depth = away - rng.uniform(*BEFORE) + lean - height * wide * away / camera.fx
    depth = depth + rng.normal(0.0, NOISE, depth.shape)
    return np.where((off < 1.0) & (beyond < 3.0 * extent), depth, np.inf), height


def _coloured(rgb: NDArray[np.uint8], hidden: Bools, shade: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """The image with fingers of one tone, darker where they turn away."""
    tone = rng.uniform((120.0, 90.0, 70.0), (220.0, 160.0, 130.0))
    skin = tone * (0.5 + 0.5 * shade[..., None] ** 2) + rng.normal(0.0, 4.0, rgb.shape)
    return np.where(hidden[..., None], np.clip(skin, 0.0, 255.0), rgb).astype(np.uint8)


def _felt(one: Recorded, hidden: Bools, rng: np.random.Generator) -> Array | None:
    """Points (TOUCHED, 3) of the reference's surface below the fingers, camera frame, None where there are too few."""
    camera = one.frame.camera
    assert camera is not None
    assert one.reference is not None
    rendered = one.renderer.render(camera, {"object": one.reference}).depth
    below = camera.back_project(rendered, hidden & (rendered > 0))
    if len(below) < TOUCHED:
        return None
    chosen = below[rng.choice(len(below), TOUCHED, replace=False)]
    return np.asarray(chosen + rng.normal(0.0, FELT_NOISE, chosen.shape), dtype=np.float64)


@dataclass(frozen=True)
class HiddenTrial:
    """One method on one frame behind fingers. level: share that was to be hidden; tolerance (m) of a right answer."""

    level: float
    mask: bool
    start: Start
    method: str
    tolerance: float
    row: Row

    @property
    def add_s(self) -> float:
        """Error (m)."""
        return self.row.errors.add_s if self.row.errors is not None else float("nan")

    @property
    def wrong(self) -> bool:
        """Farther off than what is right; what cannot be measured is."""
        return not self.add_s <= self.tolerance

    @property
    def sure(self) -> bool:
        """Said to be right."""
        return self.row.verdict == "ok"


def methods_of(start: Start, mask: bool) -> tuple[str, ...]:
    """What is asked: local methods need a start, or a mask whose middle stands in for one."""
    if start.angle is None:
        return ("vision", "fused", "icp") if mask else ("vision", "fused")
    return ("vision", "fused", "icp", "icp_segmented", "icp_touch")


def hidden_trials(one: Recorded, levels: Iterable[float], count: int, seed: int) -> Iterator[HiddenTrial]:
    """Every case of one frame that has a reference pose; the same fingers and starts for all methods."""
    if one.reference is None:
        return
    tolerance = RIGHT if one.truth is not None else RIGHT + ICP_END
    for level in levels:
        for number in range(count):
            drawn = own_seed(seed, one.name, f"behind fingers {level:g}", number)
            behind = behind_fingers(one, level, np.random.default_rng(drawn))
            # no method reads the truth: errors are measured by it
            shown = replace(behind.frame, camera_from_object_truth=one.reference)
            felt = None if behind.felt is None else replace(shown, contacts=Contacts(behind.felt))
            for start in FROM:
                prior = None
                if start.angle is not None:
                    rng = np.random.default_rng(own_seed(seed, one.name, start.name, number))
                    prior = poses.displaced(one.reference, start.angle, start.distance, one.model.centroid, rng)
                for mask in (True, False):
                    for method in methods_of(start, mask):
                        frame = felt if method in ("fused", "icp_touch") else shown
                        if frame is None:
                            continue
                        given = replace(frame, prior=prior, mask=frame.mask if mask else None)
                        row = compare_frame(given, one.judge, (method,), drawn, agree=False)[0]
                        yield HiddenTrial(level, mask, start, method, tolerance, row)


def look_behind(report: Report, ones: list[Recorded], settings: BenchSettings) -> None:
    """The table, and claims: fused is right as often as vision and any ICP, and never wrong but `ok`."""
    levels = QUICK_LEVELS if settings.quick else LEVELS
    count = settings.count(TRIALS, QUICK_TRIALS)
    found: list[HiddenTrial] = []
    for one in settings.progress(ones, len(ones), "frames behind fingers"):
        found += hidden_trials(one, levels, count, settings.seed)
    if not found:
        return
    report.tables.append(_table(found))
    settings.show(report.tables[-1])
    _claims(report, found)


def _table(found: list[HiddenTrial]) -> Table:
    columns = [Column("hidden"), Column("mask"), Column("start"), Column("method"), Column("tries", 0), Column("right")]
    columns += [
        Column("ADD-S mm"),
        Column("ok / ambiguous / lost"),
        Column("wrong but ok", 0),
    ]
    columns += [Column("ok of right"), Column("ms", 0)]
    table = Table("Recorded frames behind fingers", columns)
    for level, mask, start, some in _cases(found):
        for method in dict.fromkeys(t.method for t in some):
            here = [t for t in some if t.method == method]
            ours = method in ("vision", "fused")
            words = [sum(t.row.verdict == word for t in here) for word in ("ok", "ambiguous", "lost")]
            right = [t for t in here if not t.wrong]
            table.add(
                f"{level:.0%}",
                "mask" if mask else "none",
                start.name,
                method,
                len(here),
                Rate.of([not t.wrong for t in here]),
                Quantile.of([t.add_s for t in here], 1e3),
                " / ".join(map(str, words)) if ours else None,
                sum(t.wrong and t.sure for t in here) if ours else None,
                Rate.of([t.sure for t in right]) if ours and right else None,
                Quantile.of([t.row.time_ms for t in here]),
            )
    table.note = (
        f"Recorded depth, before which fingers are drawn that no model tells of; fused and icp_touch have {TOUCHED}"
        f" contacts below them, {1e3 * FELT_NOISE:.0f} mm off, no others have any. Right: ADD-S to the reference pose"
        f" up to {1e3 * RIGHT:.0f} mm, {1e3 * (RIGHT + ICP_END):.0f} where it is the end of an ICP. The mask is"
        " of what is left to see."
    )
    return table


def _cases(found: list[HiddenTrial]) -> Iterator[tuple[float, bool, Start, list[HiddenTrial]]]:
    for level, mask, start in dict.fromkeys((t.level, t.mask, t.start) for t in found):
        yield level, mask, start, [t for t in found if (t.level, t.mask, t.start) == (level, mask, start)]


def _claims(report: Report, found: list[HiddenTrial]) -> None:
    for level, mask, start, some in _cases(found):
        what = f"{level:.0%} hidden, {'mask' if mask else 'no mask'}, {start.words}"
        shares = {m: np.mean([not t.wrong for t in some if t.method == m]) for m in {t.method for t in some}}
        if "fused" not in shares:
            continue
        fused = float(shares.pop("fused"))
        best = max(sorted(shares), key=lambda m: shares[m])
        report.claims.append(Claim(f"{what}: fused right, against {best}", fused, float(shares[best]), True))
    sure = sum(t.wrong and t.sure for t in found)
    report.claims.append(Claim("behind fingers: wrong but ok", sure, 0, False, 0))
