"""The documents, pages of the manual among them: what they tell the reader to type works.

Blocks of these kinds are understood:

sh      every line is a command; all run in order, in one folder that holds `cases`. One whose
        comment tells a run time of minutes or hours is not run: what it names must be there
bash    installation and job scripts; not run
python  run in its place, all blocks of a document in one process with the same names
yaml    a case or some sections of one; checked
diff    lines with a plus are added to the file named, beside those without (of `extending` alone)
text    anything; not looked at

A block of Python, YAML or CSV that begins with `# NAME.py`, or what its name may be, is a file: it
is put into the folder, for the commands below it.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from conftest import ENVIRONMENT, ROOT, Run

from qbxstokes.case.describe import keys_page
from qbxstokes.case.document import parse
from qbxstokes.case.load import load_case
from qbxstokes.cli.pages import PAGES, page, topics

DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "cases" / "README.md",
    ROOT / "cases" / "tutorial.md",
    *sorted(PAGES.glob("*.md")),
]
NAMES = [str(path.relative_to(ROOT)) for path in DOCUMENTS]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
KINDS = {"sh", "bash", "python", "yaml", "csv", "diff", "text"}
# Who may show what no test runs.
NOT_RUN = {"README.md", "qbxstokes/pages/installation.md", "qbxstokes/pages/sweeps.md"}
FILE = re.compile(r"# ([\w./]+\.(?:py|yaml|csv))\n")
LONG = re.compile(r"#.*\b\d+ (min|minutes?|h|hours?)\b")
# What a piece of a case is completed with.
WHOLE = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}, "time": {"end": 1.0}}

EXTENDING = "qbxstokes/pages/extending.md"

each_document = pytest.mark.parametrize("name", NAMES)


def blocks(name: str) -> list[tuple[str, str]]:
    return BLOCK.findall((ROOT / name).read_text(encoding="utf-8"))


def commands(text: str) -> list[str]:
    """The lines of a block, those continued by a backslash as one."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.startswith("#")]


def in_an_environment(command: str) -> str:
    """A command as it is typed where the environment of run.sh is active."""
    ways = {
        "./run.sh python ": "python ",
        "./run.sh exec ": "",
        "./run.sh ": "python -m qbxstokes ",
    }
    for way, plain in {**ways, "qbxstokes ": "python -m qbxstokes "}.items():
        if command.startswith(way):
            return plain + command.removeprefix(way)
    return command


def run(command: list[str], folder: Path, root: Path = ROOT) -> None:
    """Run a command in a folder with the package below a root; its exit status must be 0."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | ENVIRONMENT | {"PATH": path, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"


def put(text: str, folder: Path) -> bool:
    """Write a block that names its file; whether it does."""
    file = FILE.match(text)
    if file:
        (folder / file[1]).parent.mkdir(parents=True, exist_ok=True)
        (folder / file[1]).write_text(text.removeprefix(file[0]))
    return file is not None


def add_lines(text: str, folder: Path) -> None:
    """Add the lines with a plus of a block to the file named in its first line."""
    head, *lines = text.splitlines()
    path = folder / head.removeprefix("--- ")
    old = "".join(f"{line[1:]}\n" for line in lines if line[0] == " ")
    assert path.read_text().count(old) == 1, text
    path.write_text(path.read_text().replace(old, "".join(f"{line[1:]}\n" for line in lines)))


@pytest.mark.slow
@pytest.mark.mpi
@pytest.mark.parametrize("name", [name for name in NAMES if name != EXTENDING])
def test_what_is_shown_works(
    name: str, tmp_path: Path, run_cli: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands and the Python of a document in order, in one folder."""
    (tmp_path / "cases").symlink_to(ROOT / "cases")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    names: dict[str, Any] = {"__name__": "__main__"}
    for kind, text in blocks(name):
        if put(text, tmp_path):
            continue
        if kind == "python":
            exec(compile(text, f"{name}: {text[:60]!r}", "exec"), names)
        for line in commands(text) if kind == "sh" else ():
            command = in_an_environment(line)
            words = shlex.split(command, comments=True)
            if LONG.search(command):
                continue
            options = [word for word in words[3:] if re.match(r"-\w", word)]  # PETSc's
            if words[:3] == ["python", "-m", "qbxstokes"] and not options:
                done = run_cli(*words[3:])  # in this process, which has imported everything
                assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
            else:
                run(["bash", "-c", command], tmp_path)


@pytest.mark.slow
def test_what_is_added_to_the_house_works(tmp_path: Path) -> None:
    """The page `extending`, literally, in a copy of the tree."""
    for part in ("qbxstokes", "tests", "cases", "pyproject.toml"):
        run(["cp", "-r", str(ROOT / part), "."], tmp_path)
    for kind, text in blocks(EXTENDING):
        if put(text, tmp_path):
            continue
        if kind == "diff":
            add_lines(text, tmp_path)
        elif kind == "python":
            run([sys.executable, "-c", text], tmp_path, tmp_path)
        for command in commands(text) if kind == "sh" else ():
            run(["bash", "-c", command], tmp_path, tmp_path)


def test_orbit_of_the_tutorial_closes() -> None:
    """An orbit closes after one period."""
    import qbxstokes as qs

    orbit = qs.run(ROOT / "cases" / "tutorial_orbit.yaml")
    assert orbit.axis[0] == pytest.approx(orbit.axis[-1], abs=1e-6)


@each_document
def test_blocks_are_of_a_kind_that_is_looked_at(name: str) -> None:
    found = {kind for kind, _ in blocks(name)}
    assert found <= KINDS - ({"bash"} if name not in NOT_RUN else set())


@each_document
def test_files_that_are_named_are_there(name: str) -> None:
    """Commands too long for a test among them: those must name a file."""
    text = (ROOT / name).read_text()
    for path in re.findall(r"\b(?:cases|tests|qbxstokes)/[\w./]+\.\w+", text):
        assert (ROOT / path).exists() or f"# {path}\n" in text, path
    for command in [line for kind, text in blocks(name) if kind == "sh" for line in commands(text)]:
        if LONG.search(command):
            assert re.search(r"\b(cases|tests)/\w", command), command


@pytest.mark.parametrize("name", [name for name in NAMES if name != EXTENDING])
def test_pieces_of_cases_are_right(name: str, tmp_path: Path) -> None:
    for _, text in blocks(name):
        put(text, tmp_path)
    for text in [text for kind, text in blocks(name) if kind == "yaml"]:
        path = tmp_path / "piece.yaml"
        given = parse(text, name).data
        rest = {key: value for key, value in WHOLE.items() if key not in given}
        if given.get("task") in ("field", "body", "rheology"):
            rest.pop("time", None)
        path.write_text(
            "\n".join([text, *(f"{key}: {json.dumps(value)}" for key, value in rest.items())])
        )
        load_case(path)


@each_document
def test_links_lead_somewhere(name: str) -> None:
    path = ROOT / name
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)]*)\)", path.read_text()):
        if target.startswith("https:"):
            continue
        other = path.parent / target if target else path
        assert other.exists(), target
        if anchor:
            assert anchor in anchors(other), f"{target}#{anchor}"


def anchors(path: Path) -> set[str]:
    """What a repository's browser calls the headings of a document."""
    headings = re.findall(r"^#+ (.*)", path.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_help_lists_the_pages_and_prints_them(run_cli: Run) -> None:
    listed = run_cli("help").stdout
    assert len(topics()) == len(list(PAGES.glob("*.md"))) > 0
    for topic, heading in topics().items():
        assert re.search(rf"^  {topic} +{re.escape(heading)}$", listed, re.MULTILINE)
        assert heading in run_cli("help", topic).stdout.splitlines()[0]


@pytest.mark.parametrize("topic", sorted(path.stem for path in PAGES.glob("*.md")))
def test_pages_read_well_in_a_terminal(topic: str) -> None:
    raw = (PAGES / f"{topic}.md").read_text()
    assert re.match(r"# .{1,70}\n\n", raw), "a heading first: it is what `help` lists"
    assert not re.search(r"<\w+>|!\[", raw), "no HTML, no pictures"
    text = page(topic)
    assert "```" not in text
    assert ".md)" not in text
    wide = [line for line in text.splitlines() if len(line) > 100]
    assert not wide


def test_unknown_topic_names_the_nearest(run_cli: Run) -> None:
    done = run_cli("help", "keyz")
    assert done.returncode == 2
    assert done.stderr == "command line: help keyz: no such topic; did you mean keys?\n"
    assert "lists them" in run_cli("help", "xxxxxxxx").stderr
    assert "one topic" in run_cli("help", "keys", "more").stderr


def test_page_of_keys_is_the_schema() -> None:
    assert (PAGES / "keys.md").read_text() == keys_page(), "run: python -m qbxstokes schema --write"


def test_pages_are_packaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wheel holds every page: `help` works where there is no checkout."""
    from flit_core import buildapi

    monkeypatch.chdir(ROOT)
    with zipfile.ZipFile(tmp_path / buildapi.build_wheel(str(tmp_path))) as wheel:
        held = {Path(name).name for name in wheel.namelist() if name.startswith("qbxstokes/pages/")}
    assert held == {path.name for path in PAGES.iterdir()}


def test_tutorial_shows_its_cases_as_they_are() -> None:
    """Excerpts of case files in the tutorial stand in the files themselves."""
    files = "".join(path.read_text() for path in sorted((ROOT / "cases").glob("tutorial_*.yaml")))
    plain = re.sub(r"\s*#.*", "", files)
    excerpts = [text for kind, text in blocks("cases/tutorial.md") if kind == "yaml"]
    assert len(excerpts) == 2
    for line in "".join(excerpts).splitlines():
        assert line in plain.splitlines()


def test_every_case_is_listed() -> None:
    listed = re.findall(r"\[`(\w+\.yaml)`\]\(\1\)", (ROOT / "cases" / "README.md").read_text())
    assert sorted(listed) == sorted(path.name for path in (ROOT / "cases").glob("*.yaml"))


def test_readme_is_read_in_one_sitting() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 200
