"""Result files: one HDF5 file per run, written atomically, read back as NumPy arrays.

Layout of a motion (format_version 1): datasets `time` (T) and the quantities of a motion
(`quantities.MOTION`), each (T, ...) with attributes `units`, `description`, `frame` and `time` as
its dimension scale; groups `provenance` (how it was made) and `summary` (what came out);
attributes `format`, `format_version`, `task`, `conventions` at the root.

A file is written under a temporary name beside its target and moved there when it is complete:
a file that carries the final name is a whole one.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.errors import CaseError, OutputError, ResultFileError
from qbxstokes.io.places import describe, reserve
from qbxstokes.io.tables import GROUP, Table, read_tables
from qbxstokes.quantities import MOTION, TIME, Quantity

if TYPE_CHECKING:
    import h5py
    import pandas
    import xarray

FORMAT = "qbxstokes"
FORMAT_VERSION = 1
CONVENTIONS = (
    "Nondimensional: length c (polar radius), time tau, speed c/tau, force mu c^2/tau, torque "
    "mu c^3/tau. Orientation: unit quaternion (q0, q1, q2, q3), scalar first, R(q) maps body to "
    "space; axis D3 = R e3; R = R3(phi) R1(theta) R3(psi). Vectors are in the space frame; force "
    "and torque act on the body."
)
_ATTRIBUTE_LIMIT = 16_384  # HDF5 refuses attributes above 64 KiB; long texts become datasets


def numbered(path: Path) -> Iterator[Path]:
    """result.h5, result-1.h5, result-2.h5, ..."""
    yield path
    for number in range(1, 1_000_000):
        yield path.with_name(f"{path.stem}-{number}{path.suffix}")


def parts_of(path: Path) -> Path:
    """The working folder of the run whose result is to be `path`."""
    return path.with_name(f"{path.name}.parts")


def free_name(path: Path) -> Path:
    """`path` where nothing is there yet, else the first numbered name that is free."""
    return next(name for name in numbered(path) if not os.path.lexists(name))


def check_writable(path: Path, overwrite: bool = False) -> None:
    """Refuse a target that cannot be written, before anything is computed; raises CaseError.

    overwrite: an existing file would be replaced, which only a result of this program may be.
    """
    folder = path.parent
    try:
        if path.is_dir():
            example = path / "result.h5"
            raise CaseError(f"{path}: is a directory; name a result file such as {example}")
        if not folder.is_dir():
            raise CaseError(
                f"{path}: there is no directory {folder}; create it or change output.file"
            )
        if not os.access(folder, os.W_OK | os.X_OK):
            raise CaseError(f"{path}: no permission to write in {folder.resolve()}; choose another")
        with contextlib.suppress(FileNotFoundError):
            os.lstat(_temporary(path))  # complains about a name that is too long
    except OSError as error:
        raise CaseError(f"{path}: cannot be a result file ({error.strerror})") from None
    if overwrite and os.path.lexists(path) and not _is_result(path):
        raise CaseError(
            f"{path}: exists and is not a result of this program, so it is not overwritten; "
            "choose another name or remove it"
        )


def _temporary(path: Path) -> Path:
    """The name under which a result is written until it is complete."""
    return path.with_name(f".{path.name}.{os.getpid()}.part")


def _is_result(path: Path) -> bool:
    import h5py

    if not path.is_file():
        return False
    try:
        with h5py.File(path, "r") as file:
            return bool(file.attrs.get("format") == FORMAT)
    except OSError:
        return False


class _PatientFile(io.FileIO):
    """A file that keeps the first failure of the system to itself until it is asked for.

    HDF5 brings the process down when a write fails under it (a full disk); with this file it goes
    on writing into nothing, and the writer looks at `failure` after each piece.
    """

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of `data`, or note why that failed."""
        view = memoryview(data).cast("B")
        done = 0
        try:
            while self.failure is None and done < len(view):
                done += super().write(view[done:])
        except OSError as error:
            self.failure = error
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """Fill all of `buffer`, with zeros where there is nothing to read."""
        view = memoryview(buffer).cast("B")
        count = super().readinto(view) or 0
        view[count:] = bytes(len(view) - count)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file, or note why that failed."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return size or 0


class ResultWriter:
    """A result file in the making; `finish` gives it its name, leaving without it removes it.

    >>> with ResultWriter(Path("result.h5"), "motion") as writer:  # doctest: +SKIP
    ...     writer.append({"time": times, "position": positions})
    ...     writer.finish({"steps": 120})
    """

    def __init__(
        self,
        path: Path,
        task: str,
        provenance: Mapping[str, Any] | None = None,
        overwrite: bool = False,
    ) -> None:
        """Create the temporary file beside `path`; raises CaseError where that is impossible."""
        import h5py

        check_writable(path, overwrite)
        self.path = path
        self.overwrite = overwrite
        self.temporary = _temporary(path)
        try:
            self.stream = _PatientFile(self.temporary, "w+")
        except OSError as error:
            raise CaseError(f"{path}: cannot be created ({error.strerror})") from None
        self.file: h5py.File = h5py.File(self.stream, "w", libver=("v108", "v110"))
        self.file.attrs.update(
            format=FORMAT, format_version=FORMAT_VERSION, task=task, conventions=CONVENTIONS
        )
        write_tree(self.file.create_group("provenance"), provenance or {})

    def append(
        self,
        samples: Mapping[str, ArrayLike],
        about: Mapping[str, Quantity] = MOTION,
    ) -> None:
        """Append samples: `time` (n,) and any quantities (n, ...); the same ones every time.

        Raises OutputError if they cannot be stored.
        """
        with self._writing():
            times = np.asarray(samples["time"], dtype=float)
            scale = self._extended("time", times, TIME)
            if "CLASS" not in scale.attrs:
                scale.make_scale("time")
            for name, values in samples.items():
                if name != "time":
                    data = self._extended(name, np.asarray(values, dtype=float), about[name])
                    if not len(data.dims[0]):
                        data.dims[0].attach_scale(scale)

    def append_events(
        self, name: str, rows: Mapping[str, ArrayLike], about: Mapping[str, Quantity]
    ) -> None:
        """Append rows to the group `events/NAME`: `time` (n,) and quantities (n, ...)."""
        with self._writing():
            for key, values in rows.items():
                self._extended(f"events/{name}/{key}", np.asarray(values, float), about[key])

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn what HDF5 and the system report into one OutputError."""
        try:
            yield
            if self.file:
                self.file.flush()
            failure = self.stream.failure
        except OSError as error:
            failure = self.stream.failure or error
        if failure is not None:
            reason = failure.strerror or str(failure)
            raise OutputError(f"{self.path}: cannot be written ({reason})") from None

    def _extended(self, name: str, values: NDArray[np.float64], about: Quantity) -> h5py.Dataset:
        """The dataset `name` with `values` after what it held."""
        if values.shape[1:] != about.shape:
            raise ValueError(f"{name}: samples of shape {values.shape[1:]}, not {about.shape}")
        if name not in self.file:
            chunk = max(1, min(len(values), 65_536 // (8 * max(1, int(np.prod(about.shape))))))
            data = self.file.create_dataset(
                name,
                data=values,
                maxshape=(None, *about.shape),
                chunks=(chunk, *about.shape),
                fletcher32=True,  # damage is noticed when reading
                track_times=False,
            )
            describe(data, about)
            return data
        data = self.file[name]
        held = len(data)
        data.resize(held + len(values), axis=0)
        data[held:] = values
        return data

    def claim(self) -> None:
        """Claim the room of all that has been laid out so far; raises OutputError."""
        with self._writing():
            self.file.flush()
            reserve(self.temporary)

    def sync(self) -> None:
        """Bring what was appended to the disk; raises OutputError."""
        with self._writing():
            os.fsync(self.stream.fileno())

    def finish(self, summary: Mapping[str, Any] | None = None) -> Path:
        """Write the summary, close, and give the file its name; returns the name it got.

        An existing file is replaced only when `overwrite` was asked for; otherwise the next free
        numbered name is taken, without a gap in which another process could lose its file.
        Raises OutputError; then nothing is left behind.
        """
        with self._writing():
            write_tree(self.file.require_group("summary"), summary or {})
        with self._writing():
            self.file.close()
            os.fsync(self.stream.fileno())
            self.stream.close()
        return self._rename()

    def _rename(self) -> Path:
        """Move the complete file to its name."""
        if self.overwrite:
            os.replace(self.temporary, self.path)
            return self.path
        for name in numbered(self.path):
            try:
                os.link(self.temporary, name)
            except FileExistsError:
                continue
            except OSError:  # a file system without hard links
                if os.path.lexists(name):
                    continue
                os.replace(self.temporary, name)
                return name
            self.temporary.unlink()
            return name
        raise OutputError(f"{self.path}: every numbered name is taken; use --overwrite")

    def __enter__(self) -> ResultWriter:
        """The writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Remove the temporary file unless `finish` moved it."""
        if self.file:
            self.file.close()
        self.stream.close()
        self.temporary.unlink(missing_ok=True)


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


class Result:
    """A result read into memory: each dataset is an attribute holding a NumPy array.

    `provenance` and `summary` are nested dictionaries; `attributes` maps each dataset's name to
    its units, description and frame; `names` lists the datasets; `tables` are the tables by name.
    """

    def __init__(
        self,
        path: Path,
        header: dict[str, Any],
        arrays: dict[str, NDArray[Any]],
        attributes: dict[str, dict[str, Any]],
        groups: dict[str, dict[str, Any]],
        tables: dict[str, Table] | None = None,
    ) -> None:
        """Collect what `load` has read."""
        self.tables: dict[str, Table] = tables or {}
        self.path = path
        self.task: str = header["task"]
        self.format_version = int(header["format_version"])
        self.conventions: str = header.get("conventions", "")
        self.provenance: dict[str, Any] = groups.pop("provenance", {})
        self.summary: dict[str, Any] = groups.pop("summary", {})
        self.groups = groups
        self.arrays = arrays
        self.attributes = attributes

    @property
    def names(self) -> list[str]:
        """Names of the datasets."""
        return list(self.arrays)

    def __getattr__(self, name: str) -> NDArray[Any]:
        """The dataset `name`."""
        arrays = self.__dict__.get("arrays", {})
        if name in arrays:
            return arrays[name]
        raise AttributeError(f"no dataset {name}; there are {', '.join(arrays)}")

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The dataset `name`."""
        return self.arrays[name]

    def __dir__(self) -> list[str]:
        """Attributes, with the datasets among them."""
        return [*super().__dir__(), *self.arrays]

    def __repr__(self) -> str:
        """Task, file and the shape of each dataset."""
        shapes = ", ".join(f"{name}{list(data.shape)}" for name, data in self.arrays.items())
        return f"<{self.task} result {self.path}: {shapes}>"

    def to_pandas(self) -> pandas.DataFrame:
        """A table with one row per instant, columns such as position_1; needs pandas."""
        import pandas as pd

        columns: dict[str, NDArray[Any]] = {}
        for name, data in self.arrays.items():
            if name == "time" or len(data) != len(self.time):
                continue
            if data.ndim == 1:
                columns[name] = data
            else:
                for label, column in zip(self._labels(name), data.T, strict=True):
                    columns[f"{name}_{label}"] = column
        return pd.DataFrame(columns, index=pd.Index(self.time, name="time"))

    def to_xarray(self) -> xarray.Dataset:
        """A Dataset over time with units and descriptions as attributes; needs xarray."""
        import xarray as xr

        variables = {
            name: (
                ("time", *(f"{name}_component" for _ in data.shape[1:])),
                data,
                self.attributes[name],
            )
            for name, data in self.arrays.items()
            if name != "time"
        }
        coordinates: dict[str, Any] = {"time": ("time", self.time, self.attributes["time"])}
        for name, data in self.arrays.items():
            if data.ndim == 2:
                coordinates[f"{name}_component"] = list(self._labels(name))
        return xr.Dataset(variables, coordinates, {"title": str(self.path), "task": self.task})

    def _labels(self, name: str) -> Sequence[str]:
        labels = self.attributes[name].get("components")
        return (
            list(labels)
            if labels is not None
            else [str(index + 1) for index in range(self.arrays[name].shape[1])]
        )


def load(path: str | Path) -> Result:
    """Read a result file; raises ResultFileError if it is missing, damaged or not ours.

    >>> result = load("jeffery_prolate.h5")  # doctest: +SKIP
    >>> result.time.shape, result.axis.shape  # doctest: +SKIP
    ((301,), (301, 3))
    """
    import h5py

    path = Path(path)
    try:
        if path.is_dir():
            raise ResultFileError(f"{path}: is a directory; name a result file (.h5)")
        if not path.exists():
            raise ResultFileError(f"{path}: no such file; name a result file (.h5)")
        if not path.is_file():  # reading a pipe might wait for ever
            raise ResultFileError(f"{path}: is a pipe or device; name a result file (.h5)")
        if not os.access(path, os.R_OK):
            raise ResultFileError(f"{path}: no permission to read it")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be read ({error.strerror})") from None
    if not h5py.is_hdf5(path):
        raise ResultFileError(f"{path}: is not an HDF5 file; name a result of this program")
    try:
        with h5py.File(path, "r") as file:
            header = dict(file.attrs)
            if header.get("format") != FORMAT or "task" not in header:
                raise ResultFileError(f"{path}: an HDF5 file, but not written by this program")
            if int(header.get("format_version", 0)) > FORMAT_VERSION:
                raise ResultFileError(
                    f"{path}: has format version {header['format_version']}, this program reads "
                    f"{FORMAT_VERSION}; update qbxstokes"
                )
            if header["task"] == "sweep":
                from qbxstokes.io.sweep_result import read_sweep

                return read_sweep(path, file, header)
            arrays: dict[str, NDArray[Any]] = {}
            attributes: dict[str, dict[str, Any]] = {}
            groups: dict[str, dict[str, Any]] = {}
            tables = read_tables(file)
            for name, item in file.items():
                if name == GROUP:
                    continue
                if isinstance(item, h5py.Group):
                    groups[name] = read_tree(item)
                    continue
                arrays[name] = item[()]
                attributes[name] = {
                    key: item.attrs[key]
                    for key in ("units", "description", "frame", "components")
                    if key in item.attrs
                }
            if "summary" not in groups:
                raise ResultFileError(f"{path}: is incomplete: it has no summary; run it again")
    except ResultFileError:
        raise
    except Exception as error:  # h5py reports damage by errors of many kinds
        reason = " ".join(str(error).split())
        raise ResultFileError(f"{path}: is damaged or truncated ({reason})") from None
    return Result(path, header, arrays, attributes, groups, tables)
