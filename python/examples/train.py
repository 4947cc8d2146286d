"""Trains a policy on the car alone, and drives it on the whole system.

``pip install singletrack[train]``; a few minutes on two cores. ``--short`` only shows that it
runs. Writes ``policy.zip`` and the curve ``training.csv``.
"""

import argparse
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

import singletrack  # noqa: F401  (registers the environments)


class Native(VecEnv):  # type: ignore[misc]
    """The native environments with the interface of stable-baselines3, actions in [-1, 1]."""

    def __init__(self, name: str, cars: int, **options: Any) -> None:
        self.envs: Any = gymnasium.make_vec(
            name, num_envs=cars, autoreset_mode="SameStep", **options
        )
        box = self.envs.single_action_space
        self.middle, self.half = (box.high + box.low) / 2, (box.high - box.low) / 2
        space = gymnasium.spaces.Box(-1.0, 1.0, box.shape, np.float32)
        super().__init__(cars, self.envs.single_observation_space, space)
        self._seed: int | None = None

    def physical(self, action: np.ndarray) -> np.ndarray:
        return self.middle + self.half * np.clip(action, -1.0, 1.0)

    def reset(self) -> np.ndarray:
        observation: np.ndarray = self.envs.reset(seed=self._seed)[0]
        self._seed = None
        return observation

    def seed(self, seed: int | None = None) -> list[int | None]:
        self._seed = seed
        return [seed]

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = self.physical(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observation, reward, terminated, truncated, info = self.envs.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for index in np.flatnonzero(terminated | truncated):
            infos[index] = {
                "terminal_observation": info["final_obs"][index],
                "TimeLimit.truncated": bool(truncated[index]),
            }
        return observation, reward.astype(np.float32), terminated | truncated, infos

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **more: Any) -> Any:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


class Curve(BaseCallback):  # type: ignore[misc]
    """Writes the mean return over the steps."""

    def __init__(self) -> None:
        super().__init__()
        self.file = open("training.csv", "w")
        self.file.write("steps,mean_return\n")

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        returns = [episode["r"] for episode in self.model.ep_info_buffer]
        if returns:
            self.file.write(f"{self.num_timesteps},{np.mean(returns):.2f}\n")
            self.file.flush()


def drive(policy: PPO, training: Native, steps: int) -> float:
    """Drives on the whole system; returns the root mean square of the distance of P, in m."""
    env = gymnasium.make("Singletrack-System-v0", timestep=0.02)
    observation, _ = env.reset(seed=1)
    errors = []
    for step in range(steps):
        action, _ = policy.predict(observation, deterministic=True)
        observation, _, terminated, truncated, info = env.step(training.physical(action))
        if step > 100:
            errors.append(info["point_error"])
        if terminated or truncated:
            print(f"ended after {0.02 * step:.1f} s: {info.get('reason')}")
            break
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=2_000_000)
    parser.add_argument("--short", action="store_true", help="only a few steps")
    options = parser.parse_args()
    cars = 64
    training = Native("Singletrack-v0", cars, timestep=0.02, randomise="other-cars",
                      max_episode_steps=500, start_error=(0.2, 0.3))  # fmt: skip
    policy = PPO(
        "MlpPolicy", VecMonitor(training), n_steps=128, batch_size=2_048, n_epochs=5,
        learning_rate=5e-4, gamma=0.98, seed=1, device="cpu",
        policy_kwargs={"log_std_init": -1.0},
    )  # fmt: skip
    policy.learn(20_000 if options.short else options.steps, callback=Curve())
    policy.save("policy")
    print(f"whole system: rms {1e3 * drive(policy, training, 1_000):.0f} mm")
