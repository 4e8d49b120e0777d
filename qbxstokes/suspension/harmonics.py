"""Real spherical harmonics of even degree: products with x_i x_j and rotations as sparse matrices.

A distribution psi(p) = sum c_lm Y_lm(p) on the sphere of axes p (orthonormal Y_lm with the phase of
Condon and Shortley), even in p, has even l, and c_{l,-m} = (-1)^m conj(c_lm) as it is real. It is
held as real numbers: c_l0, and Re c_lm, Im c_lm for m > 0. All matrix elements are algebraic; no
integral is computed:

    z Y_lm        = A(l+1,m) Y_{l+1,m} + A(l,m) Y_{l-1,m},       A(l,m)^2 = (l^2-m^2)/(4l^2-1)
    (x + iy) Y_lm = -B(l+1,m+1) Y_{l+1,m+1} + B(l,-m) Y_{l-1,m+1}, B(l,m)^2 = (l+m)(l+m-1)/(4l^2-1)

(NIST DLMF, section 14.30; A. R. Edmonds 1957, Angular Momentum in Quantum Mechanics, chapter 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.geometry.symmetric import PAIRS, PLACES
from qbxstokes.typing import Array, ComplexArray, Integers

Sparse = Any  # scipy.sparse.csr_array


@dataclass(frozen=True)
class Harmonics:
    """The real basis of even degrees up to `degree`; step 2 keeps even orders m alone.

    Even orders suffice where the polar axis is a principal axis of the strain rate, and the
    vorticity along it.
    """

    degree: int
    step: int = 1

    @cached_property
    def _complex(self) -> tuple[Integers, Integers]:
        """Degrees and orders (n,) of the complex coefficients."""
        l_values: list[int] = []
        m_values: list[int] = []
        for degree in range(0, self.degree + 1, 2):
            orders = range(-degree, degree + 1, self.step)
            l_values += [degree] * len(orders)
            m_values += orders
        return np.array(l_values, dtype=np.int64), np.array(m_values, dtype=np.int64)

    @property
    def size(self) -> int:
        """How many numbers hold a distribution."""
        return len(self._complex[0])

    @cached_property
    def degrees(self) -> Integers:
        """Degree l (n,) of each real number."""
        return self._complex[0]

    def index(self, degrees: Integers, orders: Integers) -> Integers:
        """Place of the complex coefficients of these degrees and orders."""
        # Degrees 0, 2, .. l - 2 hold sum (2 j + 1) or sum (j + 1) coefficients.
        half = degrees // 2
        before = half * (2 * half - 1) if self.step == 1 else half * half
        return np.asarray(before + (orders + degrees) // self.step)

    @cached_property
    def _unitary(self) -> tuple[Sparse, Sparse]:
        """From complex to real coefficients, and back."""
        degrees, orders = self._complex
        here, there = self.index(degrees, orders), self.index(degrees, -orders)
        sign = np.where(orders % 2, -1.0, 1.0)
        positive, negative, zero = orders > 0, orders < 0, orders == 0
        # Re c_m = (c_m + s c_-m)/2 at m > 0 and Im c_m = (c_m - s c_-m)/(2i) at -m.
        rows = [here[zero], here[positive], here[positive], there[positive], there[positive]]
        columns = [here[zero], here[positive], there[positive], here[positive], there[positive]]
        s = sign[positive]
        one = np.ones(len(s))
        values = [np.ones(int(zero.sum())), 0.5 * one, 0.5 * s, -0.5j * one, 0.5j * s]
        to_real = self._sparse(rows, columns, values)
        # c_m = Re + i Im, c_-m = s (Re - i Im).
        n, minus = here[negative], there[negative]
        rows = [here[zero], here[positive], here[positive], n, n]
        columns = [here[zero], here[positive], there[positive], minus, n]
        t = sign[negative]
        values = [np.ones(int(zero.sum())), one, 1j * one, t, -1j * t]
        return to_real, self._sparse(rows, columns, values)

    def _sparse(self, rows: list[Any], columns: list[Any], values: list[Any]) -> Sparse:
        """The matrix of pieces of rows, columns and values."""
        from scipy.sparse import csr_array

        places = np.concatenate(rows), np.concatenate(columns)
        return csr_array((np.concatenate(values), places), shape=(self.size, self.size))

    def real_matrix(self, matrix: Sparse) -> Sparse:
        """The matrix on real coefficients of one on complex coefficients that keeps psi real."""
        to_real, to_complex = self._unitary
        return (to_real @ matrix @ to_complex).real

    def _matrix(self, shift: int, values: dict[int, Array]) -> Sparse:
        """Matrix of an operator that maps Y_lm to sum of values[d] Y_{l+d, m+shift}."""
        degrees, orders = self._complex
        rows, columns, entries = [], [], []
        for change, value in values.items():
            new, order = degrees + change, orders + shift
            inside = (new >= np.abs(order)) & (new <= self.degree) & (new >= 0)
            rows.append(self.index(new[inside], order[inside]))
            columns.append(self.index(degrees[inside], orders[inside]))
            entries.append(value[inside])
        return self._sparse(rows, columns, entries)

    @cached_property
    def products(self) -> tuple[Sparse, Sparse, Sparse]:
        """Matrices on complex coefficients of z^2, (x + iy)^2 and z (x + iy), truncated.

        The last one is empty where only even orders are kept.
        """
        degrees, orders = (values.astype(np.float64) for values in self._complex)

        def a(degree: Array, order: Array) -> Array:
            return _root((degree**2 - order**2) / (4.0 * degree**2 - 1.0))

        def b(degree: Array, order: Array) -> Array:
            return _root((degree + order) * (degree + order - 1.0) / (4.0 * degree**2 - 1.0))

        n, m = degrees, orders
        below, above, up, down = a(n, m), a(n + 1, m), -b(n + 1, m + 1), b(n, -m)
        twice_z = {2: above * a(n + 2, m), 0: above**2 + below**2, -2: below * a(n - 1, m)}
        twice_x = {
            2: -up * b(n + 2, m + 2),
            0: up * b(n + 1, -m - 1) - down * b(n, m + 2),
            -2: down * b(n - 1, -m - 1),
        }
        mixed = {
            2: up * a(n + 2, m + 1),
            0: up * a(n + 1, m + 1) + down * a(n, m + 1),
            -2: down * a(n - 1, m + 1),
        }
        if self.step > 1:
            mixed = {0: np.zeros_like(n)}
        last = self._matrix(1 if self.step == 1 else 0, mixed)
        return self._matrix(0, twice_z), self._matrix(2, twice_x), last

    def quadratic(self, form: Array) -> Sparse:
        """Product with p.F.p for a symmetric form F (3, 3), on complex coefficients."""
        from scipy.sparse import eye_array

        zz, xx, zx = self.products
        mean = 0.5 * (form[0, 0] + form[1, 1])
        twist = 0.25 * (form[0, 0] - form[1, 1]) - 0.5j * form[0, 1]
        lean = form[0, 2] - 1j * form[1, 2]
        found = mean * eye_array(self.size) + (form[2, 2] - mean) * zz
        found = found + twist * xx + np.conj(twist) * xx.T
        if self.step == 1:
            found = found + lean * zx + np.conj(lean) * zx.T
        return found.tocsr()

    def rotation(self, rate: Array) -> Sparse:
        """-(w x p).grad for an angular velocity w (3,), that is -i w.L, on complex coefficients."""
        degrees, orders = (values.astype(np.float64) for values in self._complex)
        along = self._matrix(0, {0: -1j * rate[2] * orders})
        if self.step > 1 or not (rate[0] or rate[1]):
            return along
        raise_order = self._matrix(1, {0: np.sqrt((degrees - orders) * (degrees + orders + 1.0))})
        across = (rate[0] - 1j * rate[1]) * raise_order + (rate[0] + 1j * rate[1]) * raise_order.T
        return (along - 0.5j * across).tocsr()

    def drift(self, strain: Array) -> Sparse:
        """psi -> -div(psi grad V), V = p.E.p/2 on the sphere, on complex coefficients.

        From lap(psi V) = V lap psi + 2 grad psi.grad V + psi lap V and lap V = -6 V:
        <l'm'|div(psi grad V)|lm> = (1/2) [l(l+1) - l'(l'+1) - 6] <l'm'|V|lm>.
        """
        potential = self.quadratic(0.5 * strain).tocoo()
        degrees = self._complex[0]
        to, of = degrees[potential.coords[0]], degrees[potential.coords[1]]
        potential.data = potential.data * (-0.5 * (of * (of + 1.0) - to * (to + 1.0) - 6.0))
        return potential.tocsr()

    def moments(self, real: Array) -> tuple[Array, Array]:
        """<pp> (..., 3, 3) and <pppp> (..., 3, 3, 3, 3) of distributions (n, ...)."""
        low = Harmonics(min(4, self.degree), self.step)
        of = low._unitary[1] @ np.reshape(real, (self.size, -1))[: low.size]
        second, fourth = _moment_rows(low.degree, self.step)
        lead = np.shape(real)[1:]
        two = (second @ of).real
        four = (fourth.reshape(-1, fourth.shape[-1]) @ of).real.reshape(6, 6, -1)
        pairs = np.moveaxis(two[PLACES], -1, 0)
        whole = np.moveaxis(four[PLACES[:, :, None, None], PLACES], -1, 0)
        return pairs.reshape(*lead, 3, 3), whole.reshape(*lead, 3, 3, 3, 3)


def _root(square: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _moment_rows(degree: int, step: int) -> tuple[ComplexArray, ComplexArray]:
    """Rows (6, n) and (6, 6, n) on complex coefficients of the means of x_i x_j and their products.

    <f> = int psi f dp = sqrt(4 pi) <00| f |psi>.
    """
    basis = Harmonics(degree, step)
    forms = []
    for i, j in PAIRS:
        form = np.zeros((3, 3))
        form[i, j] = form[j, i] = 1.0 if i == j else 0.5
        forms.append(basis.quadratic(form).toarray())
    quadratic = np.stack(forms)
    first = np.sqrt(4.0 * np.pi) * quadratic[:, 0, :]
    return first, np.einsum("ak,bkn->abn", first, quadratic)
