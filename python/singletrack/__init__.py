"""Drive a 1:10 car under motion capture, simulate it, and train on it.

One script drives the simulator and the car::

    import singletrack

    car = singletrack.Car("sim")            # or Car("/run/singletrackd/control.sock")
    with car.drive() as drive:
        for state in drive:
            drive.point_velocity(0.4, 0.0)
            if state.drive_time_s > 5:
                break

Units are SI and radians. The world frame lies on the floor; yaw, yaw rate, sideslip and
steering are positive to the left. ``singletrack.gym`` needs the package ``gymnasium``.
"""

from importlib.metadata import version as _version

from . import law, model, stability
from ._car import Car
from ._compare import Comparison, Path, compare
from ._drive import Drive
from ._errors import ArmError, Rejected, SingletrackError
from ._fleet import Fleet, FleetDrive
from ._register import register as _register
from ._record import Record, read
from ._simulator import Simulator
from ._state import State

__all__ = [
    "ArmError",
    "Car",
    "Comparison",
    "Drive",
    "Fleet",
    "FleetDrive",
    "Path",
    "Record",
    "Rejected",
    "Simulator",
    "SingletrackError",
    "State",
    "compare",
    "law",
    "model",
    "read",
    "stability",
]
__version__ = _version("singletrack")

# For `gymnasium.make("Singletrack-v0")`.
_register()
