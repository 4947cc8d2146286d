"""Trains a policy with stable-baselines3's PPO on the car alone, and drives it on the whole system.

``pip install singletrack[gym] stable-baselines3``, with torch for the CPU: see docs/python.md.
Writes ``policy_sb3.zip`` and the curve ``training_sb3.csv``.
"""

import argparse
import math
import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

import singletrack  # noqa: F401  (registers the environments)

CARS, EPISODE = 64, 400
TASK: dict[str, Any] = {"timestep": 0.02, "start_error": (0.1, 0.2)}


class Cars(VecEnv):
    """The native cars, side by side, as stable-baselines3 wants them: actions within -1 and 1."""

    _seeds: list[int | None]

    def __init__(self, count: int) -> None:
        self.cars: Any = gymnasium.make_vec(
            "Singletrack-v0", num_envs=count, autoreset_mode=AutoresetMode.SAME_STEP,
            randomise="other-cars", max_episode_steps=EPISODE, **TASK,
        )  # fmt: skip
        space = self.cars.single_action_space
        actions = gymnasium.spaces.Box(-1.0, 1.0, space.shape, np.float32)
        super().__init__(count, self.cars.single_observation_space, actions)
        self.actions = np.zeros((count, 2), np.float32)

    def reset(self) -> Any:
        seed, self._seeds = self._seeds[0], [None] * self.num_envs
        return self.cars.reset(seed=seed)[0]

    def step_async(self, actions: Any) -> None:
        self.actions = scaled(actions, self.cars.single_action_space)

    def step_wait(self) -> Any:
        rows, rewards, terminated, truncated, known = self.cars.step(self.actions)
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for index in np.flatnonzero(ended):
            infos[index]["terminal_observation"] = known["final_obs"][index]
            # The value of the last state counts only if the time was up.
            infos[index]["TimeLimit.truncated"] = bool(truncated[index] and not terminated[index])
        return rows, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        self.cars.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.cars, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **keys: Any) -> Any:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> Sequence[bool]:
        return [False] * self.num_envs


def scaled(actions: Any, space: Any) -> Any:
    """Actions between -1 and 1 on the ranges of the space."""
    return space.low + (np.clip(actions, -1.0, 1.0) + 1.0) / 2.0 * (space.high - space.low)


class Curve(BaseCallback):
    """Writes the mean return of the latest episodes after each round."""

    def __init__(self) -> None:
        super().__init__()
        self.began, self.rounds = time.perf_counter(), 0
        self.file = open("training_sb3.csv", "w", encoding="utf-8")
        self.file.write("steps,seconds,mean_return\n")

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        episodes = self.model.ep_info_buffer
        if episodes:
            mean = np.mean([episode["r"] for episode in episodes])
            passed = time.perf_counter() - self.began
            self.file.write(f"{self.num_timesteps},{passed:.1f},{mean:.2f}\n")
            self.file.flush()
            if self.rounds % 10 == 0:
                print(f"{self.num_timesteps:9} steps, {passed:4.0f} s: return {mean:6.1f}", flush=True)
        self.rounds += 1


def train(steps: int, seed: int) -> PPO:
    """Trains on the car alone, with other people's cars."""
    model = PPO(
        "MlpPolicy", VecMonitor(Cars(CARS)), n_steps=128, batch_size=1024, n_epochs=6,
        learning_rate=lambda left: 6e-4 * left + 3e-5, gamma=0.97, gae_lambda=0.93, seed=seed,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0}, device="cpu",
    )  # fmt: skip
    return model.learn(steps, callback=Curve())


def drive(model: PPO, name: str, steps: int = 1_000) -> float:
    """Drives the paper's circle; the root mean square of the distance of P from it, in m."""
    env = gymnasium.make(name, **TASK)
    row, _ = env.reset(seed=1)
    errors = []
    for step in range(steps):
        action, _ = model.predict(row, deterministic=True)
        row, _, terminated, truncated, info = env.step(scaled(action, env.action_space))
        if step > 200:
            errors.append(info["point_error"])
        if terminated or truncated:
            print(f"{name}: ended after {0.02 * step:.1f} s: {info.get('reason')}")
            break
    return math.sqrt(np.mean(np.square(errors))) if errors else math.nan


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    # The network is small: threads cost more than they give.
    torch.set_num_threads(1)
    trained = train(options.steps, options.seed)
    trained.save("policy_sb3")
    for name in ("Singletrack-v0", "Singletrack-System-v0"):
        print(f"{name}: rms {1e3 * drive(trained, name):.0f} mm from the reference")
