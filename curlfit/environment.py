"""What acts on a stone besides its law of friction: gravity along ice that is not level, the air,
and what changes the friction on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from curlfit.stone import GRAVITY

AIR_DENSITY = 1.27  # kg/m^3, dry air at 5 degrees C and 1013 hPa
FRONTAL_AREA = 0.914 / math.pi * 0.114
"""m^2; circumference at most 36 in (0.914 m), height at least 4.5 in (0.114 m): The Rules of
Curling (World Curling), R2(a)"""


@dataclass(frozen=True)
class Environment:
    """What acts on a stone besides its law of friction; by default nothing, on level ice.

    Attributes
    ----------
    slope_x, slope_y : fall of the ice toward +x (to the right) and +y (along the sheet), in m per
        m: gravity accelerates the stone by g times the slope.
    drag : drag coefficient of the stone in still air, for its cross section `FRONTAL_AREA`; a short
        cylinder has about 0.8.
    wear : relative change of the friction for each metre along the throw, 1/m, from its start.
    sweep : friction over that of ice that is not swept, for swept_from < t <= swept_to, in s on the
        clock of the throw. The distribution of the load on the ring does not change.
    """

    slope_x: Any = 0.0
    slope_y: Any = 0.0
    drag: Any = 0.0
    wear: Any = 0.0
    sweep: Any = 1.0
    swept_from: Any = math.inf
    swept_to: Any = math.inf

    def gravity_along(self, s: Any, c: Any) -> tuple[Any, Any]:
        """Acceleration by gravity to the right of a heading and along it, m/s^2.

        Parameters
        ----------
        s, c : sine and cosine of the heading, from +y toward +x.
        """
        right = c * self.slope_x - s * self.slope_y
        along = s * self.slope_x + c * self.slope_y
        return GRAVITY * right, GRAVITY * along

    def drag_rate(self, m: Any) -> Any:
        """Deceleration by the air over the square of the speed, 1/m, of a stone of mass `m`."""
        return 0.5 * AIR_DENSITY * FRONTAL_AREA / m * self.drag
