"""`task: rheology`: a dilute suspension, from its case to the result file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.case.rheology import ISOTROPIC, RheologySection
from qbxstokes.errors import OutputError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import open_cache
from qbxstokes.motion.diagnostics import orbit_axis
from qbxstokes.plots.style import whole_file
from qbxstokes.quantities import RHEOLOGY, STRAIN_TIME
from qbxstokes.reference.stress import stresslet_numbers
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.sharing import RowTeam, with_team
from qbxstokes.simulation.from_case import pointed
from qbxstokes.simulation.hydrodynamics import Workshop, hydrodynamics_of
from qbxstokes.simulation.langevin import BrownianAverages, langevin
from qbxstokes.simulation.rheology import Rheology, rheology
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.suspension.langevin import FUNCTIONS, Ensemble, Sums
from qbxstokes.tables import TableError, read_table
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


_OF_LANGEVIN = ("trajectories", "strain", "step", "paths", "translation")


def _key_of(name: str) -> str:
    """The key of a case that Python calls by another name."""
    if name in ("flow", "stokes_number"):
        return "flow" if name == "flow" else "body.stokes_number"
    return f"rheology.langevin.{name}" if name in _OF_LANGEVIN else f"rheology.{name}"


def run(job: Job) -> dict[str, Any]:
    """Compute the suspension's stress and write its result; returns the summary.

    Rank 0 computes, so that any number of ranks gives the numbers of one; all form the rows.
    """

    def averaging(ensemble: Ensemble) -> list[Sums]:
        """Blocks of trajectories by all ranks, for rank 0."""
        own = map(ensemble.average, range(job.comm.rank, ensemble.blocks, job.comm.size))
        parts = [list(own)] if job.comm.size == 1 else job.comm.gather(list(own))
        if not parts:
            return []
        return [parts[n % len(parts)][n // len(parts)] for n in range(ensemble.blocks)]

    def compute(team: RowTeam) -> dict[str, Any]:
        def together(ensemble: Ensemble) -> list[Sums]:
            team.join("langevin", ensemble)
            return averaging(ensemble)

        cache = open_cache(job.loaded.case.hydrodynamics.cache, job.options.no_cache)
        job.plan.simulation.body.workshop = Workshop(team, cache)
        return _computed(job, together)

    return on_root(job.comm, with_team(job.comm, compute, {"langevin": averaging}))


def _computed(job: Job, averaging: Callable[[Ensemble], list[Sums]]) -> dict[str, Any]:
    """Form the body, compute its suspension, write the result file, and return the summary."""
    loaded, scene, clock = job.loaded, job.plan.simulation, job.clock
    case = loaded.case
    section = case.rheology
    with clock.part("set-up"), pointed(loaded, _key_of):
        formed = hydrodynamics_of(scene, pushed=True)
    with clock.part("suspension"), pointed(loaded, _key_of):
        found = suspension_of(loaded, scene, {"averaging": averaging})
    errors, references = {}, {}
    shape = scene.body.shape
    if case.compare.reference != "none" and isinstance(shape, Spheroid):
        exact = np.array(stresslet_numbers(shape.aspect_ratio))
        own = np.array(found.summary["stresslet_numbers"])
        errors["stresslet"] = float(np.max(np.abs(own / exact - 1.0)))
        references["stresslet"] = "Jeffery, Kim and Karrila"
    arrays, cycle = found.arrays(), found.summary["frequency"]
    if cycle is not None and found.time is not None:  # for Lissajous curves
        arrays["strain"] = np.sin(cycle * found.time) / cycle
        arrays["strain_rate"] = np.cos(cycle * found.time)
    if isinstance(found, Rheology):
        arrays |= _distributions(found, section)
    if found.time is not None:
        arrays = {"time": found.time, **arrays}
    told = {
        "hydrodynamics": formed.report(),
        "resistance": vars(formed.model.resistance),
        "suspension": {**found.summary, **_heads(found)},
        "errors": errors,
        "references": references,
        "largest_error": max(errors.values(), default=None),
    }
    summary = job.write(told, arrays, {"time": STRAIN_TIME, **RHEOLOGY})
    if section.tables and "distribution" in arrays:
        summary["files"] = _write_tables(Path(summary["result"]), arrays)
    return summary


def suspension_of(
    loaded: LoadedCase,
    scene: Simulation,
    random: Mapping[str, Any],
    numbers: Sequence[float] | None = None,
) -> Rheology | BrownianAverages:
    """The suspension of a case, at its Peclet numbers or others.

    random: arguments of `langevin` beside or in the place of the case's.
    """
    section = loaded.case.rheology
    axes, weights = orientations_of(loaded)
    common: dict[str, Any] = {
        "peclet_number": list(section.peclet_number if numbers is None else numbers),
        "protocol": section.protocol,
        "times": section.times,
        "amplitude": section.amplitude,
        "frequency": section.frequency,
        "orientations": axes,
        "position": scene.position[0],
    }
    if section.langevin is not None:
        return langevin(scene.body, scene.flow, **common, **{**vars(section.langevin), **random})
    common |= {"settling": section.settling, "tolerance": section.tolerance}
    return rheology(scene.body, scene.flow, weights=weights, **common)


def _write_tables(result: Path, arrays: dict[str, Array]) -> list[str]:
    """At each Peclet number CSV files beside the result: theta, phi, density; axes if drawn."""
    written = []
    theta, phi = np.meshgrid(arrays["theta"], arrays["phi"], indexing="ij")
    for place, number in enumerate(arrays["peclet_number"].tolist()):
        density = arrays["distribution"][place]
        if np.isnan(density).any():
            continue
        stem = f"{result.stem}-peclet-{number:g}"
        tables = {f"{stem}.csv": ("theta,phi,density", np.stack([theta, phi, density], axis=-1))}
        if "samples" in arrays:
            tables[f"{stem}-axes.csv"] = ("x1,x2,x3", arrays["samples"][place])
        for name, (header, values) in tables.items():
            path, rows = result.with_name(name), values.reshape(-1, 3)
            try:
                with whole_file(path) as temporary:
                    np.savetxt(temporary, rows, "%.17g", ",", header=header, comments="")
            except OSError as error:
                raise OutputError(f"{path}: cannot be written ({error.strerror})") from None
            written.append(str(path))
    return written


def orientations_of(loaded: LoadedCase) -> tuple[Any, Array | None]:
    """Axes (n, 3) at the start with weights (n,), or "isotropic"; raises CaseError."""
    section = loaded.case.rheology
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
    try:
        rows = np.asarray(read_table(loaded.path.parent / value).numbers)
        if rows.shape[1] not in (3, 4) or not np.isfinite(rows).all():
            wrong = f"has {rows.shape[1]} columns, or what is no number"
            raise TableError(f"{loaded.path.parent / value}: {wrong}")
    except TableError as error:
        right = "x1, x2, x3 and perhaps weight"
        raise loaded.error("rheology.orientations.table", str(error), right) from None
    return rows[:, :3], rows[:, 3] if rows.shape[1] == 4 else None


def _heads(found: Rheology | BrownianAverages) -> dict[str, Any]:
    """The material functions at each Peclet number, of a transient at its last instant."""
    arrays = found.arrays()
    heads = {"peclet_number": found.peclet_number.tolist()}
    if isinstance(found, Rheology):
        heads["error_estimate"] = found.error_estimate.tolist()
    for name in FUNCTIONS:
        for column in (name, f"{name}_standard_error"):
            if column in arrays:
                values = arrays[column] if found.time is None else arrays[column][:, -1]
                heads[column] = values.tolist()
    return heads


def _distributions(found: Rheology, section: RheologySection) -> dict[str, Array]:
    """Densities (Peclet number, theta, phi) where there are any, NaN where there is none.

    And axes (Peclet number, n, 3) drawn from them, where they were asked for.
    """
    densities, shape = found.distribution, section.distribution
    if all(density is None for density in densities):
        return {}
    tables = [None if density is None else density.table(*shape) for density in densities]
    angles = next(table for table in tables if table is not None)
    nothing = np.full(shape, np.nan)
    values = [nothing if table is None else table["density"] for table in tables]
    arrays = {"theta": angles["theta"], "phi": angles["phi"], "distribution": np.stack(values)}
    if section.samples:
        none = np.full((section.samples, 3), np.nan)
        drawn = [none if d is None else d.sample(section.samples, section.seed) for d in densities]
        arrays["samples"] = np.stack(drawn)
    return arrays
