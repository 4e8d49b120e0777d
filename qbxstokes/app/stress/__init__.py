"""`task: stress`: numerical stability, one module per table; every row has a bound."""

MAKERS: dict[str, str] = {
    "invariances": "qbxstokes.app.stress.invariances",
}
