"""`compiled`: the decorator of every numerical kernel. Machine code is kept on disk for the next start."""

from functools import partial
from typing import Any

from numba import config

from asterism.server.kernel import Kernel
from asterism.server.kernel_folder import kernel_folder


def _decorator(**options: Any) -> Any:
    if config.DISABLE_JIT:  # NUMBA_DISABLE_JIT=1, to look into kernels with a debugger
        return lambda function: function
    return partial(Kernel, folder=kernel_folder(), **options)


# The interpreter's lock is released, so that source, recorder and network go on beside the chain. Division by zero
# gives inf or nan as in numpy; the kernels test for what must not be.
compiled = _decorator(nogil=True, error_model="numpy")

# For sums over pixels: lets the compiler reorder additions, which it must in order to use the processor's wide
# registers. nan and inf keep their meaning.
compiled_sums = _decorator(nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "arcp", "nsz"})
