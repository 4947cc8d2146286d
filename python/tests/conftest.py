"""A daemon and a simulated car in real time, for the tests of the socket."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import threading
import time
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

from singletrack import Simulator

# Windows are drawn and not shown.
os.environ["MPLBACKEND"] = "agg"

PROGRAMS = ("SINGLETRACKD", "SINGLETRACK_SIM")
#: The Arduino's image too, where it is given.
BOARDS = ["native", *(["uno"] if "SINGLETRACK_UNO" in os.environ else [])]


#: Above this lateness of the machine, in s, a test in real time shows nothing: a simulated car
#: that is held up stops, as it should.
TOO_LATE = 0.04


class MachineLate(Exception):
    """A test in real time failed on a machine that was late."""


class Lateness:
    """How late this machine wakes a thread."""

    def __init__(self) -> None:
        self.longest = 0.0
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while True:
            begin = time.monotonic()
            time.sleep(0.005)
            self.longest = max(self.longest, time.monotonic() - begin - 0.005)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    if item.get_closest_marker("flaky") is None:
        return (yield)
    lateness = Lateness()
    try:
        return (yield)
    # What `pytest.raises` and `pytest.fail` raise is no `Exception`.
    except (Exception, pytest.fail.Exception) as error:
        if lateness.longest > TOO_LATE:
            raise MachineLate(f"by {lateness.longest * 1e3:.0f} ms") from error
        raise


class Daemon:
    """The daemon with its simulator: ``socket``, and ``token`` of its port on TCP."""

    def __init__(
        self, folder: Path, board: str = "native", reference: dict[str, Any] | None = None
    ) -> None:
        self.socket = folder / "control.sock"
        self.token = folder / "control.sock.token"
        line = folder / "uno"
        configuration = folder / "car.toml"
        # The configuration of the simulated car, with the addresses of this test.
        reference = reference or {"kind": "external"}
        text = Simulator(configuration={"reference": reference}).configuration()
        commands, frames = _free_port(), _free_port()
        text = _set(text, "serial", "port", f'"{line}"')
        # The port is left out by default.
        port = f'"127.0.0.1"\ncommand_port = {commands}'
        text = _set(text, "motion_capture", "interface", port)
        text = _set(text, "motion_capture", "data_port", f"{frames}")
        text = _set(text, "record", "directory", f'"{folder / "records"}"')
        text = _set(text, "state", "directory", f'"{folder / "state"}"')
        text = _set(text, "socket", "path", f'"{self.socket}"\ntcp_port = 0')
        configuration.write_text(text)
        self.log = (folder / "log").open("wb")
        self.simulator = subprocess.Popen(
            [
                os.environ["SINGLETRACK_SIM"],
                *("--board", board),
                *("--port", str(line)),
                *("--command-port", str(commands)),
                *("--data-port", str(frames)),
                *("--start", "1,-0.4868,90"),
            ],
            stdout=self.log,
            stderr=self.log,
            preexec_fn=_before_others,
        )
        _wait(line)
        self.daemon = subprocess.Popen(
            [os.environ["SINGLETRACKD"], "--config", str(configuration)],
            stdout=self.log,
            stderr=self.log,
        )
        _wait(self.socket)

    def close(self) -> None:
        for program in (self.daemon, self.simulator):
            program.terminate()
        for program in (self.daemon, self.simulator):
            program.wait(10)
        self.log.close()


def _before_others() -> None:
    """A real car is not held up by other programs; where it is allowed, neither is this one."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    except PermissionError:
        pass


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _set(text: str, section: str, key: str, value: str) -> str:
    pattern = rf"(\[{section}\]\n(?:[^\[].*\n|\n)*?){key} = .*\n"
    replaced, count = re.subn(pattern, rf"\g<1>{key} = {value}\n", text)
    assert count == 1, f"{section}.{key}"
    return replaced


def _wait(path: Path) -> None:
    deadline = time.monotonic() + 15
    while not path.exists():
        assert time.monotonic() < deadline, f"no {path}"
        time.sleep(0.02)


@pytest.fixture
def programs() -> None:
    missing = [name for name in PROGRAMS if name not in os.environ]
    if missing:
        pytest.skip(f"set {', '.join(missing)} to the programs")


@pytest.fixture
def daemon(
    tmp_path: Path, request: pytest.FixtureRequest, programs: None
) -> Iterator[Daemon]:
    running = Daemon(tmp_path, getattr(request, "param", "native"))
    yield running
    running.close()
