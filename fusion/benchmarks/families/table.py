"""The families by name. Report families share no parameter of any generator with those that may be tuned on.

A family is one world: a camera, a robot's errors, a scene, a hand, objects, what the estimator is told of them, and its
own range of seeds. `docs/evaluation.md` says how they are used; tests/fusion/benchmarks/test_families.py holds the
split.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from fusion.benchmarks.families.presets import OWN_PRESETS
from scenes.errors import unknown
from scenes.geometry.cameras import Camera
from scenes.synthesis.noise.presets import PRESETS, NoisePreset

TUNING, REPORT = "tuning", "report"
RECORDED = "recorded"
# Objects of the tuning families: every setting up to now was chosen on them.
TUNED_OBJECTS = ("mug", "drill", "bottle", "hammer", "bust", "box", "l_block", "light_bulb")
# Those of the report families.
HELD_OBJECTS = ("banana", "camera", "kettle", "sprayer")
# Long thin ones, of either.
TUNED_TOOLS, HELD_TOOLS = ("hook", "rake"), ("ladle", "wrench")
YCB_OBJECTS = ("ycb:banana", "ycb:cracker_box", "ycb:mustard_bottle", "ycb:power_drill", "ycb:tomato_soup_can")
# Cameras: a VGA structured-light camera for tuning, a longer lens and another principal point for reports (px).
TUNED_LENS = Camera(570.0, 570.0, 319.5, 239.5, 640, 480)
HELD_LENS = Camera(612.0, 611.0, 326.0, 236.5, 640, 480)
# The same cameras with a quarter of the pixels.
TUNED_COARSE, HELD_COARSE = Camera(285.0, 285.0, 159.5, 119.5, 320, 240), Camera(306.0, 305.5, 163.0, 118.0, 320, 240)
# Camera to object (m).
TUNED_RANGE, HELD_RANGE = (0.45, 0.75), (0.52, 0.92)
LEVELS = (0.0, 0.3, 0.6, 0.8, 0.9)
ALL_LEVELS = (*LEVELS, 0.95)
# Of scenes in which nothing hides more, or touch says too little to go on.
OPEN_LEVELS, GRIPPER_LEVELS = (0.0, 0.3, 0.6), (0.0, 0.2, 0.4)
NO_LEVELS = (math.nan,)


@dataclass(frozen=True)
class Family:
    """One world.

    camera: name of a noise preset or of a camera imitated from its optics; rig: name of the preset whose errors of
    touch and robot there are, "" for the camera's own. occluders, scene: as `synthesize_frames` takes them. hand:
    "five-finger", "stout" (the same kind with other lengths), "gripper" or "" for none. mask: the true visible pixels
    are given. mesh_error: as `believed` takes it. levels: hidden shares, (NaN,) for those that recordings have.
    contacts_a_finger, skin_reach (m): of fingertips with a skin. stands_for: what outside our own scenes it is meant
    to be.
    """

    name: str
    role: str
    camera: str
    stands_for: str
    hand: str = ""
    occluders: str | None = None
    scene: str = ""
    touch: tuple[str, ...] = ("point",)
    rig: str = ""
    mask: bool = False
    mesh_error: str | None = None
    contacts_a_finger: int = 1
    skin_reach: float = 0.0
    objects: tuple[str, ...] = HELD_OBJECTS
    levels: tuple[float, ...] = LEVELS
    lens: Camera = HELD_LENS
    distance: tuple[float, float] = HELD_RANGE

    @property
    def hand_known(self) -> bool:
        """Whether frames have a hand with its joints."""
        return bool(self.hand) and "unknown-hand" not in self.scene

    @property
    def seeds(self) -> range:
        """Seeds of its frames: no seed that a user chooses can make a tuning family draw what a report family does."""
        return range(2**30) if self.role == TUNING else range(2**30, 2**31)

    def preset(self) -> NoisePreset:
        """Its errors. Raises InputError where this installation has no such camera."""
        one = OWN_PRESETS.get(self.camera) or PRESETS.get(self.camera)
        if one is None:
            raise unknown("camera", self.camera, [*OWN_PRESETS, *PRESETS])
        rig = PRESETS[self.rig] if self.rig else one
        return replace(one, touch=rig.touch, robot=rig.robot)


def _tuned(name: str, camera: str, stands_for: str, **how: object) -> Family:
    common = {"objects": TUNED_OBJECTS, "lens": TUNED_LENS, "distance": TUNED_RANGE}
    return Family(name, TUNING, camera, stands_for, **{**common, **how})  # type: ignore[arg-type]


def _held(name: str, camera: str, stands_for: str, **how: object) -> Family:
    return Family(name, REPORT, camera, stands_for, **how)  # type: ignore[arg-type]


FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        # ---- may be tuned on
        _tuned("clean", "clean", "independent noise only", hand="five-finger", levels=ALL_LEVELS),
        _tuned("lab", "lab", "a laboratory, errors by formulas", hand="five-finger", levels=ALL_LEVELS),
        _tuned("loose", "lab", "fingers that no model tells of", occluders="fingers", levels=LEVELS[:-1]),
        _tuned("d435", "d435", "active stereo from its optics, a robot hand", hand="five-finger", rig="lab"),
        _tuned("dots", "dots", "structured light from its optics, dots on every line", hand="five-finger", rig="lab"),
        _tuned(
            "passive", "passive", "stereo without a projector, by a plain matcher, a robot hand", hand="five-finger"
        ),
        _tuned(
            "studio",
            "studio",
            "active stereo and a colour camera beside it that is out of calibration; the mesh has dents",
            hand="five-finger",
            mesh_error="dented",
        ),
        _tuned(
            "counter",
            "studio",
            "the same cameras over a table: shades and a ground next to the object, something loose in front",
            occluders="fingers",
            scene="table",
            touch=(),
            mesh_error="dented",
            levels=OPEN_LEVELS,
        ),
        _tuned(
            "desk",
            "lab",
            "a table-top frame, something loose in front, nothing felt",
            occluders="fingers",
            scene="table",
            touch=(),
            levels=OPEN_LEVELS,
        ),
        _tuned("rough", "rough", "a bad camera, a badly calibrated robot, worn fingertips", hand="five-finger"),
        _tuned(
            "crude",
            "crude",
            "a worse camera and robot than is believed of any, from farther away",
            hand="five-finger",
            distance=(0.5, 0.9),
        ),
        _tuned("bent", "lab", "the mesh is bent, 1.6 mm a direction", hand="five-finger", mesh_error="bent"),
        _tuned(
            "stranger",
            "d435",
            "a hand over a table that nobody has a model of, nothing felt",
            hand="five-finger",
            scene="table+unknown-hand",
            touch=(),
            rig="lab",
        ),
        _tuned("visitor", "studio", "such a hand in colour", hand="five-finger", scene="table+unknown-hand", touch=()),
        _tuned(
            "borrowed",
            "rough",
            "a robot hand without a URDF before a wall, its fingertips report contacts",
            hand="five-finger",
            scene="wall+unknown-hand",
        ),
        _tuned(
            "tools",
            "d435",
            "long thin tools in a robot hand without a URDF over a table, its fingertips report contacts",
            hand="five-finger",
            scene="table+unknown-hand",
            rig="lab",
            objects=TUNED_TOOLS,
            levels=OPEN_LEVELS,
        ),
        _tuned(
            "skin",
            "rough",
            "a robot hand without a URDF over a table, the skin of its fingertips feels several contacts each",
            hand="five-finger",
            scene="table+unknown-hand",
            contacts_a_finger=7,
            skin_reach=0.005,
        ),
        _tuned("smoothed", "smoothed", "depth that a camera maker's viewer has smoothed", hand="five-finger"),
        _tuned("filled", "filled", "depth whose holes its recorder has filled", hand="five-finger"),
        _tuned("registered", "registered", "depth registered to a larger colour image", hand="five-finger"),
        _tuned(
            "coarse",
            "d435",
            "active stereo with few pixels, from farther away: 2 to 3.5 mm a pixel",
            hand="five-finger",
            rig="lab",
            lens=TUNED_COARSE,
            distance=(0.6, 1.0),
        ),
        # ---- only reported
        _held(RECORDED, "", "recorded frames with a true pose, no mask", touch=(), objects=(), levels=NO_LEVELS),
        _held("harsh", "worn", "a worn robot, a bad camera", hand="stout"),
        _held("workshop", "workshop", "a robot hand whose errors are none of the lab's", hand="stout"),
        _held("d455", "d455", "active stereo of a longer baseline", hand="stout"),
        _held("daylight", "daylight", "stereo without a projector, of a longer baseline", hand="stout"),
        _held("xtion", "xtion", "structured light from its optics", hand="stout"),
        _held("retouched", "retouched", "active stereo whose recorder smooths it", hand="stout"),
        _held("patched", "patched", "structured light that is smoothed, its holes filled", hand="stout"),
        _held("aligned", "aligned", "depth registered to a colour image of twice as many pixels a side", hand="stout"),
        _held("azure-kinect", "azure-kinect", "time of flight from its optics", hand="stout"),
        _held("l515", "l515", "scanned time of flight from its optics", hand="stout"),
        _held(
            "distant",
            "d455",
            "active stereo of a longer baseline with few pixels, from farther away",
            hand="stout",
            lens=HELD_COARSE,
            distance=(0.7, 1.2),
        ),
        _held("ycb", "workshop", "scanned household objects", hand="stout", objects=YCB_OBJECTS),
        _held(
            "human-hand",
            "workshop",
            "a person holds the object: no model of the hand, nothing felt",
            hand="stout",
            scene="unknown-hand",
            touch=(),
        ),
        _held(
            "hand-unmodelled",
            "workshop",
            "a robot hand without a URDF whose fingertips report contacts",
            hand="stout",
            scene="unknown-hand",
        ),
        _held(
            "taxels",
            "workshop",
            "a robot hand without a URDF, ten taxels of each fingertip report contacts",
            hand="stout",
            scene="unknown-hand",
            contacts_a_finger=10,
            skin_reach=0.0062,
        ),
        _held(
            "neighbours",
            "workshop",
            "a printed object on a table, others touch and hide it",
            occluders="neighbours",
            scene="table+wall+print",
            touch=(),
            levels=OPEN_LEVELS,
        ),
        _held(
            "gripper",
            "workshop",
            "a parallel gripper over a table, two contacts",
            hand="gripper",
            scene="table+wall",
            levels=GRIPPER_LEVELS,
        ),
        _held(
            "gripper-unmodelled",
            "workshop",
            "a parallel gripper that the estimator knows nothing of",
            hand="gripper",
            scene="table+wall+unknown-hand",
            touch=(),
            levels=GRIPPER_LEVELS,
        ),
        _held(
            "kitchen-tools",
            "workshop",
            "long thin tools in a robot hand without a URDF whose fingertips report contacts",
            hand="stout",
            scene="unknown-hand",
            objects=HELD_TOOLS,
            levels=OPEN_LEVELS,
        ),
        _held("adapter", "workshop", "parts on the hand that the URDF lacks", hand="stout", scene="adapter"),
        _held("fat-mesh", "workshop", "the mesh is 1 mm too fat", hand="stout", mesh_error="fat"),
        _held("scaled-mesh", "workshop", "the mesh is 1 % too large", hand="stout", mesh_error="scaled"),
        _held("other-scan", "workshop", "the mesh is another scan of the product", hand="stout", mesh_error="scan"),
    )
}


def chosen(name: str | None, known: Iterable[str] | None = None) -> tuple[Family, ...]:
    """The named families: one, several with commas between, "all", "tuning" or "report"; None is all. Raises InputError
    listing the names.
    """
    names = list(FAMILIES if known is None else known)
    if name is not None and "," in name:
        several = {one for part in name.split(",") for one in chosen(part.strip(), names)}
        return tuple(FAMILIES[one] for one in names if FAMILIES[one] in several)
    if name in (None, "all"):
        return tuple(FAMILIES[one] for one in names)
    if name in (TUNING, REPORT):
        return tuple(FAMILIES[one] for one in names if FAMILIES[one].role == name)
    if name not in names:
        raise unknown("family", str(name), [*names, "all", TUNING, REPORT])
    return (FAMILIES[name],)
