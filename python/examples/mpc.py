"""Model predictive control of steering and speed with CasADi, past our law.

The model is the paper's kinematic limit with a lag of the servo; P follows the paper's circle.
``pip install singletrack[mpc]``; the target is the only argument.
"""

import math
import sys
import time

import casadi
import numpy as np

import singletrack
from singletrack import model

HORIZON, STEP, LAG = 12, 0.08, 0.06
DISTANCE, RATE = 0.35, 0.5
VEHICLE = model.Vehicle()


def controller() -> casadi.Opti:
    """The problem: parameters ``start`` (x, y, yaw, steering) and ``wanted`` (2, horizon)."""
    opti = casadi.Opti()
    states, inputs = opti.variable(4, HORIZON + 1), opti.variable(2, HORIZON)
    start, wanted, last = opti.parameter(4), opti.parameter(2, HORIZON), opti.parameter(2)

    def derivative(s: casadi.MX, u: casadi.MX) -> casadi.MX:
        beta = casadi.atan(VEHICLE.rear_axle_distance_m / VEHICLE.wheelbase_m * casadi.tan(s[3]))
        return casadi.vertcat(
            u[1] * casadi.cos(s[2] + beta),
            u[1] * casadi.sin(s[2] + beta),
            u[1] * casadi.cos(beta) * casadi.tan(s[3]) / VEHICLE.wheelbase_m,
            (u[0] - s[3]) / LAG,
        )

    cost = 0
    opti.subject_to(states[:, 0] == start)
    for k in range(HORIZON):
        s, u = states[:, k], inputs[:, k]
        k1 = derivative(s, u)
        k2 = derivative(s + STEP / 2 * k1, u)
        opti.subject_to(states[:, k + 1] == s + STEP * k2)
        s = states[:, k + 1]
        course = s[2] + s[3]
        point = casadi.vertcat(
            s[0] + VEHICLE.front_axle_distance_m * casadi.cos(s[2]) + DISTANCE * casadi.cos(course),
            s[1] + VEHICLE.front_axle_distance_m * casadi.sin(s[2]) + DISTANCE * casadi.sin(course),
        )
        change = u - (inputs[:, k - 1] if k else last)
        cost += casadi.sumsqr(point - wanted[:, k]) + 0.02 * casadi.sumsqr(change)
    opti.subject_to(opti.bounded(-0.42, inputs[0, :], 0.42))
    opti.subject_to(opti.bounded(0.0, inputs[1, :], 1.2))
    opti.minimize(cost)
    opti.solver("sqpmethod", {
        "qpsol": "qrqp",
        "qpsol_options": {"print_iter": False, "print_header": False, "error_on_fail": False},
        "print_header": False, "print_iteration": False, "print_status": False,
        "print_time": False, "max_iter": 4, "error_on_fail": False,
    })  # fmt: skip
    return opti.to_function(
        "mpc", [start, wanted, last, opti.x], [inputs, opti.x], ["start", "wanted", "last", "guess"],
        ["inputs", "solution"],
    )  # fmt: skip


def main(target: str = "sim", seconds: float = 15.0) -> float:
    """Drives; returns the root mean square of the distance from the reference, in m."""
    solve = controller()
    guess, last = np.zeros(solve.size1_in("guess")), np.zeros(2)
    errors, times = [], []
    with singletrack.Car(target).drive() as drive:
        for state in drive:
            now = state.drive_time or 0.0
            ahead = RATE * (now + STEP * np.arange(1, HORIZON + 1))
            wanted = np.stack([np.cos(ahead) - 1.0, np.sin(ahead)])
            began = time.perf_counter()
            inputs, guess = solve(
                [state.x, state.y, state.yaw, state.steering], wanted, last, guess
            )
            times.append(time.perf_counter() - began)
            last = np.array(inputs)[:, 0]
            last = np.clip(last, [-0.42, 0.0], [0.42, 1.2])
            drive.actuate(float(last[0]), float(last[1]))
            if now > 4.0:
                x, y = math.cos(RATE * now) - 1.0, math.sin(RATE * now)
                errors.append(math.dist(state.point, (x, y)))
            if now > seconds:
                break
    rms = math.sqrt(sum(error**2 for error in errors) / len(errors))
    print(f"rms {1e3 * rms:.1f} mm; solved in {1e3 * np.median(times):.1f} ms (median)")
    return rms


if __name__ == "__main__":
    main(*sys.argv[1:2])
