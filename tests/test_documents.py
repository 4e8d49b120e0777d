"""The documents: what they tell the reader to type works as written."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ENVIRONMENT, ROOT

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def blocks(path: Path) -> list[tuple[str, str]]:
    return [(kind, text) for kind, text in BLOCK.findall(path.read_text())]


def run(command: list[str], folder: Path) -> str:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | ENVIRONMENT | {"PATH": path},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.slow
@pytest.mark.mpi
def test_tutorial(tmp_path):
    """Every command and every piece of Python of the tutorial, in one folder, in order."""
    (tmp_path / "cases").symlink_to(ROOT / "cases")
    printed = []
    for kind, text in blocks(ROOT / "cases" / "tutorial.md"):
        if kind == "sh":
            for line in text.splitlines():
                run(shlex.split(line), tmp_path)
        elif kind == "python":
            printed.append(run([sys.executable, "-c", text], tmp_path))
    assert len(printed) == 3
    first, last = re.findall(r"\[.*?\]", printed[0])
    assert [float(x) for x in first[1:-1].split()] == pytest.approx(
        [float(x) for x in last[1:-1].split()], abs=1e-6
    )
    assert float(printed[1]) > 0.01
    assert {path.suffix for path in tmp_path.iterdir()} >= {".h5"}


def test_tutorial_shows_its_cases_as_they_are():
    """Excerpts of case files in the tutorial stand in the files themselves."""
    files = "".join(path.read_text() for path in sorted((ROOT / "cases").glob("tutorial_*.yaml")))
    plain = re.sub(r"\s*#.*", "", files)
    excerpts = [text for kind, text in blocks(ROOT / "cases" / "tutorial.md") if kind == "yaml"]
    assert len(excerpts) == 2
    for line in "".join(excerpts).splitlines():
        assert line in plain.splitlines()


@pytest.mark.slow
def test_python_of_the_readme(tmp_path):
    """The examples of the README's Python section run, one after the other, as one script."""
    text = (ROOT / "README.md").read_text()
    section = text[text.index("\n## Python\n") :].split("\n## ")[1]
    examples = BLOCK.findall(section)
    assert [kind for kind, _ in examples] == ["python"] * 3
    run([sys.executable, "-c", "".join(code for _, code in examples)], tmp_path)


def test_key_table_of_the_readme_is_the_schema():
    """The table between the markers is what `python -m qbxstokes schema --table` prints."""
    from qbxstokes.case.describe import markdown_table

    text = (ROOT / "README.md").read_text()
    shown = text.split("<!-- keys: python -m qbxstokes schema --table -->\n")[1]
    assert shown.split("<!-- end of keys -->")[0].strip() == markdown_table().strip()


def test_links_lead_somewhere():
    for path in (ROOT / "README.md", ROOT / "cases" / "README.md", ROOT / "cases" / "tutorial.md"):
        for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", path.read_text()):
            assert (path.parent / target).exists(), f"{path.name}: {target}"


def test_every_case_is_listed() -> None:
    listed = re.findall(r"\[`(\w+\.yaml)`\]\(\1\)", (ROOT / "cases" / "README.md").read_text())
    assert sorted(listed) == sorted(path.name for path in (ROOT / "cases").glob("*.yaml"))
