"""qbxstokes: motion of a rigid spheroid in Stokes flow by quadrature by expansion.

>>> import qbxstokes as qs
>>> body = qs.Body(aspect_ratio=0.5)
>>> velocity, spin = body.free_motion(qs.flow("shear", rate=2.0), orientation=[1, 0, 0])
>>> round(float(spin[2]), 9)  # Jeffery 1922: -rate k^2/(1 + k^2) with the axis along the flow
-0.4
"""

from __future__ import annotations

import sys

if sys.argv[:1] == ["-m"]:  # python -m qbxstokes: what lies in the working folder comes last
    sys.path.append(sys.path.pop(0))

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from qbxstokes.case.load import load_case as load_case
    from qbxstokes.errors import QbxStokesError as QbxStokesError
    from qbxstokes.flows import GradientSeries as GradientSeries
    from qbxstokes.flows import Series as Series
    from qbxstokes.flows import build_flow as build_flow
    from qbxstokes.geometry.spheroid import Spheroid as Spheroid
    from qbxstokes.io.results import load as load
    from qbxstokes.motion.equations import Constraints as Constraints
    from qbxstokes.motion.equations import Loads as Loads
    from qbxstokes.runs.from_python import run as run
    from qbxstokes.runs.from_python import sweep as sweep
    from qbxstokes.simulation.body import Body as Body
    from qbxstokes.simulation.body import flow as flow
    from qbxstokes.simulation.body import response_time as response_time
    from qbxstokes.simulation.body import stokes_number as stokes_number
    from qbxstokes.simulation.ensemble import ensemble as ensemble
    from qbxstokes.simulation.from_case import from_case as from_case
    from qbxstokes.simulation.langevin import langevin as langevin
    from qbxstokes.simulation.result import Motion as Motion
    from qbxstokes.simulation.rheology import rheology as rheology
    from qbxstokes.simulation.simulation import Simulation as Simulation
    from qbxstokes.simulation.surroundings import Repulsion as Repulsion
    from qbxstokes.simulation.surroundings import Wall as Wall
    from qbxstokes.simulation.suspension import Suspension as Suspension
    from qbxstokes.simulation.wall_table import OverWall as OverWall

__version__ = "0.1.0"

# Public name -> module that holds it; imported when first used, so that `import qbxstokes` costs
# nothing and the mathematics stays free of PETSc, files and options.
_PUBLIC = {
    "Body": "qbxstokes.simulation.body",
    "Constraints": "qbxstokes.motion.equations",
    "GradientSeries": "qbxstokes.flows",
    "Loads": "qbxstokes.motion.equations",
    "Motion": "qbxstokes.simulation.result",
    "Simulation": "qbxstokes.simulation.simulation",
    "Spheroid": "qbxstokes.geometry.spheroid",
    "OverWall": "qbxstokes.simulation.wall_table",
    "QbxStokesError": "qbxstokes.errors",
    "Suspension": "qbxstokes.simulation.suspension",
    "Repulsion": "qbxstokes.simulation.surroundings",
    "Series": "qbxstokes.flows",
    "Wall": "qbxstokes.simulation.surroundings",
    "build_flow": "qbxstokes.flows",
    "ensemble": "qbxstokes.simulation.ensemble",
    "flow": "qbxstokes.simulation.body",
    "from_case": "qbxstokes.simulation.from_case",
    "langevin": "qbxstokes.simulation.langevin",
    "load": "qbxstokes.io.results",
    "load_case": "qbxstokes.case.load",
    "response_time": "qbxstokes.simulation.body",
    "rheology": "qbxstokes.simulation.rheology",
    "run": "qbxstokes.runs.from_python",
    "stokes_number": "qbxstokes.simulation.body",
    "sweep": "qbxstokes.runs.from_python",
}
__all__ = ["__version__", *_PUBLIC]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name in _PUBLIC:
        value = getattr(import_module(_PUBLIC[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names, loaded or not."""
    return sorted({*globals(), *_PUBLIC})
