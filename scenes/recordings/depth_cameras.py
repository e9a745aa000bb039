"""What is believed of depth cameras that one can buy, by name. Metres, pixels.

From what makers promise and others measured, never from how captures are simulated (`scenes.synthesis.optics`): who
buys a camera knows the one and not the other. What no source tells is by judgement, and said to be. Lengths in pixels
are of images 640 to 848 pixels wide.
"""

from __future__ import annotations

from scenes.recordings.beliefs import DepthModel

# Structured light of PrimeSense: Nguyen, Izadi & Lovell (3DIMPVT 2012) measured axial and lateral noise of a Kinect;
# smooth distortion and scale as Basso, Menegatti & Pretto (IEEE T-RO 2018) found them. These are the default's values.
PRIMESENSE = DepthModel()


def _stereo(baseline: float, subpixel: float = 0.05, smooth: float = 0.06) -> DepthModel:
    """Active stereo of Intel's D400 family by its baseline (m).

    RMS error on a wall is z^2 subpixel / (focal length * baseline), 0.08 px for a usual unit, 0.03 px at best
    (Grunnet-Jepsen, Sweetser & Woodfill, "Best-known methods for tuning Intel RealSense D400 depth cameras", 2018; that
    it grows with distance and slope is measured in Ahn et al., "Analysis and noise modeling of the Intel RealSense D435
    for mobile robots", UR 2019); 848 px over 87 degrees (data sheet 337029) are a focal length of 447 px. By judgement
    0.05 px of it are each pixel's own and 0.06 px the waves over some matching windows that walls show, taken where
    hands are, at 0.7 m; 0.5 mm is left near the camera. The data sheet promises 2 % at 2 m (D435) and at 4 m (D455);
    the maker's support expects 2.5 to 5 mm at 1 m of a usual unit, which is the scale here.
    """
    focal = 447.0
    return DepthModel(
        axial_floor=0.0005,
        axial_from=0.0,
        axial_growth=round(subpixel / (focal * baseline), 5),
        lateral_sigma=1.5,
        edge_pixels=5,
        bias_sigma=round(max(smooth * 0.7**2 / (focal * baseline), 0.001), 4),
        bias_length=25.0,
        scale_sigma=0.005,
        cloud_sigma=0.003,
    )


D435 = _stereo(0.050)
D455 = _stereo(0.095)

# Azure Kinect: standard deviation at most 17 mm and a distance error below 11 mm + 0.1 % are promised (hardware
# specification) and were found kept, with some 1 mm of noise at 1 to 2 m and errors of some millimetres that go with
# place and reflectance (Toelgyessy et al., "Evaluation of the Azure Kinect", Sensors 2021): a third of 11 mm is taken
# for one sigma of a bias as wide as a thing. Mixed pixels at edges are its flaw; it has no windows.
AZURE_KINECT = DepthModel(
    axial_floor=0.0007,
    axial_from=0.0,
    axial_growth=0.0003,
    lateral_sigma=0.8,
    edge_pixels=3,
    bias_sigma=0.0035,
    bias_length=80.0,
    scale_sigma=0.002,
    cloud_sigma=0.004,
)

# L515: standard deviation 2.5 mm at 1 m and 15.5 mm at 9 m, average error below 5 mm at 1 m and 14 mm at 9 m (data
# sheet, 95 % reflectance): a constant and a quadratic term, half of 5 mm for one sigma of the bias.
L515 = DepthModel(
    axial_floor=0.0023,
    axial_from=0.0,
    axial_growth=0.00016,
    lateral_sigma=0.8,
    edge_pixels=3,
    bias_sigma=0.0025,
    bias_length=60.0,
    scale_sigma=0.002,
    cloud_sigma=0.0035,
)

# Depth rendered by a simulator, each pixel with noise of its own and nothing wrong in common.
CLEAN = DepthModel(
    lateral_sigma=0.5,
    edge_pixels=1,
    bias_sigma=0.0002,
    bias_length=40.0,
    scale_sigma=0.0002,
    shift_sigma=0.0,
    cloud_sigma=0.0013,
)

DEPTH_CAMERAS: dict[str, DepthModel] = {
    "kinect-v1": PRIMESENSE,
    "xtion": PRIMESENSE,
    "d435": D435,
    "d455": D455,
    "azure-kinect": AZURE_KINECT,
    "l515": L515,
    "clean": CLEAN,
}
