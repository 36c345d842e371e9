"""How many threads libraries use. Loads none of them: they read their variables as they load."""

from threadpoolctl import threadpool_limits

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    # Without it MKL's rounding depends on where in memory a matrix happens to lie.
    "MKL_CBWR": "AUTO",
    # Memory in large pages: 2 to 3 % less time at 41 x 41.
    "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
}
"""Environment variables of a process of one thread."""

one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")
"""Decorates functions during which linear algebra uses one thread.

SciPy solves a system of two equations for every triangle of a triangulation that it interpolates
on. OpenBLAS calls its threads for each of them, and waits for them: on 31 x 31 vertices 0.03 s
instead of 0.01 s, and up to 5 s where other programs keep the cores busy.
"""
