"""The second pass over a bag: the pixels of the frames that the first pass planned, each image decoded once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError
from scenes.files.formats.images import LARGEST_COUNT
from scenes.formats.conversion import Dropped
from scenes.formats.ros.bag import Bag, stamp_ns
from scenes.formats.ros.images import decode_depth, decode_mask, decode_rgb
from scenes.formats.ros.topics import TopicMap
from scenes.recordings import bop
from scenes.recordings.frames import Frame
from scenes.words import counted

IMAGES = ("depth", "rgb", "mask")
# Millimetres per count: 16UC1 counts millimetres (REP 118); 32FC1 is rounded to a tenth of one.
SCALE_16UC1, SCALE_32FC1 = 1.0, 0.1
# A median (m) that no camera of a hand reads, and 32FC1 in millimetres has from 5 cm on, though REP 118 has metres.
LARGEST_MEDIAN = 50.0


@dataclass
class Plan:
    """A frame to be: its number, stamp, what is known of it, and the images (topic, order in the bag) it waits for.

    cut: how its camera's full image became the one of the camera_info, in words; "" where it is the full one.
    """

    frame: Frame
    stamp: int
    images: dict[str, int]
    cut: str = ""
    seen: dict[str, Any] = field(default_factory=dict)


class Scale:
    """Millimetres per count of the depth images that are written, by frame: as published, or a tenth for 32FC1.

    medians: of the 32FC1 images that were taken as millimetres.
    """

    def __init__(self, asked: float | None) -> None:
        self.asked = asked
        self.by_frame: dict[int, float] = {}
        self.medians: list[float] = []

    def remarks(self, topic: str) -> list[str]:
        """A remark on 32FC1 that was no metres; none where all was."""
        if not self.medians:
            return []
        expected = f"{topic}: expected metres in 32FC1 (REP 118), got a median of {self.medians[0]:.4g}"
        return [f"{expected}: {counted(len(self.medians), 'image')} taken as millimetres"]

    def metres(self, number: int, image: NDArray[Any], topic: str, dropped: Dropped) -> NDArray[np.float32]:
        """(h, w) metres; readings beyond what 16 bits hold at this scale are dropped."""
        counted = image.dtype == np.uint16
        scale = self.asked or (SCALE_16UC1 if counted else SCALE_32FC1)
        self.by_frame[number] = scale
        if counted:
            return (image.astype(np.float64) * (scale * bop.MM)).astype(np.float32)
        known = image[image > 0]
        median = float(np.median(known)) if len(known) else 0.0
        if median > LARGEST_MEDIAN:
            self.medians.append(median)
            image = image * np.float32(bop.MM)
        limit = LARGEST_COUNT * scale * bop.MM
        dropped.add(topic, f"depth readings beyond {limit:.4g} m", int((image > limit).sum()))
        return np.where(image <= limit, image, np.float32(0.0)).astype(np.float32)


DECODERS = {"depth": decode_depth, "rgb": decode_rgb, "mask": decode_mask}


def whole_frames(bag: Bag, topics: TopicMap, plans: list[Plan], scale: Scale, dropped: Dropped) -> Iterator[Frame]:
    """Each frame as soon as its last image has come: images of later frames wait decoded, none is read twice."""
    roles = {topic.name: topic.role for topic in topics.topics if topic.role in IMAGES}
    waiting: dict[tuple[str, int], list[Plan]] = {}
    for plan in plans:
        for key in plan.images.items():
            waiting.setdefault(key, []).append(plan)
    counts: Counter[str] = Counter()
    for name, received, message in bag.messages(list(roles)) if plans else ():
        order = counts[name]
        counts[name] += 1
        wanted = waiting.pop((name, order), [])
        if not wanted:
            continue
        where = f"{bag.path}, {name} at {stamp_ns(message, received) / 1e9:.3f} s"
        image = DECODERS[roles[name]](message, where)
        for plan in wanted:
            plan.seen[roles[name]] = image
            if len(plan.seen) == len(plan.images):
                yield _whole(plan, topics, scale, dropped, where)
                plan.seen.clear()


def _whole(plan: Plan, topics: TopicMap, scale: Scale, dropped: Dropped, where: str) -> Frame:
    depth = plan.seen["depth"]
    camera = plan.frame.camera
    height, width = depth.shape
    if camera is not None and (camera.width, camera.height) != (width, height):
        got = f"{camera.width}x{camera.height}{plan.cut}"
        raise CaptureError(f"{where}: expected camera_info of {width}x{height} like the depth image, got {got}")
    for role in ("rgb", "mask"):
        image = plan.seen.get(role)
        if image is not None and image.shape[:2] != (height, width):
            got = f"{image.shape[1]}x{image.shape[0]}"
            raise CaptureError(f"{where}: expected {role} of {width}x{height} like the depth image, got {got}")
    name = topics.of_role("depth")[0].name
    metres = scale.metres(plan.frame.index, depth, name, dropped)
    return replace(plan.frame, depth=metres, rgb=plan.seen.get("rgb"), mask=plan.seen.get("mask"))
