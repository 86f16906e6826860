"""Scenes with known answers: a hand that holds an object, seen by a simulated depth camera."""
