"""Local surface estimates from an organised depth image."""

import warp as wp

from inhand.kernels.depth import Pinhole


@wp.kernel
def fit_planes(
    camera: Pinhole,
    depth: wp.array(dtype=float),
    window: float,
    gate: float,
    far: float,
    smooth: wp.array(dtype=float),
    normals: wp.array(dtype=wp.vec3),
    first: int,
):
    """One work item a pixel: plane through its neighbourhood, by least squares in inverse depth.

    On a plane the inverse depth is linear in the pixel coordinates, so the fit is a 3x3 system.

    Args (beyond the obvious):
        window: radius of the neighbourhood [m].
        gate: neighbours whose depth differs by more are left out, per metre of window radius.
        far: pixels behind this depth are left alone [m].
        smooth: out, depth of the fitted plane at the pixel [m], 0 without a reading.
        normals: out, unit normal towards the camera, 0 where no plane could be fitted.
    """
    i = first + wp.tid()
    u = i % camera.width
    v = i // camera.width
    z = depth[i]
    smooth[i] = z
    normals[i] = wp.vec3(0.0, 0.0, 0.0)
    if z <= 0.0 or z > far:
        return
    radius = wp.clamp(int(window * camera.fx / z + 0.5), 2, 6)
    step = wp.max(1, (radius + 2) // 3)
    tolerance = gate * window
    # Of the vectors (x, y, inverse depth) from the pixel: number, sum and second moments.
    n = float(0.0)
    total = wp.vec3()
    moments = wp.mat33()
    reach = (radius // step) * step
    for dv in range(-reach, reach + 1, step):
        for du in range(-reach, reach + 1, step):
            x = u + du
            y = v + dv
            if x < 0 or y < 0 or x >= camera.width or y >= camera.height:
                continue
            d = depth[y * camera.width + x]
            if d <= 0.0 or wp.abs(d - z) > tolerance:
                continue
            sample = wp.vec3(float(du), float(dv), 1.0 / d - 1.0 / z)
            n += 1.0
            total += sample
            moments += wp.outer(sample, sample)
    if n < 6.0:
        return
    mean = total / n
    c = moments / n - wp.outer(mean, mean)
    determinant = c[0, 0] * c[1, 1] - c[0, 1] * c[0, 1]
    if determinant < 0.05 * c[0, 0] * c[1, 1] or determinant < 1.0e-3:
        return
    a = (c[0, 2] * c[1, 1] - c[1, 2] * c[0, 1]) / determinant
    b = (c[1, 2] * c[0, 0] - c[0, 2] * c[0, 1]) / determinant
    centre = 1.0 / z + mean[2] - a * mean[0] - b * mean[1]
    if centre <= 0.0:
        return
    smooth[i] = 1.0 / centre
    # 1/z = a (u - u0) + b (v - v0) + centre = n . ray / D for the plane n . X = D.
    at_axis = centre + a * (camera.cx - float(u)) + b * (camera.cy - float(v))
    normal = wp.normalize(wp.vec3(a * camera.fx, b * camera.fy, at_axis))
    # With D > 0 the vector points away from the camera.
    normals[i] = -normal


@wp.kernel
def missing_in_rows(
    depth: wp.array(dtype=float),
    width: int,
    height: int,
    radius: int,
    count: wp.array(dtype=int),
    first: int,
):
    """One work item a row: number of its pixels without a reading up to `radius` beside each."""
    row = (first + wp.tid()) * width
    missing = int(0)
    for u in range(-radius, width):
        if u + radius < width and depth[row + u + radius] <= 0.0:
            missing += 1
        if u > radius and depth[row + u - radius - 1] <= 0.0:
            missing -= 1
        if u >= 0:
            count[row + u] = missing


@wp.kernel
def missing_share(
    depth: wp.array(dtype=float),
    in_rows: wp.array(dtype=int),
    width: int,
    height: int,
    radius: int,
    usual: float,
    share: wp.array(dtype=float),
    first: int,
):
    """One work item a column: share of pixels without a reading in the square of `radius` [pixel].

    Small holes are sensor noise; a wide area without readings is most likely empty. Where surfaces
    have holes all over, only what is missing beyond that says so.

    Args (beyond the obvious):
        in_rows: result of `missing_in_rows`.
        usual: share below 1 that counts as none; from there to 1 the result goes from 0 to 1.
        share: out, 0 at pixels with a reading.
    """
    u = first + wp.tid()
    across = wp.min(u + radius, width - 1) - wp.max(u - radius, 0) + 1
    missing = int(0)
    for v in range(-radius, height):
        if v + radius < height:
            missing += in_rows[(v + radius) * width + u]
        if v > radius:
            missing -= in_rows[(v - radius - 1) * width + u]
        if v >= 0:
            i = v * width + u
            share[i] = 0.0
            if depth[i] <= 0.0:
                down = wp.min(v + radius, height - 1) - wp.max(v - radius, 0) + 1
                found = float(missing) / float(across * down)
                share[i] = wp.max(0.0, (found - usual) / (1.0 - usual))
