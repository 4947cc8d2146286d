"""The whole system in virtual time."""

from __future__ import annotations

import os
from typing import Any

from . import _native
from ._closing import Closing
from ._state import State, state
from ._toml import Table, text


class Simulator(Closing):
    """Host, board, serial line, cameras and car in virtual time.

    The host's and the board's code are those of the car; only clock, line and network are
    simulated. The same arguments and the same calls give the same bits. It runs faster than
    real time, and only when it is stepped.

    Args:
        seed: Seed of all noise.
        start: ``(x, y, yaw)`` of the centre of mass, in m and rad.
        point: ``(x, y, yaw)`` with P, instead of the centre of mass, at this place.
        configuration: Keys of the daemon's configuration that differ from those of the
            simulated car, such as ``{"fence": {"corners_m": ...}}`` or
            ``{"limits.max_speed_m_s": 1.0}``; TOML text or a path of a file are taken too.
        truth: What is true of the car and differs from the configuration, such as
            ``{"servo.centre_us": 1510}``; see :func:`truth_keys`.
        reference: Keys of ``[reference]``; set-points from this program if left out.
        record: Path of a record to write. :meth:`close` completes it.
    """

    def __init__(
        self,
        *,
        seed: int = 1,
        start: tuple[float, float, float] | None = None,
        point: tuple[float, float, float] | None = None,
        configuration: Table = None,
        truth: Table = None,
        reference: Table = None,
        record: str | os.PathLike[str] | None = None,
    ) -> None:
        if start is not None and point is not None:
            raise ValueError("give start or point, not both")
        pose = point if point is not None else start or (0.0, 0.0, 0.0)
        self._native = _native.Simulator(
            seed=seed,
            start=[float(value) for value in pose],
            point=point is not None,
            configuration=text(configuration),
            truth=text(truth),
            reference_toml=None if reference is None else text(reference),
            record=None if record is None else os.fspath(record),
        )

    def step(self, ticks: int = 1) -> State:
        """Runs ticks of 10 ms; returns the state after the last one."""
        self._native.step(ticks)
        return self.state

    @property
    def state(self) -> State:
        """The state after the last tick; one is run if there was none."""
        values = self._native.state()
        if values is None:
            return self.step()
        return state(values)

    @property
    def now(self) -> float:
        """The virtual time, in s."""
        return self._native.now

    @property
    def mode(self) -> str:
        """The mode of the supervisor."""
        return self._native.mode

    def truth(self) -> dict[str, Any]:
        """The ground truth: ``x``, ``y``, ``yaw``, ``speed``, ``point``, ... of the car."""
        return self._native.truth()

    def arm(self) -> None:
        """Requests to drive, with the next tick."""
        self._native.request("arm")

    def disarm(self) -> None:
        """Requests to slow down, stop and disarm, with the next tick."""
        self._native.request("disarm")

    def stop(self) -> None:
        """Requests an emergency stop, with the next tick: neutral until the board is reset."""
        self._native.request("stop")

    def set_reference(self, reference: Table) -> int:
        """Puts another reference in force; returns the number of the configuration."""
        return self._native.set_reference(text(reference))

    def lose_markers(self, duration: str) -> None:
        """The cameras lose the car once, from now on, for a time such as ``"300ms"``."""
        self._native.lose_markers(duration)

    def marker_loss(self, pattern: str | None) -> None:
        """The cameras lose the car periodically, such as ``"200ms@2s"``; ``None`` ends it."""
        self._native.marker_loss(pattern)

    def fault(self, name: str, value: Any) -> None:
        """Sets a fault.

        ============== =====================================================
        name           value
        ============== =====================================================
        imu            none, silent, stuck, saturated, erratic
        motor_sensor   none, gone, doubled, halved, erratic
        cameras        none, occluded, absent, silent
        camera_jump_m  (x, y, z) added to the car's position
        line_drop      probability that a byte of the serial line is lost
        line_corrupt   probability that a bit of a byte is flipped
        line_delay_us  further delay of every byte
        line_stuck     whether nothing passes
        cable          whether the USB cable is plugged in, which carries the board's power
        board_power    whether the board has power
        esc_power      whether the ESC is switched on
        battery        whether the battery is plugged in
        servo_reversed whether the servo turns the other way
        stop_switch    whether the stop input is open
        ============== =====================================================
        """
        self._native.set_fault(name, value)

    def press_reset(self) -> None:
        """Presses the board's reset button."""
        self._native.press_reset()

    def place(self, x: float, y: float, yaw: float) -> None:
        """Puts the car down elsewhere, at rest."""
        self._native.place(x, y, yaw)

    def configuration(self) -> str:
        """The daemon's configuration, as TOML."""
        return self._native.configuration()

    def close(self) -> None:
        """Completes the record, if there is one."""
        self._native.finish()


def truth_keys() -> dict[str, tuple[str, str]]:
    """The keys of ``truth``: range and meaning of each."""
    return {name: (range_, help_) for name, range_, help_ in _native.truth_keys()}
