"""The law of a body in polynomial flows, fitted to its functional."""

import math
from functools import cache
from itertools import combinations_with_replacement, permutations

import numpy as np

from qbxstokes.bie.functional import FaxenCoefficients, ModalFunctional
from qbxstokes.typing import Array

LEVI_CIVITA: Array = np.zeros((3, 3, 3))
for _i, _j, _k in permutations(range(3)):
    LEVI_CIVITA[_i, _j, _k] = np.linalg.det(np.eye(3)[[_i, _j, _k]])


@cache
def stokes_polynomials(degree: int) -> Array:
    """Orthonormal basis of the homogeneous Stokes flows of degree 1, 2 or 3 (not to be changed).

    Returns derivative tensors (n, 3, 3, ...) of order degree, [i, j, k...] = d_j d_k ... u_i,
    that are free of divergence and whose Laplacian is free of curl: n = 8, 15 or 21.
    """
    exponents = list(combinations_with_replacement(range(3), degree))
    tensors = []
    for i in range(3):
        for index in exponents:
            tensor = np.zeros((3,) * (degree + 1))
            for permuted in set(permutations(index)):
                tensor[(i, *permuted)] = 1.0
            tensors.append(tensor)
    space = np.stack(tensors)
    constraints = [np.einsum("nii...->n...", space).reshape(len(space), -1)]
    if degree == 3:
        laplacian = np.einsum("nijkk->nij", space)
        constraints.append((laplacian - laplacian.swapaxes(1, 2)).reshape(len(space), -1))
    matrix = np.concatenate(constraints, axis=1).T
    _, singular, rows = np.linalg.svd(matrix)
    rank = int(np.sum(singular > 1e-12 * singular[0]))
    return np.tensordot(rows[rank:], space, axes=1)


def faxen_coefficients(functional: ModalFunctional) -> tuple[FaxenCoefficients, float]:
    """Coefficients of the free motion, and the misfit of the law they are fitted to.

    Each basis flow is put on the grid, its free motion taken, and the coefficients of its degree
    are the least-squares solution over the basis. With exact hydrodynamics the misfit vanishes, so
    it measures the error of the discretisation (largest absolute difference, unit derivatives).

    A sphere has no axis: U = u + q0 Lap u and Omega = w/2, and the other coefficients are exact
    zeros, which the motion then leaves out (Lap w = 0 in a Stokes flow).
    """
    # Cylindrical components of a cubic flow hold modes up to 4: eight nodes keep 0 and 1 clean.
    grid = functional.on_grid(8)
    d = np.array([0.0, 0.0, 1.0])
    fits: list[Array] = []
    misfit = 0.0
    for degree, terms_of in ((1, _linear_terms), (2, _quadratic_terms), (3, _cubic_terms)):
        tensors = stokes_polynomials(degree)
        velocity = tensors
        for _ in range(degree):
            # The first contraction meets every point, the later ones follow point by point.
            path = "n...j,xj->nx..." if velocity is tensors else "nx...j,xj->nx..."
            velocity = np.einsum(path, velocity, grid.points)
        motion = np.einsum("axj,nxj->na", grid.weights, velocity / math.factorial(degree))
        known, terms = terms_of(tensors, d)
        measured = (motion[:, :3] if degree == 2 else motion[:, 3:]) - known
        matrix = np.moveaxis(terms, 0, -1).reshape(-1, len(terms))
        free = slice(None)
        if functional.grid.shape.symmetry == "sphere":
            free = slice(1 if degree == 2 else 0)
        solution = np.zeros(len(terms))
        solution[free] = np.linalg.lstsq(matrix[:, free], measured.ravel(), rcond=None)[0]
        misfit = max(misfit, float(np.max(np.abs(matrix @ solution - measured.ravel()))))
        fits.append(solution)
    return FaxenCoefficients(float(fits[0][0]), fits[1], fits[2]), misfit


def _linear_terms(a: Array, d: Array) -> tuple[Array, Array]:
    """Half the vorticity (n, 3), and the term of lambda (1, n, 3), of gradients (n, 3, 3)."""
    strain = 0.5 * (a + a.swapaxes(1, 2))
    return 0.5 * np.einsum("iab,nba->ni", LEVI_CIVITA, a), np.cross(d, strain @ d)[None]


def _quadratic_terms(b: Array, d: Array) -> tuple[Array, Array]:
    """Terms (5, n, 3) of the quadratic coefficients, of second derivatives (n, 3, 3, 3)."""
    laplacian = np.einsum("nijj->ni", b)
    along = b @ d @ d
    gradient = np.einsum("njki,j,k->ni", b, d, d)
    terms = [laplacian, along, np.outer(laplacian @ d, d), np.outer(along @ d, d), gradient]
    return np.zeros_like(along), np.stack(terms)


def _cubic_terms(c: Array, d: Array) -> tuple[Array, Array]:
    """Terms (4, n, 3) of the cubic coefficients, of third derivatives (n, 3, 3, 3, 3)."""
    along = c @ d @ d
    laplacian = np.einsum("nijkk->nij", c)
    spin = np.einsum("iab,nba->ni", LEVI_CIVITA, along)

    def turn(gradient: Array) -> Array:
        return np.cross(d, 0.5 * (gradient + gradient.swapaxes(1, 2)) @ d)

    terms = [spin, np.outer(spin @ d, d), turn(laplacian), turn(along)]
    return np.zeros_like(spin), np.stack(terms)
