"""Is what the user asks for what the user gets? Tolerance against true error and its estimate.

Random bodies, k log-uniform in [1/50, 50], in random flows: polynomials of degree 1 to 3, or a
stokeslet, rotlet or stresslet at 1.5 to 5 longest semi-axes from the centre. RUNS=200 has so many.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
import pytest
from scenes import examine, random_sample

RUNS = int(os.environ.get("RUNS", 12))


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10])
def test_honesty(tolerance: float, record_property: Callable[[str, object], None]) -> None:
    """No tolerance is missed; estimates are mostly within a factor of 100 of the error."""
    rng = np.random.default_rng(1)
    samples = [random_sample(rng) for _ in range(RUNS)]
    errors, estimates = np.transpose([examine(*sample, tolerance) for sample in samples])
    ratio = estimates / errors
    within = float(np.mean((ratio >= 0.01) & (ratio <= 100.0)))
    told = f"error {errors.max():.1e}, bound {tolerance:.0e}; {np.sum(ratio < 1.0)} estimates below"
    record_property(
        "worst", f"{told}, median ratio {np.median(ratio):.2g}, {within:.0%} within 100"
    )
    assert errors.max() <= tolerance
    assert within > 0.5
