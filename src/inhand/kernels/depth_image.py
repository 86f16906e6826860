"""Local surface estimates from an organised depth image."""

import warp as wp

from inhand.kernels.depth import Pinhole
from inhand.kernels.hand_fit import DepthView

RowSums = wp.types.vector(length=5, dtype=float)
"""Sums of 1, x, x^2, w and x w: readings of a row, x pixels to the right, of inverse depth w."""


@wp.func
def window_radius(camera: Pinhole, window: float, z: float):
    """Radius [pixel] of a neighbourhood of radius `window` [m] at depth `z` [m]."""
    return wp.clamp(int(window * camera.fx / z + 0.5), 2, 6)


@wp.func
def sum_row(view: DepthView, i: int, z: float, window: float, gate: float):
    """Sums over the neighbourhood's part of pixel i's row: of the readings on a surface at `z`."""
    radius = window_radius(view.camera, window, z)
    width = view.camera.width
    u = i % width
    n, x, xx, w, xw = float(0.0), float(0.0), float(0.0), float(0.0), float(0.0)
    du = wp.max(-radius, -u) - 1
    last = wp.min(radius, width - 1 - u)
    while du < last:
        du += 1
        d = view.depth[i + du]
        if wp.abs(d - z) <= gate * window and d > 0.0:
            n += 1.0
            x += float(du)
            xx += float(du * du)
            w += 1.0 / d
            xw += float(du) / d
    return RowSums(n, x, xx, w, xw)


@wp.kernel
def sum_rows(
    view: DepthView,
    window: float,
    gate: float,
    far: float,
    sums: wp.array(dtype=RowSums),
    first: int,
):
    """One work item a pixel: `sum_row` around it, where `fit_planes` may ask for it."""
    i = first + wp.tid()
    z = view.depth[i]
    if z > 0.0 and z - far <= gate * window:
        sums[i] = sum_row(view, i, z, window, gate)


@wp.kernel
def fit_planes(
    view: DepthView,
    window: float,
    gate: float,
    far: float,
    sums: wp.array(dtype=RowSums),
    smooth: wp.array(dtype=float),
    first: int,
):
    """One work item a pixel: plane through its neighbourhood, by least squares in inverse depth.

    On a plane the inverse depth is linear in the pixel coordinates, so the fit is a 3x3 system. Its
    sums go over a square of pixels, row by row: where a row's reading above or below the pixel is
    on the same surface, the row's sums are taken from there.

    Args (beyond the obvious):
        view: its normals are an output, 0 where no plane could be fitted.
        window: radius of the neighbourhood [m].
        gate: neighbours whose depth differs by more are left out, per metre of window radius.
        far: pixels behind this depth are left alone [m].
        sums: result of `sum_rows`.
        smooth: out, depth of the fitted plane at the pixel [m], 0 without a reading.
    """
    camera, depth = view.camera, view.depth
    i = first + wp.tid()
    z = depth[i]
    smooth[i] = z
    view.normals[i] = wp.vec3(0.0, 0.0, 0.0)
    if z <= 0.0 or z > far:
        return
    u, v = i % camera.width, i // camera.width
    radius = window_radius(camera, window, z)
    # Sums of the rows, of the rows times y, as many pixels below, and of the readings' y^2.
    s, s_y, s_yy = RowSums(), RowSums(), float(0.0)
    dv = wp.max(-radius, -v) - 1
    last = wp.min(radius, camera.height - 1 - v)
    while dv < last:
        dv += 1
        j = i + dv * camera.width
        row = sums[j]
        if wp.abs(depth[j] - z) > gate * window or depth[j] <= 0.0:
            row = sum_row(view, j, z, window, gate)
        s += row
        s_y += float(dv) * row
        s_yy += float(dv * dv) * row[0]
    # Number, means of x, y and w, and their covariances.
    n, x, y, w = s[0], s[1] / s[0], s_y[0] / s[0], s[3] / s[0]
    xx, xy, yy = s[2] / n - x * x, s_y[1] / n - x * y, s_yy / n - y * y
    xw, yw = s[4] / n - x * w, s_y[3] / n - y * w
    determinant = xx * yy - xy * xy
    a, b = (xw * yy - yw * xy) / determinant, (yw * xx - xw * xy) / determinant
    centre = w - a * x - b * y
    if n < 4.0 or determinant < wp.max(0.05 * xx * yy, 1.0e-3) or centre <= 0.0:
        return
    smooth[i] = 1.0 / centre
    # 1/z = a (u - u0) + b (v - v0) + centre = n . ray / D for the plane n . X = D.
    at_axis = centre + a * (camera.cx - float(u)) + b * (camera.cy - float(v))
    # With D > 0 this vector points away from the camera.
    view.normals[i] = -wp.normalize(wp.vec3(a * camera.fx, b * camera.fy, at_axis))


@wp.kernel
def missing_in_rows(view: DepthView, radius: int, count: wp.array(dtype=int), first: int):
    """One work item a row: number of its pixels without a reading up to `radius` beside each."""
    width = view.camera.width
    row = (first + wp.tid()) * width
    missing = int(0)
    u = -radius - 1
    while u + 1 < width:
        u += 1
        if u + radius < width and view.depth[row + u + radius] <= 0.0:
            missing += 1
        if u > radius and view.depth[row + u - radius - 1] <= 0.0:
            missing -= 1
        if u >= 0:
            count[row + u] = missing


@wp.kernel
def missing_share(
    view: DepthView, radius: int, in_rows: wp.array(dtype=int), usual: float, first: int
):
    """One work item a column: share of pixels without a reading in the square of `radius` [pixel].

    Small holes are sensor noise; a wide area without readings is most likely empty. Where surfaces
    have holes all over, only what is missing beyond that says so.

    Args (beyond the obvious):
        view: its shares of missing readings are the output, 0 at pixels with a reading.
        in_rows: result of `missing_in_rows`.
        usual: share below 1 that counts as none; from there to 1 the result goes from 0 to 1.
    """
    width, height = view.camera.width, view.camera.height
    u = first + wp.tid()
    across = wp.min(u + radius, width - 1) - wp.max(u - radius, 0) + 1
    missing = int(0)
    v = -radius - 1
    while v + 1 < height:
        v += 1
        if v + radius < height:
            missing += in_rows[(v + radius) * width + u]
        if v > radius:
            missing -= in_rows[(v - radius - 1) * width + u]
        if v >= 0:
            i = v * width + u
            view.missing[i] = 0.0
            if view.depth[i] <= 0.0:
                down = wp.min(v + radius, height - 1) - wp.max(v - radius, 0) + 1
                found = float(missing) / float(across * down)
                view.missing[i] = wp.max(0.0, (found - usual) / (1.0 - usual))
