"""Evidence and leave-one-out against samplers, see `samplers.py`."""

from __future__ import annotations

import numpy as np
import pytest
from samplers import CASES, closed_form, fitted, nested, psis

from curlfit.comparison.criteria import log_likelihood
from curlfit.comparison.evidence import log_evidence


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.fitted)
def test_log_evidence_against_nested_sampling(case):
    fit = fitted(case)
    expected, error, _ = nested(fit, seed=1)
    found = log_evidence(fit, sum(log_likelihood(fit).values()))
    assert found == pytest.approx(expected, abs=3 * error)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.fitted)
def test_leave_one_out_against_importance_sampling(case):
    fit = fitted(case)
    found, expected = closed_form(fit), psis(fit, seed=1)
    assert float(expected.pareto_k.max()) < 0.7
    assert found.elpd == pytest.approx(expected.elpd_loo, abs=0.3)
    assert found.stderr == pytest.approx(expected.se, rel=0.02)
    assert found.p_loo == pytest.approx(expected.p_loo, abs=0.3)
    np.testing.assert_allclose(found.left_out, expected.loo_i, atol=0.1)
