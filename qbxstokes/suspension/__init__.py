"""Rheology of dilute suspensions: distributions of orientations, and the stress they give."""
