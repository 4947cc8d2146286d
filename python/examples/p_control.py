"""P control of P on the paper's circle, in ten lines; the target is the only argument."""

import math
import sys

import singletrack

target = sys.argv[1] if len(sys.argv) > 1 else "sim"
with singletrack.Car(target).drive() as drive:
    for state in drive:
        angle = 0.5 * state.drive_time
        x, y = math.cos(angle) - 1.0, math.sin(angle)
        px, py = state.point
        drive.point_velocity(-0.5 * math.sin(angle) + x - px, 0.5 * math.cos(angle) + y - py)
        if angle > 2 * math.pi:
            break
print(f"P is {1e3 * math.hypot(x - px, y - py):.1f} mm from the reference; {drive.reason}")
