"""`task: stress`: its tables have become tests, see tests/stress."""

MAKERS: dict[str, str] = {}
