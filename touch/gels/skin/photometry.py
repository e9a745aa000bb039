"""What a gel's colours say of its skin: how each changes with the skin's slope and with how deep it is pressed in.

A matt skin under lights shows I_c = r (a_c + b_c . n): its colours are linear in its normal, and the relative
difference q_c = I_c / I0_c - 1 from the untouched skin does not know the reflectance r. Lamps are near: their light
changes over the image, and a skin that is pressed towards them is brighter without any slope. So q_c = s_c(u, v) .
(n - n0) + d_c(u, v) h with h the indentation, s of second order over the image and d of first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.files.formats.json_text import parsed
from scenes.robot.gels import Gel

Array = NDArray[np.float64]

FORMAT = "palpate-gel-calibration"
# Version 1 had the slopes by the colours, which noise makes too flat.
VERSION = 2
# Terms of the polynomials over the image (see image_terms): of the slopes' share, and of the depth's.
TERMS, DEPTH_TERMS = 6, 3
# Indentations are told in millimetres where they multiply coefficients: those are about as large as the slopes' then.
MILLIMETRES = 1e3


@dataclass(frozen=True)
class Photometry:
    """by_normal (3, 3, TERMS): the relative change of channel c by the normal's change along axis i; by_depth (3,
    DEPTH_TERMS): the same by a millimetre of indentation; size (width, height) of the images; darkest (counts): darker
    backgrounds count as that bright; ball (m), presses, misfit (share of the changes that is left) and depths (m) of
    the presses, if the ball has that radius; sensors: of how many it is the mean; light (no unit): the lamps' share of
    the light on the untouched skin, if the ball has that radius (0: not known).
    """

    by_normal: Array
    by_depth: Array
    size: tuple[int, int]
    darkest: float
    ball: float = 0.0
    presses: int = 0
    misfit: float = 0.0
    depths: tuple[float, ...] = ()
    sensors: int = 1
    light: float = 0.0

    def maps(self, gel: Gel) -> tuple[Array, Array]:
        """(h, w, 3, 3) relative change of a channel by the normal's, (h, w, 3) by the indentation (m); on the gel's own
        pixels, kept as long as the gel.
        """
        kept = self.__dict__.setdefault("_kept", WeakKeyDictionary())
        if gel not in kept:
            terms = image_terms(gel.width, gel.height)
            slopes = np.ascontiguousarray(np.einsum("hwt,cit->hwci", terms, self.by_normal))
            depths = MILLIMETRES * np.einsum("hwt,ct->hwc", terms[..., :DEPTH_TERMS], self.by_depth)
            kept[gel] = slopes, np.ascontiguousarray(depths)
        slopes, depths = kept[gel]
        return slopes, depths

    def to_json(self) -> dict[str, Any]:
        """The calibration file's content."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "size": list(self.size),
            "darkest": self.darkest,
            "by_normal": self.by_normal.tolist(),
            "by_depth": self.by_depth.tolist(),
            "ball_mm": 1e3 * self.ball,
            "presses": self.presses,
            "misfit": self.misfit,
            "depths_mm": [1e3 * depth for depth in self.depths],
            "sensors": self.sensors,
            "light": self.light,
        }

    @staticmethod
    def from_json(entry: Mapping[str, Any], where: str) -> Photometry:
        """Raises InputError for another format, shape or numbers that are not finite."""
        if entry.get("format") != FORMAT:
            raise InputError(f"{where}: expected a gel's calibration ({FORMAT}), got {entry.get('format')!r}")
        if entry.get("version") != VERSION:
            said = f"got {entry.get('version')!r}: calibrate again"
            raise InputError(f"{where}: expected a gel's calibration of version {VERSION}, {said}")
        try:
            by_normal = np.array(entry["by_normal"], dtype=np.float64)
            by_depth = np.array(entry["by_depth"], dtype=np.float64)
            depths = tuple(1e-3 * float(x) for x in entry.get("depths_mm", ()))
            width, height = (int(x) for x in entry["size"])
            values = [float(entry.get(name, 0.0)) for name in ("darkest", "ball_mm", "presses", "misfit", "light")]
            sensors = int(entry.get("sensors", 1))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{where}: expected by_normal, by_depth, size and darkest in the calibration") from error
        for name, found, shape in (
            ("by_normal", by_normal, (3, 3, TERMS)),
            ("by_depth", by_depth, (3, DEPTH_TERMS)),
        ):
            if found.shape != shape or not np.isfinite(found).all():
                raise InputError(f"{where}: expected finite {name} {shape}, got {found.shape}")
        if not np.isfinite(values).all() or not np.isfinite(depths).all():
            raise InputError(f"{where}: expected finite numbers, got {values} and depths_mm {depths}")
        if values[0] <= 0:
            raise InputError(f"{where}: expected darkest above 0 counts, got {values[0]:g}")
        if sensors < 1:
            raise InputError(f"{where}: expected one sensor or more, got {sensors}")
        ball, presses, misfit = 1e-3 * values[1], int(values[2]), values[3]
        return Photometry(
            by_normal, by_depth, (width, height), values[0], ball, presses, misfit, depths, sensors, values[4]
        )


def mean_of(found: Sequence[Photometry]) -> Photometry:
    """The calibration of a kind of sensor: the mean of several sensors', each counted once. Raises InputError for
    images of different sizes.

    Lamps differ from sensor to sensor, and what one has of its own is wrong for all others; so is the error of its
    presses.
    """
    sizes = {one.size for one in found}
    if len(sizes) != 1:
        told = " and ".join(f"{width}x{height}" for width, height in sorted(sizes)) or "none"
        raise InputError(f"calibration: expected several of one size of image, got {told}")
    counts = np.array([one.sensors for one in found], dtype=np.float64)
    share = counts / counts.sum()
    return Photometry(
        np.asarray(sum(part * one.by_normal for part, one in zip(share, found))),
        np.asarray(sum(part * one.by_depth for part, one in zip(share, found))),
        found[0].size,
        max(one.darkest for one in found),
        found[0].ball,
        sum(one.presses for one in found),
        float(sum(part * one.misfit for part, one in zip(share, found))),
        tuple(depth for one in found for depth in one.depths),
        int(counts.sum()),
        float(sum(part * one.light for part, one in zip(share, found))) if all(one.light for one in found) else 0.0,
    )


_KEPT: WeakKeyDictionary[Gel, Photometry] = WeakKeyDictionary()


def photometry_of(gel: Gel, where: str) -> Photometry:
    """The gel's calibration, read once. Raises InputError for one that is malformed or of another size."""
    assert gel.calibration is not None
    found = _KEPT.get(gel)
    if found is None:
        found = Photometry.from_json(gel.calibration, where)
        if found.size != (gel.width, gel.height):
            got = f"{found.size[0]}x{found.size[1]}"
            raise InputError(f"{where}: expected a calibration of {gel.width}x{gel.height} pixels, got one of {got}")
        _KEPT[gel] = found
    return found


def read_photometry(path: Path) -> Photometry:
    """A calibration file. Raises InputError, one line, for what is none."""
    try:
        content = parsed(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a gel's calibration, it cannot be read as JSON: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a gel's calibration, got {type(content).__name__}")
    return Photometry.from_json(content, str(path))


def relative(difference: NDArray[np.float32], gel: Gel, darkest: float) -> NDArray[np.float32]:
    """(h, w, 3) differences of colours as shares of the background's; working pixels."""
    return np.asarray(difference / np.maximum(gel.level, np.float32(darkest)))


def image_terms(width: int, height: int) -> Array:
    """(h, w, TERMS): 1, u, v, u^2, uv, v^2 with u and v from -1 to 1 over the image."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height))
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
