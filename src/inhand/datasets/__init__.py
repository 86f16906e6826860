"""Readers of recorded and rendered data sets."""
