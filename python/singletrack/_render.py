"""Pictures of a car on its reference, drawn with numpy."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from ._extra import load

Frame = NDArray[np.uint8]

#: Edge of a frame, in pixels.
SIZE = 480
#: What is seen around the reference, in m.
MARGIN = 0.8
#: Simulated time between two frames of a window, in s.
INTERVAL = 0.04

_GRID, _REFERENCE, _TRAIL = (232, 232, 232), (150, 150, 150), (235, 150, 140)
_BODY, _WHEEL, _POINT, _WANTED = (70, 110, 170), (40, 40, 40), (200, 40, 30), (60, 60, 60)


class Picture:
    """A view from above: grid of 1 m, reference, trail of P, the car and P.

    Args:
        path: Places of the reference, m: shape ``(n, 2)``.
        geometry: Distances from G to the front and rear axle, and from the front axle to P, m.
    """

    def __init__(self, path: NDArray[np.float64], geometry: tuple[float, float, float]) -> None:
        self._front, self._rear, self._ahead = geometry
        low, high = path.min(axis=0), path.max(axis=0)
        span = float((high - low).max()) + 2 * MARGIN
        self._scale = SIZE / span
        self._corner = (low + high) / 2 - span / 2
        self._empty: Frame = np.full((SIZE, SIZE, 3), 255, np.uint8)
        for metre in range(math.floor(self._corner.min()), math.ceil(self._corner.max() + span)):
            for far in (np.array([1e3, 0.0]), np.array([0.0, 1e3])):
                middle = metre * (far == 0.0)
                self._line(self._empty, middle - far, middle + far, 0.5 / self._scale, _GRID)
        for begin, end in zip(path, path[1:]):
            self._line(self._empty, begin, end, 0.008, _REFERENCE)
        self._ground, self._trail = self._empty, list[NDArray[np.float64]]()

    def follow(self, step: int, state: NDArray[np.float64]) -> None:
        """Adds the P of a state to the trail, which begins with an episode."""
        if step == 0:
            self._ground, self._trail = self._empty.copy(), []
        self._trail.append(self._point(state))

    def draw(self, state: NDArray[np.float64], wanted: NDArray[np.float64]) -> Frame:
        """The car in a state, with the place of its reference."""
        for begin, end in zip(self._trail, self._trail[1:]):
            self._line(self._ground, begin, end, 0.008, _TRAIL)
        del self._trail[:-1]
        frame = self._ground.copy()
        x, y, steering, _, yaw, *_ = state
        along = _direction(yaw)
        across = np.array([-along[1], along[0]])
        centre = np.array([x, y])
        front, rear = centre + self._front * along, centre - self._rear * along
        self._line(frame, rear - 0.02 * along, front + 0.02 * along, 0.07, _BODY)
        for axle, angle in ((front, yaw + steering), (rear, yaw)):
            half = 0.03 * _direction(angle)
            for side in (-0.075 * across, 0.075 * across):
                self._line(frame, axle + side - half, axle + side + half, 0.014, _WHEEL)
        point = self._point(state)
        self._line(frame, front, point, 0.004, _WHEEL)
        self._line(frame, wanted, wanted, 0.03, _WANTED)
        self._line(frame, point, point, 0.022, _POINT)
        return frame

    def _point(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y, steering, _, yaw, *_ = state
        ahead = self._front * _direction(yaw) + self._ahead * _direction(yaw + steering)
        return np.array([x, y]) + ahead

    def _line(
        self,
        image: Frame,
        begin: NDArray[np.float64],
        end: NDArray[np.float64],
        radius: float,
        colour: tuple[int, int, int],
    ) -> None:
        """A line with round ends, in m; its edges are smooth."""
        flip = np.array([1.0, -1.0])
        bx, by = (begin - self._corner) * flip * self._scale + (0, SIZE)
        ex, ey = (end - self._corner) * flip * self._scale + (0, SIZE)
        pixels = max(radius * self._scale, 0.5)
        left, right = _span(bx, ex, pixels)
        top, bottom = _span(by, ey, pixels)
        if left >= right or top >= bottom:
            return
        x, y = np.arange(left, right) + 0.5 - bx, np.arange(top, bottom)[:, None] + 0.5 - by
        square = (ex - bx) ** 2 + (ey - by) ** 2
        share = np.clip((x * (ex - bx) + y * (ey - by)) / max(square, 1e-12), 0.0, 1.0)
        distance = np.hypot(x - share * (ex - bx), y - share * (ey - by))
        cover = np.clip(pixels + 0.5 - distance, 0.0, 1.0)[..., None]
        part = image[top:bottom, left:right]
        part[...] = part + cover * (np.array(colour) - part) + 0.5


class Window:
    """A window that shows frames in real time."""

    def __init__(self) -> None:
        self._pyplot = load("matplotlib.pyplot", "plots")
        self._figure = self._pyplot.figure("singletrack", figsize=(5, 5))
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.axis("off")
        self._image = axes.imshow(np.zeros((SIZE, SIZE, 3), np.uint8))
        self._figure.show(warn=False)
        self._ahead, self._due = 0.0, time.monotonic()

    def is_due(self, seconds: float) -> bool:
        """Whether a frame is due after further simulated time; waits for real time then."""
        self._ahead += seconds
        if self._ahead < INTERVAL:
            return False
        self._due = max(self._due + self._ahead, time.monotonic() + 1e-3)
        self._ahead = 0.0
        self._figure.canvas.start_event_loop(self._due - time.monotonic())
        return True

    def show(self, frame: Frame) -> None:
        """Shows a frame."""
        self._image.set_data(frame)
        self._figure.canvas.draw_idle()
        self._figure.canvas.flush_events()

    def close(self) -> None:
        """Closes the window."""
        self._pyplot.close(self._figure)


def _direction(angle: float) -> NDArray[np.float64]:
    return np.array([math.cos(angle), math.sin(angle)])


def _span(begin: float, end: float, radius: float) -> tuple[int, int]:
    """The pixels of an interval that are in the frame."""
    low, high = min(begin, end) - radius - 1, max(begin, end) + radius + 2
    return int(np.clip(low, 0, SIZE)), int(np.clip(high, 0, SIZE))
