"""Model predictive control of P with OSQP: the paper's circle, cut off by a wall.

Under the law P is two integrators, so that the prediction is linear: a small quadratic program
at every tick. P may not go beyond ``WALL``; the reference does. ``pip install singletrack[mpc]``;
the target is the only argument.
"""

import math
import sys
import time

import numpy as np
import osqp
from scipy import sparse

import singletrack

HORIZON, STEP = 20, 0.05
RATE, FASTEST, WALL = 0.5, 0.8, 1.8


class Controller:
    """Velocities of P over the horizon: least distance from the reference, and few changes."""

    def __init__(self) -> None:
        n = HORIZON
        # P after each step is its position plus STEP times the sum of the velocities so far.
        self.sums = STEP * np.tril(np.ones((n, n)))
        self.changes = np.eye(n) - np.eye(n, k=-1)
        weight = self.sums.T @ self.sums + 0.01 * self.changes.T @ self.changes
        # OSQP reads the upper half.
        hessian = sparse.triu(2.0 * np.kron(np.eye(2), weight), format="csc")
        # An octagon within the largest speed, and the wall.
        angles = np.arange(8) * math.pi / 4
        sides = np.vstack([np.kron([math.cos(a), math.sin(a)], np.eye(n)) for a in angles])
        wall = np.hstack([np.zeros((n, n)), self.sums])
        self.speeds = np.full(8 * n, FASTEST * math.cos(math.pi / 8))
        self.solver = osqp.OSQP()
        self.solver.setup(
            hessian, np.zeros(2 * n), sparse.csc_matrix(np.vstack([sides, wall])),
            np.full(9 * n, -np.inf), np.concatenate([self.speeds, np.full(n, np.inf)]),
            verbose=False, eps_abs=1e-4, eps_rel=1e-4, max_iter=200,
        )  # fmt: skip
        self.last = np.zeros(2)

    def __call__(self, point: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """The velocity of P now; ``wanted`` has the shape ``(2, HORIZON)``."""
        linear = []
        for axis in range(2):
            before = np.zeros(HORIZON)
            before[0] = self.last[axis]
            linear.append(
                2.0 * self.sums.T @ (point[axis] - wanted[axis])
                - 0.02 * self.changes.T @ before
            )
        # Beyond the wall, by noise or lag, P may go back only: there is always a solution.
        room = np.full(HORIZON, max(WALL - point[1], 0.0))
        self.solver.update(q=np.concatenate(linear), u=np.concatenate([self.speeds, room]))
        found = self.solver.solve()
        # Without a solution the car stops.
        solved = found.info.status.startswith("solved")
        self.last = found.x[[0, HORIZON]] if solved else np.zeros(2)
        return self.last


def main(target: str = "sim", seconds: float = 13.0) -> float:
    """Drives; returns how far P went beyond the wall, in m (negative: it did not)."""
    controller = Controller()
    times, beyond = [], -math.inf
    with singletrack.Car(target).drive() as drive:
        for state in drive:
            now = state.drive_time
            angle = RATE * (now + STEP * np.arange(1, HORIZON + 1))
            wanted = np.stack([0.4868 + np.sin(angle), 1.0 - np.cos(angle)])
            began = time.perf_counter()
            vx, vy = controller(np.array(state.point), wanted)
            times.append(time.perf_counter() - began)
            drive.point_velocity(vx, vy)
            beyond = max(beyond, state.point[1] - WALL)
            if now > seconds:
                break
    print(f"{1e3 * beyond:.1f} mm beyond the wall; solved in {1e3 * np.median(times):.2f} ms (median)")
    return beyond


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "sim")
