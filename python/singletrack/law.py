"""The feedback linearising laws: from a velocity of P to commands of the car."""

from __future__ import annotations

from collections.abc import Sequence

from . import _native
from .model import Vehicle


def front_point(
    yaw: float,
    yaw_rate: float,
    sideslip: float,
    steering: float,
    velocity: Sequence[float],
    *,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
    front_axle_distance: float | None = None,
) -> tuple[float, float]:
    """The proposed law, equation 7 (8 with an estimated ``front_axle_distance``).

    Args:
        velocity: Wanted velocity of P in the world, ``(vx, vy)`` in m/s.
        point_distance: Distance p of P from the front axle, m.

    Returns:
        Speed of the centre of mass (m/s) and steering rate (rad/s).

    Raises:
        ValueError: Near the singularity of the law.
    """
    car = vehicle or Vehicle()
    front = car.front_axle_distance_m if front_axle_distance is None else front_axle_distance
    return _native.front_point(
        yaw,
        yaw_rate,
        sideslip,
        steering,
        [float(value) for value in velocity],
        point_distance,
        front,
        car.wheelbase_m,
    )


def velocity_point(
    yaw: float,
    yaw_rate: float,
    sideslip: float,
    velocity: Sequence[float],
    *,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
) -> tuple[float, float]:
    """The law of the appendix. Returns speed (m/s) and steering angle (rad)."""
    return _native.velocity_point(
        yaw,
        yaw_rate,
        sideslip,
        [float(value) for value in velocity],
        point_distance,
        vehicle or Vehicle(),
    )


def point(
    x: float,
    y: float,
    yaw: float,
    steering: float,
    *,
    point_distance: float = 0.35,
    front_axle_distance: float | None = None,
) -> tuple[float, float]:
    """The position of P (m), equation 3, of a car with G at ``(x, y)``."""
    front = Vehicle().front_axle_distance_m if front_axle_distance is None else front_axle_distance
    return _native.point_p(x, y, yaw, steering, front, point_distance)
