"""Spheroids, their surface grids, and rotations."""
