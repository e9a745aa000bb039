"""Meshes as found: what is mended, and what is refused with its reason."""

import re

import igl
import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from scenes.errors import MeshError
from scenes.geometry import mesh_repair
from scenes.geometry.surface_kernels import least_patch
from scenes.synthesis import library


def box():
    mesh = trimesh.creation.box((0.06, 0.08, 0.10))
    return np.array(mesh.vertices), np.array(mesh.faces)


def ball(subdivisions=2):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.05)
    return np.array(mesh.vertices), np.array(mesh.faces)


def closed(vertices, faces):
    vertices, faces, mended = mesh_repair.close(vertices, faces, "thing")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    return mesh, mended


def test_a_good_mesh_stays_as_it_is():
    vertices, faces = box()
    out, triangles, mended = mesh_repair.close(vertices, faces, "box")
    assert mended == []
    assert trimesh.Trimesh(out, triangles).volume == pytest.approx(0.06 * 0.08 * 0.10)
    assert len(triangles) == len(faces)


@pytest.mark.parametrize("name", library.names())
def test_library_objects_need_no_repair(name):
    model = library.make(name)
    again = mesh_repair.close(model.vertices, model.faces, name)
    assert again[2] == []
    assert len(again[1]) == len(model.faces)


def test_duplicate_vertices_are_merged():
    vertices, faces = ball()
    soup = vertices[faces].reshape(-1, 3)  # as an STL holds it: every triangle its own corners
    mesh, _ = closed(soup, np.arange(len(soup)).reshape(-1, 3))
    assert len(mesh.vertices) == len(vertices)


def test_corners_with_round_off_are_merged_or_accepted():
    vertices, faces = ball()
    soup = vertices[faces].reshape(-1, 3)
    noisy = soup + 1e-9 * np.random.default_rng(0).normal(size=soup.shape)
    out, triangles, mended = mesh_repair.close(noisy, np.arange(len(soup)).reshape(-1, 3), "soup")
    assert trimesh.Trimesh(out, triangles).volume == pytest.approx(trimesh.Trimesh(vertices, faces).volume, rel=1e-5)
    assert all("no gap" in m for m in mended)


def test_an_inverted_mesh_is_turned():
    vertices, faces = ball()
    mesh, mended = closed(vertices, faces[:, ::-1])
    assert any("outwards" in m for m in mended)
    assert mesh.volume == pytest.approx(trimesh.Trimesh(vertices, faces).volume)


def test_some_triangles_wound_the_wrong_way():
    vertices, faces = ball()
    faces[::3] = faces[::3, ::-1]
    mesh, mended = closed(vertices, faces)
    assert mended
    assert mesh.volume == pytest.approx(trimesh.Trimesh(*ball()).volume)


def test_a_cavity_stays_a_cavity():
    outer, inner = trimesh.creation.icosphere(radius=0.05), trimesh.creation.icosphere(radius=0.03)
    inner.invert()
    both = trimesh.util.concatenate([outer, inner])
    mesh, _ = closed(np.array(both.vertices), np.array(both.faces))
    assert mesh.volume == pytest.approx(outer.volume - abs(inner.volume))


def test_two_bodies_one_of_them_inverted():
    a, b = trimesh.creation.icosphere(radius=0.03), trimesh.creation.icosphere(radius=0.03)
    b.apply_translation([0.1, 0, 0])
    b.invert()
    both = trimesh.util.concatenate([a, b])
    mesh, _ = closed(np.array(both.vertices), np.array(both.faces))
    assert mesh.volume == pytest.approx(2 * a.volume)


def test_one_missing_triangle_is_filled():
    vertices, faces = ball()
    mesh, mended = closed(vertices, faces[1:])
    assert any("1 hole filled" in m for m in mended)
    assert mesh.volume == pytest.approx(trimesh.Trimesh(vertices, faces).volume, rel=1e-6)


def test_a_box_without_lids_is_closed():
    vertices, faces = box()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    sides = faces[np.abs(mesh.face_normals[:, 2]) < 0.5]
    filled, mended = closed(vertices, sides)
    assert any("2 holes filled" in m for m in mended)
    assert filled.volume == pytest.approx(0.06 * 0.08 * 0.10)


@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
@example(85910666, 2)  # two holes that touch in a vertex
def test_a_few_missing_triangles_anywhere(seed, missing):
    vertices, faces = ball(3)
    keep = np.delete(faces, np.random.default_rng(seed).choice(len(faces), missing, replace=False), axis=0)
    mesh, _ = closed(vertices, keep)
    assert mesh.volume == pytest.approx(trimesh.Trimesh(vertices, faces).volume, rel=1e-2)


def test_vertices_that_no_triangle_uses_may_be_anything():
    vertices, faces = ball()
    junk = np.vstack([vertices, [[np.nan, 0, 0], [5.0, 5.0, 5.0]]])
    mesh, _ = closed(junk, faces)
    assert np.isfinite(mesh.vertices).all()
    assert np.ptp(mesh.vertices, axis=0).max() < 0.11


def test_repeated_and_empty_triangles_are_removed():
    vertices, faces = ball()
    mesh, mended = closed(vertices, np.vstack([faces, faces[:2], [[0, 0, 1], [2, 3, 3]]]))
    assert len(mesh.faces) == len(faces)
    assert any("4 empty or repeated" in m for m in mended)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda v, f: (v, f[:0]), r"got \d+ vertices and no triangle"),
        (lambda v, f: (v * [1, 1, 0], f), "expected a solid, got a flat mesh"),
        (lambda v, f: (v, np.vstack([f, [[0, 1, 10_000]]])), r"vertex numbers 0\.\.\d+, got 0\.\.10000"),
        (lambda v, f: (v, np.vstack([f, [[0, 1, -1]]])), r"got -1\.\."),
        (lambda v, f: (np.where(np.arange(len(v))[:, None] == 3, np.nan, v), f), "NaN or infinity"),
        (lambda v, f: (v * np.inf, f), "NaN or infinity"),
        (lambda v, f: (v, f[v[f][:, :, 2].mean(axis=1) > 0]), "expected a closed mesh"),
        (lambda v, f: (v * 0 + 1, f), "expected a solid"),
        (lambda v, f: (v, np.hstack([f, f[:, :1]])), r"triangles of shape \(m, 3\)"),
        (lambda v, f: (v[:, :2], f), r"vertices of shape \(n, 3\)"),
    ],
)
def test_refusals(spoil, message):
    with np.errstate(invalid="ignore"):
        vertices, faces = spoil(*ball())
    with pytest.raises(MeshError, match=f"cup.ply: .*{message}"):
        mesh_repair.close(vertices, faces, "cup.ply")


def test_a_flat_mesh_that_lies_askew_is_refused(recwarn):
    vertices, faces = box()
    turned = (vertices * [1, 1, 0]) @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    with pytest.raises(MeshError, match="expected a solid"):
        mesh_repair.close(turned, faces, "plate")
    assert not [warning for warning in recwarn if issubclass(warning.category, RuntimeWarning)]


def test_half_a_ball_names_how_much_is_missing():
    vertices, faces = ball(3)
    half = faces[vertices[faces][:, :, 2].mean(axis=1) > -0.02]
    with pytest.raises(MeshError, match=r"1 hole, \d+% of its surface once closed"):
        mesh_repair.close(vertices, half, "bowl", mesh_repair.RepairSettings(max_lid_share=0.1))


def test_holes_are_a_share_of_the_closed_surface():
    """Of what a mesh has left, they can be many times as much."""
    vertices, faces = ball(2)
    with pytest.raises(MeshError) as told:
        mesh_repair.close(vertices, faces[::9], "splinters")
    share = int(re.search(r"(\d+)% of its surface", str(told.value))[1])
    assert share <= 100


def test_winding_numbers_agree_with_the_reference(rng):
    model = library.make("mug")
    points = rng.uniform(model.vertices.min(axis=0) - 0.02, model.vertices.max(axis=0) + 0.02, size=(100, 3))
    ours = mesh_repair.winding_numbers(model.vertices, model.faces, points)
    assert np.allclose(ours, igl.winding_number(model.vertices, model.faces, points), atol=1e-9)


def test_a_fin_without_volume_goes_and_leaves_no_hole():
    vertices, faces = ball(2)
    # two triangles, wound against each other, stand on one edge: simplified scans have them
    a, b = faces[0][:2]
    other = int(np.setdiff1d(faces[np.isin(faces, [a]).any(axis=1)], faces[0])[0])
    finned = np.concatenate([faces, [[a, b, other], [b, a, other]]])
    mesh, _ = closed(vertices, finned)
    assert mesh.is_watertight
    assert len(mesh.faces) == len(faces)


def least_area(ring, i, k):
    """Of the patches over corners i to k, by trying all."""
    if k - i < 2:
        return 0.0
    parts = []
    for j in range(i + 1, k):
        area = 0.5 * np.linalg.norm(np.cross(ring[j] - ring[i], ring[k] - ring[i]))
        parts.append(area + least_area(ring, i, j) + least_area(ring, j, k))
    return min(parts)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(3, 9))
def test_the_patch_over_a_rim_is_the_least_of_all(seed, corners):
    ring = np.random.default_rng(seed).normal(size=(corners, 3))
    patch = np.zeros((corners - 2, 3), dtype=np.int64)
    assert least_patch(ring, np.zeros((corners, corners), dtype=bool), 1e-12, patch)
    corner, one, other = np.moveaxis(ring[patch], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(one - corner, other - corner), axis=1).sum()
    assert area == pytest.approx(least_area(ring, 0, corners - 1))
    # every side of the rim is a side of one triangle
    sides = {tuple(sorted(side)) for t in patch.tolist() for side in zip(t, [*t[1:], t[0]])}
    assert {tuple(sorted((n, (n + 1) % corners))) for n in range(corners)} <= sides


def test_a_patch_has_no_chord_that_is_taken():
    ring = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    taken, patch = np.zeros((4, 4), dtype=bool), np.zeros((2, 3), dtype=np.int64)
    for chord in ((0, 2), (1, 3)):
        taken[chord] = True
        found = least_patch(ring, taken, 1e-12, patch)
        assert found == (chord == (0, 2))
        assert not found or {1, 3} <= set(patch[0]) & set(patch[1])


def test_a_scan_without_what_it_stood_on_is_closed_as_it_was():
    """The rim of a scan ends in whole triangles: ragged, and still one lid."""
    model = library.make("bottle")
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    low = model.vertices[:, 2].min()
    rest = model.faces[mesh.triangles_center[:, 2] > low + 0.004]
    assert 0.01 < 1.0 - trimesh.Trimesh(model.vertices, rest).area / mesh.area < 0.3
    whole, mended = closed(model.vertices, rest)
    assert any("filled" in m for m in mended)
    assert whole.volume == pytest.approx(mesh.volume, rel=0.05)
