"""The commands `plot`, `animate` and `export`: what is made of result files."""

import argparse
import json
import os
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from qbxstokes.case.document import parse_key
from qbxstokes.case.sweep import column_name
from qbxstokes.errors import CaseError, QbxStokesError
from qbxstokes.io.export import FORMATS as EXPORTED
from qbxstokes.io.names import newer, newest
from qbxstokes.io.results import Result, SweepResult, load

PLOT_USAGE = """\
usage: python -m qbxstokes plot FILE ... [options]

Draws what result files (.h5) hold, or the newest result of a case (.yaml); each
picture is a file NAME-KIND.FORMAT. An older picture of that name is replaced.

options
  -o WHERE            folder of the pictures (default: here), or file of one
  --format FORMAT     pdf (default), svg or png; several with commas
  --kind KIND         only these, several with commas
  --trajectory N      of a sweep: the pictures of one trajectory
  --quiet, --json     print nothing; print the names of the files as JSON

of a motion
{motion}
of a field
  velocity-field (relative to the body), lab-field (in space), traction, error;
  instants: up to nine instants in one sheet
of an ensemble
  distributions, means, correlation
of a suspension
  material-functions, lissajous, distribution
of a sweep
  a summary of its table, such as period, rotation_rate, orbit_drift;
  orientations: axes of all trajectories on the sphere, at start and end;
  of one that was measured the error over the time;
  or columns of its table, any against any other, swept keys as in the case:
  --x A --y B,...     curves of B over A
  --by C,...          one curve (or map) per value of C
  --value D           a map of D over A and B
  --scale SCALE       loglog, semilogx, semilogy or linear
  --average HOW       rows with the same A (and C, or B) as one: their mean with
                      its standard deviation, or their median with 10 to 90 %
  --histogram A,...   how often each value occurs, an outline per value of C
"""

ANIMATE_USAGE = """\
usage: python -m qbxstokes animate FILE [options]

The tumbling body with the trail of its axis and the path of its centre.

options
  -o WHERE            folder of the animation (default: here), or its file
  --format FORMAT     gif (default), or mp4 where ffmpeg is installed
  --from T --until T  window of time (default: all)
  --frames N          number of frames (default: 48 a turn, 60 to 360 in all)
  --fps N             frames per second (default: 25)
  --trajectory N      of a sweep: which trajectory
  --quiet, --json     print nothing; print the name of the file as JSON
"""

EXPORT_USAGE = """\
usage: python -m qbxstokes export FILE ... [options]

Writes what result files (.h5) hold, or the newest result of a case (.yaml),
for other programs: NAME.csv, NAME.npz or NAME.nc.

options
  --csv               a table (default), a row per instant; of a sweep per
                      trajectory, of a field per point (a file for each set)
  --npz               all arrays, for NumPy
  --netcdf            arrays with named axes, for xarray and others
  --format F,...      the same by name: csv, npz, netcdf
  -o WHERE            folder of the files (default: here), or a file, whose
                      ending then says the format
  --trajectory N      of a sweep: the samples of one trajectory
  --units             in physical units, of a case with a section `units`
  --overwrite         replace files that are there
  --quiet, --json     print nothing; print the names of the files as JSON
"""

_FLAGS = {"csv": "csv", "npz": "npz", "nc": "netcdf"}  # of `export`
_COLUMNS = ("x", "y", "by", "value", "histogram")
Drawing = Callable[[], Any]  # a figure of matplotlib


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are CaseErrors."""

    def error(self, message: str) -> NoReturn:
        raise CaseError(f"command line: {message}; see python -m {self.prog} --help")


def picture_command(command: str, words: Sequence[str]) -> int:
    """Carry out one of the commands; returns the exit status, raises CaseError for bad input."""
    parser = _Parser(prog=f"qbxstokes {command}", add_help=False, allow_abbrev=False)
    parser.add_argument("files", nargs="*")
    parser.add_argument("-o", "--output", type=Path, default=Path())
    parser.add_argument("--trajectory", type=int)
    for flag in ("quiet", "json", "help"):
        parser.add_argument(f"--{flag}", action="store_true")
    if command != "export":
        parser.add_argument("--format", default="pdf" if command == "plot" else "gif")
    if command == "plot":
        parser.add_argument("--kind", type=_listed, action="extend", default=[])
        parser.add_argument("--x")
        parser.add_argument("--value")
        parser.add_argument("--scale")
        parser.add_argument("--average")
        for name in ("--y", "--by", "--histogram"):
            parser.add_argument(name, type=_listed, action="extend", default=[])
    elif command == "export":
        parser.add_argument("--format", type=_listed, action="extend", default=[])
        for flag in (*_FLAGS.values(), "overwrite", "units"):
            parser.add_argument(f"--{flag}", action="store_true")
    else:
        parser.add_argument("--frames", type=int)
        parser.add_argument("--fps", type=int, default=25)
        parser.add_argument("--from", type=float, dest="begin")
        parser.add_argument("--until", type=float)
    words = ["--help" if word == "-h" else word for word in words]
    options = parser.parse_intermixed_args(words)
    if options.help:
        print(_usage(command), end="")
        return 0
    if not options.files:
        raise CaseError(f"command line: {command} needs a result file")
    written = {"plot": _plot, "animate": _animate, "export": _export}[command](options)
    if options.json:
        print(json.dumps([str(path) for path in written], indent=2))
    elif not options.quiet:
        for path in written:
            print(path)
    return 0


def drawings(
    path: Path,
    kinds: Sequence[str] = (),
    trajectory: int | None = None,
    roles: Mapping[str, Any] | None = None,
) -> dict[str, Drawing]:
    """Kind and drawing of each picture of a file; `roles`: x, y, by, value, scale of a sweep.

    Raises CaseError for kinds, columns or trajectories that are not there, ResultFileError for a
    file that is damaged or was not written by this program.
    """
    from qbxstokes.plots.pictures import kinds as chosen
    from qbxstokes.plots.source import sampling

    result = _opened(path, trajectory)
    if result.task != "sweep" and (note := sampling(result)):
        print(f"qbxstokes: {path}: {note}", file=sys.stderr)
    return chosen(result, kinds, roles)


def _opened(path: Path, trajectory: int | None) -> Result:
    """The result in a file, or one trajectory of the sweep in it."""
    result = told(path)
    if trajectory is None:
        return result
    if not isinstance(result, SweepResult):
        raise CaseError(f"{path}: is not a sweep, so it has no trajectories by number")
    if "time" not in result.arrays:
        raise CaseError(f"{path}: keeps summaries alone; run it with sweep.store: samples")
    try:
        return result.trajectory(trajectory)
    except IndexError as error:
        raise CaseError(f"{path}: {error}") from None


def told(name: str | Path) -> Result:
    """The result of a file, or the newest of a case; standard error says what may surprise."""
    result = load(name)
    if result.path != Path(name):
        print(f"qbxstokes: {name}: its newest result is {result.path}", file=sys.stderr)
    elif later := newer(result.path):
        print(f"qbxstokes: {name}: {later} is a newer result of its case", file=sys.stderr)
    return result


def _plot(options: argparse.Namespace) -> list[Path]:
    from qbxstokes.plots import style

    single = _file(options, style.FORMATS)
    formats = [single.suffix[1:]] if single else _listed(options.format)
    for name in formats:
        if name not in style.FORMATS:
            raise CaseError(f"command line: --format is one of {', '.join(style.FORMATS)}")
    roles = {key: _columns(getattr(options, key)) for key in _COLUMNS}
    roles |= {"scale": options.scale, "average": options.average}
    roles = {key: given for key, given in roles.items() if given}
    # All files are read before the first picture is written.
    chosen = {
        newest(name): drawings(Path(name), options.kind, options.trajectory, roles)
        for name in options.files
    }
    if single and sum(map(len, chosen.values())) > 1:
        among = ", ".join(next(iter(chosen.values())))
        raise CaseError(f"{single}: is one picture; choose with --kind among {among}")
    _make_folder(single.parent if single else options.output)
    written = []
    for path, kinds in chosen.items():
        for kind, draw in kinds.items():
            stem = f"{_stem(path, options)}-{kind}"
            targets = [single or options.output / f"{stem}.{name}" for name in formats]
            try:
                with style.styled():
                    figure = draw()
                written += [style.save(figure, target) for target in targets]
            except QbxStokesError as error:
                kept = [str(target) for target in targets if target.exists()]
                note = f"; {', '.join(kept)}: an earlier picture, kept" if kept else ""
                raise type(error)(f"{error}{note}") from None
    return written


def _animate(options: argparse.Namespace) -> list[Path]:
    from qbxstokes.plots.animation import FORMATS, animate

    if len(options.files) > 1:
        raise CaseError(f"command line: {options.files[1]}: animate takes one file at a time")
    single = _file(options, FORMATS)
    if options.format not in FORMATS:
        raise CaseError(f"command line: --format is one of {', '.join(FORMATS)}")
    if options.frames is not None and not 1 <= options.frames <= 10_000:
        raise CaseError("command line: --frames is a number from 1 to 10000")
    if not 1 <= options.fps <= 50:
        raise CaseError("command line: --fps is a number from 1 to 50")
    result = _opened(Path(options.files[0]), options.trajectory)
    path = result.path
    if isinstance(result, SweepResult):
        raise CaseError(f"{path}: is a sweep; choose one of its motions with --trajectory N")
    if result.task != "motion":
        raise CaseError(f"{path}: holds no motion to animate")
    infinity = float("inf")
    window = (
        -infinity if options.begin is None else options.begin,
        infinity if options.until is None else options.until,
    )
    film = animate(result, options.frames, options.fps, window)
    target = single or options.output / f"{_stem(path, options)}.{options.format}"
    _make_folder(target.parent)
    return [film.save(target)]


def _export(options: argparse.Namespace) -> list[Path]:
    single = _file(options, EXPORTED)
    if single and len(options.files) > 1:
        raise CaseError(f"{single}: one file for several results; name a folder")
    if unknown := set(options.format) - set(_FLAGS.values()):
        known = ", ".join(_FLAGS.values())
        raise CaseError(f"command line: --format {unknown.pop()}: is not one of {known}")
    wanted = {flag for flag in _FLAGS.values() if getattr(options, flag)} | set(options.format)
    kinds = [kind for kind in EXPORTED if _FLAGS[kind] in wanted] or ["csv"]
    results = [_opened(Path(name), options.trajectory) for name in options.files]
    if options.units:
        results = [result.in_units() for result in results]
    folder = _make_folder(single.parent if single else options.output)
    written: list[Path] = []
    for result in results:
        stem = _stem(result.path, options)
        for name in [single.name] if single else [f"{stem}.{kind}" for kind in kinds]:
            # Files appear under their names only when all are whole.
            with tempfile.TemporaryDirectory(prefix=".", dir=folder) as place:
                for made in result.export(Path(place, name)):
                    if (target := folder / made.name).exists() and not options.overwrite:
                        right = "choose another name with -o, or --overwrite"
                        raise CaseError(f"{target}: exists already; {right}")
                    written.append(made.replace(target))
    return written


def _file(options: argparse.Namespace, formats: Iterable[str]) -> Path | None:
    """The file that -o names; None where it is a folder."""
    named: Path = options.output
    if not named.suffix or named.is_dir():
        return None
    if named.suffix[1:] not in formats:
        raise CaseError(
            f"{named}: -o takes a folder, or a file that ends in .{', .'.join(formats)}"
        )
    return named


def _usage(command: str) -> str:
    if command != "plot":
        return ANIMATE_USAGE if command == "animate" else EXPORT_USAGE
    from qbxstokes.plots import bodies, pictures

    kinds = {**pictures.KINDS, **bodies.KINDS}
    return PLOT_USAGE.format(
        motion=textwrap.indent("".join(f"{kind:20}{text}\n" for kind, text in kinds.items()), "  ")
    )


def _columns(given: Any) -> Any:
    """Names of columns, where keys of the case stand for them."""
    if isinstance(given, list):
        return [_columns(name) for name in given]
    return column_name(parse_key(given)) if given and set(".[") & set(given) else given


def _listed(text: str) -> list[str]:
    return [word for word in text.split(",") if word]


def _stem(path: Path, options: argparse.Namespace) -> str:
    return path.stem if options.trajectory is None else f"{path.stem}-{options.trajectory}"


def _make_folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CaseError(f"{folder}: cannot be made a folder ({error.strerror})") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise CaseError(f"{folder}: no permission to write there; name another with -o")
    return folder
