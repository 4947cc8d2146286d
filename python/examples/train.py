"""Trains a policy on the car alone, and drives it on the whole system.

Augmented random search of a linear policy (Mania, Guy, Recht 2018), which needs nothing but
numpy: some two minutes on two cores. Writes ``policy.npz`` and the curve ``training.csv``.
``--short`` only shows that it runs.
"""

import argparse
import math
import time
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import singletrack  # noqa: F401  (registers the environments)

#: Directions that are tried at once, each with both signs on ``CARS`` cars.
DIRECTIONS, CARS, BEST = 24, 2, 12
NOISE, STEP_SIZE, EPISODE = 0.05, 0.06, 400
TASK: dict[str, Any] = {"timestep": 0.02, "start_error": (0.1, 0.2)}


class Policy:
    """Steering and speed as a linear function of the normalised observation."""

    def __init__(self, space: Any, columns: int) -> None:
        self.middle, self.half = (space.high + space.low) / 2, (space.high - space.low) / 2
        self.weights = np.zeros((2, columns + 1))
        self.count, self.mean, self.square = 1e-3, np.zeros(columns), np.full(columns, 1e-3)

    def see(self, rows: NDArray[np.floating[Any]]) -> None:
        """Updates mean and spread of the observations."""
        weight = len(rows)
        total = self.count + weight
        change = rows.mean(axis=0) - self.mean
        self.mean = self.mean + change * weight / total
        spread = change**2 * self.count * weight / total
        self.square = self.square + rows.var(axis=0) * weight + spread
        self.count = total

    def act(self, rows: NDArray[Any], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Actions; ``weights`` has the shape ``(2, columns)``, or one such for each row."""
        scaled = (rows - self.mean) / np.sqrt(self.square / self.count + 1e-6)
        inputs = np.concatenate([np.clip(scaled, -5, 5), np.ones((len(rows), 1))], axis=1)
        outputs = np.einsum("...ij,...j->...i", weights, inputs)
        return np.asarray(self.middle + self.half * np.tanh(outputs))


def returns(
    envs: Any, policy: Policy, weights: NDArray[np.float64], seed: int, episode: int
) -> NDArray[Any]:
    """The sum of rewards of the first episode of each car."""
    rows, _ = envs.reset(seed=seed)
    total, alive = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    for _ in range(episode):
        rows, reward, terminated, truncated, _ = envs.step(policy.act(rows, weights))
        total += np.where(alive, reward, 0.0)
        alive &= ~(terminated | truncated)
        policy.see(rows)
        if not alive.any():
            break
    return total


def train(iterations: int, seed: int, episode: int = EPISODE) -> Policy:
    """Trains on the car alone, with other people's cars."""
    count = 2 * DIRECTIONS * CARS
    envs = gymnasium.make_vec(
        "Singletrack-v0", num_envs=count, randomise="other-cars",
        max_episode_steps=episode + 1, **TASK,
    )  # fmt: skip
    columns = envs.single_observation_space.sample().size
    policy = Policy(envs.single_action_space, columns)
    generator = np.random.default_rng(seed)
    began = time.perf_counter()
    with open("training.csv", "w", encoding="utf-8") as curve:
        curve.write("steps,mean_return\n")
        for iteration in range(iterations):
            tried = generator.standard_normal((DIRECTIONS, *policy.weights.shape))
            both = np.concatenate([policy.weights + NOISE * tried, policy.weights - NOISE * tried])
            weights = np.repeat(both, CARS, axis=0)
            found = returns(envs, policy, weights, seed + count * iteration, episode)
            up, down = found.reshape(2, DIRECTIONS, CARS).mean(axis=2)
            best = np.argsort(-np.maximum(up, down))[:BEST]
            spread = np.concatenate([up[best], down[best]]).std() + 1e-6
            gain = np.einsum("d,dij->ij", up[best] - down[best], tried[best])
            policy.weights = policy.weights + STEP_SIZE / (BEST * spread) * gain
            curve.write(f"{(iteration + 1) * count * episode},{found.mean():.2f}\n")
            if iteration % 20 == 0 or iteration + 1 == iterations:
                passed = time.perf_counter() - began
                print(f"{iteration + 1:4} iterations, {passed:4.0f} s: return {found.mean():6.1f}")
    return policy


def drive(policy: Policy, name: str, steps: int = 1_000) -> float:
    """Drives the paper's circle; the root mean square of the distance of P from it, in m."""
    env = gymnasium.make(name, **TASK)
    rows, _ = env.reset(seed=1)
    errors = []
    for step in range(steps):
        action = policy.act(np.asarray(rows)[None], policy.weights)[0]
        rows, _, terminated, truncated, info = env.step(action.astype(np.float32))
        if step > 200:
            errors.append(info["point_error"])
        if terminated or truncated:
            print(f"{name}: ended after {0.02 * step:.1f} s: {info.get('reason')}")
            break
    return math.sqrt(np.mean(np.square(errors))) if errors else math.nan


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--short", action="store_true", help="two short iterations")
    options = parser.parse_args()
    short = (2, options.seed, 50)
    trained = train(*short) if options.short else train(options.iterations, options.seed)
    np.savez("policy.npz", weights=trained.weights, mean=trained.mean, square=trained.square)
    for name in ("Singletrack-v0", "Singletrack-System-v0"):
        print(f"{name}: rms {1e3 * drive(trained, name):.0f} mm from the reference")
