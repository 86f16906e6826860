"""Labelling of images by hand: poses of hand and object, and finger angles, as ground truth."""
