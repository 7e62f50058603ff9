"""Effects on a stone besides its friction law: gravity on ice that is not level, air
drag, and changes of the friction during the throw."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from curlfit.stone import GRAVITY

AIR_DENSITY = 1.27  # kg/m^3, dry air at 5 degrees C and 1013 hPa
FRONTAL_AREA = 0.914 / math.pi * 0.114
"""m^2; circumference at most 36 in (0.914 m), height at least 4.5 in (0.114 m): The
Rules of Curling (World Curling), R2(a)"""
WEAR_KNOTS = (0.0, 10.0, 20.0, 30.0)  # m along the throw


@dataclass(frozen=True)
class Environment:
    """Effects on a stone besides its friction law; none by default, on level ice.

    Attributes
    ----------
    slope_x, slope_y : downward slope of the ice toward +x (to the right) and +y (along
        the sheet), in m per m: gravity accelerates the stone by g times the slope.
    drag : drag coefficient of the stone in still air, for the cross section
        `FRONTAL_AREA`; about 0.8 for a short cylinder.
    wear : relative change of the friction per metre along the throw from
        its start, 1/m.
    wear_10, wear_20, wear_30 : additional relative change of the friction at 10, 20
        and 30 m along the throw; interpolated by a natural cubic spline that is 0
        at the start.
    sweep : friction relative to that on unswept ice, for swept_from < t <=
        swept_to, in s on the clock of the throw. The distribution of the load on
        the ring does not change.
    """

    slope_x: Any = 0.0
    slope_y: Any = 0.0
    drag: Any = 0.0
    wear: Any = 0.0
    sweep: Any = 1.0
    swept_from: Any = math.inf
    swept_to: Any = math.inf
    wear_10: Any = 0.0
    wear_20: Any = 0.0
    wear_30: Any = 0.0

    def gravity_along(self, s: Any, c: Any) -> tuple[Any, Any]:
        """Acceleration due to gravity, to the right of a heading and along it, m/s^2.

        Parameters
        ----------
        s, c : sine and cosine of the heading, from +y toward +x.
        """
        right = c * self.slope_x - s * self.slope_y
        along = s * self.slope_x + c * self.slope_y
        return GRAVITY * right, GRAVITY * along

    def wear_along(self) -> tuple[Any, Any, Any, Any, Any]:
        """Relative change of the friction along the throw: its slope at the start, 1/m,
        and one sixth of the jumps of its third derivative at the knots, 1/m^3.

        The second derivatives M of the natural spline at the inner knots, h apart,
        satisfy M_(i-1) + 4 M_i + M_(i+1) = 6 (w_(i-1) - 2 w_i + w_(i+1))/h^2.
        """
        h = WEAR_KNOTS[1] - WEAR_KNOTS[0]
        bend_10 = 6 * (-2 * self.wear_10 + self.wear_20) / h**2
        bend_20 = 6 * (self.wear_10 - 2 * self.wear_20 + self.wear_30) / h**2
        m_10, m_20 = (4 * bend_10 - bend_20) / 15, (4 * bend_20 - bend_10) / 15
        thirds = (0.0, m_10 / h, (m_20 - m_10) / h, -m_20 / h, 0.0)
        first, second, third, last = (
            (after - before) / 6 for before, after in pairwise(thirds)
        )
        slope = self.wear + self.wear_10 / h - h * m_10 / 6
        return slope, first, second, third, last

    def drag_rate(self, m: Any) -> Any:
        """Deceleration by air drag divided by the squared speed, 1/m, for a stone
        of mass `m`."""
        return 0.5 * AIR_DENSITY * FRONTAL_AREA / m * self.drag
