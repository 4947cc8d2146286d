"""Stability of the steady motion under the laws: the paper's section on structural stability.

``deviation`` is dl: the law assumes the centre of mass so far behind its true position, in m.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import _native
from .model import Vehicle

Law = Literal["front-point", "velocity-point"]
Belief = Literal["centre-of-mass", "front-axle"]


def eigenvalues(
    speed: float,
    deviation: float = 0.0,
    *,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
    law: Law = "front-point",
    belief: Belief = "centre-of-mass",
) -> NDArray[np.complex128]:
    """The eigenvalues of the steady motion, in 1/s: four of the proposed law, or three."""
    real, imaginary = _native.eigenvalues(
        _values(vehicle), law, belief, point_distance, speed, deviation
    )
    values: NDArray[np.complex128] = real + 1j * imaginary
    return values


def is_stable(
    speed: float,
    deviation: float = 0.0,
    *,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
    law: Law = "front-point",
    belief: Belief = "centre-of-mass",
) -> bool:
    """Whether the steady motion is stable."""
    return _native.is_stable(_values(vehicle), law, belief, point_distance, speed, deviation)


def critical_speed(
    deviations: Sequence[float] = (0.0, 0.0),
    *,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
) -> float | None:
    """The speed (m/s) up to which the proposed law is stable for every dl of a range (m).

    ``None`` if it is stable at every speed, 0 if at none.
    """
    low, high = deviations
    return _native.critical_speed(_values(vehicle), point_distance, [low, high])


def smallest_point_distance(
    deviations: Sequence[float] = (0.0, 0.0), *, vehicle: Vehicle | None = None
) -> float | None:
    """The distance p (m) beyond which the proposed law is stable at every speed."""
    low, high = deviations
    return _native.smallest_point_distance(_values(vehicle), [low, high])


def hopf_points(
    speed: float,
    *,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
    law: Law = "front-point",
    belief: Belief = "centre-of-mass",
) -> list[dict[str, Any]]:
    """The Hopf bifurcations over dl: ``deviation``, ``angular_frequency``, ``criticality``, ..."""
    return _native.hopf_points(_values(vehicle), law, belief, point_distance, speed)


def sampled(
    speed: float,
    deviation: float = 0.0,
    *,
    period: float = 0.01,
    delay: float = 0.0,
    position_gain: float = 0.0,
    longest_delay: float = 0.5,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
    law: Law = "front-point",
    belief: Belief = "centre-of-mass",
) -> tuple[float, float | None]:
    """Spectral radius per tick of the sampled loop, and its delay margin in s."""
    return _native.sampled(
        _values(vehicle),
        law,
        belief,
        point_distance,
        speed,
        deviation,
        period,
        delay,
        position_gain,
        longest_delay,
    )


def _values(vehicle: Vehicle | None) -> list[float]:
    return (vehicle or Vehicle())._values
