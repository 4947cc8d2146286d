"""Several cars, each with a daemon of its own."""

from __future__ import annotations

import os
import warnings
from typing import Any

from ._errors import ArmError, SingletrackError
from ._native import Fleet as _Native
from ._native import FleetDrive as _NativeDrive


class Fleet:
    """The cars of a file as that of `singletrack fleet`.

    Args:
        path: The file, such as `fleet.toml`.
    """

    def __init__(self, path: str | os.PathLike[str] = "fleet.toml") -> None:
        self._native = _Native(os.fspath(path))

    @property
    def sockets(self) -> dict[str, str]:
        """The control socket of each car, by its name: for :class:`Car`."""
        return {name: os.fspath(socket) for name, socket in self._native.sockets()}

    def status(self) -> dict[str, dict[str, Any]]:
        """By name, the daemon's answer to `status`; only ``error``, why there is none."""
        return self._native.status()

    def arm(
        self, *, start_in: float = 3.0, together: bool = False, uncalibrated: bool = False
    ) -> FleetDrive:
        """Arms all cars if all are ready. They follow the references of their configurations.

        Args:
            start_in: The time in s until all references begin, within 10 ms of each other.
            together: Stop all when the drive of one ends.
            uncalibrated: Arm also cars whose commissioning is not complete.
        """
        try:
            return FleetDrive(self._native.arm(start_in, together, uncalibrated))
        except RuntimeError as error:
            raise ArmError(str(error)) from error

    def disarm(self) -> None:
        """Slows all cars down, also those of another program."""
        self._tell(stops=False)

    def stop(self) -> None:
        """Emergency stop of all cars: neutral at once, until their boards are reset."""
        self._tell(stops=True)

    def _tell(self, *, stops: bool) -> None:
        try:
            self._native.tell(stops)
        except RuntimeError as error:
            raise SingletrackError(str(error)) from error


class FleetDrive:
    """The drive of all cars; as a context, it ends with :meth:`disarm`.

    It goes on only while the program calls :meth:`hold` at least every 0.1 s. When the program
    hangs or dies, each car begins to stop by itself within 0.2 s.
    """

    def __init__(self, native: _NativeDrive) -> None:
        self._native = native

    @property
    def time(self) -> float:
        """The time in s since the references began; negative before."""
        return self._native.time()

    def hold(self, seconds: float = 0.0) -> bool:
        """Holds the drives for this time, and at least once. Whether a car still drives.

        Raises :class:`ArmError` if a car was not armed: then no car drives.
        """
        try:
            goes_on = self._native.hold(seconds)
        except RuntimeError as error:
            raise ArmError(str(error)) from error
        for warning in self._native.warnings():
            warnings.warn(warning, RuntimeWarning, stacklevel=2)
        return goes_on

    def disarm(self) -> dict[str, tuple[str, str | None]]:
        """Slows all cars down, and waits until they stand. Returns :attr:`ends`."""
        self._native.disarm()
        while self.hold(0.1):
            pass
        return self.ends

    @property
    def ends(self) -> dict[str, tuple[str, str | None]]:
        """By name, mode and reason of each car whose drive has ended."""
        try:
            return {name: (mode, reason) for name, mode, reason in self._native.ends()}
        except RuntimeError as error:
            raise ArmError(str(error)) from error

    def __enter__(self) -> FleetDrive:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.disarm()
        except ArmError:
            # What the block raised says why.
            if kind is None:
                raise
