"""`task: field`, and the section `field` of a motion: the flow around the body, to a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.case.document import plain
from qbxstokes.case.load import LoadedCase
from qbxstokes.geometry import rotation
from qbxstokes.io import field as store
from qbxstokes.io.names import told_by
from qbxstokes.io.store import Work
from qbxstokes.io.writer import ResultWriter
from qbxstokes.quantities import RECORDABLE, of_bodies
from qbxstokes.runs.destination import identity_of, working_folder
from qbxstokes.runs.field_lines import moving_tracers, steady_tracers, tracers_among
from qbxstokes.runs.field_targets import chosen_instants, instant_of
from qbxstokes.runs.field_work import FieldWork
from qbxstokes.runs.plan import plan_of
from qbxstokes.runs.progress import Clock, compilation_told
from qbxstokes.runs.sharing import RowTeam, seconds_between
from qbxstokes.simulation.flow_around import Instant
from qbxstokes.simulation.from_case import pointed
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


# The service of the other ranks to a motion with a field.
FIELD = "field"


def run(job: Job) -> dict[str, Any]:
    """Carry out `task: field` on all ranks; returns the summary on all of them."""
    comm, loaded = job.comm, job.loaded
    seconds_between(loaded)
    with working_folder(job, identity_of(loaded, [])) as (folder, done):
        if folder is None:
            return {"result": str(done), "finished_before": True}
        job.interruption.listening = True
        with compilation_told(comm, not job.options.quiet), pointed(loaded):
            summary = _computed(job, folder)
    return dict(comm.bcast(summary))


def _computed(job: Job, folder: Work) -> dict[str, Any]:
    """Compute the field on all ranks; rank 0 writes the file and returns the summary.

    folder: the working folder, held by rank 0.
    """
    loaded, clock = job.loaded, job.clock
    case = loaded.case
    section = case.field
    # The other ranks plan as rank 0 did, which has found nothing wrong.
    instant = instant_of(section, (job.plan or plan_of(loaded)).simulation)
    work = FieldWork(job, job.comm, [instant], folder)
    target, identity = folder.target, json.dumps(folder.identity)
    if job.comm.rank != 0:
        work.write(None)
        return {}
    # A run that was killed as it ended may have left its whole result.
    replace = job.overwrite or (folder.resumed and told_by(target, "identity") == identity)
    record = {**job.provenance, "identity": identity}
    with ResultWriter(target, case.task, record, replace, folder.folder) as writer:
        facts = work.write(writer)
        around = work.around(instant)
        state = {
            "position": instant.position,
            "orientation": instant.quaternion,
            "axis": rotation.axis(instant.quaternion),
            **around.state,
        }
        about = {name: RECORDABLE[name] for name in state}
        if instant.position.ndim > 1:
            about = {name: of_bodies(q, len(instant.position)) for name, q in about.items()}
        one = {name: values[None] for name, values in state.items()}
        writer.append({"time": np.zeros(1), **one}, about)
        if section.tracers is not None:
            with clock.part("tracers"):
                paths = steady_tracers(around, section.tracers, instant)
            store.put_arrays(writer.file[store.GROUP], "tracers", paths, {})
        errors = facts.pop("errors")
        summary: dict[str, Any] = {
            **job.heading(),
            **facts,
            **around.state,
            "scales": around.scales,
            "errors": errors,
            "largest_error": max(errors.values()),
            "wall_times": dict(clock.parts),
        }
        summary["files"] = export_field(loaded, clock, writer.file, folder)
        summary["result"] = str(writer.finish(summary))
    summary["files"] += draw_pictures(loaded, clock, Path(summary["result"]))
    return summary


def field_of_motion(
    job: Job,
    samples: Mapping[str, Array],
    writer: ResultWriter,
    assembled: Any,
    team: RowTeam,
    folder: Work,
) -> dict[str, Any]:
    """The field at the chosen instants of a motion, into its open result file; for rank 0.

    samples: `time` (T,) and quantities (T, ...). team: the other ranks, which take part by
    `help_with_field`.
    """
    loaded, section, time = job.loaded, job.loaded.case.field, job.loaded.case.time
    times = samples["time"]
    instants = [
        Instant(
            float(times[index]),
            samples["position"][index],
            samples["orientation"][index],
            samples["velocity"][index],
            samples["angular_velocity"][index],
        )
        for index in chosen_instants(loaded, times)
    ]
    key = json.dumps(plain(section))
    comm = team.join(FIELD, instants, folder.joined(0), key)
    work = FieldWork(job, comm, instants, folder, key)
    facts = work.write(writer)
    if section.tracers is not None:
        start, end = assembled.initial, float(times[-1])
        if loaded.case.coupled:  # the other ranks no longer join in its solves
            assembled.scene.part()
        with job.clock.part("tracers"):
            follow = tracers_among if loaded.case.coupled else moving_tracers
            with job.interruption.at_once(folder.folder):
                told = assembled.equations, start, end, time.tolerance
                paths = follow(work.solution, section.tracers, *told)
        store.put_arrays(writer.file[store.GROUP], "tracers", paths, {})
    return facts


def help_with_field(job: Job, instants: list[Instant], folder: Work, key: str) -> None:
    """What the other ranks do for `field_of_motion`."""
    FieldWork(job, job.comm, instants, folder.joined(job.comm.rank), key).write(None)


def export_field(loaded: LoadedCase, clock: Clock, file: Any, work: Work) -> list[str]:
    """Write the file for ParaView, if asked for; the names of what was written.

    work: the working folder of the result, whose name it gets.
    """
    section = loaded.case.field
    if section is None or not section.vtk:
        return []
    from qbxstokes.io.field import export

    with clock.part("export"):
        return [str(export(file, work.target.with_suffix(".vtkhdf"), work.folder))]


def draw_pictures(loaded: LoadedCase, clock: Clock, result: Path) -> list[str]:
    """Draw the pictures of a field, if asked for; the names of what was written."""
    section = loaded.case.field
    if section is None or not section.pictures:
        return []
    from qbxstokes.io.results import load
    from qbxstokes.plots.field import draw_field

    with clock.part("pictures"):
        return [str(name) for name in draw_field(load(result), result.with_suffix(""))]
