"""One BLAS thread while a problem is being solved."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


def single_threaded_blas() -> AbstractContextManager:
    """Numpy's and scipy's BLAS run on one thread within; the kernels of this package keep all of theirs.

    A step makes dozens of small products and one small factorisation. Beside numba's threads a second one of
    OpenBLAS costs more than it saves: a Cholesky factor of 168 x 168, 1 ms by itself, took 48 ms, a body's
    registration 55 s instead of 39.
    """
    return _controller().limit(limits=1, user_api="blas")


@cache
def _controller() -> ThreadpoolController:
    """Looks through all loaded libraries, 20 ms; by the first solve all that matter are loaded."""
    return ThreadpoolController()
