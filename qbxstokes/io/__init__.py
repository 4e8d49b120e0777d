"""Files: results in HDF5, and what other programs open."""
