"""Environment steps per second: the car alone and the whole system, one car and many."""

import argparse
import time

import gymnasium
import numpy as np

import singletrack  # registers the environments


Rates = tuple[float, float]


def single(name: str, steps: int) -> Rates:
    """Steps of one car per second, and per second of a processor."""
    env = gymnasium.make(name, disable_env_checker=True, control_input=["point_velocity"])
    env.reset(seed=1)
    action = np.array([0.0, 0.5], np.float32)
    began, used = time.perf_counter(), time.process_time()
    for _ in range(steps):
        *_, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    return steps / (time.perf_counter() - began), steps / (time.process_time() - used)


def many(name: str, cars: int, steps: int) -> Rates:
    """The same of many cars together."""
    envs = gymnasium.make_vec(name, num_envs=cars, lost=1e9, max_episode_steps=10**9)
    envs.reset(seed=1)
    actions = np.tile(np.array([0.25, 0.5], np.float32), (cars, 1))
    began, used = time.perf_counter(), time.process_time()
    for _ in range(steps):
        envs.step(actions)
    done = cars * steps
    return done / (time.perf_counter() - began), done / (time.process_time() - used)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true", help="a tenth of the steps")
    share = 10 if parser.parse_args().short else 1
    print(f"singletrack {singletrack.__version__}: steps of 10 ms a second, and a second of CPU")
    for name, one, together in (
        ("Singletrack-v0", 10_000, 400),
        ("Singletrack-System-v0", 2_000, 20),
    ):
        for cars, (rate, of_cpu) in (
            (1, single(name, one // share)),
            (256, many(name, 256, max(2, together // share))),
        ):
            print(f"{name:22} {cars:4} cars {rate:10.0f} {of_cpu:10.0f}")
