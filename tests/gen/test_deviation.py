"""The deviation of the approximate materials, in real renders."""

from __future__ import annotations

import numpy as np
import pytest

from gen.deviation import deviations, relative
from gen.farm import Farm


def test_relative_error() -> None:
    exact = np.array([3.0, 4.0, 0.0], np.float32)
    assert relative(exact * 1.1, exact) == pytest.approx((0.1, 0.1))
    assert relative(exact + np.float32([0, 0, 5]), exact) == pytest.approx((1.0, 1.25))


@pytest.mark.render
def test_narrow_lobes_deviate_little() -> None:
    """As their docstrings say."""
    with Farm(1) as farm:
        substrate, phong = deviations(farm, alphas=(0.05,), speculars=(0.5,), exponents=(100.0,))
    assert substrate.rms["specular"] == pytest.approx(0.021, abs=0.002)
    assert substrate.rms["diffuse"] == pytest.approx(0.13, abs=0.005)
    assert phong.rms["specular"] == pytest.approx(0.033, abs=0.002)
    assert phong.peak["diffuse"] < 1e-5
    assert "13.0" in substrate.line()
