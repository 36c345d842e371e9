"""Number of threads of libraries.

Imports none of them, because they read their environment variables when they are loaded.
"""

from threadpoolctl import threadpool_limits

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    # Otherwise MKL's rounding depends on the memory alignment of a matrix.
    "MKL_CBWR": "AUTO",
    # Memory in large pages: 2 to 3 % less time at 41 x 41.
    "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
}
"""Environment variables of a single-threaded process."""

one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")
"""Decorator: linear algebra inside the function uses one thread.

SciPy's interpolation on a triangulation solves a system of two equations for every triangle.
OpenBLAS synchronises its threads for each of them: on 31 x 31 vertices this takes 0.03 s instead of
0.01 s, and up to 5 s on busy cores.
"""
