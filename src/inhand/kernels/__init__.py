"""Warp kernels, grouped by what they compute, and the one place that launches them."""
