"""Findings of the studies of the paper, as records that can be imported without JAX."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from curlfit.inference.fit.result import FitResult
from curlfit.numerics.arrays import Booleans, Floats
from curlfit.paper.printed import EQ_28

if TYPE_CHECKING:
    from curlfit.paper.ring_states import RingStates

RADIUS = 0.065
"""Ring radius of sect. 4, m; the 0.032 of eq. 17 corresponds to it."""

NAMES = ("mu1_xi", "mu2_xi", "mu1_eta + mu2_eta")

PRINTED: Floats = np.array([EQ_28[name] for name in NAMES])

HALF_DIGIT: Floats = np.array([0.00005, 0.0005, 0.0005])
"""Half a unit of the last printed digit of each."""


SHOWN = {
    "eq14": ("path",), "prop5": ("path",), "eq28": ("eq28",), "isotropic": ("isotropic",),
    "eq24": ("ring",), "split": ("ring", "eq28"),
}  # fmt: skip
"""The studies whose findings each figure shows, by file name."""


@dataclass(frozen=True)
class Kinematics:
    """Motion by eq. 12 at times of shape (n,).

    t in s; speed in m/s; spin in rad/s, heading from +y toward +x in rad; xi, eta in m/s^2 are the
    acceleration to the right of the motion and along it (left sides of eq. 24); angular in rad/s^2.
    """

    t: Floats
    speed: Floats
    heading: Floats
    spin: Floats
    xi: Floats
    eta: Floats
    angular: Floats

    def epsilon(self, radius: float) -> Floats:
        """`R omega/v`, for a ring radius in m."""
        return radius * self.spin / self.speed

    def until(self, time: float) -> Kinematics:
        """The rows with t <= `time`."""
        rows = self.t <= time + 1e-9
        return Kinematics(**{name: values[rows] for name, values in vars(self).items()})


@dataclass(frozen=True)
class PathFindings:
    """Properties of eq. 12.

    Attributes
    ----------
    motion : by eq. 12, every 0.1 s on 0..20 s. printed, wrong_sign : with eq. 14 as printed, and
    with its wrong sign alone.
    start : dx/dt, dy/dt (m/s) and omega (1/s) at t = 0. end : x, y (m) and turns at t = 23 s.
    x_form : c, k, p of `d2x/dt2 = -(c + k (1 - t/23)^p)`, in m/s^2, m/s^2, 1.
    y_form : k, p of `d2y/dt2 = -k (1 - t/23)^p`. by_hand : largest relative difference between
    derivatives by JAX and by hand. sign_change : time in s at which d2x/dt2 changes sign.
    ax, ay, ax_printed, ay_printed : d2x/dt2 and d2y/dt2 in m/s^2, correct and as printed.
    bound_form : coefficient and exponents of `R omega/(dy/dt)`, the bound of eq. 17.
    ice_slope : at each time, the largest dx(A)/dy(A) on the ring, in the ice frame.
    slope : the same in the moving frame, v_xi(A)/v_eta(A).
    """

    motion: Kinematics
    printed: Kinematics
    wrong_sign: Kinematics
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    x_form: tuple[float, float, float]
    y_form: tuple[float, float]
    by_hand: float
    sign_change: float
    ax: Floats
    ay: Floats
    ax_printed: Floats
    ay_printed: Floats
    bound_form: tuple[float, float, float]
    ice_slope: Floats
    slope: Floats

    @property
    def ratio(self) -> Floats:
        """a_xi/a_eta of the trajectory."""
        return self.motion.xi / self.motion.eta

    @property
    def limit(self) -> Floats:
        """`eps/sqrt(1 - eps^2)`: the bound of isotropic friction on that ratio."""
        epsilon = self.motion.epsilon(RADIUS)
        return epsilon / np.sqrt(1 - epsilon**2)


@dataclass(frozen=True)
class DeviationCounts:
    """Numbers of states by their deviation.

    Attributes
    ----------
    states : with a consistent load. left : of these, deviating to the left for counter-clockwise
    spin. slow, slow_left : the same for |epsilon| < 1, where the instant centre of velocities lies
    outside the base. speeds_up : states with T_eta > 0. remark : deviating to the left with
    n1 > 0, n2 < 0 (n1 mirrored for clockwise spin), T_eta > 0 and the rotation slowing.
    range : smallest and largest force to the right over the weight.
    """

    states: int
    left: int
    slow: int
    slow_left: int
    speeds_up: int
    remark: int
    range: tuple[float, float]

    @classmethod
    def of(cls, states: RingStates, where: Booleans | None = None) -> DeviationCounts:
        """Counts of the existing states, or of those in `where`."""
        use = states.exists if where is None else states.exists & where
        left, slow = use & (states.right < 0), use & (states.epsilon < 1)
        speeds_up = use & (states.t_eta > 0)
        tilted = (states.n1 * np.sign(states.omega) > 0) & (states.n2 < 0)
        remark = left & speeds_up & tilted & (states.spin_up * states.omega < 0)
        return cls(
            states=int(use.sum()),
            left=int(left.sum()),
            slow=int(slow.sum()),
            slow_left=int((slow & left).sum()),
            speeds_up=int(speeds_up.sum()),
            remark=int(remark.sum()),
            range=(float(states.right[use].min()), float(states.right[use].max())),
        )


@dataclass(frozen=True)
class Example:
    """A state with the exceptional deviation to the left.

    Coefficients by name; v in m/s, omega in 1/s; forces to the right and forward over the weight;
    least is the smallest coefficient of friction on the ring.
    """

    coefficients: dict[str, float]
    v: float
    omega: float
    t_xi: float
    t_eta: float
    least: float


@dataclass(frozen=True)
class Curve:
    """Force over weight against spin at 2 m/s: omega in 1/s, t_xi, t_eta, and smallest mu.

    The label is LaTeX except for the word mu.
    """

    label: str
    omega: Floats
    t_xi: Floats
    t_eta: Floats
    least: Floats


@dataclass(frozen=True)
class IsotropicFindings:
    """Results on the grids.

    Attributes
    ----------
    laws : number of local laws tested for Prop. 1. triple_states : number of their states.
    orthogonality : largest |cos| of the angle between T and M_N. handedness : smallest
    (T x M_N).k/(|T| |M_N|), 1 for a right-handed triple. arm : largest relative difference of |M_N|
    and h |T|.
    coulomb : Prop. 2. power : Prop. 3 for powers of the speed, by exponent. mixture : Prop. 3 for
    non-monotonic functions. mixture_example, power_example : deviations to the left.
    stribeck : Prop. 4, by case, where mu > 0 on the whole ring. negative : the same where mu < 0
    somewhere on it. stribeck_example : of case (ii), mu > 0.
    curves : for the figure.
    """

    laws: int
    triple_states: int
    orthogonality: float
    handedness: float
    arm: float
    coulomb: DeviationCounts
    power: dict[float, DeviationCounts]
    power_example: Example
    mixture: DeviationCounts
    mixture_example: Example
    stribeck: dict[str, DeviationCounts]
    negative: dict[str, DeviationCounts]
    stribeck_example: Example
    curves: tuple[Curve, ...]

    @property
    def power_total(self) -> tuple[int, int, int]:
        """States, states with |epsilon| < 1, and deviations to the left, over all exponents."""
        all_counts = self.power.values()
        return (
            sum(one.states for one in all_counts),
            sum(one.slow for one in all_counts),
            sum(one.left for one in all_counts),
        )


@dataclass(frozen=True)
class Expansion:
    """A first-order form compared with the ring.

    Attributes
    ----------
    epsilon : shape (n,). gap : largest relative difference of T_xi, T_eta, M at each epsilon, over
    the coefficients taken one at a time, shape (n, 3). order : power of epsilon with which each
    decreases, shape (3,); NaN where the gap is rounding error.
    """

    epsilon: Floats
    gap: Floats
    order: Floats

    @property
    def largest(self) -> float:
        """Largest gap at the first epsilon, 0.1."""
        return float(self.gap[0].max())


@dataclass(frozen=True)
class RingFindings:
    """Results of the ring integrals.

    Attributes
    ----------
    eq_22_gap : largest difference of eq. 22 from the radial law, over the largest coefficient.
    load_errors : relative errors of T_xi, T_eta, M under uniform load, shape (radii, 3).
    radial, front_back : eq. 23 and the right sides of eq. 27 compared with the ring.
    closed_gap : largest distance (m) and angle (rad) between eq. 27 in closed form and integrated
    numerically, t <= 20 s. ring_gap : the same between eq. 27 and the full ring.
    t : s. l1, l2, l3 : combinations that solve eq. 24 at each time, shape (n,).
    rank : of eq. 24 with respect to the four unknowns, and with l1, l2, l3 as further rows.
    l1_zero : time in s at which l1 changes sign, or None. l1_ratio : rho/R beyond which it does not
    on t <= 20 s. l3_largest : for such stones. greatest_epsilon : on t <= 20 s.
    radial_fit : the radial law fitted with coefficients of either sign; radial_l its l1, l2, l3.
    split_epsilon : values examined. split_uniform : largest relative change of T_xi, T_eta, M at
    each when mu1_eta and mu2_eta are exchanged, uniform load. split_consistent : relative change of
    T_eta, consistent load.
    """

    eq_22_gap: float
    load_errors: Floats
    radial: Expansion
    front_back: Expansion
    closed_gap: tuple[float, float]
    ring_gap: tuple[float, float]
    t: Floats
    l1: Floats
    l2: Floats
    l3: Floats
    rank: tuple[int, int]
    l1_zero: float | None
    l1_ratio: float
    l3_largest: float
    greatest_epsilon: float
    radial_fit: FitResult
    radial_l: tuple[float, float, float]
    split_epsilon: Floats
    split_uniform: Floats
    split_consistent: Floats


class Row(NamedTuple):
    """Eq. 28 computed by one method."""

    method: str
    radius: float
    rho: float
    window: float
    mu: Floats
    """mu1_xi, mu2_xi, mu1_eta + mu2_eta"""


def coefficients_of(result: FitResult) -> Floats:
    """mu1_xi, mu2_xi, mu1_eta + mu2_eta of a fit of the front-back law."""
    mu = {name: result.parameters[name].value for name in result.coefficients}
    return np.array([mu["mu1_xi"], mu["mu2_xi"], mu["mu1_eta"] + mu["mu2_eta"]])


@dataclass(frozen=True)
class Uncertainty:
    """Posterior of eq. 28 when R and rho vary within their printed rounding.

    Attributes
    ----------
    radius, rho : draws in m, shape (n,). mu : draws of the three coefficients, shape (n, 3).
    interval : 95 % intervals, shape (3, 2). noise : the standard error at R = 0.054 m,
    rho = 0.1 m, entirely from the residuals, shape (3,).
    preference : difference in chi-squared between the best and the worst stone in the range.
    positive : share of the draws without bounds in which all coefficients are positive.
    free_interval : 95 % intervals of these unbounded draws. effective : effective sample size.
    check : largest error of the interpolation at stones between the nodes, in standard errors.
    share : fraction of the draws that round to all three printed numbers. nearest : the radius and
    rho within the ranges whose coefficients are nearest to the printed ones; nearest_mu : these
    coefficients.
    """

    radius: Floats
    rho: Floats
    mu: Floats
    interval: Floats
    noise: Floats
    preference: float
    positive: float
    free_interval: Floats
    effective: float
    check: float
    share: float
    nearest: tuple[float, float]
    nearest_mu: Floats

    @property
    def covered(self) -> Booleans:
        """Whether each interval overlaps the printed value within its rounding."""
        low, high = self.interval.T
        return (low <= PRINTED + HALF_DIGIT) & (high >= PRINTED - HALF_DIGIT)


@dataclass(frozen=True)
class Eq28Findings:
    """Reproductions of eq. 28.

    Attributes
    ----------
    rows : results of the methods, in the order of the table. fit : of the trajectory with the
    printed stone. solid : the same with the radius of gyration of a solid cylinder.
    uncertainty : over R and rho.
    """

    rows: tuple[Row, ...]
    fit: FitResult
    solid: FitResult
    uncertainty: Uncertainty

    @property
    def ratio(self) -> tuple[float, float]:
        """Mean transversal over mean tangential coefficient, for the printed stone and `solid`."""
        mu, other = coefficients_of(self.fit), coefficients_of(self.solid)
        return float((mu[0] + mu[1]) / mu[2]), float((other[0] + other[1]) / other[2])
