"""Images of bags in every encoding, and those that no capture is made of."""

from __future__ import annotations

import bags
import cv2
import numpy as np
import pytest
from bags import HEIGHT, MS, PLAIN, START, WIDTH, Messages, converted, plain, write_map
from commands import refused, run


@pytest.mark.parametrize(
    ("encoding", "channels"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0])],
)
def test_colour_encodings(tmp_path, encoding, channels):
    out, rng = plain("ros1", 1), np.random.default_rng(0)
    rgb = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    out.image("/color", START, rgb[:, :, channels], encoding, pad=3)
    capture, _ = converted(tmp_path, out, PLAIN | {"/color": {"role": "rgb"}})
    assert np.array_equal(capture[0].rgb, rgb)


def test_grey_and_compressed_colour(tmp_path):
    rng = np.random.default_rng(0)
    rgb = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8), (0, 0), 5)
    topics = PLAIN | {"/color": {"role": "rgb"}}
    for name in ("mono8", "png", "jpeg"):
        out = plain("sqlite3", 1)
        if name == "mono8":
            out.image("/color", START, rgb[:, :, 0], "mono8")
        else:
            data = cv2.imencode(f".{name}", rgb[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
            out.compressed("/color", START, data, f"rgb8; {name} compressed bgr8")
        found = converted(tmp_path / name, out, topics)[0][0].rgb
        expected = np.repeat(rgb[:, :, :1], 3, axis=2) if name == "mono8" else rgb
        assert np.abs(found.astype(int) - expected).max() <= (8 if name == "jpeg" else 0)


def test_inverse_depth_and_depth_beyond_what_is_kept(tmp_path):
    rng = np.random.default_rng(1)
    metres = rng.uniform(0.4, 2.0, (HEIGHT, WIDTH)).astype(np.float32)
    metres[0] = 0.0
    out = Messages("ros1")
    out.camera_info("/depth/info", START)
    out.compressed("/depth", START, bags.compressed_metres(metres), "32FC1; compressedDepth png")
    found = converted(tmp_path / "a", out)[0][0].depth
    assert np.array_equal(found == 0, metres == 0)
    assert np.abs(found - metres).max() < 2.0**2 / (100 * 101) + 1e-4  # one count of the inverse depth at 2 m
    far = metres.copy()
    far[1, :5] = 6.6
    out = Messages("mcap")
    out.camera_info("/depth/info", START)
    out.image("/depth", START, far, "32FC1")
    capture, said = converted(tmp_path / "b", out)
    assert said["dropped"] == [{"what": "/depth", "why": "depth readings beyond 6.554 m", "count": 5}]
    assert np.abs(capture[0].depth - np.where(far > 6.55, 0, far)).max() <= 0.0500001e-3
    topics = {"/depth": {"role": "depth", "depth_scale": 0.25}, "/depth/info": {"role": "camera_info"}}
    capture, said = converted(tmp_path / "c", out, topics)
    assert said["dropped"] == []
    assert np.abs(capture[0].depth - far).max() <= 0.1250001e-3


def test_distortion_needs_rectified_images(tmp_path, capsys):
    out = plain("ros1", 1)
    out.camera_info("/depth/info", START + 1, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))
    bag = out.write(tmp_path / "bag")
    made = write_map(tmp_path / "topics.json", PLAIN)
    argv = ("convert", bag, tmp_path / "c", "--topics", made, "--object", "box")
    assert "expected images without distortion, got coefficients up to 0.1" in refused(capsys, *argv)
    write_map(made, {"/depth": {"role": "depth"}, "/depth/info": {"role": "camera_info", "rectified": True}})
    assert run(*argv) == 0


def seen_by(kind, **info):
    """One depth image, and a camera_info that says more than K."""
    out = Messages(kind)
    out.image("/depth", START, np.full((HEIGHT, WIDTH), 500, dtype=np.uint16), "16UC1")
    out.camera_info("/depth/info", START, **info)
    return out


@pytest.mark.parametrize("rectified", [False, True])
@pytest.mark.parametrize(
    ("size", "binning", "region", "expected"),
    [
        ((128, 96), (2, 2), (0, 0, 0, 0), [[40.0, 0.0, 15.625], [0.0, 41.25, 11.875]]),
        ((128, 96), (0, 1), (20, 10, 64, 48), [[80.0, 0.0, 11.25], [0.0, 82.5, 13.75]]),
        ((320, 240), (2, 4), (6, 8, 128, 192), [[40.0, 0.0, 12.625], [0.0, 20.625, 3.9375]]),
        ((64, 48), (1, 1), (0, 0, 64, 48), [[80.0, 0.0, 31.25], [0.0, 82.5, 23.75]]),
    ],
)
@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_binned_images_and_regions_have_their_own_intrinsics(
    tmp_path, kind, size, binning, region, expected, rectified
):
    """K and P are of the full image: the region's corner is subtracted, then what is left divided by the binning."""
    topics = PLAIN | {"/depth/info": {"role": "camera_info", "rectified": rectified}}
    capture, _ = converted(tmp_path, seen_by(kind, size=size, binning=binning, region=region), topics)
    np.testing.assert_allclose(capture[0].camera.matrix[:2], expected, rtol=1e-12)
    assert (capture[0].camera.width, capture[0].camera.height) == (WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("info", "message"),
    [
        (
            {"binning": (2, 2)},
            "like the depth image, got 32x24 (64x48, of which 64x48 at 0, 0, binned 2x2)",
        ),
        ({"region": (20, 0, 64, 48)}, "a region of the 64x48 pixels, got 64x48 at 20, 0, binned 1x1"),
        ({"binning": (99, 1)}, "got 64x48 at 0, 0, binned 99x1"),
    ],
)
def test_regions_that_are_none_of_the_image(tmp_path, capsys, info, message):
    bag = seen_by("mcap", **info).write(tmp_path / "bag")
    made = write_map(tmp_path / "topics.json", PLAIN)
    assert message in refused(capsys, "convert", bag, tmp_path / "c", "--topics", made, "--object", "box")


def test_metres_that_are_millimetres_are_taken_as_such(tmp_path, capsys):
    metres = np.random.default_rng(2).uniform(0.4, 2.0, (HEIGHT, WIDTH)).astype(np.float32)
    metres[:20] = np.nan
    out = Messages("mcap")
    out.camera_info("/depth/info", START)
    for i, image in enumerate((1e3 * metres, 1e3 * metres, np.zeros_like(metres))):
        out.image("/depth", START + i * 100 * MS, image, "32FC1")
    capture, said = converted(tmp_path, out)
    for frame in (capture[0], capture[1]):
        assert np.abs(frame.depth - np.nan_to_num(metres)).max() <= 0.0501e-3
    median = 1e3 * float(np.nanmedian(metres))
    line = f"/depth: expected metres in 32FC1 (REP 118), got a median of {median:.4g}: 2 images taken as millimetres"
    assert said["remarks"] == [line]
    assert said["dropped"] == []
    assert line in capsys.readouterr().out
