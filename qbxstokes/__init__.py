"""qbxstokes: motion of a rigid spheroid in Stokes flow by quadrature by expansion."""

__version__ = "0.1.0"
