"""Work items that the threads of a block share.

Such a kernel begins with `item, lane = wp.tid()`: lane k of `wp.block_dim()` takes every so-many-th
point from the k-th on. On a CPU a block is one thread, which takes them all. Warp's tiles would do
the sums as well, but not on several CPU threads at a time.
"""

import warp as wp

from inhand.kernels.normal_equations import Vector6


@wp.func_native("WP_TILE_SYNC();")
def wait_for_block():
    """Go on when all threads of the block have come here, and see what they have written."""


@wp.func_native(
    """
    if (WP_TILE_BLOCK_DIM == 1)
        return value;
#if defined(__CUDA_ARCH__)
    __shared__ float parts[WP_TILE_BLOCK_DIM];
#else  // for tests: one CPU thread at a time runs blocks of several
    static float parts[WP_TILE_BLOCK_DIM];
#endif
    const int lane = WP_TILE_THREAD_IDX;
    parts[lane] = value;
    WP_TILE_SYNC();
    for (int half = WP_TILE_BLOCK_DIM / 2; half > 0; half /= 2) {
        if (lane < half)
            parts[lane] += parts[lane + half];
        WP_TILE_SYNC();
    }
    const float sum = parts[0];
    WP_TILE_SYNC();
    return sum;
    """
)
def block_sum(value: float) -> float:
    """Sum over the threads of a block of 2^n; all of them must come here."""


@wp.func
def sum_rows(rows: wp.array3d(dtype=Vector6), item: int, lane: int):
    """Add what all threads have in `rows`, (thread, item, row), to what the first has there; all
    threads of the block must come here."""
    wait_for_block()
    if wp.block_dim() > 1:
        for row in range(lane, rows.shape[2], wp.block_dim()):
            total = rows[0, item, row]
            for other in range(1, wp.block_dim()):
                total += rows[other, item, row]
            rows[0, item, row] = total
    wait_for_block()
