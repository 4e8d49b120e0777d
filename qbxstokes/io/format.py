"""What every file of this program says of itself, and nested dictionaries in HDF5."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import h5py

FORMAT = "qbxstokes"
FORMAT_VERSION = 1
PARTS = "parts"  # the group that names the parts which a result shows
CONVENTIONS = (
    "Nondimensional: length c (polar radius), time tau, speed c/tau, force mu c^2/tau, torque "
    "mu c^3/tau. Orientation: unit quaternion (q0, q1, q2, q3), scalar first, R(q) maps body to "
    "space; axis D3 = R e3; R = R3(phi) R1(theta) R3(psi). Vectors are in the space frame; force "
    "and torque act on the body."
)
_ATTRIBUTE_LIMIT = 16_384  # HDF5 refuses attributes above 64 KiB; long texts become datasets


def write_tree(group: h5py.Group, tree: Mapping[str, Any]) -> None:
    """Store nested dictionaries of numbers, texts and arrays; None and '' stay distinguishable."""
    import h5py

    for name, value in tree.items():
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
        else:
            value = item[()]
            if isinstance(value, bytes):
                tree[name] = value.decode()
            elif isinstance(value, np.ndarray) and value.dtype == object:
                tree[name] = [text.decode() for text in value]
            else:
                tree[name] = value
    return tree
