"""What gels are worth: one, two and three presses against point contacts at the same places, with and without a start
and a camera; single-press localization; calibration; time; slip; recorded grasps where there are some.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.gels.presses import BALL, CALIBRATED, Press, calibrated_digit, calibration, place, presses
from fusion.benchmarks.gels.recorded import add_recorded
from fusion.benchmarks.gels.slip import add_slides, add_tracks
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table, own_seed
from fusion.truth.metrics import pose_error
from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from scenes.robot.gels import Gel
from scenes.synthesis import library
from scenes.synthesis.gels import bridged, pressed_by, see
from scenes.threads import one_blas_thread
from touch.gels.localize import localize_gels
from touch.gels.patches import patch_of, patches_of
from touch.gels.rows import patch_rows
from touch.gels.skin.heights import indentation_of
from touch.localization import Localization, localize

Array = NDArray[np.float64]

# Objects with edges, and one without.
OBJECTS = ("box", "l_block", "drill", "hammer", "mug")
EDGED = ("box", "l_block", "drill", "hammer")
# T1 section 4.3's coarse start, per axis (rad, m).
START = float(np.deg2rad(16.0)) / np.sqrt(3.0), 0.033 / np.sqrt(3.0)
# A mode is the truth when it is closer than this (m, rad).
NEAR = 0.010, float(np.deg2rad(10.0))
# Shares of a chi-square with six degrees of freedom: 95 %.
CHI_SQUARE_95 = 12.592
# Hidden share of the frames with a hand and a camera.
HIDDEN = 0.9


@dataclass(frozen=True)
class Score:
    """Of one answer: rotation (rad) and translation (m) errors modulo symmetry, squared Mahalanobis distance of the
    truth from the nearest mode, whether a mode is near the truth, how many modes, seconds of processor.
    """

    rotation: float
    translation: float
    distance: float
    among: bool
    modes: int
    seconds: float


def run(settings: BenchSettings) -> Report:
    """All tables; of recorded grasps alone where their folder is named."""
    trials = settings.count(12, 2)
    done = f"{trials} trials an object and cell" if settings.data is None else "recorded grasps"
    report = Report("gel", "Gel sensors against point contacts", done, settings.seed)
    if settings.data is None:
        add_presses(report, settings, trials)
        add_calibration(report, settings)
        add_slides(report, settings)
        add_vision(report, settings)
    add_recorded(report, settings)
    if settings.data is None:
        add_tracks(report, settings)
    return report


def score(model: ObjectModel, found: Localization, truth: Array, seconds: float) -> Score:
    """How far the answer is from the truth."""
    error = pose_error(found.pose, truth, model.centroid, model.symmetries)
    near, distance = False, np.inf
    for mode in found.modes:
        one = pose_error(mode.pose, truth, model.centroid, model.symmetries)
        near |= bool(np.linalg.norm(one[:3]) < NEAR[1] and np.linalg.norm(one[3:]) < NEAR[0])
        # several modes are one posterior: its region is theirs together
        distance = min(distance, float(one @ np.linalg.solve(mode.covariance, one)))
    return Score(
        float(np.linalg.norm(error[:3])),
        float(np.linalg.norm(error[3:])),
        distance,
        near,
        len(found.modes),
        seconds,
    )


def _timed(work) -> tuple[Localization, float]:  # type: ignore[no-untyped-def]  # a closure of the loop below
    begin = time.process_time()
    found = work()
    return found, time.process_time() - begin


def add_presses(report: Report, settings: BenchSettings, trials: int) -> None:
    """Presses against contacts: with T1's start, and one press from nowhere."""
    table = Table(
        "With a coarse start (16°, 33 mm): one, two and three presses",
        [
            Column("object"),
            Column("presses", 0),
            Column("points: rotation °", 1),
            Column("gels: rotation °", 1),
            Column("points: mm", 1),
            Column("gels: mm", 1),
            Column("gels: 95 % regions hold"),
        ],
    )
    alone = Table(
        "From nowhere: is the truth among the modes?",
        [
            Column("object"),
            Column("presses", 0),
            Column("points: among"),
            Column("gels: among"),
            Column("points: modes", 1),
            Column("gels: modes", 1),
            Column("gels: processor s", 2),
        ],
    )
    names = settings.some(OBJECTS, 3)
    cells = [(name, count) for name in names for count in (1, 2, 3)]
    held: list[bool] = []
    pooled: dict[str, list[float]] = {"points": [], "gels": []}
    for name, count in settings.progress(cells, len(cells), "presses"):
        model = library.make(name)
        started: dict[str, list[Score]] = {"points": [], "gels": []}
        free: dict[str, list[Score]] = {"points": [], "gels": []}
        for trial in range(trials):
            rng = np.random.default_rng(own_seed(settings.seed, "press", name, count, trial))
            truth = se3.make_pose(se3.random_rotations(1, rng)[0], rng.normal(size=3) * 0.1)
            felt = presses(model, truth, count, rng)
            if len(felt) < count:
                continue
            delta = rng.normal(size=6) * np.repeat(START, 3)
            prior = Prior.isotropic(se3.perturb(truth, delta[None], model.centroid)[0], *START)
            for scores, known in ((started, prior), (free, None)):
                for kind, found, seconds in _answers(model, felt, known, trial):
                    scores[kind].append(score(model, found, truth, seconds))
        rotation = {kind: np.array([s.rotation for s in scores]) for kind, scores in started.items()}
        moved = {kind: [s.translation for s in scores] for kind, scores in started.items()}
        inside = [s.distance < CHI_SQUARE_95 for s in started["gels"]]
        held += inside
        table.add(
            name,
            count,
            *(Quantile.of(rotation[kind], 180 / np.pi) for kind in ("points", "gels")),
            *(Quantile.of(moved[kind], 1e3) for kind in ("points", "gels")),
            Rate.of(inside),
        )
        if name in EDGED and count > 1:  # one press leaves the turn about its normal to the start
            for kind, values in rotation.items():
                pooled[kind] += values.tolist()
        alone.add(
            name,
            count,
            *(Rate.of([s.among for s in free[kind]]) for kind in ("points", "gels")),
            *(Quantile.of([s.modes for s in free[kind]]) for kind in ("points", "gels")),
            Quantile.of([s.seconds for s in free["gels"]]),
        )
    table.note = (
        "Medians over trials; every trial another pose, places, sensors (lamps, skin; the mean calibration of others)."
    )
    report.tables += [table, alone]
    settings.show(table)
    settings.show(alone)
    share = float(np.mean(held)) if held else float("nan")
    ratio = float(np.median(pooled["gels"]) / np.median(pooled["points"])) if pooled["gels"] else float("nan")
    what = "median rotation error, gels over points, two and three presses on objects with edges"
    report.claims.append(Claim(what, ratio, 0.5, False))
    report.claims.append(Claim("95 % regions hold, at least", share, 0.90, True))
    report.claims.append(Claim("95 % regions hold, at most", share, 0.98, False))


def _answers(
    model: ObjectModel, felt: list[Press], prior: Prior | None, seed: int
) -> list[tuple[str, Localization, float]]:
    contacts = Contacts.concatenate([press.contact for press in felt])
    patches = [press.patch for press in felt]
    return [
        ("points", *_timed(lambda: localize(model, contacts, seed, prior=prior))),
        ("gels", *_timed(lambda: localize_gels(model, patches, seed, prior))),
    ]


def add_calibration(report: Report, settings: BenchSettings) -> None:
    """Heights of pressed objects, with lamps and skins that the calibration did not see; and the time of each step."""
    table = Table(
        f"Height from colour, calibrated on {CALIBRATED} other sensors",
        [
            Column("pressed"),
            Column("presses", 0),
            Column("RMS in contact mm", 3),
            Column("75 % below mm", 3),
            Column("90 % below mm", 3),
            Column("to 0.1 mm"),
            Column("of 1 other: RMS mm", 3),
            Column("told sigmas", 1),
            Column("image ms", 1),
            Column("wall ms", 1),
            Column("patch and rows ms", 1),
        ],
    )
    count = settings.count(10, 3)
    every: list[HeightTrial] = []
    for name in settings.some(OBJECTS, 3):
        model = library.make(name)
        found = []
        for trial in range(count):
            rng = np.random.default_rng(own_seed(settings.seed, "height", name, trial))
            # another thread of linear algebra would spin for a while after each product, and count as the image's
            with one_blas_thread():
                tried = _height(model, rng, trial % CALIBRATED)
            if tried is not None:
                found.append(tried)
        every += found
        table.add(name, *_heights_row(found))
    table.add("all", *_heights_row(every))
    table.note = (
        f"Calibrations from presses of a {1e3 * BALL:g} mm ball on other sensors: the mean of {CALIBRATED}, and one"
        " alone. Told sigmas: RMS of the error over what is said of it. Times of processor, and on the clock (longer"
        " where other programs run), on one thread."
    )
    report.tables.append(table)
    settings.show(table)
    errors = [one.error for one in every]
    report.claims.append(Claim("height from colour, median RMS mm", 1e3 * float(np.median(errors)), 0.1, False, 3))
    report.claims.append(
        Claim("ms of processor an image, median", 1e3 * float(np.median([t.image for t in every])), 20.0, False, 1)
    )
    report.claims.append(Claim("ms a patch, median", 1e3 * float(np.median([t.rows for t in every])), 5.0, False, 1))


@dataclass(frozen=True)
class HeightTrial:
    """Of one press: RMS (m) in the contact, with the mean calibration and with one other sensor's; RMS of the error in
    the sigmas that are told; seconds of processor and on the clock for the image, and of processor for patch and rows.
    """

    error: float
    by_one: float
    sigmas: float
    image: float
    wall: float
    rows: float


def _height(model: ObjectModel, rng: np.random.Generator, by: int) -> HeightTrial | None:
    """One press; None where nothing is touched. by: the sensor whose calibration alone is tried, too."""
    gel: Gel = calibrated_digit(rng)
    points, normals = model.sample_surface(1, seed=int(rng.integers(2**31)))
    depth = pressed_by(model, place(points[0], normals[0], 0.001, 0.1, rng), gel)
    if not (depth > 1e-4).any():
        return None
    image = see(gel, depth, rng)
    indentation_of(image, gel)  # what is built once a sensor is no image's time
    clock, begin = time.perf_counter(), time.process_time()
    pressed = indentation_of(image, gel)
    middle, stop = time.process_time(), time.perf_counter()
    patch_rows([patch_of("gel", pressed)])
    end = time.process_time()
    step = gel.working_step
    true = bridged(depth, gel)[::step, ::step]
    on = depth[::step, ::step] > 1e-4
    alone = indentation_of(image, replace(gel, calibration=calibration(by)))
    left = (pressed.depth - true)[on]
    return HeightTrial(
        float(np.sqrt(np.mean(left**2))),
        float(np.sqrt(np.mean((alone.depth - true)[on] ** 2))),
        float(np.sqrt(np.mean((left / pressed.sigma[on]) ** 2))),
        middle - begin,
        stop - clock,
        end - middle,
    )


def _heights_row(found: list[HeightTrial]) -> list[object]:
    errors = np.array([one.error for one in found])
    return [
        len(found),
        Quantile.of(errors, 1e3),
        *(Quantile.of(errors, 1e3, share) for share in (0.75, 0.9)),
        Rate.of([bool(error <= 0.0001) for error in errors]),
        Quantile.of([one.by_one for one in found], 1e3),
        Quantile.of([one.sigmas for one in found]),
        *(Quantile.of([getattr(one, name) for one in found], 1e3) for name in ("image", "wall", "rows")),
    ]


def add_vision(report: Report, settings: BenchSettings) -> None:
    """Hands with a camera: gels on the fingertips against point contacts of the same grasps."""
    from fusion.estimation.estimate import estimate
    from scenes.synthesis.hands import five_finger_hand
    from scenes.synthesis.recording import synthesize_frames

    count = settings.count(8, 1)
    table = Table(
        f"A hand that hides {100 * HIDDEN:.0f} % from the camera",
        [
            Column("object"),
            Column("frames", 0),
            Column("camera and points: rotation °", 1),
            Column("camera and gels: rotation °", 1),
            Column("camera and points: mm", 1),
            Column("camera and gels: mm", 1),
        ],
    )
    names = settings.some(OBJECTS, 1)
    for name in settings.progress(names, len(names), "with a camera"):
        model = library.make(name)
        seed = own_seed(settings.seed, "vision", name)
        frames = synthesize_frames(model, five_finger_hand(), count, HIDDEN, ("point", "gel"), "lab", seed)
        errors: dict[str, list[Array]] = {"points": [], "gels": []}
        for frame in frames:
            assert frame.camera_from_object_truth is not None
            for kind, shown in (("points", _same_places(frame)), ("gels", _without_points(frame))):
                answer = estimate(shown, model, seed=frame.index)
                errors[kind].append(
                    pose_error(answer.pose, frame.camera_from_object_truth, model.centroid, model.symmetries)
                )
        turned = {kind: [float(np.linalg.norm(e[:3])) for e in found] for kind, found in errors.items()}
        moved = {kind: [float(np.linalg.norm(e[3:])) for e in found] for kind, found in errors.items()}
        table.add(
            name,
            len(frames),
            *(Quantile.of(turned[kind], 180 / np.pi) for kind in ("points", "gels")),
            *(Quantile.of(moved[kind], 1e3) for kind in ("points", "gels")),
        )
    table.note = (
        "Gels without a calibration: outline and its own colours. Points: contacts of the fingers whose gel is touched;"
        " a fingertip feels all around, its gel one side. Start 16° and 33 mm off."
    )
    report.tables.append(table)
    settings.show(table)


def _same_places(frame: Frame) -> Frame:
    """The contacts of those fingers whose gels are touched, without the gels."""
    assert frame.hand is not None
    sensors = frame.hand.sensors
    touched = {sensors[patch.sensor].link for patch in patches_of(frame) if len(patch)}
    kept = [row for row, name in enumerate(frame.contacts.sensors) if sensors[name].link in touched]
    return replace(frame, gels={}, contacts=frame.contacts.take(np.array(kept, dtype=np.int64)))


def _without_points(frame: Frame) -> Frame:
    return replace(frame, contacts=Contacts(np.zeros((0, 3))))
