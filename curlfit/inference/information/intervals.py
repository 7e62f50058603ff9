"""Confidence intervals by Student's t."""

from __future__ import annotations


class WithInterval:
    """A value with its standard error and the degrees of freedom of that."""

    value: float
    stderr: float | None
    dof: float | None

    def interval(self, level: float = 0.95) -> tuple[float, float] | None:
        """Confidence interval by Student's t; None where there is no standard error."""
        if self.stderr is None:
            return None
        reach = student_quantile(level, self.dof) * self.stderr
        return self.value - reach, self.value + reach


def student_quantile(level: float, dof: float | None) -> float:
    """Half width, in standard errors, of a two-sided confidence interval at a level.

    Student's t with `dof` degrees of freedom; Gaussian where `dof` is None
    (sigma known).
    """
    from scipy.special import ndtri, stdtrit  # slow to load

    upper = (1 + level) / 2
    return float(ndtri(upper) if dof is None else stdtrit(dof, upper))
