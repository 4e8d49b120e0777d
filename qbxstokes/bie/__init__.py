"""Integral equations of a rigid body: mobility, resistance, and the body model they give."""
