"""Start PETSc once, with the options of the case below those of the command line."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any


def start(arguments: Sequence[str] = (), options: Mapping[str, Any] | None = None) -> Any:
    """Initialise PETSc and return the petsc4py.PETSc module.

    arguments: the command line that is left for PETSc. options: the `petsc:` section of the case,
    which yields to the command line and to PETSC_OPTIONS; a key may start with a dash or not, a
    value of None or True makes a flag. Later calls only add options.
    """
    import petsc4py

    petsc4py.init([sys.argv[0], *arguments])
    from petsc4py import PETSc

    database = PETSc.Options()
    for key, value in (options or {}).items():
        name = key.lstrip("-")
        if not database.hasName(name):
            database.setValue(name, None if value is None or value is True else str(value))
    return PETSc


def unused_options(PETSc: Any) -> list[str]:
    """Names of the options that nothing has asked for."""
    database = PETSc.Options()
    return sorted(name for name in database.getAll() if not database.used(name))
