"""Checks a certificate of the safety filter, as `singletrack certify` writes it.

    python3 check_filter.py CERTIFICATE.json [CAR.toml]

It shares nothing with the program that wrote the file: it derives the ranges of the claim from the settings,
checks that the boxes cover them, and bounds every stop of each box (docs/theorems.md, theorem 5) with intervals
of 120 binary digits. Each figure must be its bound, rounded up to a micrometre: less is not proved, and more is not
what the filter uses. Given the car's configuration, the settings that it spells out must be the certificate's.
Exit status 1 if it is no proof.
"""

import json
import math
import re
import sys
import tomllib
from fractions import Fraction
from functools import lru_cache

BITS = 120
ONE = 1 << BITS
MICRO = 10**6
# Digits of pi that are cut off: it lies between this and the next.
PI = [Fraction(3141592653589793238462643383279502 + last, 10**33) for last in (0, 1)]
GRAVITY = Fraction("9.80665")
# Line, board and the frame of a servo or an ESC, ms; lags of a settled servo; pieces of the way of a stop.
LINE, LAGS, PIECES = 40, 3, 12

# The axes of a box, and which end of each is the worst; of the angle both.
AXES = {"speed_um_s": 1, "delay_us": 1, "braking_um_s2": 0, "pose_age_us": 1, "curvature_error_u_per_m": 1,
        "steering_urad": None, "spread_urad": 1}
SETTINGS = """actuators.speed_dead_time_ms actuators.steering_dead_time_ms actuators.steering_lag_ms
    control.period_ms fence.braking_m_s2 law.front_axle_distance_m limits.max_speed_m_s limits.max_steering_rad
    safety_filter.course_error_rad safety_filter.curvature_error_per_m safety_filter.curvature_error_per_m_per_m_s2
    safety_filter.position_error_m safety_filter.reaction_ms safety_filter.speed_error_m_s
    supervisor.hold_distance_m supervisor.hold_ms vehicle.friction vehicle.front_axle_distance_m
    vehicle.rear_axle_distance_m""".split()


class Interval:
    """All numbers between two, in units of 2^-BITS."""

    __slots__ = ("low", "high")

    def __init__(self, low, high):
        self.low, self.high = low, high

    @staticmethod
    def of(number):
        return Interval(math.floor(number * ONE), math.ceil(number * ONE))

    def __add__(self, other):
        return Interval(self.low + other.low, self.high + other.high)

    def __sub__(self, other):
        return Interval(self.low - other.high, self.high - other.low)

    def __mul__(self, other):
        ends = (self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high)
        return Interval(min(ends) >> BITS, -(-max(ends) >> BITS))

    def __truediv__(self, other):
        if other.low <= 0:
            raise ValueError("a division by what may be zero")
        ends = [(end << BITS, by) for end in (self.low, self.high) for by in (other.low, other.high)]
        return Interval(min(end // by for end, by in ends), max(-(-end // by) for end, by in ends))

    def root(self):
        return Interval(math.isqrt(self.low << BITS), math.isqrt(self.high << BITS) + 1)


ZERO, UNIT = Interval.of(0), Interval.of(1)


def extreme(pick, *intervals):
    """The least (min) or the most (max) of numbers of these."""
    return Interval(pick(one.low for one in intervals), pick(one.high for one in intervals))


def series(first, ratio):
    """first (1 - r_1 + r_1 r_2 - ...), r_k = ratio(k), up to terms that fall: the rest is below the last of them."""
    total, term, count = first, first, 0
    while max(abs(term.low), abs(term.high)) > 2:
        count += 1
        term = ZERO - term * ratio(count)
        total = total + term
    return Interval(total.low - 4, total.high + 4)


def sine_cosine(angle):
    """By the series of a part of the angle, which is then doubled again."""
    doublings = 8 + max(0, (max(abs(angle.low), abs(angle.high)) >> BITS).bit_length())
    part = Interval(angle.low >> doublings, -(-angle.high >> doublings))
    square = part * part
    sine = series(part, lambda k: square / Interval.of(2 * k * (2 * k + 1)))
    cosine = series(UNIT, lambda k: square / Interval.of(2 * k * (2 * k - 1)))
    for _ in range(doublings):
        sine, cosine = sine * cosine * Interval.of(2), UNIT - sine * sine * Interval.of(2)
    return sine, cosine


def arc_tangent(value):
    for _ in range(3):
        value = value / (UNIT + (UNIT + value * value).root())
    square = value * value
    return series(value, lambda k: square * Interval.of(Fraction(2 * k - 1, 2 * k + 1))) * Interval.of(8)


def tangent(angle):
    sine, cosine = sine_cosine(angle)
    return sine / cosine


HALF, HIGH = Interval.of(Fraction(1, 2)), Interval.of(Fraction(3, 4)).root()
OUTWARD = [(UNIT, ZERO), (HIGH, HALF), (HALF, HIGH)]
for _ in range(3):
    OUTWARD += [(ZERO - left, ahead) for ahead, left in OUTWARD[-3:]]


def largest_component(right, left, opening, outward):
    """The largest component along a unit vector of the unit vectors from the right to the left one."""
    ends = extreme(max, *(one[0] * outward[0] + one[1] * outward[1] for one in (right, left)))
    from_right = right[0] * outward[1] - right[1] * outward[0]
    to_left = outward[0] * left[1] - outward[1] * left[0]
    ends_of_both = ((from_right.low, to_left.low), (from_right.high, to_left.high))
    # A cone of less than half a turn is where both are positive, a wider one where either is.
    low, high = ((min(pair) >= 0, max(pair) >= 0) for pair in ends_of_both)
    surely, perhaps = low[opening.low >= PI[1] * ONE], high[opening.high >= PI[0] * ONE]
    if opening.high >= 2 * PI[0] * ONE:
        surely, perhaps = opening.low >= 2 * PI[1] * ONE, True
    return UNIT if surely else Interval(ends.low, ONE) if perhaps else ends


@lru_cache(maxsize=None)
def wheels(rear, wheelbase, angles):
    """The curvatures (1/m) and the sideslips of the rolling car between two angles of the wheels."""
    curvatures = [tangent(Interval.of(Fraction(angle, MICRO))) / Interval.of(wheelbase) for angle in angles]
    return curvatures, [arc_tangent(Interval.of(rear) * curvature) for curvature in curvatures]


@lru_cache(maxsize=None)
def room(car, speed, delay, braking, age, curvature_error, sent, spread):
    """How far from a side in each direction every stop of the box ends, in m, by theorem 5."""
    ticks, period, rear, wheelbase, widest, hold, speed_error, *others = car
    speed, delay, braking, age = (Fraction(value, MICRO) for value in (speed, delay, braking, age))
    speed += speed_error
    blind = min(speed * age, hold)
    length = blind + speed * (delay + period) + speed * speed / (2 * braking)
    settled = blind + speed * period * (ticks + 1)
    others += [length / PIECES, Fraction(curvature_error, MICRO)]
    growth, grip, position_error, aside, piece, curvature_error = map(Interval.of, others)
    before = (max(sent[0] - spread, -widest), min(sent[1] + spread, widest))

    def bends(angles):
        ends = wheels(rear, wheelbase, angles)[0]
        lateral = extreme(min, extreme(max, ends[1], ZERO - ends[0]) * Interval.of(speed * speed), grip)
        error = curvature_error + extreme(max, lateral - Interval.of(GRAVITY / 4), ZERO) * growth
        return (ends[0] - error) * piece, (ends[1] + error) * piece
    first, then = bends(before), bends(sent)
    slips = wheels(rear, wheelbase, before)[1]
    right = left = ZERO
    distances = [[position_error] for _ in OUTWARD]
    for index in range(PIECES):
        turns = first if index * length < PIECES * settled else then
        to_right, to_left = right + turns[0], left + turns[1]
        ends = extreme(min, right, to_right) + slips[0] - aside, extreme(max, left, to_left) + slips[1] + aside
        vectors = [sine_cosine(end)[::-1] for end in ends]
        for outward, way in zip(OUTWARD, distances):
            way.append(way[-1] + largest_component(*vectors, ends[1] - ends[0], outward) * piece)
        right, left = to_right, to_left
    return [extreme(max, *way) for way in distances]


def require(holds, what):
    if not holds:
        raise ValueError(what)


def is_figure(value, bound):
    """Whether it is the bound in millionths, rounded up."""
    above = value * ONE - bound.high * MICRO
    return type(value) is int and ONE // (2 * MICRO) < above < ONE + ONE // 1000


def residuals(number):
    """What servo and motor still lack where the filter relies on them, by its key and that of the filter's error."""
    steering = Interval.of(number["limits.max_steering_rad"])
    lacking = steering * Interval.of(2) * series(UNIT, lambda k: Interval.of(Fraction(LAGS, k)))
    curvature = (tangent(steering) - tangent(steering - lacking)) / Interval.of(number["wheelbase"])
    delay = (number["actuators.speed_dead_time_ms"] + LINE) / 1000
    return {
        "curvature_u_per_m": curvature,
        "course_urad": curvature * Interval.of(number["rear"]),
        "speed_um_s": Interval.of(number["fence.braking_m_s2"] * delay),
    }


def digest(settings):
    """FNV-1a of the settings as lines, after their length."""
    hashed, lines = 0xCBF29CE484222325, "".join(f"{key}={text}\n" for key, text in settings.items()).encode()
    for byte in len(lines).to_bytes(8, "little") + lines:
        hashed = (hashed ^ byte) * 0x100000001B3 % 2**64
    return f"{hashed:016x}"


def check_settings(given):
    settings = given["settings"]
    require(list(settings) == sorted(SETTINGS), "other settings")
    for key, text in settings.items():
        plain = re.fullmatch(r"(0|[1-9]\d{,20})(\.\d{,20}[1-9])?", text, re.ASCII)
        require(plain, f"{key} is no plain decimal")
    require(given["digest"] == digest(settings), "the digest is not that of the settings")
    number = {key: Fraction(text) for key, text in settings.items()}
    number["wheelbase"] = number["vehicle.front_axle_distance_m"] + number["vehicle.rear_axle_distance_m"]
    number["rear"] = number["wheelbase"] - number["law.front_axle_distance_m"]
    require(number["fence.braking_m_s2"] > 0 and number["rear"] > 0, "no brakes, or no rear axle")
    require(0 < number["limits.max_steering_rad"] <= Fraction("1.2"), "the wheels turn too far")
    return number


def check(given):
    """The claim that is proved, in words; ValueError if it is not."""
    require(set(given) == {"boxes", "digest", "ranges", "residuals", "settings", "steering_ticks"}, "other keys")
    number = check_settings(given)
    lacking, bounds = given["residuals"], residuals(number)
    require(set(lacking) == set(bounds), "other residuals")
    require(all(is_figure(lacking[key], bound) for key, bound in bounds.items()), "a residual is another one")
    of = lambda key: number["safety_filter." + key]
    up = lambda value: math.ceil(value * MICRO)
    allowed = lambda key, residual: max(up(of(key)), lacking[residual])
    steering, braking = up(number["limits.max_steering_rad"]), up(number["fence.braking_m_s2"])
    ranges = {
        "speed_um_s": [0, up(number["limits.max_speed_m_s"])],
        "delay_us": [0, up(of("reaction_ms") / 1000)],
        "braking_um_s2": [braking // 2, braking],
        "pose_age_us": [0, up(number["supervisor.hold_ms"] / 1000)],
        "curvature_error_u_per_m": [0, allowed("curvature_error_per_m", "curvature_u_per_m")],
        "steering_urad": [-steering, steering],
        "spread_urad": [0, 2 * steering],
    }
    text = lambda value: json.dumps(value, sort_keys=True)  # in which False is no 0
    require(text(given["ranges"]) == text(ranges), "other ranges than those of the settings")
    ticks, period = given["steering_ticks"], number["control.period_ms"]
    settled = number["actuators.steering_dead_time_ms"] + LAGS * number["actuators.steering_lag_ms"] + LINE
    require(type(ticks) is int and 0 <= ticks * period - settled < period, "another number of ticks")
    check_cover(given["boxes"], ranges)
    course_error, speed_error = allowed("course_error_rad", "course_urad"), allowed("speed_error_m_s", "speed_um_s")
    car = (ticks, period / 1000, number["rear"], number["wheelbase"], steering, number["supervisor.hold_distance_m"],
           Fraction(speed_error, MICRO), of("curvature_error_per_m_per_m_s2"), number["vehicle.friction"] * GRAVITY,
           of("position_error_m"), Fraction(course_error, MICRO))
    for box in given["boxes"]:
        worst = [tuple(box[axis]) if worse is None else box[axis][worse] for axis, worse in AXES.items()]
        right = len(box["room_um"]) == len(OUTWARD) and all(map(is_figure, box["room_um"], room(car, *worst)))
        require(right, f"the room is not that of its box: {box}")
    return f"proved: {len(given['boxes'])} boxes with {len(OUTWARD)} bounds each, digest {given['digest']}"


def check_cover(boxes, ranges):
    """Every state of the ranges is in a box: they are all cells of a grid whose parts meet."""
    cells = 1
    for box in boxes:
        require(set(box) == {*AXES, "room_um"}, "other keys of a box")
        whole = all([type(end) for end in box[axis]] == [int, int] for axis in AXES)
        require(whole, "an axis of a box is no range")
    for axis, whole in ranges.items():
        parts = sorted({tuple(box[axis]) for box in boxes})
        edges = [whole[0], *(part[1] for part in parts)]
        meet = [part == ends and ends[0] < ends[1] for part, ends in zip(parts, zip(edges, edges[1:]))]
        require(parts and all(meet) and edges[-1] == whole[1], f"the boxes do not cover {axis}")
        cells *= len(parts)
    places = {tuple(tuple(box[axis]) for axis in AXES) for box in boxes}
    require(len(places) == len(boxes) == cells, "a box is missing, or there twice")


def read(text):
    once = lambda pairs: require(len(dict(pairs)) == len(pairs), "a key is there twice") or dict(pairs)
    other = lambda number: require(False, f"{number} is no whole number")
    return json.loads(text, object_pairs_hook=once, parse_float=other, parse_constant=other)


REFUSALS = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, OSError, RecursionError)


def main(arguments):
    try:
        given = read(open(arguments[0], encoding="utf-8").read())
        proved = check(given)
        car = tomllib.loads(open(arguments[1], encoding="utf-8").read()) if len(arguments) > 1 else {}
        for key, text in given["settings"].items():
            own = car.get(key.rsplit(".", 1)[0], {}).get(key.rsplit(".", 1)[1], text)
            require(Fraction(str(own)) == Fraction(text), f"{key} is {own} in the configuration, and not {text}")
        print(proved)
        return 0
    except REFUSALS as error:
        print(f"NOT proved: {arguments[0]}: {error}")
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) if len(sys.argv) > 1 else __doc__)
