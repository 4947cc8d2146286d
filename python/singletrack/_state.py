"""What a controller outside sees of a tick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import Any

from ._errors import ArmError

Pair = tuple[float, float]


@dataclass(frozen=True)
class State:
    """The state after one tick of the controller.

    Values of a car that is not seen are NaN, or ``None``. Times are in s, lengths in m, angles
    in rad; the centre of mass is G, the point that follows the reference is P.
    """

    #: Time since the first tick of the daemon or of the simulation, in s.
    t_s: float
    #: The tick's time on ``CLOCK_MONOTONIC`` (on the virtual clock of a simulation), in ns.
    time_ns: int
    #: Mode of the supervisor: ``driving``, ``slowing``, ``stopping``, ``ready``, ...
    mode: str
    #: Why the car does not drive, or why the last drive ended.
    reason: str | None
    #: Number of the tick.
    tick: int = 0
    #: Why an arm request would be refused now.
    preflight: str | None = None
    #: Phase of the session with the board.
    link: str = "disconnected"
    #: Position of G along x, in m.
    x_m: float = nan
    #: Position of G along y, in m.
    y_m: float = nan
    #: Yaw, in rad, not wrapped.
    yaw_rad: float = nan
    #: Speed of G, in m/s.
    speed_m_s: float = nan
    #: Angle from the car's axis to the velocity of G, in rad.
    sideslip_rad: float = nan
    #: Yaw rate, in rad/s.
    yaw_rate_rad_s: float = nan
    #: Steering angle that was commanded with this tick, within the limits, in rad.
    steering_rad: float = 0.0
    #: Speed that was commanded with this tick, within the limits, in m/s.
    commanded_speed_m_s: float = 0.0
    #: Time by which the state was predicted for the command, in s.
    looked_ahead_s: float = nan
    #: Position of P, in m.
    point_m: Pair = (nan, nan)
    #: Velocity of P that the law was given, in m/s.
    point_velocity_m_s: Pair | None = None
    #: Where P should be, in m.
    reference_m: Pair | None = None
    #: Path parameter of the reference, in s; NaN outside of a drive.
    path_s: float = nan
    #: Why the reference is slowed down.
    slowed_by: str | None = None
    #: Age of the newest accepted pose, in s.
    pose_age_s: float = nan
    #: Whether the tick had no new pose.
    held: bool = True
    #: Time since the first driving tick, in s; NaN outside of a drive.
    drive_time_s: float = nan
    #: Number of the set-point in force.
    sequence: int | None = None
    #: Age of the set-point in force, in s.
    setpoint_age_s: float = nan
    #: Age of the newest telemetry of the board, in s.
    board_age_s: float = nan
    #: Why a set-point was refused in this tick.
    setpoint_refused: str | None = None
    #: What the safety filter did: none, limited, scaled, stopped or yielded.
    filtering: str = "none"
    #: Number of ticks of this or the last drive in which the safety filter acted.
    filtered_ticks: int = 0
    #: Gains of the position loop along x and y, in 1/s; ``None`` if nothing can be tuned.
    gain_per_s: Pair | None = None
    #: Distance p of P from the front axle, in m; NaN if nothing can be tuned.
    point_distance_m: float = nan
    #: The distance that p goes to, in m; NaN if nothing can be tuned.
    wanted_point_distance_m: float = nan

    @property
    def driving(self) -> bool:
        """Whether a drive is underway that the controller outside commands."""
        return self.mode in ("driving", "slowing")

    @property
    def standing(self) -> bool:
        """Whether no drive is underway."""
        return self.mode in ("disconnected", "idle", "ready", "fault")


def refuse_driven(state: State) -> None:
    """Raises if a program or a person drives the car: our standstill would be mixed in."""
    if state.mode in ("arming", "driving", "jogging"):
        raise ArmError(f"the car is driven already: mode {state.mode}")


def state(values: Mapping[str, Any]) -> State:
    """The state of a line of the stream, or of a tick of the simulation."""
    known = {name: values[name] for name in _NAMES if values.get(name) is not None}
    for name in ("point_m", "point_velocity_m_s", "reference_m", "gain_per_s"):
        if name in known:
            x, y = known[name]
            known[name] = (float(x), float(y))
    setpoint = values.get("setpoint")
    if isinstance(setpoint, Mapping):
        known["sequence"] = setpoint.get("sequence")
        known["setpoint_age_s"] = setpoint.get("age_s", nan)
    known.setdefault("reason", None)
    return State(**known)


_NAMES = tuple(State.__dataclass_fields__)
