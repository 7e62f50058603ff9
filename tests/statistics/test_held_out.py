"""A short run of the coverage of predictions; `held_out.py` makes the table
of a long one."""

from __future__ import annotations

import pytest
from held_out import ASKED, CASES, LEVELS, answers
from scipy.stats import binomtest


@pytest.mark.slow
def test_bands_hold_the_truth_at_least_as_often_as_they_say():
    outcomes = list(answers(CASES[0], 60, seed=7))
    for level, (_, _, nominal, _) in LEVELS.items():
        for kind in ("both", "parameters"):
            for name in ASKED:
                inside = sum(getattr(answer, kind)[level][name] for answer in outcomes)
                # what could not be seen of a wrong law widens the bands of both errors
                sides = "less" if kind == "both" else "two-sided"
                chance = binomtest(inside, len(outcomes), nominal, sides).pvalue
                assert chance > 1e-3, (level, kind, name)


@pytest.mark.slow
def test_bands_of_a_wrong_law_are_wide_enough_within_the_fitted_speeds():
    outcomes = list(answers(CASES[1], 20, seed=7))
    assert all(answer.found for answer in outcomes)
    for name in ("y at 14 s", "y at 17 s", "phi at 17 s"):
        assert sum(answer.both["95 %"][name] for answer in outcomes) >= 17, name
        assert not any(answer.parameters["95 %"][name] for answer in outcomes), name
