"""The one reader of tables: separators, comments, headers, and where a file is wrong."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from qbxstokes.errors import FlowError
from qbxstokes.flows.series import GradientSeries
from qbxstokes.tables import TableError, read_table


@pytest.mark.parametrize(
    "text",
    [
        "t,a,b\n0,1,2\n3,4,5.5\n",
        "\ufefft;a;b\r\n0;1;2\r\n3;4;5.5\r\n",
        "# made by hand\nt\ta\tb\n\n0\t1\t2  # the start\n3\t4\t5.5",
        "t  a b\n 0 1   2\n3 4 5.5\n",
        '"t", "a", "b"\n0, 1, 2\n3, 4, 5.5\n',
    ],
)
def test_every_separator_gives_the_same(text: str, tmp_path: Path) -> None:
    path = tmp_path / "table.txt"
    path.write_text(text, encoding="utf-8")
    table = read_table(path, columns=3)
    assert table.names == ("t", "a", "b")
    assert table.numbers.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.5]]
    assert table.lines[1] == 1 + next(i for i, line in enumerate(text.split("\n")) if "5.5" in line)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("1,2\n3,x\n", "line 2, column 2: 'x' is no finite number"),
        ("a,b\n1,2\n\n3,nan\n", "line 4, column 2: 'nan'"),
        ("1;2\n3;0,5\n", "line 2, column 2: '0,5' is no number; write a point for the comma: 0.5"),
        ("1,2\n3,\n", "line 2, column 2: is empty"),
        ("1,2\n3\n", "line 2 has 1 entries; 2 are expected"),
        ("1,2,3\n", "line 1 has 3 columns; 2 are expected"),
        ("a,b\n# 1,2\n", "no rows below its header"),
        ("", "holds no rows"),
    ],
)
def test_faults_name_file_line_and_column(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(TableError, match=r"table\.csv") as caught:
        read_table(path, columns=2)
    assert told in str(caught.value)


@pytest.mark.parametrize("name", ["pipe", "pipe.npy", "folder", "/dev/zero"])
def test_what_is_no_file_is_not_waited_for(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    os.mkfifo(tmp_path / "pipe.npy")
    (tmp_path / "folder").mkdir()
    with pytest.raises(TableError, match="a file is expected"):
        read_table(tmp_path / name)
    with pytest.raises(FlowError, match="a file is expected"):
        GradientSeries.from_file(tmp_path / name)


def test_words_arrays_and_missing_files(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("key,angle\nfree,90 deg\nlocked,1\n")
    assert read_table(path, words=True).words == [["free", "90 deg"], ["locked", "1"]]
    np.save(tmp_path / "a.npy", np.arange(6, dtype=np.float32).reshape(3, 2))
    numbers = read_table(tmp_path / "a.npy", columns=2).numbers
    assert isinstance(numbers, np.memmap)
    assert numbers.dtype == np.float32
    for name, told in (("a.npy", "has 2 columns"), ("none.csv", "No such file")):
        with pytest.raises(TableError, match=told):
            read_table(tmp_path / name, columns=3)
    (tmp_path / "bad.npy").write_bytes(b"no array")
    with pytest.raises(TableError, match="is no table"):
        read_table(tmp_path / "bad.npy")
