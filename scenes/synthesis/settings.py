"""What is the same in every synthetic frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from scenes.geometry.cameras import Camera
from scenes.synthesis.staging.loose_fingers import LooseFingerSettings
from scenes.synthesis.staging.tables import TableSettings
from scenes.synthesis.staging.views import ViewSettings


@dataclass(frozen=True)
class SynthesisSettings:
    """Metres, radians, newtons. Values by judgement where no source is named."""

    # A VGA structured-light camera.
    camera: Camera = field(default_factory=lambda: Camera(570.0, 570.0, 319.5, 239.5, 640, 480))
    views: ViewSettings = field(default_factory=ViewSettings)
    fingers: LooseFingerSettings = field(default_factory=LooseFingerSettings)
    # Grasps tried, each with its own views, before the asked occlusion is called out of reach.
    grasps: int = 9
    # What hides the object may come this near to the camera (shares of the object's distance, see ViewSettings): the
    # later ones only after `relax_after` grasps did not reach the asked occlusion with the first.
    foregrounds: tuple[float, ...] = (0.7, 0.5, 0.1)
    relax_after: int = 3
    # Where views drawn at random did not do, cameras walk towards the asked share, with these in turn.
    climb_foregrounds: tuple[float, ...] = (0.7, 0.5, 0.3, 0.1)
    # A wall or table: distance behind the object's centre (m), and largest angle from facing the camera.
    background: bool = True
    background_distance: tuple[float, float] = (0.3, 1.0)
    background_tilt: float = float(np.deg2rad(35.0))
    # Tables, of scenes that have one.
    table: TableSettings = field(default_factory=TableSettings)
    # Things that stand about, beside and behind the object: how many, and the share of the object that they may hide
    # beyond what was asked.
    clutter: tuple[int, int] = (4, 8)
    clutter_hides: float = 0.004
    # The prior is the truth turned and moved by exactly this much (T1 section 4.3).
    prior_angle: float = float(np.deg2rad(16.0))
    prior_distance: float = 0.033
    # Contacts drawn on the object when there is no hand.
    loose_contacts: int = 5
    # Contacts that a fingertip reports, as a skin of taxels does, and how far from its middle they may be (m).
    contacts_a_finger: int = 1
    skin_reach: float = 0.005
    # Forces of a grasp (N), friction coefficient, and the share of the friction cone that is used.
    force: tuple[float, float] = (1.0, 5.0)
    friction: float = 0.5
    friction_used: float = 0.8
    # Torque about the normal: the friction that is left over times this lever (m): a rubber tip of 8 mm radius has
    # about 1 mm; 0 is a hard finger.
    torsion_radius: float = 0.001
    # One draw of calibration, scale, bias, joint and sensor offsets for all frames, as one robot has; sequences always
    # have one. Otherwise every frame is another robot's.
    one_robot: bool = False
    # Depth images are stored in steps of this (m); frames in memory are rounded alike.
    depth_unit: float = 1e-4
    # Write the true visible pixels as the object's mask, and a colour image: of cameras imitated from their optics the
    # infra-red image that depth was read from, in grey.
    mask: bool = False
    rgb: bool = True
    infrared: bool = True
