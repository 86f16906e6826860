"""Kernels that make the kernels' inner functions callable from tests."""

# mypy: disable-error-code="valid-type, no-untyped-def, index"

import warp as wp

from inhand.kernels.fields import Fields, field_at
from inhand.kernels.normal_equations import Matrix6, Vector6, solve_in_place
from inhand.kernels.object_fit import moved


@wp.kernel
def write_index(out: wp.array(dtype=int), first: int):
    """Every work item writes its own index plus one, so that zero means untouched."""
    i = first + wp.tid()
    out[i] += i + 1


@wp.kernel
def look_up(
    fields: Fields,
    body: wp.array(dtype=int),
    points: wp.array(dtype=wp.vec3),
    value: wp.array(dtype=wp.vec4),
    first: int,
):
    i = first + wp.tid()
    value[i] = field_at(fields, body[i], points[i])


@wp.kernel
def solve(
    A: wp.array(dtype=Matrix6), b: wp.array(dtype=Vector6), x: wp.array(dtype=Vector6), first: int
):
    i = first + wp.tid()
    x[i] = solve_in_place(A[i], b[i], 6)


@wp.kernel
def move(
    T: wp.array(dtype=wp.mat44),
    x: wp.array(dtype=Vector6),
    pivot: wp.array(dtype=wp.vec3),
    T_moved: wp.array(dtype=wp.mat44),
    first: int,
):
    i = first + wp.tid()
    T_moved[i] = moved(T[i], x[i], pivot[i])
