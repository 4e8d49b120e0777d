"""Many paths on two ranks: memory, the same bits on any number of ranks, killed and resumed.

10^5 paths of 10^3 samples (3.6 GB of float32 in HDF5, made here and deleted) are followed by one
body for its tumbling, by the command line.

Run:      python cases/benchmarks/paths.py      (some 10 min, 4 GB of disk; --small: 1 min; --csv)
Expected: `same` 1 in every row; at most 300 MB a rank; a result below 5 MB. "us" is wall time
          times ranks for a path and sample.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from measure import command

import qbxstokes as qs

SAMPLES, END = 1001, 20.0
FREQUENCY = np.array([0.4, 0.9, 1.5, 2.3, 3.1])


def make(file, paths):
    """Gradients of five cosines along each path, [time, trajectory], 256 paths at a time."""
    times, rng = np.linspace(0.0, END, SAMPLES), np.random.default_rng(1)
    with h5py.File(file, "w") as out:
        out["t"] = times
        data = out.create_dataset("A", (paths, SAMPLES, 9), np.float32)
        for first in range(0, paths, 256):
            n = min(256, paths - first)
            phase = rng.uniform(0.0, 2.0 * np.pi, (n, 1, 5))
            waves = np.cos(times[:, None] * FREQUENCY + phase).astype(np.float32)
            amplitude = 0.3 * rng.normal(size=(n, 5, 9))
            amplitude[..., 8] = -amplitude[..., 0] - amplitude[..., 4]
            data[first : first + n] = waves @ amplitude.astype(np.float32)


@command
def main(small=False):
    """The table."""
    paths = 2_000 if small else 100_000
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder / "tracers.h5", paths)
        case = {
            "body": {"aspect_ratio": 0.2},
            "flow": {"type": "linear", "gradient": {"file": "tracers.h5"}},
            "time": {"end": END, "tolerance": 1e-6},
            "statistics": {"quantities": ["tumbling"], "keep": 64, "every": 10},
            "checkpoint": {"every": "2 s"},
            "sweep": {"axes": [{"flow.trajectory": "all"}], "store": "statistics"},
        }
        (folder / "case.json").write_text(json.dumps(case))
        first = None
        qs.ensemble(qs.Body(0.2), qs.GradientSeries.gaussian(paths=8, end=2.0))  # compiles
        for ranks, killed in ((2, False), (1, False), (3, False), (2, True)):
            result = folder / f"{ranks}{'_killed' * killed}.h5"
            begin = time.perf_counter()
            run = f"mpirun -n {ranks} --oversubscribe {sys.executable} -m qbxstokes case.json"
            run = [*run.split(), "--quiet", "--set", f"output.file={result.name}"]
            if killed:
                with subprocess.Popen(run, cwd=folder, start_new_session=True) as process:
                    time.sleep(0.5 * rows[0]["s"])
                    process.send_signal(signal.SIGKILL)
                    process.wait()
                run.append("--resume")
            _, status, use = os.wait4(subprocess.Popen(run, cwd=folder).pid, 0)
            assert status == 0, f"{ranks} ranks failed"
            spent = time.perf_counter() - begin
            found = qs.load(result)
            first = first or found
            same = all(np.array_equal(found[n], first[n], equal_nan=True) for n in first.names)
            row = {"ranks": ranks, "killed": int(killed), "s": spent, "same": int(same)}
            row["us"] = 1e6 * spent * ranks / (paths * SAMPLES)
            row |= {"MB_a_rank": use.ru_maxrss / 1024, "result_MB": result.stat().st_size / 1e6}
            rows.append(row)
    return {"paths": rows}
