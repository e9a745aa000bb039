"""Depth cameras that one can buy, as far as their optics are published; the rest is chosen and said to be."""

from __future__ import annotations

from scenes.synthesis.optics.settings import (
    Imager,
    Matcher,
    OpticalCamera,
    Pattern,
    PatternCamera,
    StereoCamera,
    TimeOfFlightCamera,
)

# Some 5000 dots over 86 x 57 degrees (Grunnet-Jepsen et al., "Projectors for Intel RealSense depth cameras D4xx", 2018;
# datasheet 337029): 2 tan 43 * 2 tan 28.5 = 2.03 of tangents. The radius of a dot is chosen by eye from its images.
_D435_DOTS = Pattern(density=5000 / 2.03, radius=0.0012)

# Baselines 50 and 95 mm, 3 um global-shutter imagers, 126 disparities searched and 1/32 px steps: datasheet 337029 and
# Keselman et al., "Intel RealSense stereoscopic depth cameras", CVPRW 2017 (census windows of 7 x 7, left-right check,
# median, second peak and neighbours' thresholds). Where the projector stands is read off the datasheet's drawings.
D435 = StereoCamera("d435", baseline=0.050, projector=0.029, pattern=_D435_DOTS)
D455 = StereoCamera("d455", baseline=0.095, projector=0.035, pattern=_D435_DOTS)

# PS1080: baseline 75 mm, windows of 9 x 9, disparity in steps of 1/8 px (Konolige and Mihelich, "Technical description
# of Kinect calibration", 2011); 3 x 3 tiles of 3861 bright spots over 58 x 45 degrees (Reichinger, "Kinect pattern
# uncovered", 2011), light through a narrow filter, so that little of the room's gets in. The range is that of a Kinect
# in practice, 0.4 to 5 m; 0.8 to 3.5 m is advised.
XTION = PatternCamera(
    "xtion",
    baseline=0.075,
    pattern=Pattern(density=9 * 3861 / 0.918, radius=0.0009, spread=0.3, haze=0.05, power=0.5),
    imager=Imager(
        blur=0.6, ambient=0.05, speckle=0.2, bits=10, read_noise=20.0, exposure=(0.02, 1.0), overexposed=0.02
    ),
    matcher=Matcher(method="block", window=9, disparities=128, step=1 / 8, median=0),
)

# Azure Kinect: 0.25 m is the nearest of its modes (wide), 3.86 m the farthest of the narrow one (hardware
# specification); its sensor demodulates at up to 320 MHz (Bamji et al., ISSCC 2018). Which frequencies it uses is not
# published: three with a common divisor of 20 MHz reach 7.5 m. Electrons are set so that the standard deviation is the
# measured 1 mm or so at 1 to 2 m (Toelgyessy et al., "Evaluation of the Azure Kinect", Sensors 2021).
AZURE_KINECT = TimeOfFlightCamera(
    "azure-kinect", frequencies=(220e6, 180e6, 140e6), electrons=60000.0, nearest=0.25, farthest=3.86
)

# L515: a beam of coded infra-red light is scanned and its phase measured, one detector for the whole field; ways of
# detoured light are those of a lamp at the camera, backwards. Standard deviation 2.5 mm at 1 m, 15.5 mm at 9 m on
# 95 % reflectance, range 0.25 to 9 m (datasheet). The code is imitated by three frequencies.
L515 = TimeOfFlightCamera(
    "l515",
    frequencies=(120e6, 90e6, 75e6),
    electrons=25000.0,
    ambient=0.005,
    read_noise=8.0,
    least=60.0,
    scattered=0.0,
    blur=0.5,
    nearest=0.25,
    farthest=9.0,
    disagreement=0.25,
)

KNOWN_CAMERAS: dict[str, OpticalCamera] = {camera.name: camera for camera in (D435, D455, XTION, AZURE_KINECT, L515)}
