"""Numba, for whom it is installed: machine code on the first call of a kernel, kept on disk for the next run."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba  # type: ignore[import-not-found, import-untyped, unused-ignore]  # not needed: see chain_engine

Kernel = TypeVar("Kernel", bound=Callable[..., object])
_FASTER = {"contract", "reassoc", "nsz", "arcp"}  # sums in any order; what is not a number stays so


def compiled(kernel: Kernel) -> Kernel:
    """The kernel in machine code. All that it calls stands in its own file, by whose date numba knows old code."""
    try:
        return cast(Kernel, numba.njit(cache=True, error_model="numpy", fastmath=_FASTER)(kernel))
    except RuntimeError:  # no folder to keep it in, neither beside the file nor in the user's home
        return cast(Kernel, numba.njit(error_model="numpy", fastmath=_FASTER)(kernel))
