"""What every file of this program says of itself, and nested dictionaries in HDF5."""

from __future__ import annotations

import mmap
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import HeldFileError

if TYPE_CHECKING:
    import h5py

    from qbxstokes.quantity import Quantity

FORMAT = "qbxstokes"
FORMAT_VERSION = 1
PARTS = "parts"  # the group that names the parts which a result shows
DIMENSION = "This is a netCDF dimension but not a netCDF variable."  # the name of its scale
CONVENTIONS = (
    "Nondimensional: length c (polar radius), time tau, speed c/tau, force mu c^2/tau, torque "
    "mu c^3/tau. Orientation: unit quaternion (q0, q1, q2, q3), scalar first, R(q) maps body to "
    "space; axis D3 = R e3; R = R3(phi) R1(theta) R3(psi). Vectors are in the space frame; force "
    "and torque act on the body."
)
# The texts of a file stand in heaps (HDF5's file format, III.E) that lie near its two ends.
_HEAP, _HEAP_HEADER, _OBJECT_HEADER = b"GCOL\x01\0\0\0", 16, 16
_LOOKED_AT = 2**23  # bytes at each end
_ATTRIBUTE_LIMIT = 16_384  # HDF5 refuses attributes above 64 KiB; long texts become datasets


def open_file(path: str | Path) -> h5py.File:
    """An HDF5 file opened for reading; raises HeldFileError, or OSError where damage shows.

    All of its structure bears checksums but for the heaps of texts. HDF5 walks through these by the
    lengths that stand in them, for ever where such a length is zero.
    """
    import h5py

    size = os.path.getsize(path)
    if size:
        with open(path, "rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for begin in sorted({0, max(0, size - _LOOKED_AT)}):
                _check_heaps(data, begin, min(size, begin + _LOOKED_AT))
    try:
        return h5py.File(path, "r")
    except OSError as error:
        if "unable to lock file" in str(error):
            wrong = "another program has it open to write; wait until it has closed it"
            raise HeldFileError(f"{path}: {wrong}") from None
        raise


def _check_heaps(data: mmap.mmap, begin: int, end: int) -> None:
    at = data.find(_HEAP, begin, end)
    while at >= 0:
        last = at + int.from_bytes(data[at + 8 : at + 16], "little")
        place = at + _HEAP_HEADER
        while place + _OBJECT_HEADER <= last:
            number = int.from_bytes(data[place : place + 2], "little")
            length = int.from_bytes(data[place + 8 : place + 16], "little")
            step = _OBJECT_HEADER + -(-length // 8) * 8 if number else length
            if step == 0 or place + step > last:
                raise OSError(f"its texts are damaged at byte {place}")
            place += step
        at = data.find(_HEAP, at + 1, end)


def stored_text(text: str) -> str:
    """A text as files hold it: names of files may have bytes that are no UTF-8."""
    return text.encode("utf-8", "backslashreplace").decode()


def is_dimension(data: h5py.Dataset) -> bool:
    """Whether a dataset holds nothing but marks a dimension."""
    mark = data.attrs.get("NAME", b"") if data.ndim == 1 else b""
    return isinstance(mark, bytes) and mark.startswith(DIMENSION.encode())


def describe(data: h5py.Dataset, about: Quantity) -> None:
    """Attach units, description, frame and components."""
    data.attrs.update(units=about.units, description=about.description, frame=about.frame)
    if about.components:
        data.attrs["components"] = list(about.components)


def placed_dataset(
    group: h5py.Group, name: str, shape: tuple[int, ...], dtype: Any, about: Quantity | None = None
) -> h5py.Dataset:
    """A contiguous dataset that has its room in the file at once, and is filled later."""
    import h5py

    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_layout(h5py.h5d.CONTIGUOUS)
    creation.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    creation.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    kind = h5py.h5t.py_create(np.dtype(dtype), logical=True)
    space = h5py.h5s.create_simple(shape)
    data = h5py.Dataset(h5py.h5d.create(group.id, name.encode(), kind, space, creation))
    if about is not None:
        describe(data, about)
    return data


def write_tree(group: h5py.Group, tree: Mapping[str, Any]) -> None:
    """Store nested dictionaries of numbers, texts and arrays; None and '' stay distinguishable."""
    import h5py

    for name, value in tree.items():
        if isinstance(value, str):
            value = stored_text(value)
        if isinstance(value, Mapping):
            write_tree(group.require_group(name), value)
        elif value is None:
            group.attrs[name] = h5py.Empty("f8")
        elif isinstance(value, (str, bool, int, float, np.generic)) and (
            not isinstance(value, str) or len(value) < _ATTRIBUTE_LIMIT // 4
        ):
            group.attrs[name] = value
        else:
            group.create_dataset(name, data=value, track_times=False)


def read_tree(group: h5py.Group) -> dict[str, Any]:
    """The inverse of `write_tree`."""
    import h5py

    tree: dict[str, Any] = {}
    for name, value in group.attrs.items():
        if isinstance(value, h5py.Empty):
            tree[name] = None
        else:
            tree[name] = value.item() if isinstance(value, np.generic) else value
    for name, item in group.items():
        if isinstance(item, h5py.Group):
            tree[name] = read_tree(item)
        elif not is_dimension(item):
            value = item[()]
            if isinstance(value, bytes):
                tree[name] = value.decode()
            elif isinstance(value, np.ndarray) and value.dtype == object:
                tree[name] = [text.decode() for text in value]
            else:
                tree[name] = value
    return tree


def first_difference(one: Any, other: Any, prefix: str = "") -> str | None:
    """Dotted key of the first difference of two nested dictionaries."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in dict.fromkeys([*one, *other]):
            found = first_difference(one.get(key), other.get(key), f"{prefix}{key}.")
            if found is not None:
                return found
        return None
    return None if one == other else prefix.rstrip(".")
