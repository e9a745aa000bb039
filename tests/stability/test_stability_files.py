"""Damaged files of every kind that is read; and each damage that once came through."""

import struct
import zlib

import numpy as np
import pytest
from cases import files as stability_cases_files
from cases.mutations import mutate

from fusion.results.files import read_covariances
from scenes.errors import CaptureError, InputError, MeshError
from scenes.files.formats import images, ply
from scenes.geometry.objects import ObjectModel
from scenes.robot.sensors import read_sensors

CASES = stability_cases_files.CASES

DEEP = '{"a":' * 100_000 + "1" + "}" * 100_000


def test_holds(case):
    case.run()


def test_damage_repeats_with_its_seed():
    data = b'{"frames": [1, 2, 3], "name": "x"}'
    first, second = ([mutate(data, np.random.default_rng(5)) for _ in range(1)] for _ in range(2))
    assert first == second
    assert len({mutate(data, np.random.default_rng(i)) for i in range(50)}) > 40


def test_json_nested_without_end_is_refused(tmp_path):
    path = tmp_path / "deep.json"
    path.write_text(DEEP)
    with pytest.raises(InputError, match="expected JSON"):
        read_sensors(path)
    with pytest.raises(InputError, match=r"expected a result\.json"):
        read_covariances(path)
    path.write_text('{"frames": [{"frame": Infinity, "covariance": []}]}')
    with pytest.raises(InputError, match=r"expected a result\.json"):
        read_covariances(path)


@pytest.mark.parametrize(("width", "height"), [(46_341, 46_341), (2**31 - 1, 2**31 - 1), (30_000, 20_000)])
def test_an_image_that_claims_too_many_pixels_is_refused(tmp_path, width, height):
    path = tmp_path / "000000.png"
    images.write_depth(path, np.full((4, 4), 0.5, dtype=np.float32), 0.1)
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    path.write_bytes(bytes(data))
    for read in (lambda: images.read_depth(path, 0.1), lambda: images.read_rgb(path), lambda: images.read_mask(path)):
        with pytest.raises(CaptureError, match="pixels"):
            read()


def test_a_header_that_the_decoder_stumbles_over_is_refused(tmp_path):
    path = tmp_path / "000000.png"
    path.write_bytes(b"BM" + struct.pack("<IHHIIiiHHIIiiII", 60, 0, 0, 54, 40, 2**30, 2**30, 1, 24, 0, 0, 0, 0, 0, 0))
    with pytest.raises(CaptureError, match="expected a PNG image"):
        images.read_rgb(path)


@pytest.mark.parametrize(
    "text",
    [
        # a face before any vertex, and a count that is infinite: two ways to stop the reader of text PLY
        "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n3 0 1 2\n",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\ninf 0 1 2\n",
    ],
)
def test_a_mesh_that_stops_its_reader_is_refused(tmp_path, text):
    path = tmp_path / "mesh.ply"
    path.write_text(text)
    with pytest.raises(MeshError, match="expected"):
        ObjectModel.load(path)
    with pytest.raises(MeshError, match="expected"):
        ply.read_cloud(path)
