"""What a depth camera is made of: pattern, projector, lens, sensor, matcher, clock. Metres, radians, hertz, pixels.

Light is in one unit throughout: 1 is what a white surface sends back that faces the camera, 1 m away, lit by a lamp at
the camera of strength 1 (radiance over its value there).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Pattern:
    """Dots that a projector throws: one to a square cell, at a random place in it, of random strength."""

    # Dots in a square of tangent 1 by 1 of the projector's field (no unit).
    density: float
    # Radius of a dot: standard deviation of its light over the tangent of its direction (no unit).
    radius: float
    # Dots' strengths are drawn evenly from 1 - spread to 1 + spread times their mean.
    spread: float = 0.6
    # Share of the light that is not in dots: an uneven haze, standard deviation `haze_grain` of its mean.
    haze: float = 0.15
    haze_grain: float = 0.5
    # Strength over the field: the mean of the pattern is 1 in the middle.
    power: float = 0.06


@dataclass(frozen=True)
class Imager:
    """Lens and sensor of an infra-red camera."""

    # Blur of the lens: standard deviation in pixels of the frame.
    blur: float = 0.6
    # Electrons of a full pixel, and noise of reading one out (electrons). OV9282-like global-shutter sensors of 3 um.
    full_well: float = 7000.0
    read_noise: float = 12.0
    # Bits of the image that is matched: the matcher takes 8.
    bits: int = 8
    # Automatic exposure: mean of the image that is aimed at (share of full), least and longest exposure (full wells per
    # unit of light), and the largest amplification after it.
    aim: float = 0.28
    exposure: tuple[float, float] = (0.02, 2.0)
    # Exposure is shortened until no more than this share of the image is full.
    overexposed: float = 0.03
    gain: float = 8.0
    # Contrast of laser speckle in one pixel (no unit): each eye sees another.
    speckle: float = 0.12
    # Light of the room (see above), and which share of it comes from one lamp.
    ambient: float = 0.2
    lamp: float = 0.5


@dataclass(frozen=True)
class Matcher:
    """How disparity is found, and which readings are kept."""

    method: Literal["semi-global", "block"] = "semi-global"
    # Disparities searched (px, a multiple of 16): the nearest reading is focal length * baseline / this.
    disparities: int = 128
    # Side of the matching window (px).
    window: int = 7
    # Penalties of semi-global matching for a step of one disparity and for a larger one (per pixel of the window).
    small_step: float = 4.0
    large_step: float = 24.0
    # The best match is this much better than the second (percent), and both eyes agree within (px; semi-global only:
    # a known pattern has no second eye, and OpenCV's block matcher reads unset memory when it compares).
    uniqueness: int = 8
    agreement: int = 1
    # Contrast of a window, in standard deviations of its noise, below which nothing is read: dark and unlit places.
    contrast: float = 1.25
    # Sub-pixel: rounds of refinement by the image's slope in a Gaussian window (standard deviation, px), 0 for the
    # matcher's own; and the smallest step of disparity (px).
    refinements: int = 3
    refinement_window: float = 3.0
    step: float = 1 / 32
    # Side of the median filter (px; 0 is none), and smallest piece that is kept (px) with its largest inner step (px).
    median: int = 5
    speckle_area: int = 60
    speckle_step: float = 1.0


@dataclass(frozen=True)
class Build:
    """How well cameras of a kind are calibrated: standard deviations over cameras of what is left, chosen so that depth
    is off by some 0.5 % at 2 m (datasheet 337029 warrants 2 %).
    """

    # Baseline (share of it), right camera turned against the calibration about x and z (rad) and about y (rad), and
    # its radial distortion (coefficient of the cubic term, tangents): walls are read as bowls.
    baseline: float = 0.0015
    turned: float = 8e-5
    verged: float = 1e-4
    distortion: float = 8e-4


@dataclass(frozen=True)
class StereoCamera:
    """Two infra-red cameras and a projector between or beside them; depth is that of the left one."""

    name: str
    # Right camera and projector: how far to the right (+x) of the left camera (m).
    baseline: float
    projector: float
    pattern: Pattern
    imager: Imager = field(default_factory=Imager)
    matcher: Matcher = field(default_factory=Matcher)
    build: Build = field(default_factory=Build)
    # Farthest reading (m).
    farthest: float = 10.0
    # Rays a pixel side: dots have sub-pixel places.
    samples: int = 2


@dataclass(frozen=True)
class PatternCamera:
    """Structured light: one infra-red camera and the projector `baseline` (m) to its right, whose pattern is known."""

    name: str
    baseline: float
    pattern: Pattern
    imager: Imager = field(default_factory=Imager)
    matcher: Matcher = field(default_factory=Matcher)
    build: Build = field(default_factory=Build)
    # Readings are kept from nearest to farthest (m).
    nearest: float = 0.4
    farthest: float = 5.0
    samples: int = 2


@dataclass(frozen=True)
class TimeOfFlightCamera:
    """A lamp at the camera whose light swings; each pixel measures how late it comes back."""

    name: str
    # Modulation (Hz), highest first: two or more, whose common divisor gives the range without ambiguity.
    frequencies: tuple[float, ...]
    # Electrons that one unit of light (see above) frees in a pixel during the measurement at one frequency; light of
    # the room in the same unit; noise of reading one of four samples (electrons).
    electrons: float
    ambient: float = 0.05
    read_noise: float = 20.0
    # Share of the swing that arrives in the samples (no unit).
    modulation: float = 0.8
    # Electrons of swing below which nothing is read, and electrons of one sample above which it is full.
    least: float = 450.0
    full_well: float = 400000.0
    # Distances of the frequencies that disagree by more than this (m, root mean square) are no reading.
    disagreement: float = 0.06
    # Blur of the lens (px), and light scattered in it: share, and how far (standard deviation, px).
    blur: float = 0.6
    scattered: float = 0.004
    scatter_length: float = 40.0
    # Delay of the lamp against its calibration: standard deviation over cameras (m of distance).
    delay: float = 0.002
    # Times that light is followed from one surface to another, and pixels between the patches that send it on and
    # between those that receive it last.
    bounces: int = 2
    sender_step: int = 16
    receiver_step: int = 8
    # Readings are kept from nearest to farthest (m).
    nearest: float = 0.25
    farthest: float = 5.0
    samples: int = 2


OpticalCamera = StereoCamera | PatternCamera | TimeOfFlightCamera
