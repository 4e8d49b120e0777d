"""`task: benchmark`: work-precision tables, one module each.

Every time is the median of repeats, and its ratio is to the baseline of the same run.
"""

MAKERS: dict[str, str] = {
    "accuracy": "qbxstokes.app.benchmark.accuracy",
    "iterations": "qbxstokes.app.benchmark.iterations",
    "setup": "qbxstokes.app.benchmark.setup",
    "step": "qbxstokes.app.benchmark.step",
    "integrators": "qbxstokes.app.benchmark.integrators",
    "events": "qbxstokes.app.benchmark.events",
    "command": "qbxstokes.app.benchmark.command",
    "batch": "qbxstokes.app.benchmark.batch",
    "ranks": "qbxstokes.app.benchmark.ranks",
    "sweeps": "qbxstokes.app.benchmark.sweeps",
    "field": "qbxstokes.app.benchmark.field",
    "scaling": "qbxstokes.app.benchmark.scaling",
}
