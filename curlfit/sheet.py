"""The sheet of ice: positions of its lines and circles.

Dimensions from The Rules of Curling (World Curling, rule R1), which gives both feet and
metres: 114 ft from tee to tee, 12 ft from tee to hack, 21 ft from tee to hog line, 6 ft
from tee to back line; circles of 6, 4, 2 and 1/2 ft radius; 146 to 150 ft long, at most
16 ft 5 in wide.

Positions along the sheet are measured from the thrower's hack, positions across it from
the centre line, positive to the right.
"""

from __future__ import annotations

FOOT = 0.3048

TEE_TO_TEE = 34.747
TEE_TO_HACK = 3.658
TEE_TO_HOG = 6.401
TEE_TO_BACK = 1.829
HOG_TO_HOG = TEE_TO_TEE - 2 * TEE_TO_HOG  # 21.945 m

LENGTH = 45.720
WIDTH = 5.000
CIRCLES = (1.829, 1.219, 0.610, 0.152)
"""Outer radii of the circles of the house in m, twelve-foot circle to button."""
HOUSE = CIRCLES[0]
STONE_RADIUS = 0.145
"""Outer radius of the stone, m; its circumference is at most 36 in (0.914 m)."""

LINES = {
    "hack": 0.0,
    "back": TEE_TO_HACK - TEE_TO_BACK,
    "tee": TEE_TO_HACK,
    "hog": TEE_TO_HACK + TEE_TO_HOG,
    "centre": TEE_TO_HACK + TEE_TO_TEE / 2,
    "far-hog": TEE_TO_HACK + TEE_TO_TEE - TEE_TO_HOG,
    "far-tee": TEE_TO_HACK + TEE_TO_TEE,
}
"""y of the lines, in m from the hack of the thrower."""
TEE = LINES["far-tee"]
"""y of the far tee, the target."""
END = TEE + TEE_TO_BACK + STONE_RADIUS
"""y beyond which a stone lies entirely past the back line and is out of play."""
