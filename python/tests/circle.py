"""One script for the simulator and for a car: P control on the paper's circle."""

from __future__ import annotations

import math
import sys

import singletrack

RADIUS, RATE, GAIN = 1.0, 0.5, 1.0


def circle(car: singletrack.Car, seconds: float) -> list[float]:
    """Drives; returns the distances of P from the reference, from the third second on."""
    errors = []
    with car.drive() as drive:
        start = None
        for state in drive:
            start = state.t_s if start is None else start
            time = state.t_s - start
            angle = RATE * time
            x, y = RADIUS * math.cos(angle), RADIUS * math.sin(angle)
            px, py = state.point_m
            drive.point_velocity(-RATE * y + GAIN * (x - px), RATE * x + GAIN * (y - py))
            if time > 3.0:
                errors.append(math.hypot(x - px, y - py))
            if time > seconds:
                break
    assert time > seconds, f"ended after {time:.2f} s: {drive.reason}"
    assert drive.state is not None and drive.state.mode in ("ready", "idle"), drive.state
    return errors


if __name__ == "__main__":
    target = sys.argv[1] if len(sys.argv) > 1 else "sim"
    options = {"point": (1.0, 0.0, math.pi / 2)} if target == "sim" else {}
    found = circle(singletrack.Car(target, **options), 20.0)
    mean = math.sqrt(sum(error**2 for error in found) / len(found))
    print(f"{target}: rms {1e3 * mean:.1f} mm, largest {1e3 * max(found):.1f} mm")
