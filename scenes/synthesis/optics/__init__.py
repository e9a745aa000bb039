"""Depth cameras imitated from their optics: active stereo, structured light, time of flight.

Nothing here adds an error by a formula for depth. Light is followed from the projector or lamp to the surfaces and into
the lens; what the sensor makes of it is matched or demodulated as the cameras do. Shadows, fat and ragged edges, holes,
steps, rounded creases and flying pixels follow.
"""

from __future__ import annotations

from scenes.synthesis.optics.cameras import take
from scenes.synthesis.optics.known_cameras import KNOWN_CAMERAS
from scenes.synthesis.optics.light.things import Material
from scenes.synthesis.optics.settings import OpticalCamera, PatternCamera, StereoCamera, TimeOfFlightCamera
from scenes.synthesis.optics.shots import Shot
from scenes.synthesis.optics.units import CameraUnit, draw_unit

__all__ = [
    "KNOWN_CAMERAS",
    "CameraUnit",
    "Material",
    "OpticalCamera",
    "PatternCamera",
    "Shot",
    "StereoCamera",
    "TimeOfFlightCamera",
    "draw_unit",
    "take",
]
