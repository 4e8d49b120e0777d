"""qbxstokes: motion of a rigid spheroid in Stokes flow by quadrature by expansion."""
