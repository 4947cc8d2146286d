"""Gymnasium environments: one car, or many side by side.

``gymnasium.make("Singletrack-v0")`` is the car alone, with the board's own servo and motor
control; its state is known. ``gymnasium.make("Singletrack-System-v0")`` is the whole system:
the supervisor, the estimator, cameras with noise and latency, the board behind its serial
line. ``gymnasium.make_vec(..., num_envs=256)`` steps many cars natively.

Names are those of f1tenth_gym where both have the same thing.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from . import _native
from ._register import MAX_STEPS, register
from ._render import Frame, Picture, Window
from ._toml import Table, text

__all__ = ["RANDOMISE", "SingletrackEnv", "SingletrackVectorEnv", "register"]

Observation = Any
Ranges = Mapping[str, tuple[float, float]]

#: The columns of the state, with f1tenth_gym's names.
STATE = ("pose_x", "pose_y", "delta", "linear_vel_x", "pose_theta", "ang_vel_z", "beta")

#: Largest yaw rate of an observation, in rad/s: that of the IMU.
MAX_YAW_RATE = 35.0

#: The paper's circle: radius 1 m, 0.5 m/s, from its right end on.
CIRCLE: Mapping[str, Any] = {
    "kind": "circle",
    "radius_m": 1.0,
    "angular_velocity_rad_s": 0.5,
    "start": "beginning",
}

#: Cars that differ from their configuration as other people's cars do: domain randomisation
#: for ``randomise``, by the names of the table ``[truth]``.
RANDOMISE: Mapping[str, tuple[float, float]] = {
    "vehicle.mass_kg": (1.5, 2.6),
    "vehicle.yaw_inertia_kg_m2": (0.018, 0.035),
    "vehicle.friction": (0.22, 0.6),
    "vehicle.front_cornering_stiffness_n_rad": (40.0, 80.0),
    "vehicle.rear_cornering_stiffness_n_rad": (90.0, 170.0),
    "servo.centre_us": (1485.0, 1515.0),
    "servo.gain_us_per_rad": (-880.0, -720.0),
    "servo.lag_ms": (20.0, 80.0),
    "servo.backlash_us": (0.0, 15.0),
    "drive_train.rolling_m_s2": (0.5, 1.2),
    "battery.start_v": (7.2, 8.4),
}

_INFORMATION = ("point_error", "progress", "speed")


def _options(
    *,
    whole_system: bool = False,
    reference: Table = None,
    reward: Literal["tracking", "progress"] = "tracking",
    control_input: Sequence[str] | str = ("steering_angle", "speed"),
    observation: Literal["tracking", "kinematic_state", "original"] = "tracking",
    randomise: Ranges | Literal["other-cars"] | None = None,
    configuration: Table = None,
    truth: Table = None,
    timestep: float = 0.01,
    preview: Sequence[float] = (0.0, 0.2, 0.4, 0.6),
    lost: float = 1.0,
    start_error: tuple[float, float] = (0.1, 0.2),
    max_episode_steps: int | None = None,
) -> dict[str, Any]:
    """The arguments of both environments, checked."""
    for name, values in (
        ("timestep", [timestep]),
        ("lost", [lost]),
        ("preview", preview),
        ("start_error", start_error),
    ):
        if not np.isfinite(values).all() or np.min(values, initial=0.0) < 0.0:
            raise ValueError(f"{name} is {values}: it must be finite, and not negative")
    periods = round(timestep / 0.01)
    if periods < 1 or abs(periods * 0.01 - timestep) > 1e-9:
        raise ValueError(f"timestep is {timestep} s: it must be a multiple of 0.01")
    words = [control_input] if isinstance(control_input, str) else control_input
    if observation not in ("tracking", "kinematic_state", "original"):
        raise ValueError(
            f'observation is {observation!r}: use "tracking", "kinematic_state" or "original"'
        )
    ranges: Ranges
    if randomise == "other-cars":
        ranges = RANDOMISE
    else:
        if isinstance(randomise, str):
            raise ValueError(f'randomise is {randomise!r}: use "other-cars" or ranges')
        ranges = randomise or {}
    return {
        "observation": "kinematic_state" if observation == "original" else observation,
        "native": {
            "whole_system": whole_system,
            "reference_toml": text(CIRCLE if reference is None else reference),
            "configuration": text(configuration),
            "truth": text(truth),
            "randomise": [(name, float(low), float(high)) for name, (low, high) in ranges.items()],
            "reward": reward,
            "control": ", ".join(words),
            "periods": periods,
            "max_steps": max_episode_steps or MAX_STEPS,
            "preview": [float(time) for time in preview],
            "lost_m": float(lost),
            "start_error": [float(value) for value in start_error],
        },
    }


def _action_space(native: _native.Batch, control: str) -> spaces.Box:
    steering, reverse, speed = native.limits
    ranges = {"steering_angle": (-steering, steering), "speed": (-reverse, speed)}
    both = [ranges.get(word, (-speed, speed)) for word in control.split(", ")]
    low, high = np.array(both * (2 // len(both)), np.float32).T
    return spaces.Box(low, high, dtype=np.float32)


def _picture(native: _native.Batch, mode: str | None, known: Sequence[str]) -> Picture | None:
    if mode not in (None, *known):
        raise ValueError(f"render_mode is {mode!r}: use {' or '.join(known)}")
    return Picture(native.path(), native.geometry) if mode else None


def _observation_space(native: _native.Batch, chosen: dict[str, Any]) -> Any:
    given = chosen["native"]
    _, reverse, speed = native.limits
    # A car may be faster than it should, and slide.
    fast = 2.0 * max(speed, reverse) + 1.0
    if chosen["observation"] == "tracking":
        action = np.abs(_action_space(native, given["control"]).high).tolist()
        head = [fast, np.pi, MAX_YAW_RATE, np.pi / 2, *action]
        reaches = [given["lost_m"] + fast * (ahead + 1.0) for ahead in given["preview"]]
        high = np.array(head + [each for far in reaches for each in (far, far, fast, fast)])
        return spaces.Box(-high.astype(np.float32), high.astype(np.float32), dtype=np.float32)
    # A car that is farther from the path of its reference is lost.
    away = given["lost_m"] + sum(native.geometry) + fast
    low, high = native.path().min(axis=0) - away, native.path().max(axis=0) + away
    most = [np.pi / 2, fast, np.pi, MAX_YAW_RATE, np.pi]
    bounds = zip(STATE, [*low, *np.negative(most)], [*high, *most], strict=True)
    return spaces.Dict(
        {name: spaces.Box(np.float32(low), np.float32(high), ()) for name, low, high in bounds}
    )


def _clipped(rows: NDArray[Any], space: Any) -> Observation:
    """An observation, or one of each row, within its bounds."""
    if isinstance(space, spaces.Box):
        return np.clip(rows, space.low, space.high)
    values = rows.astype(np.float32)
    yaw = STATE.index("pose_theta")
    values[..., yaw] = np.remainder(rows[..., yaw] + np.pi, 2 * np.pi) - np.pi
    return {
        name: np.asarray(np.clip(values[..., column], space[name].low, space[name].high))
        for column, name in enumerate(STATE)
    }


class SingletrackEnv(gymnasium.Env[Any, Any]):
    """One car that follows a reference with its point P.

    Args:
        whole_system: The whole system instead of the car alone. State and observation are then
            the estimate; a drive that the supervisor ends is an end of the episode, with its
            reason in ``info["reason"]``.
        reference: Keys of ``[reference]``: a circle (the default: the paper's), a path,
            a figure of eight or waypoints. The car is put down near its beginning. A closed
            reference then begins at the place nearest to P, or with ``start = "beginning"``,
            which the default has, at its beginning. With the reward ``"progress"`` it is always
            at the place that P has come to.
        reward: ``"tracking"``: exp(-e/0.1 m) of the distance e between P and the reference at
            its time; ``"progress"``: travel of P along the path, less its distance from it. Both
            less 0.05 of the squared change of the action; -10 for a car that is lost.
        control_input: The columns of the action, in their order: ``["steering_angle",
            "speed"]`` (rad and m/s; the default, and the order of f1tenth_gym's arrays),
            ``["speed", "steering_angle"]``, or ``["point_velocity"]``: the velocity of P in the
            world, m/s.
        observation: ``"tracking"``: float32 of the shape ``(6 + 4 k,)``, clipped to bounds from the
            configuration: speed, sideslip, yaw
            rate, steering and the last action; then, for each of the ``k`` times of
            ``preview``, distance from P to the reference and velocity of the reference, forward
            and left of the car. ``"kinematic_state"``: f1tenth_gym's dictionary ``pose_x,
            pose_y, delta, linear_vel_x, pose_theta, ang_vel_z, beta``, bounded too, with
            ``pose_theta`` from -pi to pi.
        randomise: Ranges by the names of the table ``[truth]``, drawn at each reset, or
            ``"other-cars"`` for :data:`RANDOMISE`.
        configuration: Keys of the daemon's configuration, such as ``limits.max_speed_m_s``.
        truth: What is true of every car and differs from the configuration.
        timestep: Time between two actions, in s; a multiple of 0.01.
        preview: Times ahead at which the reference is seen, in s.
        lost: Distance between P and the reference that ends the episode, in m.
        start_error: Largest errors of the start: of P along each axis (m), and of the yaw (rad).
        render_mode: ``"rgb_array"``: :meth:`render` returns a view from above, uint8 of the shape
            ``(480, 480, 3)``; ``"human"``, with the extra ``plots``: a window, in real time.

    ``info`` has ``point_error`` (m), ``progress`` (m), ``speed`` (the true one, m/s) and, once the
    episode has been terminated, ``reason``.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as the base class)
        "render_modes": ["human", "rgb_array"] if find_spec("matplotlib") else ["rgb_array"],
        "render_fps": 100,
    }

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        chosen = _options(**options)
        self._kind: str = chosen["observation"]
        # The wrapper TimeLimit of `make` truncates.
        chosen["native"]["max_steps"] = 2**31
        native = {**chosen["native"], "autoreset": "disabled", "threads": 1}
        self._native = _native.Batch(1, native)
        self.action_space = _action_space(self._native, chosen["native"]["control"])
        self.observation_space = _observation_space(self._native, chosen)
        self.timestep = chosen["native"]["periods"] * 0.01
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1 / self.timestep)}
        self._picture = _picture(self._native, render_mode, ["human", "rgb_array"])
        self._window = Window() if render_mode == "human" else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Puts the car down at the start. Without a ``seed`` the random numbers go on."""
        first = self._np_random is None
        super().reset(seed=seed)
        if seed is not None or first:
            seed = int(self.np_random.integers(2**63))
        state, observation, *_ = self._native.reset([seed])
        if self._picture:
            self._follow(self._picture)
        return self._observation(state[0], observation[0]), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drives for a ``timestep``."""
        row = np.asarray(action, dtype=np.float64)
        if row.shape != self.action_space.shape:
            raise ValueError(f"an action has the shape {self.action_space.shape}, not {row.shape}")
        state, observation, reward, terminated, truncated, known, reason = self._native.step_one(
            *row.tolist()
        )
        information: dict[str, Any] = dict(zip(_INFORMATION, known, strict=True))
        if reason:
            information["reason"] = reason
        if self._picture:
            self._follow(self._picture)
        return self._observation(state, observation), reward, terminated, truncated, information

    def render(self) -> Any:
        """The view from above of ``"rgb_array"``; ``"human"`` draws it in its window."""
        if not self._picture:
            gymnasium.logger.warn('render() draws with render_mode="rgb_array" or "human"')
            return None
        frame = self._picture.draw(self._native.truth()[0], self._native.reference()[0, :2])
        return self._window.show(frame) if self._window else frame

    def close(self) -> None:
        """Closes the window."""
        if self._window:
            self._window.close()

    def _follow(self, picture: Picture) -> None:
        picture.follow(self._native.steps()[0], self._native.truth()[0])
        if self._window and self._window.is_due(self.timestep):
            self.render()

    @property
    def truth(self) -> dict[str, float]:
        """The true state, by the names of :data:`STATE`."""
        return dict(zip(STATE, self._native.truth()[0].tolist(), strict=True))

    @property
    def point(self) -> NDArray[np.float64]:
        """P as it is seen: shape ``(2,)``, m."""
        return self._native.point().reshape(2)

    @property
    def reference(self) -> NDArray[np.float64]:
        """Position and velocity of the reference now: shape ``(4,)``, m and m/s."""
        return self._native.reference().reshape(4)

    def _observation(self, state: NDArray[np.float64], row: NDArray[np.float32]) -> Observation:
        return _clipped(row if self._kind == "tracking" else state, self.observation_space)


class SingletrackVectorEnv(VectorEnv[Any, Any, Any]):
    """Many cars, stepped natively on several threads; arguments as :class:`SingletrackEnv`.

    With ``render_mode="rgb_array"``, :meth:`render` returns a tuple with the frame of each car.

    Args:
        num_envs: The number of cars.
        autoreset_mode: When a car whose episode has ended is reset; gymnasium's default is
            with the next step. With ``SAME_STEP``, ``info`` has ``final_obs``.
        threads: Threads; as many as processors if left out. The results do not depend on it.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        **options: Any,
    ) -> None:
        chosen = _options(**options)
        mode = AutoresetMode(autoreset_mode)
        words = {
            AutoresetMode.NEXT_STEP: "next_step",
            AutoresetMode.SAME_STEP: "same_step",
            AutoresetMode.DISABLED: "disabled",
        }
        if num_envs < 1:
            raise ValueError(f"num_envs is {num_envs}: at least one is needed")
        if threads is None:
            # A thread is not worth its start for a few cars alone.
            worth = num_envs if chosen["native"]["whole_system"] else num_envs // 16
            threads = max(1, min(len(os.sched_getaffinity(0)), worth))
        self._kind: str = chosen["observation"]
        self._mode = mode
        native = {**chosen["native"], "autoreset": words[mode], "threads": threads}
        self._native = _native.Batch(num_envs, native)
        self.num_envs = num_envs
        self.single_action_space = _action_space(self._native, chosen["native"]["control"])
        self.single_observation_space = _observation_space(self._native, chosen)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.timestep = chosen["native"]["periods"] * 0.01
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": round(1 / self.timestep),
            "autoreset_mode": mode,
        }
        picture = _picture(self._native, render_mode, self.metadata["render_modes"])
        self._pictures = [copy.copy(picture) for _ in range(num_envs)] if picture else []

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Resets the cars; with ``options={"reset_mask": mask}`` those of the mask.

        A car with the seed ``s`` behaves as a single environment with this seed.
        """
        first = self._np_random is None
        if isinstance(seed, (int, np.integer)):
            seed = int(seed)
            super().reset(seed=seed)
            given: list[int | None] = [seed + index for index in range(self.num_envs)]
        elif seed is not None:
            given = list(seed)
            if len(given) != self.num_envs:
                raise ValueError(f"{len(given)} seeds are given for {self.num_envs} environments")
        elif first:
            given = [int(value) for value in self.np_random.integers(2**31, size=self.num_envs)]
        else:
            given = [None] * self.num_envs
        seeds = [None if value is None else _seed(value) for value in given]
        mask = None
        if options and options.get("reset_mask") is not None:
            mask = [bool(value) for value in options["reset_mask"]]
            if len(mask) != self.num_envs:
                raise ValueError(f"the mask has {len(mask)} of {self.num_envs} environments")
        state, observation, *_ = self._native.reset(seeds, mask)
        self._follow()
        return self._observation(state, observation), {}

    def step(
        self, actions: Any
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Drives all cars for a ``timestep``; ``actions`` has the shape ``(num_envs, 2)``."""
        rows = np.ascontiguousarray(actions, dtype=np.float64)
        if rows.shape != self.action_space.shape:
            raise ValueError(f"actions have the shape {self.action_space.shape}, not {rows.shape}")
        state, observation, rewards, terminated, truncated, known = self._native.step(rows)
        information: dict[str, Any] = {}
        all_cars = np.ones(self.num_envs, dtype=np.bool_)
        for column, name in enumerate(_INFORMATION):
            information[name] = known[:, column]
            information[f"_{name}"] = all_cars
        if terminated.any():
            reasons = np.full(self.num_envs, None, dtype=object)
            for index, reason in self._native.reasons():
                reasons[index] = reason
            information["reason"] = reasons
            information["_reason"] = reasons != None  # noqa: E711
        if self._mode is AutoresetMode.SAME_STEP and (terminated | truncated).any():
            final = np.full(self.num_envs, None, dtype=object)
            ended = np.zeros(self.num_envs, dtype=np.bool_)
            for index, last, row in self._native.last():
                final[index] = self._observation(last, row)
                ended[index] = True
            information.update(final_obs=final, _final_obs=ended)
        self._follow()
        return (
            self._observation(state, observation),
            rewards,
            terminated,
            truncated,
            information,
        )

    def render(self) -> tuple[Frame, ...] | None:
        """The views from above of ``"rgb_array"``."""
        if not self._pictures:
            gymnasium.logger.warn('render() draws with render_mode="rgb_array"')
            return None
        rows = zip(self._pictures, self.truth, self.reference[:, :2], strict=True)
        return tuple(picture.draw(state, wanted) for picture, state, wanted in rows)

    def _follow(self) -> None:
        if self._pictures:
            for each in zip(self._pictures, self._native.steps(), self.truth, strict=True):
                each[0].follow(*each[1:])

    @property
    def truth(self) -> NDArray[np.float64]:
        """The true states: shape ``(num_envs, 7)``, the columns of :data:`STATE`."""
        return self._native.truth()

    @property
    def point(self) -> NDArray[np.float64]:
        """P of each car as it is seen: shape ``(num_envs, 2)``, m."""
        return self._native.point()

    @property
    def reference(self) -> NDArray[np.float64]:
        """Position and velocity of each car's reference: shape ``(num_envs, 4)``."""
        return self._native.reference()

    def _observation(self, state: NDArray[np.float64], rows: NDArray[np.float32]) -> Observation:
        return _clipped(rows if self._kind == "tracking" else state, self.single_observation_space)


def _seed(seed: int) -> int:
    """The native seed of an environment with this seed."""
    generator, _ = gymnasium.utils.seeding.np_random(seed)
    return int(generator.integers(2**63))
