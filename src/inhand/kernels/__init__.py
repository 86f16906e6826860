"""Warp kernels, grouped by what they compute, and the one place that launches them."""

import warp as wp

wp.config.log_level = wp.LOG_ERROR
wp.config.enable_backward = False
# Rounding may differ between machines, but infinities and NaN keep their meaning.
wp.config.cpu_compiler_flags = (
    f"{wp.config.cpu_compiler_flags or '-march=native'} "
    "-mreassociate -freciprocal-math -fno-signed-zeros -ffp-contract=fast"
)
