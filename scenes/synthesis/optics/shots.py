"""What an optical camera delivers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Shot:
    """depth (h, w) float32 metres along z, 0 = no reading; infrared (h, w) uint8: the image, or amplitude, below it."""

    depth: NDArray[np.float32]
    infrared: NDArray[np.uint8]
