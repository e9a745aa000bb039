"""Reference values of BOP's pose errors, by straightforward code of its own: `python tests/helpers/bop_reference.py
FOLDER`.

Written from the definitions of Hodan et al. (BOP Challenge 2020, ECCVW 2020; On evaluation of 6D object pose
estimation, ECCVW 2016) as bop_toolkit has them in pose_error.py, visibility.py and misc.py (visibility "bop19", cost
"step", turns about continuous axes every 1 % of the diameter). Nothing of palpate is used: plain loops, millimetres,
a ray caster of a few lines, JSON and PNG files read and written here. It writes a small data set into FOLDER and prints
the values that tests/scenes/formats/test_formats_metrics.py holds.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 48, 36
K = np.array([[70.0, 0.0, 23.2], [0.0, 72.0, 17.9], [0.0, 0.0, 1.0]])
DEPTH_SCALE = 0.1
DELTA = 15.0
TAUS = [0.05 * i for i in range(1, 11)]
STEP = 0.01
SCENE = "test/000001"

# ---- the data set: a box about its corner, a cone's stump beside its axis, a crooked tetrahedron; millimetres


def box():
    corners = [[x, y, z] for x in (0, 90) for y in (0, 60) for z in (0, 45)]
    faces = [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]  # fmt: skip
    return np.array(corners, float), faces


def stump(sides=24):
    ring = [2 * math.pi * i / sides for i in range(sides)]
    points = [[20 + 40 * math.cos(a), 40 * math.sin(a), -50] for a in ring]
    points += [[20 + 25 * math.cos(a), 25 * math.sin(a), 50] for a in ring]
    points += [[20, 0, -50], [20, 0, 50]]
    faces = []
    for i in range(sides):
        j = (i + 1) % sides
        faces += [[i, j, sides + j], [i, sides + j, sides + i]]
        faces += [[2 * sides, j, i], [2 * sides + 1, sides + i, sides + j]]
    return np.array(points, float), faces


def tetrahedron():
    points = [[0, 0, 0], [80, 5, -3], [10, 70, 4], [15, 20, 65]]
    return np.array(points, float), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


MODELS = {1: box(), 2: stump(), 3: tetrahedron()}
SYMMETRIES = {
    1: {"symmetries_discrete": [[-1, 0, 0, 90, 0, -1, 0, 60, 0, 0, 1, 0, 0, 0, 0, 1]]},
    2: {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [20, 0, 0]}]},
    3: {},
}


def turn(axis, angle):
    """Rodrigues' formula."""
    x, y, z = np.array(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


TRUTHS = {
    0: {
        1: (turn([1, 2, 0.5], 0.8), [-150, -60, 600]),
        2: (turn([0.3, -1, 0.2], 1.3), [20, 40, 620]),
        3: (turn([1, 1, 1], 2.0), [120, -80, 580]),
    },
    1: {
        1: (turn([-1, 0.3, 2], 2.2), [60, 50, 550]),
        2: (turn([1, 0.1, 0], -0.9), [-110, -30, 500]),
        3: (turn([0, 1, -1], 0.4), [-20, 40, 640]),
    },
}
# image, object, rotation about the object's own origin, shift in the camera's axes; before it, a symmetry or none
ERRORS = [
    (0, 1, turn([1, 0, 0], 0.05), [1.0, -2.0, 4.0], 0),
    (0, 2, turn([0, 0, 1], 1.234), [0.5, 0.2, -3.0], 0),
    (0, 3, turn([0, 1, 0], 0.3), [5.0, 5.0, 5.0], 0),
    (1, 1, turn([0, 1, 1], -0.08), [-3.0, 1.0, 2.0], 1),
    (1, 2, turn([1, 1, 0], 0.15), [20.0, -5.0, 9.0], 0),
    (1, 3, turn([1, 0, 2], 2.5), [-30.0, 10.0, 40.0], 0),
]


def estimates():
    """(image, object): rotation (3, 3), translation (3,)."""
    found = {}
    for image, number, rotation, shift, symmetry in ERRORS:
        r, t = (np.array(part, float) for part in TRUTHS[image][number])
        if symmetry:
            member = np.array(SYMMETRIES[number]["symmetries_discrete"][symmetry - 1], float).reshape(4, 4)
            r, t = r @ member[:3, :3], r @ member[:3, 3] + t
        found[image, number] = r @ rotation, t + np.array(shift, float)
    return found


def render(number, rotation, translation):
    """(h, w) depth along z in millimetres, 0 where there is nothing: every pixel's ray against every triangle."""
    vertices, faces = MODELS[number]
    moved = vertices @ rotation.T + translation
    image = np.zeros((HEIGHT, WIDTH))
    corners = np.array([project(point) for point in moved])  # all are before the camera: no pixel beyond them sees it
    (left, top), (right, bottom) = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0))
    for v in range(max(0, int(top)), min(HEIGHT, int(bottom) + 1)):
        for u in range(max(0, int(left)), min(WIDTH, int(right) + 1)):
            ray = np.array([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 1.0])
            nearest = math.inf
            for face in faces:
                a, b, c = moved[face]
                system = np.stack([ray, a - b, a - c], axis=1)
                if abs(np.linalg.det(system)) < 1e-9:
                    continue
                z, p, q = np.linalg.solve(system, a)
                if p >= 0 and q >= 0 and p + q <= 1 and 0 < z < nearest:
                    nearest = z
            if nearest < math.inf:
                image[v, u] = nearest
    return image


def write_dataset(folder: Path) -> dict[tuple[int, int, str], np.ndarray]:
    """Write the data set and poses.csv; returns the renderings at truth ("gt") and estimate ("est")."""
    scene = folder / SCENE
    for part in (scene / "depth", folder / "models"):
        part.mkdir(parents=True)
    infos = {}
    for number, (vertices, faces) in MODELS.items():
        lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
        lines += [f"property double {axis}" for axis in "xyz"]
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        lines += [" ".join(repr(float(x)) for x in row) for row in vertices]
        lines += [f"3 {a} {b} {c}" for a, b, c in faces]
        (folder / "models" / f"obj_{number:06d}.ply").write_text("\n".join([*lines, ""]))
        infos[number] = {"diameter": diameter(number), **SYMMETRIES[number]}
    (folder / "models" / "models_info.json").write_text(json.dumps(infos))
    cameras, truths, pictures = {}, {}, {}
    found = estimates()
    for image, objects in TRUTHS.items():
        seen = np.full((HEIGHT, WIDTH), 900.0)
        rows = []
        for number, (rotation, translation) in objects.items():
            translation = np.array(translation, float)
            pictures[image, number, "gt"] = render(number, rotation, translation)
            pictures[image, number, "est"] = render(number, *found[image, number])
            alone = pictures[image, number, "gt"]
            seen = np.where((alone > 0) & (alone < seen), alone, seen)
            rows.append({"obj_id": number, "cam_R_m2c": rotation.ravel().tolist(), "cam_t_m2c": translation.tolist()})
        seen[10:20, 20:26] = 350.0  # something stands before
        seen[22:27, 4:40] = 0.0  # no reading
        cv2.imwrite(str(scene / "depth" / f"{image:06d}.png"), np.rint(seen / DEPTH_SCALE).astype(np.uint16))
        cameras[image] = {"cam_K": K.ravel().tolist(), "depth_scale": DEPTH_SCALE}
        truths[image] = rows
    (scene / "scene_camera.json").write_text(json.dumps(cameras))
    (scene / "scene_gt.json").write_text(json.dumps(truths))
    with (folder / "poses.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["scene_id", "im_id", "obj_id", "score", "R", "t", "time"])
        for (image, number), (rotation, translation) in found.items():
            cells = [" ".join(repr(float(x)) for x in part.ravel()) for part in (rotation, translation)]
            writer.writerow([1, image, number, 1.0, *cells, -1])
    return pictures


# ---- the errors


def diameter(number):
    vertices = MODELS[number][0]
    return max(float(np.linalg.norm(a - b)) for a in vertices for b in vertices)


def symmetric(info):
    """Rotations and translations of the symmetries: turns about each continuous axis after each discrete one."""
    discrete = [(np.eye(3), np.zeros(3))]
    for row in info.get("symmetries_discrete", []):
        member = np.array(row, float).reshape(4, 4)
        discrete.append((member[:3, :3], member[:3, 3]))
    turns = []
    for row in info.get("symmetries_continuous", []):
        steps = math.ceil(math.pi / STEP)
        offset = np.array(row["offset"], float)
        for i in range(steps):
            rotation = turn(row["axis"], 2 * math.pi * i / steps)
            turns.append((rotation, offset - rotation @ offset))
    turns = turns or [(np.eye(3), np.zeros(3))]
    return [(r2 @ r1, r2 @ t1 + t2) for r1, t1 in discrete for r2, t2 in turns]


def place(pose, points):
    return [pose[0] @ point + pose[1] for point in points]


def project(point):
    image = K @ point
    return image[:2] / image[2]


def add(estimate, truth, points):
    pairs = zip(place(estimate, points), place(truth, points))
    return sum(float(np.linalg.norm(a - b)) for a, b in pairs) / len(points)


def adi(estimate, truth, points):
    found = place(estimate, points)
    return sum(min(float(np.linalg.norm(a - b)) for b in found) for a in place(truth, points)) / len(points)


def maximum(estimate, truth, points, symmetries, measure):
    found = [measure(p) for p in place(estimate, points)]
    worst = []
    for rotation, translation in symmetries:
        equivalent = truth[0] @ rotation, truth[0] @ translation + truth[1]
        expected = [measure(p) for p in place(equivalent, points)]
        worst.append(max(float(np.linalg.norm(a - b)) for a, b in zip(found, expected)))
    return min(worst)


def vsd(estimate, truth, observed, size):
    """Mean over the tolerances, each a share of the diameter."""
    both = alone = 0
    gaps = []
    for v in range(HEIGHT):
        for u in range(WIDTH):
            length = math.hypot((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 1.0)
            e, t, o = (float(image[v, u]) * length for image in (estimate, truth, observed))
            seen_t = t > 0 and (o == 0 or t - o <= DELTA)
            seen_e = e > 0 and (o == 0 or e - o <= DELTA or seen_t)
            if seen_t and seen_e:
                both += 1
                gaps.append(abs(t - e) / size)
            elif seen_t or seen_e:
                alone += 1
    if both + alone == 0:
        return 1.0
    return sum((sum(gap >= tau for gap in gaps) + alone) / (both + alone) for tau in TAUS) / len(TAUS)


def reference(folder: Path, pictures) -> dict[str, dict[str, float]]:
    """Every error of every estimate, from the files: millimetres, pixels, shares; keyed "image object"."""
    infos = json.loads((folder / "models" / "models_info.json").read_text())
    truths = json.loads((folder / SCENE / "scene_gt.json").read_text())
    values = {}
    with (folder / "poses.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            image, number = int(row["im_id"]), int(row["obj_id"])
            estimate = np.array(row["R"].split(), float).reshape(3, 3), np.array(row["t"].split(), float)
            entry = next(e for e in truths[str(image)] if e["obj_id"] == number)
            truth = np.array(entry["cam_R_m2c"]).reshape(3, 3), np.array(entry["cam_t_m2c"])
            points = MODELS[number][0]
            members = symmetric(infos[str(number)])
            counts = cv2.imread(str(folder / SCENE / "depth" / f"{image:06d}.png"), cv2.IMREAD_UNCHANGED)
            values[f"{image} {number}"] = {
                "add": add(estimate, truth, points),
                "adi": adi(estimate, truth, points),
                "mssd": maximum(estimate, truth, points, members, lambda p: p),
                "mspd": maximum(estimate, truth, points, members, project),
                "vsd": vsd(
                    pictures[image, number, "est"],
                    pictures[image, number, "gt"],
                    counts * DEPTH_SCALE,
                    infos[str(number)]["diameter"],
                ),
            }
    return values


if __name__ == "__main__":
    target = Path(sys.argv[1])
    json.dump(reference(target, write_dataset(target)), sys.stdout, indent=4)
    sys.stdout.write("\n")
