"""Which messages make a frame: times, tolerance, transforms between samples; what is dropped is counted."""

from __future__ import annotations

import numpy as np
import pytest
from bags import HEIGHT, KINDS, MS, PLAIN, SECOND, START, WIDTH, Messages, converted, plain

from scenes.formats.conversion import numbers_in_time, period_of
from scenes.geometry import poses


@pytest.mark.parametrize("kind", KINDS)
def test_counts_of_what_is_dropped_are_exact(tmp_path, kind, capsys):
    out = plain(kind, 6)
    out.image("/depth", START, np.full((HEIGHT, WIDTH), 7, dtype=np.uint16), "16UC1")  # a second one of that time
    rgb = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    for i, off in ((0, 15), (1, 19), (2, 21), (3, 40), (4, -20)):
        out.image("/color", START + (100 * i + off) * MS, rgb + i, "rgb8")
    for i in (0, 1, 2, 5):  # 3 and 4 have no transform near
        out.transform("/tf", START + (100 * i + 10) * MS, "base", "camera", np.eye(4))
    topics = PLAIN | {"/color": {"role": "rgb"}, "/tf": {"role": "tf"}}
    capture, said = converted(
        tmp_path, out, topics, world="robot base", frames={"world": "base"}, required=["rgb"], tolerance_s=0.02
    )
    assert said["dropped"] == [
        {"what": "/depth", "why": "a stamp that another image has", "count": 1},
        {"what": "/depth", "why": "no rgb within 20 ms", "count": 2},
        {"what": "/depth", "why": "no transform from base to camera within 20 ms", "count": 2},
        {"what": "/color", "why": "nearest to no frame within 20 ms", "count": 3},
    ]
    assert (said["frames"], len(capture)) == (2, 2)
    assert [int(frame.rgb[0, 0, 0]) for frame in capture] == [0, 1]
    assert "dropped 2 of /depth: no rgb within 20 ms" in capsys.readouterr().out


def test_what_is_not_required_is_remarked(tmp_path):
    out = plain("mcap", 3)
    out.image("/color", START, np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8), "rgb8")
    capture, said = converted(tmp_path, out, PLAIN | {"/color": {"role": "rgb"}})
    assert said["remarks"] == ["2 of 3 frames without rgb within 20 ms"]
    assert [frame.rgb is not None for frame in capture] == [True, False, False]


def test_transforms_between_samples(tmp_path):
    out = plain("mcap", 2)
    start, end = poses.exp([0.1, -0.2, 0.3, 0.1, 0.2, 0.3]), poses.exp([0.3, 0.1, -0.2, 0.2, -0.1, 0.4])
    out.transform("/tf", START + 90 * MS, "base", "camera", start)
    out.transform("/tf", START + 120 * MS, "base", "camera", end)
    topics = PLAIN | {"/tf": {"role": "tf"}}
    capture, said = converted(tmp_path, out, topics, world="robot base", frames={"world": "base"})
    assert said["dropped"][0]["count"] == 1
    middle = poses.inverse(capture[0].camera_from_world)
    np.testing.assert_allclose(middle[:3, 3], start[:3, 3] * 2 / 3 + end[:3, 3] / 3, atol=1e-12)
    turned = poses.log_rotation(start[:3, :3].T @ middle[:3, :3])
    np.testing.assert_allclose(turned, poses.log_rotation(start[:3, :3].T @ end[:3, :3]) / 3, atol=1e-12)


def test_a_gap_in_time_is_a_gap_in_the_frames_numbers(tmp_path):
    """The tracker's clock is the number: a second without images is no thirtieth of one."""
    out, period = Messages("mcap"), SECOND // 30
    came = [0, 1, 2, 3, 4, 34, 35, 37]
    for i in came:
        stamp = START + i * period + (3 * MS if i == 35 else 0)  # a camera is never on time
        out.image("/depth", stamp, np.full((HEIGHT, WIDTH), 500, dtype=np.uint16), "16UC1")
        out.camera_info("/depth/info", stamp)
    capture, said = converted(tmp_path, out)
    assert capture.frame_ids == tuple(came)
    assert capture.manifest.notes["stamps_ns"]["34"] == START + 34 * period
    assert said["remarks"] == ["2 gaps in time: frame numbers leave out 30 periods of 33.33 ms"]


def test_images_that_are_dropped_leave_their_numbers_out(tmp_path):
    out = plain("mcap", 6)
    for i in (0, 1, 5):
        out.transform("/tf", START + 100 * i * MS, "base", "camera", np.eye(4))
    topics = PLAIN | {"/tf": {"role": "tf"}}
    capture, said = converted(tmp_path, out, topics, world="robot base", frames={"world": "base"})
    assert capture.frame_ids == (0, 1, 5)
    assert said["dropped"][0]["count"] == 3


@pytest.mark.parametrize(
    ("stamps", "numbers"),
    [
        ([], []),
        ([7], [0]),
        ([7, 7], [0, 1]),
        ([0, 33, 1033], [0, 1, 31]),  # a gap among three is no period
        ([0, 33, 50, 99], [0, 1, 2, 3]),
        ([0, 10, 20, 10**15], [0, 1, 2, 100_002]),  # a clock that was set
    ],
)
def test_numbers_count_periods(stamps, numbers):
    assert numbers_in_time(stamps, period_of(stamps)) == numbers
