"""What depth cameras do to the truth: structured light, time of flight and stereo, with what averaging does not remove.

Structured light follows Nguyen, Izadi and Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and
tracking" (3DIMPVT 2012): axial noise that grows with depth and incidence, lateral noise in pixels. The lateral part
moves the place that a pixel looks at, and depth is read in steps of disparity, both as in Handa et al., "A benchmark
for RGB-D visual odometry, 3D reconstruction and SLAM" (ICRA 2014). Time of flight follows Fankhauser et al., "Kinect v2
for mobile robot navigation: evaluation and modeling" (ICAR 2015), stereo the propagation of a disparity error
(Keselman et al., "Intel RealSense stereoscopic depth cameras", CVPRW 2017). Metres and radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry.appearance.rendering import Rendering
from scenes.geometry.cameras import Camera
from scenes.synthesis.noise import depth_kernels as kernels

Array = NDArray[np.float64]
Depth = NDArray[np.float32]

# Incidence is held below this (rad): the formulas diverge at 90 degrees, where no light comes back anyway.
LARGEST_INCIDENCE = np.deg2rad(88.0)
PRINCIPLES = ("structured light", "time of flight", "stereo")


@dataclass(frozen=True)
class DepthNoise:
    """Every error of a depth image; each part is off at 0. Defaults: a structured-light camera without bias. Papers
    in the module's docstring.
    """

    # How depth is measured, which decides the axial formula: one of PRINCIPLES.
    principle: str = "structured light"
    # Share of that formula's axial sigma (no unit); 0 switches it off, 1 is the published camera.
    axial: float = 1.0
    # Stereo: standard deviation of a match (px; Keselman et al.: 0.05 to 0.1), and the correlation length (px) of
    # neighbouring errors, which a matching window of several pixels makes alike; 0 is independent.
    match_sigma: float = 0.08
    match_length: float = 0.0
    # Share of their lateral sigma (no unit).
    lateral: float = 1.0
    # Smallest step of disparity (px) and distance between projector and camera (m): Kinect, 1/8 px and 75 mm.
    disparity_step: float = 0.125
    baseline: float = 0.075
    # Incidence at which readings begin to be lost and where all are (rad): 70 to 85 degrees; pi/2 for both is off.
    grazing_start: float = float(np.deg2rad(70.0))
    grazing_end: float = float(np.deg2rad(85.0))
    # Readings lost at random (share of pixels).
    dropout: float = 0.0
    # Lose what the projector cannot light because something nearer stands in its way.
    shadow: bool = False
    # Parts narrower than this in the image (px) are lost: the matching window sees more of what is behind. 0 is off.
    thin: int = 0
    # Albedo of all surfaces for light that comes by way of a second one (no unit): concavities read too far. 0 is off.
    multipath: float = 0.0
    # Share of the pixels beside a depth step that read a depth in between.
    flying: float = 0.0
    # A depth step: difference between neighbours above this (m).
    step: float = 0.010
    # Smooth error of depth over the image: standard deviation (m) and correlation length (px; correlation
    # exp(-d^2 / 2 L^2)).
    bias: float = 0.0
    bias_length: float = 40.0
    # Standard deviation of the depth scale (no unit), one draw per frame.
    scale: float = 0.0


@dataclass(frozen=True)
class DepthErrors:
    """What a camera keeps doing wrong in every frame: bias (h, w) in standard deviations, scale likewise."""

    bias: Array
    scale: float


def draw_depth_errors(camera: Camera, noise: DepthNoise, rng: np.random.Generator) -> DepthErrors:
    """One camera's lasting errors, for a whole recording."""
    shape = (camera.height, camera.width)
    bias = smooth_field(shape, noise.bias_length, rng) if noise.bias > 0 else np.zeros(shape)
    return DepthErrors(bias, float(rng.normal()))


def axial_sigma(z: Array, incidence: Array) -> Array:
    """Standard deviation (m) of depth z (m) at an incidence (rad) between ray and normal (Nguyen et al., eq. 3, 4).

    0.0012 + 0.0019 (z - 0.4)^2, and for an incidence above 60 degrees + 0.0001 / sqrt(z) theta^2 / (pi/2 - theta)^2.
    """
    theta = np.minimum(incidence, LARGEST_INCIDENCE)
    safe = np.maximum(z, 0.05)  # nearer than any camera of the kind reads; keeps the square root finite
    steep = 0.0001 / np.sqrt(safe) * theta**2 / (np.pi / 2 - theta) ** 2
    return 0.0012 + 0.0019 * (z - 0.4) ** 2 + np.where(theta > np.deg2rad(60.0), steep, 0.0)


def time_of_flight_sigma(z: Array, incidence: Array) -> Array:
    """Standard deviation (m) of depth z (m) by time of flight at an incidence (rad) (Fankhauser et al., indoors).

    1.5 - 0.5 z + 0.3 z^2 + 0.1 z^1.5 theta^2 / (pi/2 - theta)^2, in millimetres.
    """
    theta = np.minimum(incidence, LARGEST_INCIDENCE)
    safe = np.maximum(z, 0.0)
    return 1e-3 * (1.5 - 0.5 * safe + 0.3 * safe**2 + 0.1 * safe**1.5 * theta**2 / (np.pi / 2 - theta) ** 2)


def stereo_sigma(z: Array, focal_baseline: float, match_sigma: float) -> Array:
    """Standard deviation (m) of depth z (m) whose disparity focal_baseline / z (px) is off by match_sigma (px)."""
    return z**2 * match_sigma / focal_baseline


def lateral_sigma(incidence: Array) -> Array:
    """Standard deviation (px) of where a pixel looks: 0.8 + 0.035 theta / (pi/2 - theta) (Nguyen et al., eq. 2)."""
    theta = np.minimum(incidence, LARGEST_INCIDENCE)
    return 0.8 + 0.035 * theta / (np.pi / 2 - theta)


def incidence_angles(rendering: Rendering, camera: Camera) -> Array:
    """(h, w) angle (rad) between each pixel's ray and the surface normal there; 0 where nothing is seen."""
    out = np.zeros(rendering.ids.shape)
    lens = (camera.fx, camera.fy, camera.cx, camera.cy, rendering.region[0], rendering.region[1])
    kernels.incidence(*lens, rendering.ids, rendering.normals, out)
    return out


def observed(
    rendering: Rendering,
    camera: Camera,
    settings: DepthNoise,
    rng: np.random.Generator,
    errors: DepthErrors | None = None,
) -> Depth:
    """The depth image (h, w) float32 metres, 0 = no reading, that a camera with these errors records of a view.

    errors: the camera's lasting ones; without them bias and scale are drawn anew. Raises InputError for an unknown
    principle.
    """
    truth = rendering.depth.astype(np.float64)
    shape = truth.shape
    seen = truth > 0
    incidence = incidence_angles(rendering, camera)
    depth = truth
    if settings.lateral > 0:
        shift = rng.normal(size=(2, *shape))
        depth = np.zeros(shape)
        ids = np.ascontiguousarray(rendering.ids)
        kernels.read_depth(truth, ids, shift, incidence, settings.lateral, LARGEST_INCIDENCE, depth)
        seen &= depth > 0
    if settings.multipath > 0:
        from scenes.synthesis.noise.multipath import multipath_error

        depth = depth + multipath_error(rendering, camera, settings.multipath)
    if settings.flying > 0:
        depth = _flying(depth, truth, settings, rng)
    depth = np.array(depth)  # changed in place from here on
    if settings.axial > 0:
        _add_axial(depth, incidence, camera, settings, rng)
    bias, factor = np.zeros((0, 0)), 1.0
    if settings.bias > 0:
        bias = smooth_field(shape, settings.bias_length, rng) if errors is None else errors.bias
    if settings.scale > 0:
        factor += settings.scale * (rng.normal() if errors is None else errors.scale)
    focal_baseline = camera.fx * settings.baseline
    kernels.read_off(depth, bias, settings.bias, factor, focal_baseline, settings.disparity_step)
    if settings.grazing_start < np.pi / 2:
        ramp = (incidence - settings.grazing_start) / max(settings.grazing_end - settings.grazing_start, 1e-9)
        seen &= rng.random(shape) >= np.clip(ramp, 0.0, 1.0)
    if settings.dropout > 0:
        seen &= rng.random(shape) >= settings.dropout
    if settings.shadow:
        seen &= ~projector_shadow(truth, camera.fx * settings.baseline)
    if settings.thin > 0:
        seen &= ~thin_parts(truth, settings.thin, settings.step)
    return np.where(seen & (depth > 0), depth, 0.0).astype(np.float32)


def _add_axial(depth: Array, incidence: Array, camera: Camera, settings: DepthNoise, rng: np.random.Generator) -> None:
    """One draw of the axial error of each pixel, added in place."""
    if settings.principle == "structured light":
        draws = rng.normal(size=depth.shape)
        kernels.add_structured_light(depth, incidence, draws, settings.axial, LARGEST_INCIDENCE)
    elif settings.principle == "time of flight":
        depth += settings.axial * time_of_flight_sigma(depth, incidence) * rng.normal(size=depth.shape)
    elif settings.principle == "stereo":
        alike = settings.match_length > 0
        draws = smooth_field(depth.shape, settings.match_length, rng) if alike else rng.normal(size=depth.shape)
        depth += settings.axial * stereo_sigma(depth, camera.fx * settings.baseline, settings.match_sigma) * draws
    else:
        raise InputError(f"depth noise: expected a principle of {', '.join(PRINCIPLES)}, got {settings.principle!r}")


def depth_steps(depth: Array, step: float) -> tuple[NDArray[np.bool_], Array, Array]:
    """Pixels (h, w) beside a jump above `step` (m), and the nearest and farthest depth among their 3 x 3 neighbours.

    Pixels without a reading neither make a jump nor are beside one.
    """
    depth = np.asarray(depth, dtype=np.float64)
    near, far = np.zeros(depth.shape), np.zeros(depth.shape)
    kernels.extremes(depth, near, far)
    return (depth > 0) & (far - near > step), near, far


def _flying(depth: Array, truth: Array, settings: DepthNoise, rng: np.random.Generator) -> Array:
    edge, near, far = depth_steps(truth, settings.step)
    chosen = edge & (rng.random(depth.shape) < settings.flying)
    share = rng.random(depth.shape)
    mixed = np.array(depth)
    mixed[chosen] = share[chosen] * near[chosen] + (1 - share[chosen]) * far[chosen]
    return mixed


def smooth_field(shape: tuple[int, ...], length: float, rng: np.random.Generator) -> Array:
    """Gaussian random field over (h, w) pixels: mean 0, variance 1, correlation exp(-d^2 / (2 length^2)).

    White noise on a lattice of length / 4 is smoothed by a Gaussian of length / sqrt(2), whose correlation with
    itself is the one asked for, and read off at the pixels by cubic interpolation.
    """
    from scipy.ndimage import gaussian_filter, map_coordinates

    pitch = max(1.0, length / 4.0)
    sigma = length / np.sqrt(2.0) / pitch
    margin = int(np.ceil(4 * sigma))
    size = [int(np.ceil(n / pitch)) + 2 * margin + 2 for n in shape]
    smooth = gaussian_filter(rng.normal(size=size), sigma, mode="wrap", truncate=5.0)
    # Variance of the smoothed noise: the sum of the squared kernel, separable
    reach = np.arange(-int(5.0 * sigma + 0.5), int(5.0 * sigma + 0.5) + 1)
    kernel = np.exp(-0.5 * (reach / sigma) ** 2)
    kernel /= kernel.sum()
    grid = np.meshgrid(*[margin + np.arange(n) / pitch for n in shape], indexing="ij")
    return np.asarray(map_coordinates(smooth, grid, order=3, mode="nearest") / np.sum(kernel**2))


def quantised(depth: Array, focal_baseline: float, step: float) -> Array:
    """Depth (m) read through disparity focal_baseline / depth (px m / m) rounded to whole steps (px)."""
    safe = np.where(depth > 0, depth, 1.0)
    steps = np.maximum(np.rint(focal_baseline / safe / step), 1.0)
    return np.where(depth > 0, focal_baseline / (steps * step), 0.0)


def projector_shadow(depth: Array, focal_baseline: float) -> NDArray[np.bool_]:
    """Pixels (h, w) that a projector `baseline` to the right of the camera (+x) cannot light.

    The projector sees pixel column u at column u - focal_baseline / depth of its own. Going right in the camera's
    image its column must grow; a pixel with a greater one than some pixel to its right lies behind that one.
    """
    columns = np.arange(depth.shape[1]) - focal_baseline / np.where(depth > 0, depth, np.inf)
    columns = np.where(depth > 0, columns, np.inf)
    least = np.minimum.accumulate(columns[:, ::-1], axis=1)[:, ::-1]
    # Half a pixel of slack: neighbours on one steep surface are not each other's shadow
    return np.asarray((depth > 0) & (columns > least + 0.5))


def thin_parts(depth: Array, width: int, step: float) -> NDArray[np.bool_]:
    """Pixels (h, w) of parts narrower than `width` px that stand more than `step` (m) before what is beside them.

    A grey closing of depth fills in whatever does not hold a square of that many pixels; no reading is infinitely far.
    """
    from scipy.ndimage import grey_closing

    far = np.where(depth > 0, depth, 1e3)
    return np.asarray((depth > 0) & (grey_closing(far, size=(width, width), mode="nearest") - far > step))
