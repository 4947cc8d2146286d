"""Writes reference.txt: Riccati equations solved by SciPy, for tests/lqi.rs.

Run with SciPy 1.17.1 (LAPACK's QZ, and balancing) in this folder. A line is a matrix: its
case, its name, rows, columns, and the entries by rows, as repr() writes them.
"""

import numpy as np
import scipy
from scipy.linalg import expm, solve_discrete_are

PERIOD = 0.01


def lqi(lag, integral, error, velocity, period=PERIOD):
    """One axis: the integral, the error, the lagged velocity, exact in the hold."""
    if lag > 0:
        # The error and the velocity, exactly; the integral sums the error at the tick.
        motion = np.array([[0, 1, 0], [0, -1 / lag, 1 / lag], [0, 0, 0]])
        step = expm(motion * period)
        a = np.array(
            [[1, period, 0], [0, 1, step[0, 1]], [0, 0, step[1, 1]]]
        )
        b = np.array([[0], [step[0, 2]], [step[1, 2]]])
    else:
        a = np.array([[1, period, 0], [0, 1, 0], [0, 0, 0]])
        b = np.array([[0], [period], [1.0]])
    return a, b, np.diag([integral, error, 0.0]), np.array([[velocity]])


def turning(rate, lag, period=PERIOD):
    """Both axes of a frame that turns: two integrals, two errors, two velocities."""
    j = np.array([[0, -1], [1, 0]])
    z, i = np.zeros((2, 2)), np.eye(2)
    motion = np.block(
        [
            [z, i, z, z],
            [z, -rate * j, i, z],
            [z, z, -rate * j - i / lag, i / lag],
            [z, z, z, z],
        ]
    )
    step = expm(motion * period)
    return (
        step[:6, :6],
        step[:6, 6:],
        np.diag([4.0, 4.0, 1.0, 2.0, 0.0, 0.0]),
        np.diag([0.05, 0.08]),
    )


CASES = {
    "integrator": (
        np.eye(2),
        PERIOD * np.eye(2),
        np.diag([1.0, 3.0]),
        np.diag([0.1, 0.2]),
    ),
    "double-integrator": (
        np.array([[1, PERIOD], [0, 1]]),
        np.array([[PERIOD**2 / 2], [PERIOD]]),
        np.diag([1.0, 0.0]),
        np.array([[0.004]]),
    ),
    "lqi-ideal": lqi(0.0, 1.0, 1.0, 0.0625),
    "lqi-motor": lqi(0.08, 1.0, 1.0, 0.0625),
    "lqi-servo": lqi(0.04, 4.0, 1.0, 0.02),
    "lqi-slow": lqi(0.3, 0.1, 1.0, 1.0, 0.02),
    "turning": turning(1.5, 0.08),
    "unstable": (
        np.array([[1.2, 0.3, 0.0], [-0.1, 0.9, 0.4], [0.2, 0.0, 1.1]]),
        np.array([[0.0, 1.0], [0.5, 0.0], [1.0, 0.2]]),
        np.diag([1.0, 0.5, 2.0]),
        np.array([[1.0, 0.2], [0.2, 0.5]]),
    ),
}

with open("reference.txt", "w") as file:
    print(f"# SciPy {scipy.__version__}; written by reference.py", file=file)
    for case, (a, b, q, r) in CASES.items():
        x = solve_discrete_are(a, b, q, r)
        k = np.linalg.solve(r + b.T @ x @ b, b.T @ x @ a)
        for name, matrix in dict(a=a, b=b, q=q, r=r, x=x, k=k).items():
            rows, columns = matrix.shape
            entries = " ".join(repr(float(entry)) for entry in matrix.ravel())
            print(case, name, rows, columns, entries, file=file)
