"""The vehicle models of the simulator and of the law's analysis.

A state has the columns ``x, y, yaw, yaw_rate, sideslip``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

#: ``"linear"``: the paper's equation 1; ``"saturating"``: with tyre forces that saturate;
#: ``"relaxed"``: the simulator's, which also starts, stops and reverses.
Kind = Literal["linear", "saturating", "relaxed"]

_PAPER = _native.paper_vehicle()


@dataclass(frozen=True)
class Vehicle:
    """Parameters of the single-track model; the default is the paper's 1:10 car."""

    mass_kg: float = _PAPER["mass_kg"]
    yaw_inertia_kg_m2: float = _PAPER["yaw_inertia_kg_m2"]
    front_axle_distance_m: float = _PAPER["front_axle_distance_m"]
    rear_axle_distance_m: float = _PAPER["rear_axle_distance_m"]
    friction: float = _PAPER["friction"]
    front_cornering_stiffness_n_rad: float = _PAPER["front_cornering_stiffness_n_rad"]
    rear_cornering_stiffness_n_rad: float = _PAPER["rear_cornering_stiffness_n_rad"]

    @property
    def wheelbase_m(self) -> float:
        """Distance between the axles, in m."""
        return self.front_axle_distance_m + self.rear_axle_distance_m


def derivative(
    states: ArrayLike,
    speed: ArrayLike,
    steering: ArrayLike,
    *,
    vehicle: Vehicle | None = None,
    kind: Kind = "linear",
) -> NDArray[np.float64]:
    """The time derivative of states.

    Args:
        states: Shape ``(n, 5)`` or ``(5,)``: x, y (m), yaw (rad), yaw rate (rad/s), sideslip (rad).
        speed: Speed of the centre of mass, m/s; ``(n,)`` or a number.
        steering: Steering angle, rad; ``(n,)`` or a number.

    Returns:
        The same shape as ``states``, per second.
    """
    rows = np.asarray(states, dtype=np.float64)
    flat = np.atleast_2d(rows)
    count = len(flat)
    result = _native.model_derivative(
        kind,
        vehicle or Vehicle(),
        flat,
        np.broadcast_to(np.asarray(speed, dtype=np.float64), count).copy(),
        np.broadcast_to(np.asarray(steering, dtype=np.float64), count).copy(),
    )
    return result.reshape(rows.shape)


def simulate(
    start: ArrayLike,
    speed: ArrayLike,
    steering: ArrayLike,
    period: float = 0.01,
    *,
    vehicle: Vehicle | None = None,
    kind: Kind = "relaxed",
) -> NDArray[np.float64]:
    """The states of a car under speeds and steering angles that hold for ``period`` s each.

    Args:
        start: Shape ``(5,)``.
        speed: Shape ``(n,)``, m/s.
        steering: Shape ``(n,)``, rad.

    Returns:
        Shape ``(n + 1, 5)``, integrated by the classic Runge-Kutta method at 1 kHz.
    """
    speeds, angles = np.broadcast_arrays(
        np.atleast_1d(np.asarray(speed, dtype=np.float64)),
        np.atleast_1d(np.asarray(steering, dtype=np.float64)),
    )
    return _native.model_simulate(
        kind,
        vehicle or Vehicle(),
        np.asarray(start, dtype=np.float64),
        speeds.copy(),
        angles.copy(),
        period,
    )
