"""The surface of a rig's cylinder that is nearest to points, compiled."""

import numba
import numpy as np


@numba.njit(cache=True)
def nearest(points, radius, rim):
    """Of each of N points, (5, N): the depth below the nearest surface, m, the distance from the
    axis, m, radial and vertical component of the normal, and its curvature around the rim, 1/m."""
    result = np.empty((5, len(points)))
    for i in range(len(points)):
        distance = np.sqrt(points[i, 0] ** 2 + points[i, 1] ** 2)
        # From the centre line of the rim:
        outwards, upwards = distance - (radius - rim), points[i, 2] + rim
        over, across, along, bent = max(outwards, upwards), 0.0, 1.0, 0.0
        if outwards > 0.0 and upwards > 0.0:
            over = np.sqrt(outwards**2 + upwards**2)
            across, along, bent = outwards / over, upwards / over, 1.0 / over
        elif outwards > upwards:
            across, along = 1.0, 0.0
        result[0, i] = rim - over
        # On the axis the normal is vertical: any distance will do.
        result[1, i] = distance if distance > 0.0 else 1.0
        result[2, i], result[3, i], result[4, i] = across, along, bent
    return result
