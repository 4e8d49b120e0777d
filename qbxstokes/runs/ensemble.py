"""A sweep of which statistics are kept: bodies along all paths of a series, on any number of ranks.

Paths are handed out in units of some blocks, whose sums are added in the order of their numbers:
the result is the same to the last bit on any number of ranks. A rank makes the units it has
finished safe every `checkpoint.every`, in the working folder of the result.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.case.document import plain
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.schema import Case
from qbxstokes.case.sweep import TRAJECTORY, Column, SweepSpace, column_name
from qbxstokes.errors import FlowError
from qbxstokes.flows.series import GradientSeries, series_of_case
from qbxstokes.geometry import rotation
from qbxstokes.io.cache import open_cache
from qbxstokes.io.store import Work
from qbxstokes.io.writer import ResultWriter
from qbxstokes.quantities import of_ensemble
from qbxstokes.runs.destination import identity_of, result_path, working_folder
from qbxstokes.runs.parallel import HandOut, on_root
from qbxstokes.runs.progress import compilation_told
from qbxstokes.runs.report import counted, duration, render, size
from qbxstokes.runs.sharing import Crew, Gathering, Item, notes, seconds_between
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.ensemble import BLOCK, Ensemble, turns_with_inertia
from qbxstokes.simulation.ensemble_means import Found, Sums, added, slenderness
from qbxstokes.simulation.from_case import body_of, pointed, start_quaternion, times_of
from qbxstokes.simulation.hydrodynamics import Workshop
from qbxstokes.simulation.shared_gradient import SharedGradient
from qbxstokes.typing import AnyArray

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

UNITS = "units"  # the parts of an ensemble
ORIENTATION = ("start", "orientation")
# Most units, and bytes that their sums take together: rank 0 holds them all at the end.
_MOST_UNITS, _MOST_BYTES = 1024, 256 * 2**20

# Seconds on one core to begin, for a path and interval, for a body more of it, massless or not, and
# for a look at it; an inertial one is divided where the flow turns by more than _SHORT in it.
_BEGIN, _PATH, _BODY, _INERTIAL, _LOOK, _SHORT = 2.5, 1.0e-7, 1.7e-7, 1.2e-6, 8.0e-8, 0.08
# How much longer a body takes that relaxes by so many rates over its Stokes number after kinks.
_SUDDEN, _FASTEST = {"sextic": 1.0, "pieces": 1.0, "linear": 6.0, "hold": 25.0}, 15.0
_SAMPLED = 16  # paths that are read to know how long it takes


# -- from the case --------------------------------------------------------------------------------


def ensemble_of(loaded: LoadedCase) -> tuple[Ensemble, dict[str, AnyArray]]:
    """The ensemble that a case writes down, and the swept values of its bodies by name (B,)."""
    case, space = loaded.case, loaded.space
    assert space is not None
    paths: Column | None = None
    starts: Column | None = None
    axes, alone = [], None
    for columns in space.axes:
        names = {column.key: column for column in columns}
        if TRAJECTORY in names:
            paths, starts = names.pop(TRAJECTORY), names.pop(ORIENTATION, None)
        elif [*names] == [ORIENTATION] and starts is None:
            starts = names.pop(ORIENTATION)
            alone = starts.where
        elif all(key[0] == "body" for key in names):
            axes.append(columns)
            continue
        for key, column in names.items():
            right = "sweep flow.trajectory, start.orientation beside it or alone, and keys of body"
            raise loaded.error(column.where, f"{'.'.join(map(str, key))} has no statistics", right)
    if paths is not None and alone:
        raise loaded.error(alone, "goes with the paths", "start.orientation beside flow.trajectory")
    bodies, swept = _bodies(loaded, axes)
    axis = None
    if starts is not None:
        values = starts.take(np.arange(starts.size))
        axis = values if values.shape[1] == 3 else rotation.axis(rotation.normalize(values))
    elif "orientation" in case.start.given_keys:
        axis = rotation.axis(start_quaternion(case.start, bodies[0].shape))
    with pointed(loaded):
        series = _gradients(loaded, paths, starts, bodies)
        ensemble = Ensemble(
            bodies, series, axis, case.statistics, case.time.tolerance, case.brownian
        )
    return ensemble, swept


def _bodies(
    loaded: LoadedCase, axes: list[tuple[Column, ...]]
) -> tuple[tuple[Body, ...], dict[str, AnyArray]]:
    """A body for every combination of swept values, the last axis fastest, and these values."""
    space = SweepSpace(tuple(axes))
    found = space.values(np.arange(space.size)) if axes else {}
    swept = {column_name(key): values for key, values in found.items()}
    bodies = []
    for place in np.ndindex(space.shape):
        data = space.assign(loaded.document.data, place)
        case = Case.read(data)
        given = {"forces": case.forces.given, "constraints": case.constraints.given}
        given |= {name: bool(getattr(case, name).given_keys) for name in ("events", "compare")}
        given |= {"field": case.field is not None, "output.fields": bool(case.output.fields)}
        given |= {f"start.{name}": name != ORIENTATION[1] for name in case.start.given_keys}
        given |= {"hydrodynamics.solve": case.hydrodynamics.solve == "every_step"}
        given |= {f"petsc.{name}": name.startswith("ts_") for name in case.petsc}
        for name in (name for name, there in given.items() if there):
            raise loaded.error(name, "has no meaning with statistics", "leave it out")
        bodies.append(body_of(replace(loaded, case=case)))
    return tuple(bodies), swept


def _gradients(
    loaded: LoadedCase, paths: Column | None, starts: Column | None, bodies: tuple[Body, ...]
) -> GradientSeries | SharedGradient:
    """The gradients along the chosen paths, or that of the case's flow for as many as start."""
    time = loaded.case.time
    try:
        if paths is not None:
            return _series(loaded, paths, time.end)
        if starts is None:
            right = "flow.trajectory: all, or start.orientation, all in one gradient"
            raise loaded.error("sweep.axes", "vary no flow.trajectory", right)
        accuracy, times = time.tolerance / float(slenderness(bodies).max()), times_of(loaded)
        if len(times) < 2:
            raise loaded.error(
                "time.at", "holds one instant", "two or more: axes move between them"
            )
        return SharedGradient(loaded.flow, times, starts.size, accuracy)
    except FlowError as error:
        raise loaded.error(("flow", *error.key), str(error)) from None


def _series(loaded: LoadedCase, paths: Column, end: float | None) -> GradientSeries:
    """The gradients along the chosen paths, at the samples from 0 to the end of the motion."""
    series = series_of_case(loaded.case.flow.spec(), loaded.path.parent)
    chosen = paths.take(np.arange(paths.size))
    if np.any(chosen != np.round(chosen)) or chosen.min() < 0 or chosen.max() >= len(series):
        wrong = f"reach from {chosen.min():g} to {chosen.max():g}"
        right = f"whole numbers from 0 to {len(series) - 1}"
        raise loaded.error(paths.where, wrong, right)
    series = series.chosen(chosen.astype(np.int64))
    times = series.times
    if end is None:
        raise loaded.error("time", "gives no end", "time.end, up to the last sample")
    slack = 1e-3 * (times[-1] - times[0]) / len(times)  # of instants in single precision
    if not times[0] <= 0.0 < end <= times[-1] + slack:
        wrong = f"is {end:g} and the series covers {times[0]:g} to {times[-1]:g}"
        raise loaded.error("time.end", wrong, "an end within the series, which starts at 0")
    last = int(np.searchsorted(times, end + slack, "right"))
    return series.part(slice(None), slice(int(np.searchsorted(times, 0.0)), last))


# -- the work -------------------------------------------------------------------------------------


def units_of(ensemble: Ensemble) -> list[range]:
    """Blocks of each unit: as many units as rank 0 can hold the sums of, at most."""
    held = ensemble.bytes_of_sums
    most = max(1, min(_MOST_UNITS, int(_MOST_BYTES / held), ensemble.blocks))
    per_unit = -(-ensemble.blocks // most)
    starts = range(0, ensemble.blocks, per_unit)
    return [range(start, min(start + per_unit, ensemble.blocks)) for start in starts]


def run(job: Job) -> dict[str, Any]:
    """Follow all paths on all ranks; returns the summary on all of them."""
    comm, loaded = job.comm, job.loaded
    ensemble, swept = ensemble_of(loaded)
    units = units_of(ensemble)
    identity = identity_of(loaded, [], units=len(units), block=BLOCK)
    every = seconds_between(loaded)
    with working_folder(
        job, identity, lambda work: [note["unit"] for note in notes(work, UNITS)]
    ) as (folder, found):
        if folder is None:
            return {"result": str(found), "finished_before": True}
        with job.clock.part("models"):
            cache = open_cache(loaded.case.hydrodynamics.cache, job.options.no_cache)
            for body in ensemble.bodies:
                body.workshop = Workshop(cache=cache)
            ensemble = replace(ensemble, given_laws=on_root(comm, lambda: ensemble.laws))
        gathering = Gathering(comm, folder, UNITS, every=every)
        left = sorted(set(range(len(units))) - set(found))
        begin = time.perf_counter()
        sampling = _follow(job, ensemble, units, left, gathering)
        with job.clock.part("output"):
            told = sampling, len(units), begin
            return gathering.concluded(
                lambda items: _write(job, ensemble, swept, folder, items, *told)
            )


def _follow(
    job: Job, ensemble: Ensemble, units: list[range], left: list[int], gathering: Gathering
) -> dict[str, Any]:
    """What is left of the paths, unit by unit as ranks become free; returns what samples leave."""
    comm, clock = job.comm, job.clock
    speak = comm.rank == 0 and not job.options.quiet and job.options.progress != "none"
    done = BLOCK * sum(len(blocks) for n, blocks in enumerate(units) if n not in left)
    crew = Crew(job, gathering, ensemble.paths, "paths", min(ensemble.paths, done))
    job.interruption.listening = True
    sampling: dict[str, Any] = {}
    with compilation_told(comm, speak):
        for place in crew.numbers(len(left) + 1):
            if place == 0:  # the first thing to do, by whoever comes first
                with clock.part("sampling"):
                    sampling = ensemble.sampling() if ensemble.settings.sampling else {}
                continue
            number = left[place - 1]
            sums: Sums = {}
            with clock.part("paths"):
                for block in units[number]:
                    sums = added(sums, ensemble.block(block))
                    crew.counters.add(HandOut.DONE, BLOCK)
                    crew.poke()
                    crew.stop_if_asked()
            with clock.part("output"):
                trace = np.array([ensemble.series.trace])
                gathering.add({**sums, "trace": trace}, {"unit": number})
    crew.end()
    return next((found for found in comm.allgather(sampling) if found), {})


def _write(
    job: Job,
    ensemble: Ensemble,
    swept: dict[str, AnyArray],
    folder: Work,
    items: Iterator[Item],
    sampling: dict[str, Any],
    count: int,
    begin: float,
) -> dict[str, Any]:
    """On rank 0: the sums of all units in their order, into the result file; the summary."""
    held: dict[int, dict[str, AnyArray]] = {}
    trace = 0.0
    for arrays, note in items:
        trace = max(trace, float(arrays.pop("trace")[0]))
        held[note["unit"]] = arrays
    found = ensemble.result((held.pop(number) for number in range(count)), sampling)
    ratios = np.array([body.effective_ratio for body in ensemble.bodies])
    stokes = np.array([float(body.stokes_number) for body in ensemble.bodies])
    arrays = {"aspect_ratio": ratios, "stokes_number": stokes} | {
        name: values for name, values in swept.items() if values.dtype.kind == "f"
    }
    arrays |= dict(arrays_of(found))
    summary = {
        **job.heading(),
        "task": "ensemble",
        **found.summary,
        "trace": trace,
        "bodies": len(ensemble.bodies),
        "quantities": list(found.quantities),
        "stresses": {
            name: [mean.tolist(), error.tolist()]
            for name, (mean, error) in (found.stresses or {}).items()
        },
        "wall_time": time.perf_counter() - begin,
        "ranks": job.comm.size,
    }
    record = {**job.provenance, "identity": json.dumps(folder.identity)}
    replaces = job.overwrite or folder.resumed
    with ResultWriter(folder.target, "ensemble", record, replaces, folder.folder) as writer:
        writer.put(arrays, {name: of_ensemble(name) for name in arrays})
        summary["result"] = str(writer.finish(plain(summary)))
    return summary


def arrays_of(found: Found) -> Iterator[tuple[str, AnyArray]]:
    """The datasets of a result, by name."""
    for place, name in enumerate(found.quantities):
        rates = () if name.startswith("cos_") else ("over_strain", "over_strain_error")
        for part in ("moments", "moments_error", *rates, "counts"):
            yield f"{name}_{part}", getattr(found, part)[:, place]
        yield f"{name}_edges", found.edges[place]
        yield f"{name}_in_time", found.mean_in_time[:, place].T
        yield f"{name}_spread_in_time", found.spread_in_time[:, place].T
    yield "time", found.time
    yield "lag", found.lag
    yield "correlation", found.correlation.T
    if found.axes is not None:
        yield "axis", found.axes
    for name, (mean, error) in (found.stresses or {}).items():
        yield name, mean
        yield f"{name}_standard_error", error


# -- what is told ---------------------------------------------------------------------------------


def planned(job: Job) -> tuple[dict[str, Any], str]:
    """What will be done, and what it takes, as data and as text."""
    loaded, ranks, (ensemble, _) = job.loaded, job.comm.size, ensemble_of(job.loaded)
    series, bodies = ensemble.series, len(ensemble.bodies)
    lengths = np.diff(series.intervals[0])
    intervals = len(lengths)
    cells = float(ensemble.paths * intervals)
    looks = ensemble.paths * len(ensemble.looks) * bodies * len(ensemble.names) / 3.0
    own = isinstance(series, GradientSeries)
    read = cells * series.samples.shape[-1] * series.samples.dtype.itemsize * own
    sudden = _SUDDEN[series.interpolation]
    inertial = sum(
        sudden if _FASTEST * lengths.min() > np.max(body.stokes_number) else 1.0
        for body in ensemble.bodies
        if turns_with_inertia(body)
    )
    parts = max(1.0, ensemble.rate * float(lengths.mean()) / _SHORT)
    turning = bodies * _BODY + inertial * _INERTIAL * parts
    begin = time.perf_counter()
    series.read(0, min(_SAMPLED, ensemble.paths))
    reading = (time.perf_counter() - begin) / min(_SAMPLED, ensemble.paths)
    work = cells * (_PATH + turning) + looks * _LOOK + reading * ensemble.paths
    if ensemble.settings.sampling and own:  # half of the samples again, for a block
        work *= 1.0 + 1.5 / ensemble.blocks
    facts: dict[str, Any] = {
        "paths": ensemble.paths,
        "samples": len(series.times),
        "bodies": bodies,
        "looks": len(ensemble.looks),
        "bytes_read": read,
        "bytes_on_disk": ensemble.bytes_of_sums
        + 8 * 3 * bodies * len(ensemble.looks) * min(ensemble.settings.keep, ensemble.paths),
        "seconds": {str(p): _BEGIN + work / p for p in sorted({1, ranks, 64})},
    }
    seconds = facts["seconds"]
    runs = [
        ("paths", f"{facts['paths']} of {counted(facts['samples'], 'sample')}"),
        ("bodies", f"{facts['bodies']}, each along every path"),
        ("looks", f"{facts['looks']} at {', '.join(ensemble.settings.quantities)}"),
    ]
    needs = [
        ("read", size(facts["bytes_read"])),
        ("disk", f"{size(facts['bytes_on_disk'])} for {result_path(loaded)}"),
        ("time", f"about {duration(seconds[str(ranks)])} on {counted(ranks, 'rank')}"),
    ]
    return facts, _text(loaded, {"Runs": runs, "Needs": needs}) + "\n"


def _text(loaded: LoadedCase, sections: Any) -> str:
    return render(f"Ensemble: {loaded.case.title or loaded.path.stem}", str(loaded.path), sections)


def remarks(_: Job, summary: dict[str, Any]) -> Iterator[str]:
    """Nothing more is to be told."""
    yield from ()


def summary_text(job: Job, summary: dict[str, Any]) -> str:
    """What was found, how fast, and where it is."""
    bodies, sampling = counted(int(summary["bodies"]), "body", "bodies"), summary["sampling"]
    solved = [("paths", f"{summary['paths']}, {bodies} along each")]
    if "gradient" in sampling:
        text = f"as polynomials off by {sampling['gradient']:.2g} of its size"
        solved.append(("gradient", f"{text}, in {sampling['intervals']} intervals"))
    if summary["trace"]:
        told = f"{summary['trace']:.2g} of the gradients' size was projected out"
        solved.append(("trace", told))
    if "axis_median" in sampling:
        text = f"{sampling['axis_median']:.2g} of the axis at the end (median), "
        text += f"{sampling['axis_90_percent']:.2g} for 9 of 10"
        solved.append(("left by samples", text))
    if "intrinsic_viscosity" in summary["stresses"]:
        pairs = zip(*summary["stresses"]["intrinsic_viscosity"], strict=True)
        told = ", ".join(f"{mean:.4g} +- {error:.1g}" for mean, error in pairs)
        solved.append(("viscosity", f"[eta] = {told}"))
    spent = f"{duration(summary['wall_time'])} on {counted(summary['ranks'], 'rank')}"
    ended = {"Times": [("ensemble", spent)], "Result": [("file", summary["result"])]}
    return _text(job.loaded, {"Solved": solved, **ended})
