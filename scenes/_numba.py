"""How kernels are compiled, and what numba loads for them.

Spares numba a look for SciPy's linear algebra by loading it: a tenth of a second at a process's first kernel.

Before its first kernel runs, numba registers how array products are compiled, and to know whether it may it imports
SciPy's BLAS. SciPy is there, palpate depends on it; it is enough to see that. A kernel that multiplies arrays still
loads it, when it is compiled or called.
"""

from __future__ import annotations

import importlib.util
from functools import cache
from typing import Any

from numba.core import types
from numba.core.options import DefaultOptions
from numba.extending import intrinsic

# Flags of kernels in which a product and the sum that it goes into may be rounded once, where the processor can do
# both in one step: a seventh of the time of sums over rows, and no less exact. All else is as IEEE 754 has it.
FUSED = {"contract"}

# Of kernels that allocate nothing: their callers hold what they work on, so nobody need count who does. Counting is a
# locked step of the processor at each slice and call, a tenth of the time of a frame without a start. Numba's own
# option, which another numba may not have.
LENT: dict[str, Any] = {"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}


@cache
def spare_blas() -> None:
    """Let numba's first look for a BLAS see that SciPy is installed; those after it load it, as ever."""
    import numba.np.linalg as linear

    real = getattr(linear, "ensure_blas", None)
    if real is None:
        return  # another numba asks in another way

    def only_look() -> None:
        linear.ensure_blas = real
        if importlib.util.find_spec("scipy") is None:
            raise ImportError("no SciPy")

    linear.ensure_blas = only_look


def _fused(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    """A product and a sum, a * b + c, rounded once."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), codegen


# Of kernels: a * b + c rounded once, as a BLAS sums the products of a row and a column, so that loops over points have
# the bits that NumPy's products of whole arrays have.
fused: Any = intrinsic(_fused)
