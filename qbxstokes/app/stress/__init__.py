"""`task: stress`: numerical stability, one module per table; every row has a bound."""

MAKERS: dict[str, str] = {
    name: f"qbxstokes.app.stress.{name}"
    for name in (
        "aspect_ratios",
        "expansions",
        "resolution",
        "conditioning",
        "stokes_numbers",
        "magnitudes",
        "positions",
        "orientations",
        "invariances",
        "long_runs",
        "torque_free",
    )
}
# Makes one more table of all that were made.
SUMMARY = "qbxstokes.app.stress.summary"
