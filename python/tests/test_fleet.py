"""Two cars with a daemon each, in real time."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import Daemon, Lateness

from singletrack import ArmError, Car, Fleet

CIRCLE = {"kind": "circle", "radius_m": 1.0, "angular_velocity_rad_s": 0.5}
HOLDER = """
import sys, singletrack
drive = singletrack.Fleet(sys.argv[1]).arm(start_in=1.0)
while drive.hold(0.05):
    print(drive.time, flush=True)
"""


@pytest.fixture
def fleet(tmp_path: Path, programs: None) -> Iterator[Path]:
    """The file of two cars that have just been started."""
    daemons, text = [], ""
    for name in ("car1", "car2"):
        folder = tmp_path / name
        folder.mkdir()
        daemons.append(Daemon(folder, reference=CIRCLE))
        text += f'[[car]]\nname = "{name}"\nsocket = "{daemons[-1].socket}"\n'
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    yield file
    for daemon in daemons:
        daemon.close()


def wait(fleet: Fleet, mode: str) -> None:
    deadline = time.monotonic() + 20
    while any((car.get("state") or {}).get("mode") != mode for car in fleet.status().values()):
        assert time.monotonic() < deadline, fleet.status()
        time.sleep(0.05)


@pytest.mark.flaky(reruns=3, only_rerun="MachineLate")
def test_the_cars_drive_while_the_program_holds_them(fleet: Path, tmp_path: Path) -> None:
    cars = Fleet(fleet)
    with pytest.raises(ArmError, match="car1: not ready .*no car was armed"):
        cars.arm()
    wait(cars, "ready")
    other = tmp_path / "other.toml"
    other.write_text(fleet.read_text().replace("[[car]]", "[[car]]\nnumber = 7", 1))
    with pytest.raises(ArmError, match="car1: number is 7, and board.car_id of its daemon is"):
        Fleet(other).arm()

    with cars.arm(start_in=1.0) as drive:
        assert drive.time < 0.0
        assert drive.hold(2.0) and 0.9 < drive.time
        assert {car["state"]["mode"] for car in cars.status().values()} == {"driving"}
        assert drive.ends == {}
    assert {reason for _, reason in drive.ends.values()} == {"requested"}
    assert set(drive.ends) == set(cars.sockets)
    cars.stop()
    wait(cars, "fault")
    assert {car["state"]["reason"] for car in cars.status().values()} == {"emergency-stop"}


@pytest.mark.flaky(reruns=3, only_rerun="MachineLate")
def test_the_cars_stop_when_the_program_is_killed(fleet: Path) -> None:
    cars = Fleet(fleet)
    wait(cars, "ready")
    holder = subprocess.Popen([sys.executable, "-P", "-c", HOLDER, fleet], stdout=subprocess.PIPE)
    wait(cars, "driving")
    watched = [Car(socket) for socket in cars.sockets.values()]
    lateness, killed = Lateness(), time.monotonic()
    holder.kill()
    while any(car.state.mode == "driving" for car in watched):
        assert time.monotonic() < killed + 0.2 + lateness.longest
    holder.wait()
    wait(cars, "ready")
    for car in watched:
        assert car.status()["state"]["reason"] == "operator-gone"
