"""Sampling of 4-point bases (paper, Alg. 2) and extraction of their congruent sets (Super4PCS).

A base is two pairs of points, (0, 1) and (2, 3), whose lines cross. The crossing divides the pairs
in two ratios. Rigid motions keep the pairs' lengths, the ratios and the angle between the pairs,
so two pairs of model points with these lengths, whose intermediate points at these ratios coincide
and which enclose this angle, are a congruent set (Mellado et al., "Super 4PCS", 2014).
"""

import warp as wp

from inhand.kernels.pair_matching import PairTable, angle_between


@wp.func
def pair_feature(points: wp.array(dtype=wp.vec3), normals: wp.array(dtype=wp.vec3), p: int, q: int):
    """PPF of points p and q: distance [m] and angles of n_p and line, n_q and line, n_p and n_q
    [rad]."""
    line = points[q] - points[p]
    distance = wp.length(line)
    d = line / wp.max(distance, 1.0e-9)
    n_p = normals[p]
    n_q = normals[q]
    return wp.vec4(distance, angle_between(n_p, d), angle_between(n_q, d), angle_between(n_p, n_q))


@wp.func
def angle_bin(model: PairTable, angle: float):
    """Bin of an angle [rad]."""
    return wp.clamp(int(angle / wp.PI * float(model.n_angle)), 0, model.n_angle - 1)


@wp.struct
class BaseRule:
    """Parameters of Alg. 2."""

    discount: float
    """gamma: factor on a point's probability when it is sampled."""
    max_tries: int
    coplanarity: float
    """Largest distance of the fourth point to the plane of the others [m]."""
    max_cosine: float
    """Largest absolute cosine of the angle at the first point."""
    any_angles: int
    """1: the model need not have a pair's angles, only be as large as the pair is long."""


@wp.func
def known_to_model(model: PairTable, rule: BaseRule, feature: wp.vec4):
    """Whether some pair of the model has this discretised feature: PPF_M[f] is not empty."""
    d = int(feature[0] / model.distance_step)
    if d >= model.n_distance:
        return False
    if rule.any_angles == 1:
        return True
    n = model.n_angle
    cell = (d * n + angle_bin(model, feature[1])) * n + angle_bin(model, feature[2])
    cell = cell * n + angle_bin(model, feature[3])
    return model.cell_start[cell + 1] > model.cell_start[cell]


@wp.func
def draw(pi: wp.array2d(dtype=float), row: int, r: float):
    """Index drawn by the probabilities in a row of `pi`, from r in [0, 1); -1 if all are 0."""
    total = float(0.0)
    for k in range(pi.shape[1]):
        total += pi[row, k]
    if total <= 0.0:
        return -1
    left = r * total
    chosen = int(-1)
    for k in range(pi.shape[1]):
        if pi[row, k] > 0.0:
            chosen = k
            left -= pi[row, k]
            if left < 0.0:
                break
    return chosen


@wp.func
def crossing_ratios(points: wp.array(dtype=wp.vec3), base: wp.vec4i):
    """Where the lines ab and cd of a base's points come nearest: a + r1 (b - a), c + r2 (d - c)."""
    u = points[base[1]] - points[base[0]]
    v = points[base[3]] - points[base[2]]
    w = points[base[0]] - points[base[2]]
    uu = wp.dot(u, u)
    vv = wp.dot(v, v)
    uv = wp.dot(u, v)
    determinant = uu * vv - uv * uv
    if determinant < 1.0e-4 * uu * vv:
        return wp.vec2(1.0e3, 1.0e3)
    r1 = (uv * wp.dot(v, w) - vv * wp.dot(u, w)) / determinant
    r2 = (uu * wp.dot(v, w) - uv * wp.dot(u, w)) / determinant
    return wp.vec2(r1, r2)


@wp.kernel
def sample_bases(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    prior: wp.array(dtype=float),
    model: PairTable,
    rule: BaseRule,
    seed: int,
    pi: wp.array2d(dtype=float),
    bases: wp.array(dtype=wp.vec4i),
    ratios: wp.array(dtype=wp.vec2),
    first: int,
):
    """One work item a base, with its own random stream: SAMPLE_ONE_BASE of Alg. 2.

    Args (beyond the obvious):
        prior: probability of every point before anything was sampled, shape (n,).
        pi: scratch, shape (bases, n).
        bases: out, indices of the points, pairs (0, 1) and (2, 3); -1 where none was found.
        ratios: out, where the pairs' lines cross.
    """
    i = first + wp.tid()
    state = wp.rand_init(seed, i)
    bases[i] = wp.vec4i(-1, -1, -1, -1)
    for k in range(points.shape[0]):
        pi[i, k] = prior[k]
    b1 = draw(pi, i, wp.randf(state))
    if b1 < 0:
        return
    p1 = points[b1]
    for k in range(points.shape[0]):
        if not known_to_model(model, rule, pair_feature(points, normals, k, b1)):
            pi[i, k] = 0.0
    pi[i, b1] = 0.0

    b2 = int(-1)
    b3 = int(-1)
    plane = wp.vec3()
    for _ in range(rule.max_tries):
        j = draw(pi, i, wp.randf(state))
        k = draw(pi, i, wp.randf(state))
        if j < 0 or j == k:
            continue
        pi[i, j] = rule.discount * pi[i, j]
        pi[i, k] = rule.discount * pi[i, k]
        f23 = pair_feature(points, normals, j, k)
        if not known_to_model(model, rule, f23):
            continue
        u = wp.normalize(points[j] - p1)
        v = wp.normalize(points[k] - p1)
        # Points in line are as useless at 180 degrees as at 0.
        if wp.abs(wp.dot(u, v)) < rule.max_cosine:
            b2 = j
            b3 = k
            plane = wp.normalize(wp.cross(u, v))
            pi[i, j] = 0.0
            pi[i, k] = 0.0
            break
    if b2 < 0:
        return

    for _ in range(rule.max_tries):
        b4 = draw(pi, i, wp.randf(state))
        if b4 < 0:
            return
        pi[i, b4] = rule.discount * pi[i, b4]
        if wp.abs(wp.dot(plane, points[b4] - p1)) > rule.coplanarity:
            continue
        f24 = pair_feature(points, normals, b2, b4)
        f34 = pair_feature(points, normals, b3, b4)
        if known_to_model(model, rule, f24) and known_to_model(model, rule, f34):
            pair_up(points, wp.vec4i(b1, b2, b3, b4), i, bases, ratios)
            return


@wp.func
def pair_up(
    points: wp.array(dtype=wp.vec3),
    base: wp.vec4i,
    i: int,
    bases: wp.array(dtype=wp.vec4i),
    ratios: wp.array(dtype=wp.vec2),
):
    """Store the base with the pairing whose lines cross nearest to the pairs' middles."""
    best = float(1.0e3)
    for k in range(3):
        paired = base
        if k == 1:
            paired = wp.vec4i(base[0], base[2], base[1], base[3])
        if k == 2:
            paired = wp.vec4i(base[0], base[3], base[1], base[2])
        r = crossing_ratios(points, paired)
        outside = wp.max(wp.abs(r[0] - 0.5), wp.abs(r[1] - 0.5))
        if outside < best:
            best = outside
            bases[i] = paired
            ratios[i] = r


@wp.func
def even_choice(rank: int, total: int, limit: int):
    """Place of element `rank` of `total` among `limit` evenly chosen ones, -1 if it is not one."""
    if total <= limit:
        return rank
    place = (wp.int64(rank) * wp.int64(limit)) / wp.int64(total)
    before = (wp.int64(rank - 1) * wp.int64(limit)) / wp.int64(total)
    if rank > 0 and before == place:
        return -1
    return int(place)


@wp.kernel
def find_pairs(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    bases: wp.array(dtype=wp.vec4i),
    ratios: wp.array(dtype=wp.vec2),
    model: PairTable,
    tolerance: float,
    angle_tolerance: float,
    spread: float,
    limit: int,
    start: wp.array(dtype=int),
    count: wp.array(dtype=int),
    pair: wp.array(dtype=int),
    middle: wp.array(dtype=wp.vec3),
    first: int,
):
    """One work item a base's pair: the model's pairs like it, with their intermediate points.

    Item i is pair i // n of base i % n, for n bases. Only counts while `pair` is empty. Otherwise
    an even choice of `limit` pairs is stored, and `count` must hold the numbers found.

    Args (beyond the obvious):
        tolerance: of the pair's length [m].
        angle_tolerance: of the three angles of the pair's feature [rad].
        spread: intermediate points of base b are shifted by b * spread along x [m], so that one
            grid serves all bases.
        start: first place of every item in the outputs.
        count: out, number of pairs of every item.
        pair: out, index of the model's pair.
        middle: out, its intermediate point.
    """
    i = first + wp.tid()
    base = i % bases.shape[0]
    side = i // bases.shape[0]
    a = bases[base][2 * side]
    b = bases[base][2 * side + 1]
    ratio = ratios[base][side]
    shift = wp.vec3(float(base) * spread, 0.0, 0.0)
    wanted = pair_feature(points, normals, a, b)
    tolerances = wp.vec4(tolerance, angle_tolerance, angle_tolerance, angle_tolerance)
    n = model.n_angle
    lo_d = wp.max(int((wanted[0] - tolerance) / model.distance_step), 0)
    hi_d = wp.min(int((wanted[0] + tolerance) / model.distance_step), model.n_distance - 1)
    lo_1 = angle_bin(model, wanted[1] - angle_tolerance)
    hi_1 = angle_bin(model, wanted[1] + angle_tolerance)
    lo_2 = angle_bin(model, wanted[2] - angle_tolerance)
    hi_2 = angle_bin(model, wanted[2] + angle_tolerance)
    lo_3 = angle_bin(model, wanted[3] - angle_tolerance)
    hi_3 = angle_bin(model, wanted[3] + angle_tolerance)
    found = int(0)
    for d in range(lo_d, hi_d + 1):
        for bin_1 in range(lo_1, hi_1 + 1):
            for bin_2 in range(lo_2, hi_2 + 1):
                # Cells that differ in the last angle alone lie one after the other.
                row = ((d * n + bin_1) * n + bin_2) * n
                for k in range(model.cell_start[row + lo_3], model.cell_start[row + hi_3 + 1]):
                    first_point = model.pair_first[k]
                    second_point = model.pair_second[k]
                    f = pair_feature(model.points, model.normals, first_point, second_point)
                    if wp.min(tolerances - wp.abs(f - wanted)) < 0.0:
                        continue
                    if pair.shape[0] > 0:
                        place = even_choice(found, count[i], limit)
                        if place >= 0:
                            pair[start[i] + place] = k
                            p = model.points[first_point]
                            line = model.points[second_point] - p
                            middle[start[i] + place] = p + ratio * line + shift
                    found += 1
    count[i] = found


PARALLEL = wp.constant(1.0e-5)
"""Unit vectors that enclose less than this are parallel, up to rounding [rad]."""


@wp.func
def handedness(u: wp.vec3, v: wp.vec3, normals: wp.array(dtype=wp.vec3), base: wp.vec4i):
    """On which side of the plane of lines u and v the surface looks; tells mirror images apart."""
    across = wp.cross(u, v)
    if wp.length(across) < PARALLEL:  # no plane
        return 0.0
    total = normals[base[0]] + normals[base[1]] + normals[base[2]] + normals[base[3]]
    return 0.25 * wp.dot(wp.normalize(across), total)


@wp.kernel
def match_pairs(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    bases: wp.array(dtype=wp.vec4i),
    owner: wp.array(dtype=int),
    model: PairTable,
    pair: wp.array(dtype=int),
    middle: wp.array(dtype=wp.vec3),
    second_start: int,
    grid: wp.uint64,
    tolerance: float,
    angle_tolerance: float,
    side_tolerance: float,
    rank: wp.array(dtype=int),
    total: wp.array(dtype=int),
    limit: int,
    set_start: wp.array(dtype=int),
    count: wp.array(dtype=int),
    sets: wp.array(dtype=wp.vec4i),
    first: int,
):
    """One work item a first pair found on the model: the second pairs that complete it.

    Only counts while `sets` is empty. Otherwise an even choice of `limit` sets a base is stored.

    Args (beyond the obvious):
        owner: base of every first pair.
        pair, middle: from `find_pairs`; second pairs start at `second_start`.
        grid: hash grid of the second pairs' intermediate points.
        tolerance: of the distance between the two intermediate points [m].
        angle_tolerance: of the angle between the two pairs [rad].
        side_tolerance: of the handedness; 2 and more lets mirror images pass.
        rank: number of the base's sets before this item's.
        total: number of sets of every base.
        set_start: first place of every base in `sets`.
        count: out, number of sets of every item.
        sets: out, indices of the four model points.
    """
    i = first + wp.tid()
    base = owner[i]
    b = bases[base]
    u = wp.normalize(points[b[1]] - points[b[0]])
    v = wp.normalize(points[b[3]] - points[b[2]])
    angle = angle_between(u, v)
    side = handedness(u, v, normals, b)
    q0 = model.pair_first[pair[i]]
    q1 = model.pair_second[pair[i]]
    u = wp.normalize(model.points[q1] - model.points[q0])
    found = int(0)
    query = wp.hash_grid_query(grid, middle[i], tolerance)
    candidate = int(0)
    while wp.hash_grid_query_next(query, candidate):
        j = second_start + candidate
        if wp.length(middle[j] - middle[i]) > tolerance:
            continue
        q2 = model.pair_first[pair[j]]
        q3 = model.pair_second[pair[j]]
        v = wp.normalize(model.points[q3] - model.points[q2])
        if wp.abs(angle_between(u, v) - angle) > angle_tolerance:
            continue
        found_set = wp.vec4i(q0, q1, q2, q3)
        if wp.abs(handedness(u, v, model.normals, found_set) - side) > side_tolerance:
            continue
        if sets.shape[0] > 0:
            place = even_choice(rank[i] + found, total[base], limit)
            if place >= 0:
                sets[set_start[base] + place] = found_set
        found += 1
    count[i] = found
