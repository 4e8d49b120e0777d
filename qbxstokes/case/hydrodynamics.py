"""Section `hydrodynamics`: a tolerance, or every number of the discretisation."""

from __future__ import annotations

from typing import Annotated, Literal

from qbxstokes.case.base import Boolean, Integer, Number, Text
from qbxstokes.case.model import Field, Problem, Section

UNIFORM_KEYS = ("r_over_h", "upsampling", "coefficients")
GRADED_KEYS = ("radius_factor", "panel_order", "panel_ratio")


class Hydrodynamics(Section):
    """Accuracy and scheme of the boundary integral equation."""

    tolerance: Annotated[Number, Field(gt=0, le=0.1)] = Field(
        default=1e-10, description="relative error of velocities, force and torque to aim at"
    )
    scheme: Literal["graded", "uniform"] = Field(
        default="graded",
        description="quadrature: panels graded to each centre, or uniform upsampling",
    )
    n_theta: Annotated[Integer, Field(ge=4, le=4096)] | None = Field(
        default=None,
        description="Gauss-Legendre nodes in the polar angle; unset: from tolerance",
        examples=[12],
    )
    n_phi: Annotated[Integer, Field(ge=4, le=8192)] | None = Field(
        default=None,
        description="trapezoid nodes in the azimuth; unset: from tolerance",
        examples=[16],
    )
    expansion_order: Annotated[Integer, Field(ge=0, le=200)] | None = Field(
        default=None,
        description="order p of the expansions; unset: from tolerance",
        examples=[10],
    )
    radius_factor: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="expansion radius over the least local radius (graded); unset: from tolerance",
        examples=[0.3],
    )
    panel_order: Annotated[Integer, Field(ge=2, le=64)] | None = Field(
        default=None,
        description="Gauss nodes per side of a panel (graded); unset: from tolerance",
        examples=[12],
    )
    panel_ratio: Annotated[Number, Field(gt=0, le=4)] | None = Field(
        default=None,
        description="panel length over distance to the centre (graded), at most",
        examples=[0.7],
    )
    r_over_h: Annotated[Number, Field(gt=0)] | None = Field(
        default=None,
        description="radius over spacing: r = 2 pi (r/h) / n_theta (uniform)",
        examples=[0.48],
    )
    upsampling: Annotated[Integer, Field(ge=1, le=200)] | None = Field(
        default=None,
        description="upsampling factor of both directions (uniform)",
        examples=[16],
    )
    coefficients: Boolean | None = Field(
        default=None,
        description=(
            "sum expansions from their spherical-harmonic coefficients (uniform); unset: in the "
            "equal form for one target, which is faster"
        ),
        examples=[True],
    )
    expansion: Literal["average", "inner", "outer"] | None = Field(
        default=None,
        description=(
            "side of the expansions: mean of both, or one and the jump; unset: inner (graded), "
            "average (uniform)"
        ),
        examples=["inner"],
    )
    completion: Literal["surface", "point"] | None = Field(
        default=None,
        description=(
            "surface / point: flow that carries force and torque, spread or at the centre; unset: "
            "surface, but no resistance is formed where no force acts"
        ),
        examples=["surface"],
    )
    solve: Literal["functional", "every_step"] = Field(
        default="functional",
        description="free motion from functionals formed once, or by a solve at every step",
    )
    gmres_tolerance: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="relative residual of GMRES; unset: from tolerance",
        examples=[1e-12],
    )
    preconditioner: Boolean = Field(default=True, description="mode-wise preconditioner for GMRES")
    cache: Text | None = Field(
        default=None,
        description="folder that keeps operators between runs; unset: the user's cache folder",
        examples=["operators"],
    )

    def _check(self) -> None:
        foreign = UNIFORM_KEYS if self.scheme == "graded" else GRADED_KEYS
        other = "uniform" if self.scheme == "graded" else "graded"
        for name in foreign:
            if getattr(self, name) is not None:
                raise Problem(
                    f"has no meaning for scheme: {self.scheme}",
                    f"leave it out or set scheme: {other}",
                    (name,),
                )
        if self.scheme == "uniform":
            for name in ("n_theta", "n_phi", "expansion_order", "r_over_h", "upsampling"):
                if getattr(self, name) is None:
                    raise Problem("is missing", "scheme: uniform needs it explicitly", (name,))
