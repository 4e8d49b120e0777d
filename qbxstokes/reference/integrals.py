"""The elliptic integrals of a spheroid with semi-axes (k, k, 1), exact to rounding.

alpha0 = int_0^inf dl (k^2+l)^-2 (1+l)^(-1/2)   = 2/3 R_D(1, k^2, k^2)
gamma0 = int_0^inf dl (k^2+l)^-1 (1+l)^(-3/2)   = 2/3 R_D(k^2, k^2, 1)
chi0   = int_0^inf dl (k^2+l)^-1 (1+l)^(-1/2)   = 2 R_F(k^2, k^2, 1)

Definitions: Jeffery 1922, Proc. R. Soc. A 102, 161; Carlson's symmetric integrals: NIST DLMF,
section 19.16.
"""

from __future__ import annotations


def alpha0(k: float) -> float:
    """alpha0 of aspect ratio k (weight of a transverse semi-axis)."""
    from scipy.special import elliprd

    return float(2.0 / 3.0 * elliprd(1.0, k * k, k * k))


def gamma0(k: float) -> float:
    """gamma0 of aspect ratio k (weight of the polar semi-axis)."""
    from scipy.special import elliprd

    return float(2.0 / 3.0 * elliprd(k * k, k * k, 1.0))


def chi0(k: float) -> float:
    """chi0 of aspect ratio k."""
    from scipy.special import elliprf

    return float(2.0 * elliprf(k * k, k * k, 1.0))
