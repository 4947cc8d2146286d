"""Answers of the exercises of the notebooks: a right one and a wrong one of each, in order."""

BISECT = """
def bisect(holds, low, high, count=20):
    for _ in range(count):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
"""

LAW = """
def my_law(yaw, yaw_rate, sideslip, steering, velocity):
    along = np.array([math.cos(yaw + steering), math.sin(yaw + steering)])
    across = np.array([-along[1], along[0]])
    turning = car.front_axle_distance_m * yaw_rate
    speed = along @ velocity - turning * math.sin(steering)
    speed /= math.cos(sideslip - steering)
    rest = across @ velocity - speed * math.sin(sideslip - steering) - turning * math.cos(steering)
    return speed, rest / P - yaw_rate
"""

LOSS = (
    BISECT
    + """
def survives(milliseconds):
    simulator, lost = singletrack.Simulator(), False
    with singletrack.Car(simulator).drive() as drive:
        for state in drive:
            drive.actuate(0.3, 0.5)
            if state.drive_time_s > 2 and not lost:
                simulator.lose_markers(f"{milliseconds:.0f}ms")
                lost = True
            if state.drive_time_s > 5:
                break
    return drive.reason == "requested"
longest_ms = bisect(survives, 20, 2000, 7)
"""
)

ANSWERS: dict[str, list[tuple[str, str]]] = {
    "1-law": [
        (LAW, LAW.replace("/ P - yaw_rate", "/ P")),
        ("gain = math.log(20) / decay_s", "gain = 1.0"),
        ("distance = 0.5 / math.hypot(own_gain, 0.5)", "distance = 0.5 / own_gain + 0.02"),
    ],
    "2-centre-of-mass": [
        (
            BISECT + "tolerance_mm = 1e3 * bisect("
            "lambda dl: stability.is_stable(own_speed, dl, law='velocity-point'), 0.0, 0.02)",
            "tolerance_mm = 0.136",
        ),
        ("smallest_p = stability.smallest_point_distance(wheelbase)", "smallest_p = 0.35"),
        ("offset_mm = 1e3 * own_deviation", "offset_mm = 600 * own_deviation"),
    ],
    "3-delay": [
        (
            BISECT + "largest_gain = bisect("
            "lambda gain: stability.sampled(0.8, delay=own_delay, position_gain=gain)[0] < 1, 1, 12)",
            "largest_gain = math.pi / 2 / own_delay",
        ),
        (
            BISECT + "speed = bisect(lambda v: stability.sampled(v)[1] > own_margin, 0.5, 5.0)",
            "speed = 9",
        ),
        ("critical_gain = math.pi / 2 / 0.24", "critical_gain = math.pi / 2 / 0.2"),
    ],
    "4-faults": [
        (
            "stuck, gone, pulled = 'imu-stuck', 'board-failsafe', 'imu-silent'",
            "stuck, gone, pulled = 'imu-stuck', 'board-failsafe', 'link-down'",
        ),
        (LOSS, "longest_ms = 1500"),
        (
            "rise_s = times[np.argmax(speed > 0.4)] - times[np.argmax(commanded > 0)]",
            "rise_s = 0.1",
        ),
    ],
}
