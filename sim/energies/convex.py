"""Convex approximations: lower bounds on the eigenvalues of symmetric matrices."""

import numba
import numpy as np


@numba.njit(cache=True)
def raise_eigenvalues(matrices, floor):
    """Raise eigenvalues of symmetric matrices (N, 3, 3) to at least ``floor``, in place."""
    for matrix in matrices:
        # Positive pivots of matrix - floor: most matrices need no eigenvectors.
        first = matrix[0, 0] - floor
        second = (matrix[1, 1] - floor) * first - matrix[0, 1] ** 2
        if first > 0.0 and second > 0.0:
            cross = matrix[1, 2] * first - matrix[0, 1] * matrix[0, 2]
            if ((matrix[2, 2] - floor) * first - matrix[0, 2] ** 2) * second > cross * cross:
                continue
        value, vector = np.linalg.eigh(matrix)
        for k in range(3):
            if value[k] < floor:
                for i in range(3):
                    for j in range(3):
                        matrix[i, j] += (floor - value[k]) * vector[i, k] * vector[j, k]
