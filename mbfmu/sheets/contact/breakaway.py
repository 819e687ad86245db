"""How long a step may be such that it ends where a bristle breaks away, or where a point that slides stops.

The friction force has a corner where the argument of its outer projection, u = e / d + v / v_r (:mod:`.bristles`),
passes through the unit circle: from inside where a point breaks away, from outside where one that slides comes to rest
or reverses. Implicit methods follow a point that sticks as if its deflection were a function of the load, so that a
step over the corner has a velocity that is wrong. While the point sticks this error decays; after it has broken away,
it remains. With the rate r = v / d + a / v_r of u, where a is the mean acceleration of the last step and v / d counts
only if the point sticks, the corner is at |u + r s| = 1 after the time s. A step is limited to APPROACH_RATIO s, and to
the time in which u changes by LIMIT_MARGIN if that is longer. So some steps approach the corner, and one passes it.
"""

from __future__ import annotations

import numpy as np

from solvers.compiled.kernel import kernel

MAX_DEFLECTION_CHANGE = 0.5  # of a bristle in one step, in deflections d
APPROACH_RATIO = 0.9  # of the time until the corner
LIMIT_MARGIN = 0.01  # change of u in a step that may pass the corner


@kernel
def time_to_corner(uu: float, ur: float, rr: float) -> float:
    """Longest step by the products u . u, u . r and r . r of u and its rate r (1/s), s.

    A point that slides and does not reach the circle is limited to the time of its smallest distance.
    """
    if rr == 0.0 or (uu >= 1.0 and ur >= 0.0):
        return np.inf
    root = np.sqrt(max(ur * ur - rr * (uu - 1.0), 0.0))
    time = (root - ur) / rr if uu < 1.0 else (-root - ur) / rr
    return max(APPROACH_RATIO * time, LIMIT_MARGIN / np.sqrt(rr))


@kernel
def longest_deflecting_step(deflection: float, slip_scale: float, vv: float, aa: float) -> float:
    """Longest step by a point that sticks with the squares ``vv`` and ``aa`` of its slip velocity and of the mean
    acceleration of the last step, s: its deflection changes by MAX_DEFLECTION_CHANGE. A load may exceed the friction
    for a while within a step, and its error does not show that.
    """
    if vv + aa == 0.0 or vv >= 4.0 * slip_scale * slip_scale:
        return np.inf
    change = MAX_DEFLECTION_CHANGE * deflection
    return 2.0 * change / (np.sqrt(vv) + np.sqrt(vv + 2.0 * np.sqrt(aa) * change))
