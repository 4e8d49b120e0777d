"""Nondimensional numbers of a body from those of an experiment, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import SceneError
from qbxstokes.simulation.body import Body
from qbxstokes.typing import Array


def stokes_number(
    density_ratio: ArrayLike, length: ArrayLike, viscosity: ArrayLike, time: ArrayLike
) -> Array:
    """St = (rho_p/rho_f) c^2/(nu tau), as `Body` takes it; the arguments broadcast.

    density_ratio: rho_p/rho_f, of body to fluid. length: c, the polar radius; viscosity: nu,
    kinematic; time: tau, the unit of time (1/rate, or the Kolmogorov time), in units that agree.

    >>> import qbxstokes as qs
    >>> float(qs.stokes_number(2.5, 1e-4, 1e-6, 0.05))  # 0.2 mm of polystyrene or so, in water
    0.5
    """
    given = {"density_ratio": density_ratio, "length": length, "viscosity": viscosity, "time": time}
    rho, c, nu, tau = (np.asarray(value, dtype=np.float64) for value in given.values())
    for name, value in zip(given, (rho, c, nu, tau), strict=True):
        if not np.all((value > 0.0) & np.isfinite(value)):
            raise SceneError(name, f"is {value.tolist()}", "positive and finite")
    return np.asarray(rho * c**2 / (nu * tau))


def response_time(body: Body) -> Array:
    """tau_p/tau, the time in which a body of some Stokes number takes up a flow's velocity.

    Of axes in all directions alike: St V (2/R_across + 1/R_along)/3 with the volume V (Shapiro &
    Goldenberg, J. Aerosol Sci. 24, 1993). With the Kolmogorov time as the unit it is the
    tau_p/tau_eta of the literature.

    >>> import qbxstokes as qs
    >>> round(float(qs.response_time(qs.Body(1.0, stokes_number=9.0))), 9)  # of a sphere: 2 St/9
    2.0
    """
    across, along = np.diag(body.resistance)[[0, 2]]
    mobility = (2.0 / across + 1.0 / along) / 3.0
    return np.asarray(body.stokes_number * body.shape.volume * mobility)
