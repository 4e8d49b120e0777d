"""Tables: what is written is read back, and what is printed fits the page."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qbxstokes.errors import ResultFileError
from qbxstokes.io.results import load
from qbxstokes.io.tables import Column, Table, read_tables
from qbxstokes.io.writer import ResultWriter

pytestmark = pytest.mark.slow


def sample() -> Table:
    table = Table(
        "cost",
        "Cost of a step",
        (
            Column("method", description="what is evaluated"),
            Column("bodies", "", "bodies in a block", "d"),
            Column("time", "us", "wall time per body and step", ".3g", "time per step"),
            Column("error", "", "largest difference", ".1e"),
            Column("agrees"),
        ),
        notes=["Medians of five repeats."],
        provenance={"machine": "two cores", "command": "python -m qbxstokes case.yaml"},
        plot={"x": "bodies", "y": ["time"], "scale": "loglog"},
    )
    table.add(method="table", bodies=1, time=1.25, error=1e-15, agrees=True)
    table.add(method="solve", bodies=1000, time=np.float64(321.5), error=math.nan, agrees=False)
    return table


def test_text_is_aligned_and_fits() -> None:
    text = sample().to_text(60)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 60
    assert lines[0] == "Cost of a step"
    assert "[us]" in text
    row = next(line for line in lines if line.startswith("solve"))
    assert row.split() == ["solve", "1000", "322", "-", "no"]
    assert "Medians of five repeats." in text


def test_wide_tables_go_on_below() -> None:
    table = Table("wide", "Wide", tuple(Column(f"quantity_{i:02}") for i in range(20)))
    table.rows.append(tuple(range(20)))
    lines = table.to_text(80).splitlines()
    assert max(map(len, lines)) <= 80
    assert sum("quantity" in line for line in lines) >= 2


def test_long_texts_are_folded() -> None:
    table = Table("t", "T", (Column("name"), Column("remark")))
    table.add(name="a", remark="many words " * 20)
    assert max(map(len, table.to_text(80).splitlines())) <= 80


def test_markdown_has_one_row_per_row() -> None:
    lines = sample().to_markdown().splitlines()
    rows = [line for line in lines if line.startswith("|")]
    assert len(rows) == 4
    assert rows[0].split("|")[3].strip() == "time per step [us]"
    assert len({len(row) for row in rows}) == 1


def same(a: Table, b: Table) -> None:
    assert vars(a) == vars(b)
    assert [row["time"] for row in a.records()] == b["time"].tolist()


def test_csv_and_hdf5_give_the_table_back(tmp_path: Path) -> None:
    table = sample()
    same(table, Table.read_csv(table.write_csv(tmp_path / "cost.csv")))
    with ResultWriter(tmp_path / "cost.h5", "benchmark") as writer:
        table.write_hdf5(writer.file)
        writer.finish({})
    same(table, load(tmp_path / "cost.h5").tables["cost"])


def test_pandas_reads_the_csv() -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_csv(io.StringIO(sample().to_csv()), comment="#")
    assert frame["bodies"].tolist() == [1, 1000]
    assert sample().to_pandas()["time"].tolist() == [1.25, 321.5]


VALUES = {
    "text": st.text(max_size=12),
    "int": st.integers(-(2**63), 2**63 - 1),
    "float": st.floats(),
    "bool": st.booleans(),
}


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_table_survives_both_formats(data: st.DataObject) -> None:
    kinds = data.draw(st.lists(st.sampled_from(list(VALUES)), min_size=1, max_size=5))
    missing = {"text": st.none(), "float": st.none()}
    table = Table(
        "t", data.draw(st.text(max_size=9)), tuple(Column(f"c{i}") for i in range(len(kinds)))
    )
    for _ in range(data.draw(st.integers(0, 4))):
        table.add(**{
            f"c{i}": data.draw(VALUES[kind] | missing.get(kind, st.nothing()))
            for i, kind in enumerate(kinds)
        })  # fmt: skip
    assert vars(Table.from_csv(table.to_csv())) == vars(table)
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        table.write_hdf5(file)
        assert vars(read_tables(file)["t"]) == vars(table)
    table.to_text()
    table.to_markdown()


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[20:],
        lambda text: text[: len(text) // 3],
        lambda text: text.replace("1000", "many"),
        lambda text: text.replace("method,bodies", "bodies"),
        lambda text: text + "a,b\n",
        lambda text: text.replace('"title"', "title:").replace("# title: ", "# title: {"),
        lambda text: text.replace("# name: ", "# nome: "),
    ],
)
def test_damaged_tables_are_refused(damage: Any) -> None:
    with pytest.raises(ResultFileError):
        Table.from_csv(damage(sample().to_csv()))


def test_misuse_is_refused() -> None:
    with pytest.raises(ValueError, match="no column"):
        sample().add(speed=1)
    with pytest.raises(ValueError, match="identifier"):
        Column("two words")
    with pytest.raises(ValueError, match="different names"):
        Table("t", "T", (Column("a"), Column("a")))
    with pytest.raises(ValueError, match="not list"):
        sample().add(time=[1])
