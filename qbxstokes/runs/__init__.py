"""Runs, sweeps and fields on ranks and to files: where MPI, files and PETSc meet."""
