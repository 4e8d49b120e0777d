"""Rigid-body motion: equations, their Jacobian, and what is read off a trajectory."""
