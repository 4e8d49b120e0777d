"""Quadrature by expansion: kernels, source panels, azimuthal modes, layer operators."""
