"""Stability of the steady motion under the laws: the paper's section on structural stability.

``deviation`` is dl: the law assumes the centre of mass so far behind its true position, in m.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import _native
from .model import Vehicle

Law = Literal["front-point", "velocity-point"]
Belief = Literal["centre-of-mass", "front-axle"]


class _Steady(NamedTuple):
    """A car in steady motion under a law."""

    vehicle: Vehicle
    law: Law
    belief: Belief
    point_distance: float
    speed: float
    deviation: float = 0.0


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
    car = vehicle or Vehicle()
    return _native.eigenvalues(_Steady(car, law, belief, point_distance, speed, deviation))


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
    car = vehicle or Vehicle()
    return _native.is_stable(_Steady(car, law, belief, point_distance, speed, deviation))


def critical_speed(
    deviations: Sequence[float] = (0.0, 0.0),
    *,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
) -> float | None:
    """The speed (m/s) up to which the proposed law is stable for every dl of a range (m).

    ``None`` if it is stable at every speed, 0 if at none.
    """
    return _native.critical_speed(vehicle or Vehicle(), point_distance, _range(deviations))


def smallest_point_distance(
    deviations: Sequence[float] = (0.0, 0.0), *, vehicle: Vehicle | None = None
) -> float | None:
    """The distance p (m) beyond which the proposed law is stable at every speed."""
    return _native.smallest_point_distance(vehicle or Vehicle(), _range(deviations))


def hopf_points(
    speed: float,
    *,
    point_distance: float = 0.35,
    vehicle: Vehicle | None = None,
    law: Law = "front-point",
    belief: Belief = "centre-of-mass",
) -> list[dict[str, Any]]:
    """The Hopf bifurcations over dl: ``deviation``, ``angular_frequency``, ``criticality``, ..."""
    car = vehicle or Vehicle()
    return _native.hopf_points(_Steady(car, law, belief, point_distance, speed))


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
    car = vehicle or Vehicle()
    steady = _Steady(car, law, belief, point_distance, speed, deviation)
    return _native.sampled(steady, period, delay, position_gain, longest_delay)


def _range(deviations: Sequence[float]) -> list[float]:
    low, high = deviations
    if not low <= high:
        raise ValueError(f"the deviations are {low} and {high}: give two numbers in order")
    return [low, high]
