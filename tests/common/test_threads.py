import subprocess
import sys

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

from common.threads import one_blas_thread

openblas = ThreadpoolController().select(internal_api="openblas")
needs_openblas = pytest.mark.skipif(not openblas.info(), reason="NumPy has another BLAS")


def threads():
    return {library["num_threads"] for library in openblas.info()}


@needs_openblas
def test_one_thread_within_and_as_many_as_before_afterwards():
    @one_blas_thread
    def inverse(matrix):
        return np.linalg.inv(matrix), threads()

    with openblas.limit(limits=2):
        found, within = inverse(np.diag([1.0, 2.0]))
        assert within == {1} and threads() == {2}
        with pytest.raises(np.linalg.LinAlgError):
            inverse(np.zeros((2, 2)))
        assert threads() == {2}
    np.testing.assert_array_equal(found, np.diag([1.0, 0.5]))


def test_benchmarks_choose_one_thread_before_a_library_reads_how_many():
    loaded = ("import experiments.one_thread, sys; "
              "print(*{'numpy', 'torch', 'numba'} & {*sys.modules})")
    assert not subprocess.check_output([sys.executable, "-c", loaded]).split()
