"""What data say of a parameter, in one word."""

from __future__ import annotations

from enum import StrEnum


class Verdict(StrEnum):
    """What the data say of a parameter or of a quantity derived from some.

    A verdict is its word: it compares equal to it, and records are written with it.

    Examples
    --------
    >>> fit["mu1_eta"].verdict
    'not identifiable'
    >>> fit["mu1_eta"].verdict.is_known
    False
    """

    DETERMINED = "determined"
    """its standard error is below half of the parameter's typical size"""
    PRIOR = "prior"
    """determined, but not without the priors"""
    WEAK = "weak"
    """its standard error is larger, or the values that fit lie on a curve"""
    NOT_IDENTIFIABLE = "not identifiable"
    """other values fit as well"""
    AT_BOUND = "at bound"
    """the data favour values beyond it"""
    FIXED = "fixed"
    """held, not fitted"""

    def __repr__(self) -> str:
        return repr(self.value)

    @property
    def is_free(self) -> bool:
        """Whether the parameter was fitted."""
        return self != Verdict.FIXED

    @property
    def is_known(self) -> bool:
        """Whether there is a standard error to rely on."""
        return self in (Verdict.DETERMINED, Verdict.PRIOR)

    @property
    def is_left_open(self) -> bool:
        """Whether another measurement might tell what these data leave open."""
        return self in (Verdict.WEAK, Verdict.NOT_IDENTIFIABLE)
