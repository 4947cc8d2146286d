"""The environments."""

from __future__ import annotations

import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import singletrack  # registers the environments

ENVIRONMENTS = ["Singletrack-v0", "Singletrack-System-v0"]
OPTIONS: list[dict[str, Any]] = [
    {},
    {"observation": "kinematic_state"},
    {"control_input": ["point_velocity"], "reward": "progress"},
    {"randomise": "other-cars", "timestep": 0.02},
]
DRIVE = np.array([0.25, 0.5], np.float32)


@pytest.mark.parametrize("name", ENVIRONMENTS)
@pytest.mark.parametrize("options", OPTIONS)
def test_gymnasiums_checker_passes(name: str, options: dict[str, Any]) -> None:
    with warnings.catch_warnings(record=True) as warned:
        check_env(gymnasium.make(name, **options).unwrapped)
    words = [str(one.message).lower() for one in warned]
    # Another advises symmetric actions: the wrapper RescaleAction.
    assert not [text for text in words if "render" in text]
    assert not [text for text in words if "infinity" in text]


@pytest.mark.parametrize("name", ENVIRONMENTS)
@pytest.mark.parametrize("kind", ["tracking", "kinematic_state"])
def test_an_observation_is_within_its_bounds_also_of_a_car_that_is_lost(
    name: str, kind: str
) -> None:
    env = gymnasium.make(name, randomise="other-cars", lost=0.3, observation=kind)
    space: Any = env.observation_space
    observation, _ = env.reset(seed=3)
    for _ in range(300):
        assert observation in space
        observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            break
    assert observation in space


def test_the_state_of_a_car_that_drives_round_is_not_clipped_and_its_yaw_is_wrapped() -> None:
    env = gymnasium.make("Singletrack-v0", observation="kinematic_state")
    env.reset(seed=3)
    car: Any = env.unwrapped
    beyond = False
    for _ in range(1600):
        x, y, vx, vy = car.reference
        px, py = car.point
        yaw, speed = car.truth["pose_theta"], np.hypot(vx, vy)
        wanted = np.arctan2(vy + y - py, vx + x - px) - yaw
        angle = np.clip(np.remainder(wanted + np.pi, 2 * np.pi) - np.pi, -0.45, 0.45)
        observation, *_ = env.step(np.array([angle, speed], np.float32))
        beyond = beyond or abs(yaw) > np.pi
        for key, value in car.truth.items():
            apart = float(observation[key]) - value
            turns = round(apart / (2 * np.pi)) if key == "pose_theta" else 0
            assert abs(apart - 2 * np.pi * turns) < 1e-4, key
    assert beyond and -np.pi <= observation["pose_theta"] <= np.pi


def test_modes_that_need_a_package_are_declared_if_it_is_there() -> None:
    code = (
        "import sys, importlib.machinery as m\n"
        "find = m.PathFinder.find_spec\n"
        "m.PathFinder.find_spec = lambda name, *rest: (\n"
        "    None if name.startswith('matplotlib') else find(name, *rest))\n"
        "import gymnasium, singletrack, singletrack.gym\n"
        "from gymnasium.utils.env_checker import check_env\n"
        "check_env(gymnasium.make('Singletrack-v0').unwrapped)\n"
        "print(singletrack.gym.SingletrackEnv.metadata['render_modes'])"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "['rgb_array']", done.stderr


def reddish(frame: Any) -> int:
    """The pixels of P and its trail."""
    red, green, _ = np.moveaxis(frame.astype(int), 2, 0)
    return int(np.count_nonzero(red > green + 60))


def test_a_frame_shows_p_its_reference_and_the_trail() -> None:
    env = gymnasium.make("Singletrack-v0", render_mode="rgb_array", timestep=0.02)
    assert env.metadata["render_fps"] == 50
    env.reset(seed=1)
    car: Any = env.unwrapped
    frames = []
    for _ in range(3):
        for _ in range(25):
            env.step(DRIVE)
        frame: Any = env.render()
        frames.append(frame)
        assert frame.shape == (480, 480, 3) and frame.dtype == np.uint8
        # The view is the circle of 1 m with 0.8 m around it.
        for (x, y), red in ((car.point, True), (car.reference[:2], False)):
            row, column = round(240 - y * 480 / 3.6), round(240 + x * 480 / 3.6)
            assert bool(frame[row, column, 0] > 2 * frame[row, column, 1]) is red
    trails = [reddish(frame) for frame in frames]
    assert trails == sorted(set(trails))
    # Another episode has another trail.
    env.reset(seed=1)
    again: Any = env.render()
    assert reddish(again) < trails[0]


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_many_cars_are_drawn_as_one_is(mode: AutoresetMode) -> None:
    options: dict[str, Any] = {"max_episode_steps": 20, "render_mode": "rgb_array"}
    vector = gymnasium.make_vec("Singletrack-v0", num_envs=2, autoreset_mode=mode, **options)
    vector.reset(seed=3)
    for _ in range(15 if mode is AutoresetMode.DISABLED else 30):
        vector.step(np.tile(DRIVE, (2, 1)))
    frames: Any = vector.render()
    env = gymnasium.make("Singletrack-v0", **options)
    env.reset(seed=4)
    steps = {AutoresetMode.DISABLED: 15, AutoresetMode.SAME_STEP: 10, AutoresetMode.NEXT_STEP: 9}
    if mode is not AutoresetMode.DISABLED:
        for _ in range(20):
            env.step(DRIVE)
        env.reset()
    for _ in range(steps[mode]):
        env.step(DRIVE)
    alone: Any = env.render()
    assert len(frames) == 2 and np.array_equal(frames[1], alone)


def test_a_window_without_matplotlib_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ImportError, match=r"python\[plots\]"):
        gymnasium.make("Singletrack-v0", render_mode="human")
    with pytest.raises(ValueError, match="rgb_array"):
        gymnasium.make_vec("Singletrack-v0", num_envs=2, render_mode="human")


def test_the_columns_of_an_action_are_in_the_order_of_control_input() -> None:
    last = []
    for words in (["steering_angle", "speed"], ["speed", "steering_angle"], ["point_velocity"]):
        env = gymnasium.make("Singletrack-v0", control_input=words)
        env.reset(seed=1)
        box: Any = env.action_space
        limits = {"steering_angle": 0.5, "speed": 1.0}
        for _ in range(50):
            observation, *_ = env.step(DRIVE if words[0] != "speed" else DRIVE[::-1])
        last.append(observation)
        assert box.shape == (2,)
        if len(words) == 2:
            assert [limits[word] > 0.6 for word in words] == (box.high > 0.6).tolist()
    assert np.array_equal(last[0][:4], last[1][:4]) and np.array_equal(last[0][6:], last[1][6:])
    assert np.array_equal(last[0][4:6], DRIVE) and np.array_equal(last[1][4:6], DRIVE[::-1])
    default = gymnasium.make("Singletrack-v0").action_space
    assert default == gymnasium.make("Singletrack-v0", control_input=["steering_angle", "speed"]).action_space


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_an_episode_begins_where_the_reference_says(name: str) -> None:
    circle = {"kind": "circle", "radius_m": 1.0, "angular_velocity_rad_s": 0.5}
    for start in ("nearest", "beginning"):
        env = gymnasium.make(name, reference={**circle, "start": start})
        env.reset(seed=2)
        car: Any = env.unwrapped
        state = car.truth
        x, y = state["pose_x"], state["pose_y"]
        x, y = (1.0, 0.0) if start == "beginning" else _point(x, y, state["pose_theta"])
        assert np.allclose(car.reference[:2], np.array([x, y]) / np.hypot(x, y), atol=1e-4)
    # Without the key as in the configuration of a car.
    env = gymnasium.make(name, reference=circle)
    env.reset(seed=2)
    unwrapped: Any = env.unwrapped
    assert not np.allclose(unwrapped.reference[:2], (1.0, 0.0), atol=1e-3)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_same_seed_gives_the_same_bits_alone_and_side_by_side(name: str) -> None:
    steps = 120

    def alone(seed: int) -> list[np.ndarray]:
        env = gymnasium.make(name, randomise="other-cars")
        rows = [env.reset(seed=seed)[0]]
        rows += [env.step(DRIVE)[0] for _ in range(steps)]
        return rows

    assert np.array_equal(alone(3), alone(3))
    assert not np.array_equal(alone(3), alone(4))
    for threads in (1, 2):
        vector = gymnasium.make_vec(name, num_envs=3, randomise="other-cars", threads=threads)
        rows = [vector.reset(seed=3)[0]]
        rows += [vector.step(np.tile(DRIVE, (3, 1)))[0] for _ in range(steps)]
        side_by_side = np.stack(rows, axis=1)
        for index in range(3):
            assert np.array_equal(side_by_side[index], alone(3 + index))


def test_a_car_that_is_lost_ends_its_episode_with_the_reason() -> None:
    env = gymnasium.make("Singletrack-v0")
    env.reset(seed=1)
    for _ in range(1_000):
        _, reward, terminated, truncated, info = env.step(np.array([-0.4, 1.0], np.float32))
        if terminated:
            break
    assert terminated and not truncated
    assert reward == -10.0 and info["reason"] == "lost"


def test_the_supervisor_ends_an_episode_of_the_whole_system() -> None:
    env = gymnasium.make(
        "Singletrack-System-v0",
        lost=100.0,
        configuration={"fence.corners_m": [[-2.5, -2.5], [2.5, -2.5], [2.5, 2.5], [-2.5, 2.5]]},
    )
    env.reset(seed=1)
    for _ in range(1_500):
        *_, terminated, _, info = env.step(np.array([0.0, 1.0], np.float32))
        if terminated:
            break
    assert "fence" in info["reason"]


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_episodes_end_and_begin_as_gymnasium_wants_it(mode: AutoresetMode) -> None:
    vector = gymnasium.make_vec(
        "Singletrack-v0",
        num_envs=4,
        max_episode_steps=10,
        autoreset_mode=mode,
    )
    first, _ = vector.reset(seed=0)
    actions = np.tile(DRIVE, (4, 1))
    for _ in range(9):
        *_, truncated, _ = vector.step(actions)
        assert not truncated.any()
    observation, _, _, truncated, info = vector.step(actions)
    assert truncated.all()
    if mode is AutoresetMode.SAME_STEP:
        assert info["_final_obs"].all()
        assert not np.array_equal(info["final_obs"][0], observation[0])
        # A car at rest.
        assert np.all(observation[:, 0] == 0.0)
    elif mode is AutoresetMode.NEXT_STEP:
        observation, reward, _, truncated, _ = vector.step(actions)
        assert not truncated.any() and not reward.any()
        assert np.all(observation[:, 0] == 0.0)
    else:
        with pytest.raises(ValueError, match="reset"):
            vector.step(actions)
        mask = np.array([True] * 4)
        vector.reset(options={"reset_mask": mask})
        vector.step(actions)


def test_the_own_law_tracks_the_circle_in_both_environments() -> None:
    for name, most in zip(ENVIRONMENTS, (0.03, 0.05), strict=True):
        env = gymnasium.make(name, control_input=["point_velocity"], start_error=(0.05, 0.1))
        env.reset(seed=1)
        car: Any = env.unwrapped
        for step in range(1_000):
            x, y, vx, vy = car.reference
            px, py = car.point
            *_, terminated, _, info = env.step(np.array([vx + x - px, vy + y - py], np.float32))
            assert not terminated
            if step > 600:
                assert info["point_error"] < most


def test_names_and_values_are_those_of_f1tenth_gym() -> None:
    vector = gymnasium.make_vec("Singletrack-v0", num_envs=2, observation="kinematic_state")
    vector.reset(seed=1)
    for _ in range(200):
        observation, *_ = vector.step(np.tile(DRIVE, (2, 1)))
    names = ["pose_x", "pose_y", "delta", "linear_vel_x", "pose_theta", "ang_vel_z", "beta"]
    assert list(observation) == names
    assert np.allclose(observation["linear_vel_x"], 0.5, atol=0.08)
    assert np.allclose(observation["delta"], 0.25, atol=0.01)
    assert np.all(observation["ang_vel_z"] > 0.2)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"timestep": 0.015}, "timestep"),
        ({"control_input": ["torque"]}, "control_input"),
        ({"reward": "much"}, "reward"),
        ({"randomise": {"servo.lag_ms": (0.0, 1.0)}}, "servo.lag_ms"),
        ({"randomise": {"lag": (0.0, 1.0)}}, "section.key"),
        ({"randomise": {"servo.lag_ms": (50.0, 20.0)}}, "in order"),
        ({"reference": {"kind": "circle"}}, "radius_m"),
        ({"configuration": {"limits.max_sped": 1.0}}, "max_sped"),
    ],
)
def test_a_mistake_is_named(options: dict[str, Any], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        gymnasium.make("Singletrack-v0", **options)


def test_an_action_that_is_not_finite_is_refused() -> None:
    env = gymnasium.make("Singletrack-v0", disable_env_checker=True)
    env.reset(seed=1)
    with pytest.raises(ValueError, match="finite"):
        env.step(np.array([np.nan, 0.1], np.float32))


def _point(x: float, y: float, yaw: float) -> tuple[float, float]:
    return singletrack.law.point(x, y, yaw, 0.0)
