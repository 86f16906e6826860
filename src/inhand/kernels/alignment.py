"""Least-squares rigid alignment of corresponding points."""

import warp as wp

from inhand.kernels.transforms import rigid


@wp.kernel
def align_quadruples(
    targets: wp.array(dtype=wp.vec3),
    target_sets: wp.array(dtype=wp.vec4i),
    sources: wp.array(dtype=wp.vec3),
    source_sets: wp.array(dtype=wp.vec4i),
    T_target_source: wp.array(dtype=wp.mat44),
    first: int,
):
    """One work item a pair of 4-point sets: the rigid motion with the least squared error.

    The rotation comes from the singular value decomposition of the cross-covariance (Arun et al.,
    "Least-Squares Fitting of Two 3-D Point Sets", 1987).

    Args (beyond the obvious):
        target_sets, source_sets: indices of corresponding points, four a set.
    """
    i = first + wp.tid()
    target_mean = wp.vec3()
    source_mean = wp.vec3()
    for k in range(4):
        target_mean += 0.25 * targets[target_sets[i][k]]
        source_mean += 0.25 * sources[source_sets[i][k]]
    covariance = wp.mat33()
    size = float(0.0)
    for k in range(4):
        a = targets[target_sets[i][k]] - target_mean
        b = sources[source_sets[i][k]] - source_mean
        covariance += wp.outer(a, b)
        size += wp.dot(b, b)
    # The decomposition is made for numbers around one. Both factors come as proper rotations, a
    # reflection as a negative last singular value, so the product is the best rotation.
    u, _sigma, v = wp.svd3(covariance / wp.max(size, 1.0e-12))
    R = u * wp.transpose(v)
    T_target_source[i] = rigid(R, target_mean - R * source_mean)
