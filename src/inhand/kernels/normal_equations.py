"""Least squares over rigid motions: rows of the Jacobian and the solution of the system."""

from typing import Any

import warp as wp

Matrix6 = wp.types.matrix(shape=(6, 6), dtype=float)
Vector6 = wp.types.vector(length=6, dtype=float)


@wp.func
def row_of(lever: wp.vec3, direction: wp.vec3):
    """Change of a distance along `direction` with rotation and translation of what it belongs to.

    `lever`: from the centre of rotation to the point [m].
    """
    moment = wp.cross(lever, direction)
    return Vector6(moment[0], moment[1], moment[2], direction[0], direction[1], direction[2])


@wp.func
def solve_in_place(A: Any, b: Any, n: int):
    """Solution of A x = b for a symmetric positive definite A, by Cholesky.

    Arrays `A` and `b` are overwritten, `b` by the solution.
    """
    for i in range(n):
        for j in range(i + 1):
            rest = A[i, j]
            for k in range(j):
                rest -= A[i, k] * A[j, k]
            if i == j:
                A[i, i] = wp.sqrt(rest)
            else:
                A[i, j] = rest / A[j, j]
    for i in range(n):
        rest = b[i]
        for k in range(i):
            rest -= A[i, k] * b[k]
        b[i] = rest / A[i, i]
    for back in range(n):
        i = n - 1 - back
        rest = b[i]
        for k in range(i + 1, n):
            rest -= A[k, i] * b[k]
        b[i] = rest / A[i, i]
    return b
