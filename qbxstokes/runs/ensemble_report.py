"""What is told of an ensemble: before it runs what it will do and take, after it what it found."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.flows.series import GradientSeries
from qbxstokes.runs.destination import result_path
from qbxstokes.runs.ensemble import ensemble_of
from qbxstokes.runs.report import counted, duration, render, size
from qbxstokes.simulation.ensemble import turns_with_inertia

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

# Seconds on one core to begin, for a path and interval, for a body more of it, massless or not, and
# for a look at it; an inertial one is divided where the flow turns by more than _SHORT in it.
_BEGIN, _PATH, _BODY, _INERTIAL, _LOOK, _SHORT = 2.5, 1.0e-7, 1.7e-7, 1.2e-6, 8.0e-8, 0.08
# How much longer a body takes that relaxes by so many rates over its Stokes number after kinks.
_SUDDEN, _FASTEST = {"sextic": 1.0, "pieces": 1.0, "linear": 6.0, "hold": 25.0}, 15.0
_SAMPLED = 16  # paths that are read to know how long it takes


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
