"""The map of the house: imports go down only, in no circles, each outside library in one place.

The packages are ordered in levels. A module imports from its own package and from lower levels;
packages on one level do not know each other. All may import `errors`, `tables`, `typing` and
the like. Within a package too no module needs, through any others, itself.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import pytest

import qbxstokes

ROOT = Path(qbxstokes.__file__).parent
PACKAGE = "qbxstokes"

LEVELS = (
    {"geometry", "flows", "reference", "quantities", "solver_options", "units"},
    {"qbx"},
    {"bie"},
    {"motion"},
    {"plots"},
    {"petsc", "io", "case", "suspension"},
    {"simulation"},
    {"runs"},
    {"cli"},
    {"__main__", "__init__"},
)
LEVEL = {name: level for level, names in enumerate(LEVELS) for name in names}
MATHEMATICS = [name for names in LEVELS[:4] for name in sorted(names)]
SHARED = ("errors", "folders", "tables", "expressions", "typing", "quantity", "__version__")

# Libraries that only some packages may import, wherever in the file the import stands.
HOMES = {
    "petsc4py": {"petsc"},
    "mpi4py": {"petsc", "runs", "cli"},
    "yaml": {"case"},
    "h5py": {"io", "flows", "tables"},
    "matplotlib": {"plots"},
    "pint": {"units"},
    "pandas": {"io"},
    "xarray": {"io"},
    "argparse": {"runs", "cli", "__main__"},
    "logging": {"petsc", "io", "plots", "case", "simulation", "runs", "cli", "__main__"},
}
# What verifies shares no code with what is verified.
REFERENCE_LIBRARIES = {"numpy", "scipy"}
# Slow to import, needed by few runs: imported inside the functions that use them.
LAZY = ("numba", "scipy", "matplotlib", "pandas", "xarray", "pint")


def unit(module: str) -> str:
    """Package or top module of `qbxstokes` that a dotted module name belongs to."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def module_name(path: Path) -> str:
    """Dotted name of a source file below the package's folder."""
    parts = (PACKAGE, *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(source: str, module: str, is_package: bool) -> Iterator[str]:
    """Dotted names of all modules imported anywhere in a source text, relative ones resolved."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")
                parts = parts[: len(parts) - node.level + is_package]
                base = ".".join([*parts, base] if base else parts)
            if base == PACKAGE:  # from qbxstokes import bie
                yield from (f"{base}.{alias.name}" for alias in node.names)
            else:
                yield base


def violations(source: str, module: str, is_package: bool = False) -> list[str]:
    """Imports of one source text that the rules forbid, as readable lines."""
    here = unit(module)
    if here not in SHARED and here not in LEVEL:
        return [f"{module} has no level: give {here} one in {Path(__file__).name}"]
    found = []
    for name in imports(source, module, is_package):
        top = name.partition(".")[0]
        if top == PACKAGE:
            there = unit(name)
            if there in (here, *SHARED):
                continue
            if here in SHARED:
                found.append(f"{module} imports {name}: {here} imports nothing of the package")
            elif LEVEL.get(there, len(LEVELS)) >= LEVEL[here]:
                found.append(f"{module} imports {name}: not below level {LEVEL[here]}")
        elif top in HOMES and here not in HOMES[top]:
            found.append(f"{module} imports {name}: only {sorted(HOMES[top])} may")
        elif (
            here == "reference"
            and top not in REFERENCE_LIBRARIES
            and top not in sys.stdlib_module_names
        ):
            found.append(f"{module} imports {name}: only {sorted(REFERENCE_LIBRARIES)} may be")
    return found


def needed(source: str, module: str, is_package: bool, known: Iterable[str]) -> set[str]:
    """Those of the known modules that a source text imports, wherever, but for types alone."""
    tree = ast.parse(source)
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for statement in node.body
        for inner in ast.walk(statement)
    }
    found: set[str] = set()
    for node in ast.walk(tree):
        if id(node) in typing_only or not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        names = list(imports(ast.unparse(node), module, is_package))
        if isinstance(node, ast.ImportFrom):  # a name in a module, or a module in a package
            names += [f"{name}.{alias.name}" for name in names for alias in node.names]
        found |= {name for name in names if name != module and not module.startswith(f"{name}.")}
    return found & set(known)


def circles(needs: Mapping[str, set[str]]) -> list[str]:
    """Modules that need themselves through others."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        pending = [*needs[start]]
        while pending:
            name = pending.pop()
            if name not in seen:
                seen.add(name)
                pending += needs[name]
        return seen

    return sorted(name for name in needs if name in reached(name))


def run_python(code: str) -> str:
    """Output of a fresh interpreter that has run the code."""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def loaded(statements: str, libraries: tuple[str, ...]) -> str:
    """Those of the libraries that a fresh interpreter has loaded after the statements."""
    return run_python(
        f"import sys\n{statements}\nprint(*[m for m in {libraries!r} if m in sys.modules])"
    )


SOURCES = sorted(ROOT.rglob("*.py"))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_go_down(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    assert violations(source, module_name(path), path.name == "__init__.py") == []


def test_no_imports_in_circles() -> None:
    names = {module_name(path): path for path in SOURCES}
    needs = {
        name: needed(path.read_text(encoding="utf-8"), name, path.name == "__init__.py", names)
        for name, path in names.items()
    }
    assert needs["qbxstokes.flows.registry"] > {"qbxstokes.flows.base", "qbxstokes.flows.user"}
    assert circles(needs) == []


def test_circles_are_seen() -> None:
    sources = {
        "qbxstokes.flows.a": "def f():\n    from qbxstokes.flows import b",
        "qbxstokes.flows.b": "from .c import thing",
        "qbxstokes.flows.c": "import qbxstokes.flows.a",
        "qbxstokes.flows.d": "if TYPE_CHECKING:\n    from qbxstokes.flows.e import E",
        "qbxstokes.flows.e": "from qbxstokes.flows.d import D",
    }
    needs = {name: needed(text, name, False, sources) for name, text in sources.items()}
    assert circles(needs) == ["qbxstokes.flows.a", "qbxstokes.flows.b", "qbxstokes.flows.c"]


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("qbxstokes.bie.mobility", "from qbxstokes.motion import equations"),
        ("qbxstokes.bie.mobility", "from ..motion.equations import rate"),
        ("qbxstokes.bie.mobility", "from .. import motion"),
        ("qbxstokes.bie.mobility", "from qbxstokes import motion"),
        ("qbxstokes.bie.mobility", "import qbxstokes"),
        ("qbxstokes.bie.mobility", "def f():\n    import qbxstokes.petsc.shell"),
        ("qbxstokes.bie.mobility", "def f():\n    from petsc4py import PETSc"),
        ("qbxstokes.flows.linear", "from qbxstokes.geometry import spheroid"),
        ("qbxstokes.reference.jeffery", "import numba"),
        ("qbxstokes.io.results", "from qbxstokes.case import schema"),
        ("qbxstokes.io.results", "from qbxstokes.simulation import body"),
        ("qbxstokes.simulation.body", "from qbxstokes.runs import plan"),
        ("qbxstokes.runs.motion", "from qbxstokes.cli import main"),
        ("qbxstokes.flows.named", "from qbxstokes import quantities"),
        ("qbxstokes.quantities", "from qbxstokes.geometry import rotation"),
        ("qbxstokes.errors", "from qbxstokes.geometry import spheroid"),
        ("qbxstokes.helpers", ""),
    ],
)
def test_forbidden_imports_are_seen(module: str, source: str) -> None:
    assert len(violations(source, module)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("qbxstokes.motion.equations", "from qbxstokes.bie.functional import BodyModel"),
        (
            "qbxstokes.motion.equations",
            "from ..geometry import rotation\nfrom . import drift",
        ),
        ("qbxstokes.flows.linear", "from qbxstokes.errors import FlowError"),
        ("qbxstokes.simulation.body", "from qbxstokes.case import schema\nimport qbxstokes.petsc"),
        ("qbxstokes.runs.motion", "from qbxstokes.simulation import body"),
        ("qbxstokes.io.results", "from qbxstokes.quantities import MOTION"),
        ("qbxstokes.reference.jeffery", "import math\nfrom scipy import special"),
        ("qbxstokes.petsc.shell", "from petsc4py import PETSc\nfrom qbxstokes.qbx import operator"),
        ("qbxstokes.__main__", "from qbxstokes.runs import command as run"),
        ("qbxstokes.cli.main", "from qbxstokes import __version__"),
    ],
)
def test_allowed_imports_pass(module: str, source: str) -> None:
    assert violations(source, module) == []


OUTER = ("petsc4py", "mpi4py", "h5py", "matplotlib", "pandas")


@pytest.mark.parametrize("package", MATHEMATICS)
def test_mathematics_loads_no_library_of_the_outer_layers(package: str) -> None:
    assert loaded(f"import qbxstokes.{package}", (*OUTER, "yaml")) == ""


def test_no_module_of_the_mathematics_loads_them_either() -> None:
    modules = [module_name(path) for path in SOURCES if unit(module_name(path)) in MATHEMATICS]
    statements = "\n".join(f"import {module}" for module in modules)
    # yaml is left out: numba reads a configuration file of its own with it.
    assert loaded(statements, OUTER) == ""


@pytest.mark.parametrize(
    "module", ["qbxstokes", "qbxstokes.case", "qbxstokes.io", "qbxstokes.runs", "qbxstokes.cli"]
)
def test_slow_libraries_wait_until_they_are_needed(module: str) -> None:
    assert loaded(f"import {module}", LAZY) == ""
