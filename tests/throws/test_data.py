"""The shipped data and the paper's formula."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import DATA

from curlfit.paper import printed as paper


def test_the_shipped_file_is_eq_12(tmp_path):
    paper.write_jensen_shegelski(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == DATA.read_bytes()


def test_eq_12_starts_and_ends_as_checked():
    # eq. 13 prints 0, 2 m/s, 1 1/s; differentiating eq. 12 gives -0.00028,
    # 2.062, 1.0052
    h = 1e-5
    now = paper.jensen_shegelski(0.0)
    later = paper.jensen_shegelski(h)
    assert float(later.x - now.x) / h == pytest.approx(-0.00028, abs=2e-5)
    assert float(later.y - now.y) / h == pytest.approx(2.062, abs=1e-3)
    assert float(later.phi - now.phi) / h == pytest.approx(1.0052, abs=1e-4)
    end = paper.jensen_shegelski(23.0)
    assert float(end.y) == 25.0
    assert float(end.x) == pytest.approx(-0.84, abs=0.005)
    assert float(end.phi) / (2 * np.pi) == pytest.approx(2.6, abs=0.06)


def test_its_settings(eq12):
    assert len(eq12) == 230
    assert eq12.defaults == {"until": 20, "stone": {"R": 0.054, "rho": 0.1}}
    assert eq12.reference.values == paper.EQ_28
    np.testing.assert_allclose(eq12.x, paper.jensen_shegelski(eq12.t).x, atol=1e-9)
