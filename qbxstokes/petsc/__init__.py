"""PETSc: session, shell matrices, GMRES, time steppers. The only package that imports it."""
