"""Registers the environments with gymnasium."""

from __future__ import annotations

import importlib.util

#: Steps of 10 ms in an episode: 20 s.
MAX_STEPS = 2_000


def register() -> None:
    """Registers ``Singletrack-v0`` and ``Singletrack-System-v0``, if gymnasium is installed."""
    if importlib.util.find_spec("gymnasium") is None:
        return
    from gymnasium.envs.registration import register as register_one
    from gymnasium.envs.registration import registry

    for name, whole_system in (("Singletrack-v0", False), ("Singletrack-System-v0", True)):
        if name not in registry:
            register_one(
                id=name,
                entry_point="singletrack.gym:SingletrackEnv",
                vector_entry_point="singletrack.gym:SingletrackVectorEnv",
                max_episode_steps=MAX_STEPS,
                kwargs={"whole_system": whole_system},
            )
