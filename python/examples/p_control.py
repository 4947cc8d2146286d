"""P control of P on a circle about the origin, in ten lines, from where P is.

python p_control.py [SOCKET] [--uncalibrated] drives a simulated car, or that of a daemon.
"""

import math
import sys
from typing import Any

import singletrack

target = sys.argv[1] if len(sys.argv) > 1 else "sim"
options: dict[str, Any] = {"uncalibrated": "--uncalibrated" in sys.argv}
if target == "sim":
    options = {"point": (0.8, 0.0, math.pi / 2)}
with singletrack.Car(target, **options).drive() as drive:
    px, py = next(drive).point_m
    start = math.atan2(py, px)
    for state in drive:
        angle = start + 0.5 * state.drive_time_s
        x, y = 0.8 * math.cos(angle), 0.8 * math.sin(angle)
        px, py = state.point_m
        drive.point_velocity(-0.5 * y + x - px, 0.5 * x + y - py)
        if angle > start + 2 * math.pi:
            break
print(f"P is {1e3 * math.hypot(x - px, y - py):.1f} mm from the reference; {drive.reason}")
