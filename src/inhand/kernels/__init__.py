"""Warp kernels, grouped by what they compute, and the one place that launches them.

Loops over points are `while`, with the step first, as they `continue`: what Warp makes of
`range` checks the sign of the step and packs and unpacks its numbers in every round, which makes
kernels 10 to 20 % slower on a CPU.
"""

import warp as wp

wp.config.log_level = wp.LOG_ERROR
wp.config.enable_backward = False
# Rounding may differ between machines, but infinities and NaN keep their meaning.
wp.config.cpu_compiler_flags = (
    f"{wp.config.cpu_compiler_flags or '-march=native'} "
    "-mreassociate -freciprocal-math -fno-signed-zeros -ffp-contract=fast"
)
