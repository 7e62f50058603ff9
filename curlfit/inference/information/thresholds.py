"""From which singular value, share of a direction or error on something is called weak
or unknown.

Singular values are of rows in typical sizes of the parameters: s means that a direction
is known to 1/s typical sizes. Errors are in typical sizes, or factors between errors.
"""

from __future__ import annotations

import math

UNSEEN = 1e-3
"""Singular value below which a direction is not determined: known to no better than a
thousand typical sizes."""
LOOSE = 1.0
"""Singular value below which a direction is known to no better than typical sizes."""
NO_PART = 1e-3
"""Share of a direction below which a parameter takes no part in it."""
LITTLE_PART = 0.05
"""The same for a direction that is loosely determined."""
UNKNOWN = 3.0
"""Typical sizes from an estimate, beyond which nothing is known in any case."""
WEAK_ERROR = 0.5
"""Standard error over typical size, from which an estimate is weakly determined: a 95 %
interval then reaches a typical size to either side."""
LITTLE = math.sqrt(2.0)
"""Factor up to which an error along the ridge is about that at the optimum."""
STRETCHED = 2.0
"""Factor by which the error of a sum or a derived quantity may be larger along the
ridge than at the optimum, so that it is still determined ..."""
WIDE = 0.25
"""... or this error over the typical size, up to which it is determined even then."""
FAR_LESS = 4.0
"""Error at a point of the ridge over that at the optimum, above which far less is known
there: nothing of a force of the spin, where a stone may not have spun."""
INTERVAL = 6.63
"""Rise of chi squared at the ends of a 99 % interval, of one degree of freedom: values
within it fit nearly as well."""
CONVERGED = 0.01
"""Distance to the optimum, in standard errors, at which a fit has converged."""
