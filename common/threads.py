"""Threads of linear algebra on small matrices."""

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Let the OpenBLAS of NumPy and SciPy use one thread while ``function`` runs.

    SciPy solves a system of two equations for every triangle of a triangulation that it
    interpolates on. OpenBLAS calls its threads for each of them, and waits for them: on 31 x 31
    vertices 0.03 s instead of 0.01 s, and up to 5 s where other programs keep the cores busy.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with _openblas().limit(limits=1):
            return function(*args, **kwargs)

    return limited


@cache
def _openblas() -> ThreadpoolController:
    """The OpenBLAS libraries of this process, at the first call, when SciPy has loaded its own."""
    return ThreadpoolController().select(internal_api="openblas")
