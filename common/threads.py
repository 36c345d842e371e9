"""Threads of linear algebra on small matrices."""

from threadpoolctl import threadpool_limits

one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")
"""Decorates functions during which linear algebra uses one thread.

SciPy solves a system of two equations for every triangle of a triangulation that it interpolates
on. OpenBLAS calls its threads for each of them, and waits for them: on 31 x 31 vertices 0.03 s
instead of 0.01 s, and up to 5 s where other programs keep the cores busy.
"""
