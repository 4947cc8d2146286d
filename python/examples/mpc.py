"""Model predictive control of P with OSQP: a circle about the origin, cut off by a wall.

Under the law P is two integrators, so that the prediction is linear: a small quadratic program
at every tick. P may not go beyond ``WALL``; the reference does, which begins where P is.
``pip install singletrack[mpc]``; the arguments are those of ``p_control.py``.

Three things of the car count besides the integrators:

- P moves ``LAG`` after its command: the plan begins where P is going to be by then.
- The wheels turn by 0.45 rad at most, so that at 0.4 m/s the velocity of P turns by some
  0.6 rad/s: it can't change faster than by ``AGILITY``.
- Noise brings P beyond a wall that it moves along. The wall is soft, therefore, at a price that
  is above every gain: there is always a plan, and it leads back.
"""

import math
import sys
import time
from typing import Any

import numpy as np
import osqp
from scipy import sparse

import singletrack

HORIZON, STEP, TICK = 20, 0.05, 0.01
RADIUS, RATE, FASTEST, WALL = 0.8, 0.5, 0.8, 0.68
LAG, AGILITY = 0.05, 0.25


class Controller:
    """Velocities of P over the horizon: least distance from the reference, and few changes."""

    def __init__(self) -> None:
        n = HORIZON
        # P after each step is its position plus STEP times the sum of the velocities so far.
        self.sums = STEP * np.tril(np.ones((n, n)))
        self.changes = np.eye(n) - np.eye(n, k=-1)
        weight = self.sums.T @ self.sums + 0.01 * self.changes.T @ self.changes
        # The last variable is the way beyond the wall.
        hessian = np.zeros((2 * n + 1, 2 * n + 1))
        hessian[:-1, :-1] = 2.0 * np.kron(np.eye(2), weight)
        hessian[-1, -1] = 100.0
        # Octagons within the largest speed and the largest change of it, and the wall.
        angles = np.arange(8) * math.pi / 4
        self.sides = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        none = np.zeros((8 * n, 1))
        rows = np.vstack([
            np.hstack([np.kron(self.sides, np.eye(n)), none]),
            np.hstack([np.kron(self.sides, self.changes), none]),
            np.hstack([np.zeros((n, n)), self.sums, -np.ones((n, 1))]),
            np.hstack([np.zeros((1, 2 * n)), [[-1.0]]]),
        ])  # fmt: skip
        within = math.cos(math.pi / 8)
        self.speeds = np.full(8 * n, FASTEST * within)
        self.turns = np.full((8, n), AGILITY * STEP * within)
        self.solver = osqp.OSQP()
        self.solver.setup(
            # OSQP reads the upper half.
            sparse.csc_matrix(np.triu(hessian)), np.zeros(2 * n + 1), sparse.csc_matrix(rows),
            np.full(len(rows), -np.inf), np.full(len(rows), np.inf),
            verbose=False, eps_abs=1e-4, eps_rel=1e-4, max_iter=4_000,
        )  # fmt: skip
        #: The velocities on their way to the wheels.
        self.sent = [np.zeros(2)] * round(LAG / TICK)

    def __call__(self, point: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """The velocity of P now; ``wanted`` has the shape ``(2, HORIZON)``."""
        start, last = point + TICK * np.sum(self.sent, axis=0), self.sent[-1]
        linear = []
        for axis in range(2):
            before = np.zeros(HORIZON)
            before[0] = last[axis]
            linear.append(
                2.0 * self.sums.T @ (start[axis] - wanted[axis]) - 0.02 * self.changes.T @ before
            )
        turns = self.turns.copy()
        turns[:, 0] += self.sides @ last
        room = np.full(HORIZON, WALL - start[1])
        most = np.concatenate([self.speeds, turns.ravel(), room, [0.0]])
        self.solver.update(q=np.concatenate([*linear, [10.0]]), u=most)
        found = self.solver.solve(raise_error=False)
        # Without a solution the car stops.
        solved = found.info.status.startswith("solved")
        velocity = found.x[[0, HORIZON]] if solved else np.zeros(2)
        self.sent = [*self.sent[1:], velocity]
        return velocity


def main(target: str = "sim", uncalibrated: bool = False, seconds: float = 13.0) -> float:
    """Drives; returns how far P went beyond the wall, in m (negative: it did not)."""
    controller = Controller()
    times, beyond = [], -math.inf
    options: dict[str, Any] = {"uncalibrated": uncalibrated}
    if target == "sim":
        options = {"point": (RADIUS, 0.0, math.pi / 2)}
    with singletrack.Car(target, **options).drive() as drive:
        px, py = next(drive).point_m
        for state in drive:
            now = state.drive_time_s
            angle = math.atan2(py, px) + RATE * (now + LAG + STEP * np.arange(1, HORIZON + 1))
            wanted = RADIUS * np.stack([np.cos(angle), np.sin(angle)])
            began = time.perf_counter()
            vx, vy = controller(np.array(state.point_m), wanted)
            times.append(time.perf_counter() - began)
            drive.point_velocity(vx, vy)
            beyond = max(beyond, state.point_m[1] - WALL)
            if now > seconds:
                break
    print(f"{1e3 * beyond:.1f} mm beyond the wall; solved in {1e3 * np.median(times):.2f} ms (median)")
    return beyond


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "sim", "--uncalibrated" in sys.argv)
