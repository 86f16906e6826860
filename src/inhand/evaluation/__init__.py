"""Measuring an estimator against ground truth."""
