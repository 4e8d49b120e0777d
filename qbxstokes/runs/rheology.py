"""`task: rheology`: a dilute suspension, from its case to the result file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.load import LoadedCase
from qbxstokes.case.rheology import ISOTROPIC
from qbxstokes.errors import OutputError, SceneError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import open_cache
from qbxstokes.io.writer import ResultWriter
from qbxstokes.motion.diagnostics import orbit_axis
from qbxstokes.plots.style import whole_file
from qbxstokes.quantities import RHEOLOGY, STRAIN_TIME
from qbxstokes.reference.stress import stresslet_numbers
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.rows import RowTeam, with_team
from qbxstokes.simulation.hydrodynamics import Workshop
from qbxstokes.simulation.rheology import Rheology, rheology

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

Array = NDArray[np.float64]


def run_rheology(job: Job) -> dict[str, Any]:
    """Compute the suspension's stress and write its result; returns the summary.

    Rank 0 computes, so that any number of ranks gives the numbers of one; all form the rows.
    """

    def compute(team: RowTeam) -> dict[str, Any]:
        with ResultWriter(job.target, "rheology", job.provenance, job.overwrite) as writer:
            cache = open_cache(job.loaded.case.hydrodynamics.cache, job.options.no_cache)
            return _compute(job, Workshop(team, cache), writer)

    return on_root(job.comm, with_team(job.comm, compute))


def _compute(job: Job, workshop: Workshop, writer: ResultWriter) -> dict[str, Any]:
    """Form the body, compute its suspension, write the result file, and return the summary."""
    loaded, scene, clock = job.loaded, job.plan.simulation, job.clock
    case = loaded.case
    section = case.rheology
    assert section is not None
    with clock.part("set-up"), _pointed(loaded):
        formed = scene.body.hydrodynamics_in(scene.flow, scene.need(pushed=True), workshop)
    with clock.part("suspension"), _pointed(loaded):
        axes, weights = orientations_of(loaded)
        found = rheology(
            scene.body,
            scene.flow,
            list(section.peclet_number),
            protocol=section.protocol,
            times=section.times,
            amplitude=section.amplitude,
            frequency=section.frequency,
            orientations=axes,
            weights=weights,
            settling=section.settling,
            tolerance=section.tolerance,
            position=scene.position[0],
            workshop=workshop,
        )
    errors, references = {}, {}
    shape = scene.body.shape
    if case.compare.reference != "none" and isinstance(shape, Spheroid):
        exact = np.array(stresslet_numbers(shape.aspect_ratio))
        numbers = np.array(found.summary["stresslet_numbers"])
        errors["stresslet"] = float(np.max(np.abs(numbers / exact - 1.0)))
        references["stresslet"] = "Jeffery, Kim and Karrila"
    summary: dict[str, Any] = {
        "case": str(loaded.path),
        "title": case.title,
        "task": case.task,
        "complete": True,
        "hydrodynamics": formed.report(),
        "resistance": vars(formed.model.resistance),
        "suspension": {**found.summary, **_heads(found)},
        "errors": errors,
        "references": references,
        "largest_error": max(errors.values(), default=0.0),
        "skipped": list(job.plan.skips),
    }
    with clock.part("output"):
        arrays = found.arrays() | _distributions(found, section.distribution) | _cycle(found)
        if found.time is not None:
            writer.put({"time": found.time}, {"time": STRAIN_TIME})
        writer.put(arrays, RHEOLOGY)
        summary["wall_times"] = dict(clock.parts)
        summary["result"] = str(writer.finish(summary))
        if section.tables and "distribution" in arrays:
            summary["files"] = _write_tables(Path(summary["result"]), arrays)
    return summary


def _write_tables(result: Path, arrays: dict[str, Array]) -> list[str]:
    """The density at each Peclet number as a CSV file of theta, phi, density beside the result."""
    written = []
    theta, phi = np.meshgrid(arrays["theta"], arrays["phi"], indexing="ij")
    for number, density in zip(arrays["peclet_number"], arrays["distribution"], strict=True):
        if np.isnan(density).any():
            continue
        path = result.with_name(f"{result.stem}-peclet-{number:g}.csv")
        rows = np.stack([theta, phi, density], axis=-1).reshape(-1, 3)
        try:
            with whole_file(path) as temporary:
                np.savetxt(
                    temporary, rows, "%.17g", delimiter=",", header="theta,phi,density", comments=""
                )
        except OSError as error:
            raise OutputError(f"{path}: cannot be written ({error.strerror})") from None
        written.append(str(path))
    return written


@contextmanager
def _pointed(loaded: LoadedCase) -> Iterator[None]:
    """Within it what is wrong is told with the case's file and line."""
    try:
        yield
    except SceneError as error:
        key = {"flow": "flow", "stokes_number": "body.stokes_number"}.get(
            error.key, f"rheology.{error.key}"
        )
        raise loaded.error(key, error.wrong, error.right) from None


def orientations_of(loaded: LoadedCase) -> tuple[Any, Array | None]:
    """Axes (n, 3) at the start with weights (n,), or "isotropic"; raises CaseError."""
    section = loaded.case.rheology
    assert section is not None
    given = section.orientations
    if given == ISOTROPIC:
        return ISOTROPIC, None
    form, value = next(iter(given.items()))
    if form == "aligned":
        return np.array([value]), None
    if form == "orbits":
        k = loaded.case.body.outline.effective_ratio
        if k is None:
            raise loaded.error("rheology.orientations", "are orbits", "axes: this shape has no k")
        return orbit_axis(k, np.array(value), 0.0), None
    path = loaded.path.parent / value
    try:
        rows = np.loadtxt(path, delimiter=",", ndmin=2, comments="#")
    except (OSError, ValueError) as error:
        wrong = f"{path}: cannot be read ({' '.join(str(error).split())})"
        right = "lines of x1, x2, x3 and perhaps weight"
        raise loaded.error("rheology.orientations.table", wrong, right) from None
    if rows.shape[1] not in (3, 4) or not np.isfinite(rows).all():
        wrong = f"{path}: has {rows.shape[1]} columns, or what is no number"
        raise loaded.error("rheology.orientations.table", wrong, "x1, x2, x3 and perhaps weight")
    return rows[:, :3], rows[:, 3] if rows.shape[1] == 4 else None


def _heads(found: Rheology) -> dict[str, Any]:
    """The material functions at each Peclet number, of a transient at its last instant."""
    names = [f"{which}_normal_stress_difference" for which in ("first", "second")]
    last = {
        name: value if found.time is None else value[:, -1]
        for name in ("intrinsic_viscosity", *names)
        for value in (getattr(found, name),)
    }
    return {
        "peclet_number": found.peclet_number.tolist(),
        "error_estimate": found.error_estimate.tolist(),
        **{name: value.tolist() for name, value in last.items()},
    }


def _distributions(found: Rheology, shape: tuple[int, int]) -> dict[str, Array]:
    """Densities (Peclet number, theta, phi) where there are any, NaN where there is none."""
    if all(density is None for density in found.distribution):
        return {}
    tables = [None if density is None else density.table(*shape) for density in found.distribution]
    angles = next(table for table in tables if table is not None)
    nothing = np.full(shape, np.nan)
    values = [nothing if table is None else table["density"] for table in tables]
    return {"theta": angles["theta"], "phi": angles["phi"], "distribution": np.stack(values)}


def _cycle(found: Rheology) -> dict[str, Array]:
    """Strain and its rate at the instants of an oscillation, for Lissajous curves."""
    cycle = found.summary["frequency"]
    if cycle is None or found.time is None:
        return {}
    return {
        "strain": np.sin(cycle * found.time) / cycle,
        "strain_rate": np.cos(cycle * found.time),
    }
