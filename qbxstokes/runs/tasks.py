"""What each task plans before anything is computed."""

from __future__ import annotations

from typing import Any

from qbxstokes.case.load import LoadedCase


def plan_of(loaded: LoadedCase) -> Any:
    """The plan of the case's task; raises CaseError for what the schema alone cannot see."""
    if loaded.case.task == "field":
        from qbxstokes.runs.field import plan_field

        return plan_field(loaded)
    if loaded.case.task == "body":
        from qbxstokes.runs.body import plan_body

        return plan_body(loaded)
    from qbxstokes.runs.plan import make_plan

    return make_plan(loaded)
