"""Super4PCS on the device: wide coplanar bases and the rotation-aware grid (Mellado et al., "Super
4PCS: Fast Global Pointcloud Registration via Smart Indexing", 2014)."""

import warp as wp

from inhand.kernels.congruent_sets import even_choice, pair_up
from inhand.kernels.pair_matching import angle_between


@wp.struct
class WideBaseRule:
    """What a base must be like."""

    widest: float
    """No point is farther from the first one than this [m]."""
    narrowest: float
    """The fourth point is at least this far from the others [m]."""
    coplanarity: float
    """Largest distance of the fourth point to the plane of the others [m]."""
    triangles: int
    """Triangles of which the largest is taken."""
    attempts: int
    """Times that a base is begun anew when it finds no fourth point."""
    farthest_crossing: float
    """The pairs' lines cross at most this far from the pairs' middles, in their lengths."""


@wp.kernel
def sample_wide_bases(
    points: wp.array(dtype=wp.vec3),
    rule: WideBaseRule,
    seed: int,
    bases: wp.array(dtype=wp.vec4i),
    ratios: wp.array(dtype=wp.vec2),
    first: int,
):
    """One work item a base: a large random triangle, and the point nearest to its plane.

    Args (beyond the obvious):
        bases: out, indices of the points, pairs (0, 1) and (2, 3); -1 where none was found.
        ratios: out, where the pairs' lines cross.
    """
    i = first + wp.tid()
    state = wp.rand_init(seed, i)
    n = points.shape[0]
    for _attempt in range(rule.attempts):
        bases[i] = wp.vec4i(-1, -1, -1, -1)
        a = wp.randi(state, 0, n)
        b = int(a)
        c = int(a)
        largest = float(0.0)
        for _triangle in range(rule.triangles):
            j = wp.randi(state, 0, n)
            k = wp.randi(state, 0, n)
            u = points[j] - points[a]
            v = points[k] - points[a]
            area = wp.length(wp.cross(u, v))
            if area > largest and wp.length(u) < rule.widest and wp.length(v) < rule.widest:
                largest = area
                b = j
                c = k
        if largest == 0.0:
            continue
        d = flattest_point(points, rule, a, b, c)
        if d < 0:
            continue
        pair_up(points, wp.vec4i(a, b, c, d), i, bases, ratios)
        off = wp.max(wp.abs(ratios[i][0] - 0.5), wp.abs(ratios[i][1] - 0.5))
        # Of four points with one amid the others no two pairs cross.
        if off < rule.farthest_crossing:
            return
    bases[i] = wp.vec4i(-1, -1, -1, -1)


@wp.func
def flattest_point(points: wp.array(dtype=wp.vec3), rule: WideBaseRule, a: int, b: int, c: int):
    """The point nearest to the plane of three others and not too near to them, or -1."""
    plane = wp.normalize(wp.cross(points[b] - points[a], points[c] - points[a]))
    d = int(-1)
    flattest = rule.coplanarity
    for k in range(points.shape[0]):
        p = points[k]
        to_a = wp.length(p - points[a])
        others = wp.min(wp.length(p - points[b]), wp.length(p - points[c]))
        height = wp.abs(wp.dot(plane, p - points[a]))
        far = wp.min(to_a, others) > rule.narrowest
        if height < flattest and to_a < rule.widest and far:
            flattest = height
            d = k
    return d


@wp.struct
class Pairs:
    """Pairs of model points as long as the bases' pairs, those of a base one after the other."""

    points: wp.array(dtype=wp.vec3)
    """The model's points."""
    first: wp.array(dtype=int)
    second: wp.array(dtype=int)
    base: wp.array(dtype=int)
    """Index of the base."""


@wp.struct
class RotationAwareGrid:
    """Second pairs in slots by base, place of their intermediate point, and direction.

    The slots of one place lie one after the other, so that of the pairs around a point those on a
    cone of directions are found without looking at the others.
    """

    origin: wp.vec3
    """Corner of the first cell [m]."""
    cell: float
    """Edge of a cell [m], at least twice the tolerance of places: 8 cells hold all that is near."""
    size: wp.vec3i
    """Number of cells."""
    directions: wp.array(dtype=wp.vec3)
    """Middles of the bins of directions, at most 32."""
    reach: float
    """No direction is farther from the nearest middle than this [rad]."""
    start: wp.array(dtype=int)
    """First pair of every slot, and the number of pairs at the end."""


@wp.func
def direction(pairs: Pairs, k: int):
    """Unit vector along a pair."""
    return wp.normalize(pairs.points[pairs.second[k]] - pairs.points[pairs.first[k]])


@wp.func
def intermediate(pairs: Pairs, k: int, ratio: float):
    """The point on a pair's line that coincides with the other pair's in a congruent set."""
    p = pairs.points[pairs.first[k]]
    return p + ratio * (pairs.points[pairs.second[k]] - p)


@wp.func
def cell_at(index: RotationAwareGrid, p: wp.vec3):
    """The cell of a place inside the grid."""
    q = (p - index.origin) / index.cell
    return wp.vec3i(int(q[0]), int(q[1]), int(q[2]))


@wp.func
def first_slot(index: RotationAwareGrid, base: int, cell: wp.vec3i):
    """Slot of the first direction in a cell."""
    row = (base * index.size[0] + cell[0]) * index.size[1] + cell[1]
    return (row * index.size[2] + cell[2]) * index.directions.shape[0]


@wp.kernel
def find_slots(
    pairs: Pairs,
    ratios: wp.array(dtype=wp.vec2),
    index: RotationAwareGrid,
    slot: wp.array(dtype=int),
    first: int,
):
    """One work item a second pair: its slot."""
    i = first + wp.tid()
    along = direction(pairs, i)
    nearest = int(0)
    for k in range(index.directions.shape[0]):
        if wp.dot(index.directions[k], along) > wp.dot(index.directions[nearest], along):
            nearest = k
    middle = intermediate(pairs, i, ratios[pairs.base[i]][1])
    slot[i] = first_slot(index, pairs.base[i], cell_at(index, middle)) + nearest


@wp.kernel
def complete_sets(
    scene: wp.array(dtype=wp.vec3),
    bases: wp.array(dtype=wp.vec4i),
    ratios: wp.array(dtype=wp.vec2),
    one: Pairs,
    other: Pairs,
    index: RotationAwareGrid,
    tolerance: float,
    angle_tolerance: float,
    rank: wp.array(dtype=int),
    total: wp.array(dtype=int),
    limit: int,
    set_start: wp.array(dtype=int),
    count: wp.array(dtype=int),
    sets: wp.array(dtype=wp.vec4i),
    first: int,
):
    """One work item a first pair: the second pairs that make a congruent set with it.

    Only counts while `sets` is empty. Otherwise an even choice of `limit` sets a base is stored.

    Args (beyond the obvious):
        one, other: model pairs like the first and like the second pair of the bases; the latter in
            the order of the grid's slots.
        tolerance: of the distance between the two intermediate points [m].
        angle_tolerance: of the angle between the two pairs [rad].
        rank: number of the base's sets before this item's.
        total: number of sets of every base.
        set_start: first place of every base in `sets`.
        count: out, number of sets of every item.
        sets: out, indices of the four model points.
    """
    i = first + wp.tid()
    base = one.base[i]
    b = bases[base]
    wanted = angle_between(
        wp.normalize(scene[b[1]] - scene[b[0]]), wp.normalize(scene[b[3]] - scene[b[2]])
    )
    along = direction(one, i)
    middle = intermediate(one, i, ratios[base][0])
    # The bins on a cone around this pair's direction, as bits.
    cone = int(0)
    n_directions = index.directions.shape[0]
    for k in range(n_directions):
        off = wp.abs(angle_between(along, index.directions[k]) - wanted)
        if off < angle_tolerance + index.reach:
            cone |= 1 << k
    found = int(0)
    lowest = cell_at(index, middle - wp.vec3(tolerance, tolerance, tolerance))
    for corner in range(8):
        beside = wp.vec3i(corner & 1, (corner >> 1) & 1, (corner >> 2) & 1)
        slot = first_slot(index, base, lowest + beside)
        for k in range(n_directions):
            if (cone >> k) & 1 == 0:
                continue
            for j in range(index.start[slot + k], index.start[slot + k + 1]):
                if wp.length(intermediate(other, j, ratios[base][1]) - middle) > tolerance:
                    continue
                if wp.abs(angle_between(along, direction(other, j)) - wanted) > angle_tolerance:
                    continue
                if sets.shape[0] > 0:
                    chosen = even_choice(rank[i] + found, total[base], limit)
                    if chosen >= 0:
                        sets[set_start[base] + chosen] = wp.vec4i(
                            one.first[i], one.second[i], other.first[j], other.second[j]
                        )
                found += 1
    count[i] = found
