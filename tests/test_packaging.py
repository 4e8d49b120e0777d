"""What the distribution says of itself, in the several files that say it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
import yaml

import qbxstokes

ROOT = Path(qbxstokes.__file__).parents[1]
pytestmark = pytest.mark.skipif(
    not (ROOT / "CITATION.cff").exists(), reason="the package was installed without its checkout"
)


def test_citation_agrees_with_the_package() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["version"] == qbxstokes.__version__
    assert citation["license"] == project["license"]
    assert citation["authors"] == project["authors"]


def test_changelog_names_the_version() -> None:
    lines = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()
    headings = [line for line in lines if line.startswith("## ")]
    assert qbxstokes.__version__ in headings[0]


def test_types_are_shipped() -> None:
    assert (ROOT / "qbxstokes" / "py.typed").exists()
