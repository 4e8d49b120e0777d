"""`task: study`: parameter studies, one module each.

A study is cut into blocks that know nothing of each other, so that any number of ranks share them
and an interrupted study goes on where it was. Its module has

    blocks(full)         the blocks, each a dictionary of plain parameters
    compute(**block)     the rows of one block, dictionaries of plain values with a key `table`
    tables(rows)         the tables made of all rows
    figures(tables)      a figure by name, drawn from the tables
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
        "qbx_parameters",
        "qbx_aspect_ratios",
    )
}
