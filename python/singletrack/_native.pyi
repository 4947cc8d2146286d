"""The native module; its functions are used through the package."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .model import Vehicle
from .stability import _Steady

_Arrays = tuple[
    NDArray[np.float64],
    NDArray[np.float32],
    NDArray[np.float64],
    NDArray[np.bool_],
    NDArray[np.bool_],
    NDArray[np.float64],
]
_One = tuple[NDArray[np.float64], NDArray[np.float32], float, bool, bool, list[float], str]

class Batch:
    def __new__(
        cls,
        num_envs: int,
        *,
        whole_system: bool,
        reference_toml: str,
        configuration: str,
        truth: str,
        randomise: Sequence[tuple[str, float, float]],
        reward: str,
        control: str,
        autoreset: str,
        periods: int,
        max_steps: int,
        preview: Sequence[float],
        lost_m: float,
        start_error: Sequence[float],
        threads: int,
    ) -> Batch: ...
    @property
    def columns(self) -> int: ...
    @property
    def limits(self) -> tuple[float, float, float]: ...
    @property
    def geometry(self) -> tuple[float, float, float]: ...
    def path(self) -> NDArray[np.float64]: ...
    def reset(
        self, seeds: Sequence[int | None], mask: Sequence[bool] | None = None
    ) -> _Arrays: ...
    def step(self, actions: NDArray[np.float64]) -> _Arrays: ...
    def step_one(self, first: float, second: float) -> _One: ...
    def last(self) -> list[tuple[int, NDArray[np.float64], NDArray[np.float32]]]: ...
    def reasons(self) -> list[tuple[int, str]]: ...
    def steps(self) -> list[int]: ...
    def truth(self) -> NDArray[np.float64]: ...
    def reference(self) -> NDArray[np.float64]: ...
    def point(self) -> NDArray[np.float64]: ...

class Course:
    @property
    def until(self) -> float: ...
    def at(self, time: float) -> tuple[tuple[float, float], tuple[float, float]]: ...

class Connection:
    def __new__(cls, path: str) -> Connection: ...
    def send(self, command: str, **keys: Any) -> None: ...
    def take(self, wait: float) -> dict[str, Any] | None: ...
    def close(self) -> None: ...

class Simulator:
    def __new__(
        cls,
        *,
        seed: int,
        start: Sequence[float],
        point: bool,
        configuration: str,
        truth: str,
        reference_toml: str | None,
        record: str | None,
    ) -> Simulator: ...
    def step(self, count: int = 1) -> None: ...
    def state(self) -> dict[str, Any] | None: ...
    @property
    def mode(self) -> str: ...
    @property
    def now(self) -> float: ...
    @property
    def is_external(self) -> bool: ...
    def request(self, request: str) -> None: ...
    def set_reference(self, toml: str) -> int: ...
    def tune(
        self, *, gain_per_s: Sequence[float] | None = None, point_distance_m: float | None = None
    ) -> None: ...
    def setpoint(self, keys: dict[str, Any]) -> None: ...
    def truth(self) -> dict[str, Any]: ...
    def marker_loss(self, pattern: str | None) -> None: ...
    def lose_markers(self, duration: str) -> None: ...
    def set_fault(self, name: str, value: Any) -> None: ...
    def press_reset(self) -> None: ...
    def place(self, x_m: float, y_m: float, yaw_rad: float) -> None: ...
    def configuration(self) -> str: ...
    def finish(self) -> None: ...

def compare(
    begin: Callable[[Course], Callable[[dict[str, Any]], dict[str, Any]]],
    *,
    name: str,
    point: str,
    controllers: Sequence[str],
    paths: Sequence[str],
    speeds: Sequence[float],
    conditions: Sequence[str],
    first_seed: int,
    count: int,
    threads: int | None,
) -> tuple[str, str]: ...
def truth_keys() -> list[tuple[str, str, str]]: ...
def read_record(
    path: str, topics: Sequence[str] | None = None
) -> tuple[dict[str, Any], dict[str, Any]]: ...
def paper_vehicle() -> list[tuple[str, float]]: ...
def model_derivative(
    kind: str,
    vehicle: Vehicle,
    states: NDArray[np.float64],
    speed: NDArray[np.float64],
    steering: NDArray[np.float64],
) -> NDArray[np.float64]: ...
def model_simulate(
    kind: str,
    vehicle: Vehicle,
    start: NDArray[np.float64],
    speed: NDArray[np.float64],
    steering: NDArray[np.float64],
    period: float,
) -> NDArray[np.float64]: ...
def front_point(
    yaw: float,
    yaw_rate: float,
    sideslip: float,
    steering: float,
    velocity: Sequence[float],
    point_distance: float,
    front_axle_distance: float,
    wheelbase: float,
) -> tuple[float, float]: ...
def velocity_point(
    yaw: float,
    yaw_rate: float,
    sideslip: float,
    velocity: Sequence[float],
    point_distance: float,
    vehicle: Vehicle,
) -> tuple[float, float]: ...
def point_p(
    x: float,
    y: float,
    yaw: float,
    steering: float,
    front_axle_distance: float,
    point_distance: float,
) -> tuple[float, float]: ...
def eigenvalues(steady: _Steady) -> NDArray[np.complex128]: ...
def is_stable(steady: _Steady) -> bool: ...
def critical_speed(
    vehicle: Vehicle, point_distance: float, deviations: Sequence[float]
) -> float | None: ...
def smallest_point_distance(vehicle: Vehicle, deviations: Sequence[float]) -> float | None: ...
def hopf_points(steady: _Steady) -> list[dict[str, Any]]: ...
def sampled(
    steady: _Steady,
    period: float,
    delay: float,
    position_gain: float,
    longest_delay: float,
) -> tuple[float, float | None]: ...
