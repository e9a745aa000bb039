"""Which messages make a frame: times, tolerance, transforms between samples; what is dropped is counted."""

from __future__ import annotations

import numpy as np
import pytest
from bags import HEIGHT, KINDS, MS, PLAIN, START, WIDTH, converted, plain

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
