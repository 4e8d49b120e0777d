"""`task: benchmark`: its tables have become cases and scripts, see cases/benchmarks."""

MAKERS: dict[str, str] = {}
