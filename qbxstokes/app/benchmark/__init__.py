"""`task: benchmark`: work-precision tables, one module each.

Every time is the median of repeats, and its ratio is to the baseline of the same run.
"""

MAKERS: dict[str, str] = {
    "accuracy": "qbxstokes.app.benchmark.accuracy",
    "iterations": "qbxstokes.app.benchmark.iterations",
    "setup": "qbxstokes.app.benchmark.setup",
}
