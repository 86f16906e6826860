"""Object poses from pairs of oriented points matched through the pair table (Drost et al. 2010)."""

import warp as wp

from inhand.kernels.transforms import rigid

# Cosine of the angle that jitter and noise explain between a scene normal and the model's, 35 deg.
MIN_NORMAL_AGREEMENT = wp.constant(0.82)


@wp.struct
class PairTable:
    """The model's pairs by quantised feature, see `inhand.object_model.PairTable`."""

    cell_start: wp.array(dtype=int)
    pair_first: wp.array(dtype=int)
    pair_second: wp.array(dtype=int)
    points: wp.array(dtype=wp.vec3)
    normals: wp.array(dtype=wp.vec3)
    distance_step: float
    n_distance: int
    n_angle: int


@wp.func
def opposed(p1: wp.vec3, n1: wp.vec3, p2: wp.vec3, n2: wp.vec3):
    """Whether the normals look to opposite sides of the pair, seen along it."""
    along = wp.normalize(p2 - p1)
    return wp.dot(n1, n2) < wp.dot(n1, along) * wp.dot(n2, along)


@wp.func
def pair_frame(p1: wp.vec3, n1: wp.vec3, p2: wp.vec3, n2: wp.vec3, turn: bool):
    """Rotation whose columns are the pair's axes: along the pair, along its mean normal, across.

    `turn`: the second normal counts with the opposite sign in the mean.
    """
    along = wp.normalize(p2 - p1)
    a = n1 - wp.dot(n1, along) * along
    b = n2 - wp.dot(n2, along) * along
    if turn:
        b = -b
    up = wp.normalize(a + b)
    across = wp.cross(along, up)
    return wp.matrix_from_cols(along, up, across)


@wp.func
def angle_between(a: wp.vec3, b: wp.vec3):
    """Angle [rad] between unit vectors."""
    return wp.acos(wp.clamp(wp.dot(a, b), -1.0, 1.0))


@wp.kernel
def match_pairs(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    pair_a: wp.array(dtype=int),
    pair_b: wp.array(dtype=int),
    table: PairTable,
    matches: int,
    seed: int,
    T_camera_object: wp.array(dtype=wp.mat44),
    first: int,
):
    """One work item a scene pair: `matches` poses that lay a model pair onto it.

    The feature is jittered by half a cell at each draw, which makes the cells' borders soft. A
    draw from an empty cell leaves a zero matrix.
    """
    k = first + wp.tid()
    p1 = points[pair_a[k]]
    n1 = normals[pair_a[k]]
    p2 = points[pair_b[k]]
    n2 = normals[pair_b[k]]
    d = p2 - p1
    length = wp.length(d)
    direction = d / wp.max(length, 1.0e-9)
    steps = length / table.distance_step
    angles = wp.vec3(
        angle_between(n1, direction), angle_between(n2, direction), angle_between(n1, n2)
    )
    angle_steps = angles / (3.14159265 / float(table.n_angle))
    # The mean of opposed normals says little; model and scene must agree on what takes its place.
    turn = opposed(p1, n1, p2, n2)
    scene = pair_frame(p1, n1, p2, n2, turn)
    middle = 0.5 * (p1 + p2)
    for m in range(matches):
        T_camera_object[k * matches + m] = wp.mat44()
        state = wp.rand_init(seed, k * matches + m)
        cell = int(wp.floor(steps + wp.randf(state) - 0.5))
        if cell < 1 or cell >= table.n_distance:
            continue
        for a in range(3):
            # Angles are mirrored at 0 and pi.
            step = int(wp.floor(angle_steps[a] + wp.randf(state) - 0.5))
            cell = cell * table.n_angle + wp.clamp(step, 0, table.n_angle - 1)
        start = table.cell_start[cell]
        count = table.cell_start[cell + 1] - start
        if count <= 0:
            continue
        entry = start + wp.min(count - 1, int(wp.randf(state) * float(count)))
        i = table.pair_first[entry]
        j = table.pair_second[entry]
        model = pair_frame(
            table.points[i], table.normals[i], table.points[j], table.normals[j], turn
        )
        R = scene @ wp.transpose(model)
        if wp.determinant(R) < 0.5:
            continue  # both normals along the pair: nothing fixes the rotation about it
        # A pair and its mirror image have the same feature; only one of them lays the normals on.
        if wp.dot(R @ table.normals[i], n1) < MIN_NORMAL_AGREEMENT:
            continue
        if wp.dot(R @ table.normals[j], n2) < MIN_NORMAL_AGREEMENT:
            continue
        t = middle - R @ (0.5 * (table.points[i] + table.points[j]))
        T_camera_object[k * matches + m] = rigid(R, t)
