"""Datasets at fixed places of an HDF5 file, filled by many processes at once without HDF5.

HDF5 without MPI lets one process write. A dataset that is contiguous and allocated when it is
created has a place in the file that does not change: once the file is laid out and its room on the
disk is claimed, any process may write its part there with `pwrite`, and HDF5 has no part in it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import h5py

    from qbxstokes.quantities import Quantity


def placed_dataset(
    group: h5py.Group,
    name: str,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    about: Quantity | None = None,
) -> h5py.Dataset:
    """A contiguous dataset whose place in the file is fixed at once, and never filled by HDF5."""
    import h5py

    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_layout(h5py.h5d.CONTIGUOUS)
    creation.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    creation.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    space = h5py.h5s.create_simple(shape) if shape else h5py.h5s.create(h5py.h5s.SCALAR)
    kind = h5py.h5t.py_create(dtype, logical=True)
    data = h5py.Dataset(h5py.h5d.create(group.id, name.encode(), kind, space, creation))
    if about is not None:
        describe(data, about)
    return data


def describe(data: h5py.Dataset, about: Quantity) -> None:
    """Attach units, description, frame and components."""
    data.attrs.update(units=about.units, description=about.description, frame=about.frame)
    if about.components:
        data.attrs["components"] = list(about.components)


def reserve(path: Path) -> None:
    """Claim the room of a file on the disk, so that no part finds it full later; raises OSError."""
    descriptor = os.open(path, os.O_WRONLY)
    try:
        os.posix_fallocate(descriptor, 0, os.fstat(descriptor).st_size)
    finally:
        os.close(descriptor)


def write_at(descriptor: int, data: Any, offset: int) -> None:
    """Write all bytes of `data` (bytes-like) at the offset; raises OSError."""
    view = memoryview(data)
    while len(view):
        written = os.pwrite(descriptor, view, offset)
        view, offset = view[written:], offset + written
