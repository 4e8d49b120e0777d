"""The equations of motion, once, as scalar arithmetic.

Every function of `taylor` and the modules that `KERNELS` lists takes and returns plain
numbers and uses +, -, *, / alone. The same source therefore runs in many ways: on Python floats, on
NumPy rows (one entry per lane), recorded and written out for the constants of a scene (tracing.py:
one body, nothing to load), compiled by numba over a block (loops.py, compiled.py), and on complex
numbers, which makes the Jacobian exact to rounding: Im f(y + i h e)/h has no subtraction, so that h
may be 1e-100 (Squire & Trapp, SIAM Rev. 40, 1998).

The state of a body is that of `layout`: x, q and, for St > 0, V and W. The right-hand side does not
see the length of q: R(q) is divided by |q|^2, so that f is homogeneous in q, a Runge-Kutta step
commutes with scaling q, and q may be scaled to unit length at any time without any effect on the
orbit.
"""

from typing import Any

from qbxstokes.motion import fore_aft

# The kernels of each class of laws (`bie.functional.FaxenCoefficients.symmetry`): a module with
# `pack_body`, `unpack_body`, `N_NUMBERS`, `ROWS`, `free`, `driven_motion`, `accelerations`,
# `massless`, `inertial` and `for_compiler`.
KERNELS: dict[str, Any] = {"fore-aft revolution": fore_aft}

STEP = 1e-100  # h of the complex steps
