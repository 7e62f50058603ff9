"""Fits say that residuals change where they do, and only there."""

import pytest
from changes import CASES, counts

pytestmark = pytest.mark.slow
THROWS = 20


@pytest.mark.parametrize(
    "title",
    [
        "`fcv1` fitted by `front-back`, noise a tenth",
        "`semi-empirical` fitted by `front-back`, to rest",
        "positions bent as by a lens, 1e-5 to 1e-4 /m^2",
        "friction times v^-0.1 to v^-0.5",
    ],
)
def test_smooth_residuals_are_no_change(title):
    (case,) = [case for case in CASES if case.title == title]
    fitted, doubtful, changed, _ = counts(case, THROWS)
    assert doubtful == fitted == THROWS
    assert changed == 0


@pytest.mark.parametrize(
    "title",
    ["friction times 0.67 to 0.9 for 2 to 6 s", "velocity changes by 0.05 m/s"],
)
def test_changes_are_found_when_they_were(title):
    (case,) = [case for case in CASES if case.title == title]
    _, _, changed, near = counts(case, THROWS)
    assert near == changed
    assert changed > 0.7 * THROWS
