"""`task: study`: parameter studies, one module each.

A study is cut into blocks that know nothing of each other, so that any number of ranks share them
and an interrupted study goes on where it was. Its module has

    blocks(full)         the blocks, each a dictionary of plain parameters, the dear ones late
    compute(**block)     the rows of one block, dictionaries of plain values with a key `table`
    tables(rows)         the tables made of all rows
    FIGURES              functions by name that draw a figure from the tables

Whatever takes time is computed in blocks, the curves of a theory as well: tables are made on one
rank while the others wait. Each figure is drawn by one rank.
"""

MAKERS: dict[str, str] = {
    name: f"qbxstokes.app.study.{name}"
    for name in (
        "linear_shear",
        "rotation_rate",
        "orbit_drift",
        "quadratic_flow",
        "acceleration",
        "lateral_drift",
    )
}
