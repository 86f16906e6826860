"""Depth images one after the other, from a folder, a recording or a camera: `inhand run`."""
