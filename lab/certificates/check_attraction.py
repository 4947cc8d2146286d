"""Checks regions of attraction, as `singletrack stability attraction --certificates` writes them.

    python3 check_attraction.py CERTIFICATES.json
    python3 check_attraction.py --changed CERTIFICATES.json

It shares nothing with the program that wrote the file: it derives the loop from the paper's equations with
saturating tyres and exact slip angles, and shows that x'Px falls in {x'Px <= level, |steering| <= stop} (docs/theorems.md,
theorem 6) by bisection of boxes of its own, with intervals that are rounded outward. `math` is taken to be right to
1e-14. With --changed, certificates that are changed must be refused. Exit status 1 if one is no proof, or accepted.
"""

import copy
import json
import math
import sys
from math import inf, nan

GRAVITY = 9.80665
KEYS = {"law", "vehicle", "point_distance_m", "speed_m_s", "dl_m", "tyres", "slip_angles", "max_steering_rad",
        "max_steering_rate_rad_s", "coordinates", "form", "level", "yaw_rad"}
COORDINATES = ["yaw_rad", "yaw_rate_rad_s", "sideslip_rad", "steering_rad"]
MOST_BOXES = 3_000_000
ZERO, ONE, UNKNOWN = (0.0, 0.0), (1.0, 1.0), (nan, nan)


# Intervals (low, high): all numbers between two; not numbers if nothing is known.


def outward(low, high):
    return math.nextafter(low, -inf), math.nextafter(high, inf)


def add(one, other):
    if one == ZERO or other == ZERO:
        return other if one == ZERO else one
    return outward(one[0] + other[0], one[1] + other[1])


def minus(one):
    return -one[1], -one[0]


def mul(one, other):
    ends = one[0] * other[0], one[0] * other[1], one[1] * other[0], one[1] * other[1]
    if (one == ZERO or other == ZERO) and sum(ends) == 0:
        return ZERO
    return outward(min(ends), max(ends)) if sum(ends) == sum(ends) else UNKNOWN


def div(one, other):
    if not (other[0] > 0 or other[1] < 0):
        return UNKNOWN
    return mul(one, outward(1 / other[1], 1 / other[0]))


def square(one):
    low, high = mul(one, one)
    return (max(low, 0.0), high) if one[0] > 0 or one[1] < 0 else (0.0, high) if high == high else UNKNOWN


def of_values(one, other):
    if one != one or other != other:
        return UNKNOWN
    more = 1e-14 * (abs(one) + abs(other))
    return outward(min(one, other) - more, max(one, other) + more)


def falling_ratio(function, x):
    """f(z)/z of an odd function with f'(0) = 1, which falls with |z|."""
    if x[0] != x[0] or x[1] != x[1]:
        return UNKNOWN
    ratio = lambda z: function(z) / z if z else 1.0
    return of_values(ratio(max(x[1], -x[0])), ratio(max(x[0], -x[1], 0.0)))


class Chord:
    """A function of a box: its values, its value at the origin, and s with f(y) = f(0) + s y for all y of the box."""

    __slots__ = ("value", "origin", "slopes")

    def __init__(self, value, origin=None, slopes=(ZERO,) * 4):
        slopes = slopes if value == value and value[0] == value[0] else (UNKNOWN,) * 4
        self.value, self.origin, self.slopes = value, value if origin is None else origin, slopes

    def __add__(self, other):
        return Chord(add(self.value, other.value), add(self.origin, other.origin),
                     tuple(map(add, self.slopes, other.slopes)))

    def __neg__(self):
        return Chord(minus(self.value), minus(self.origin), tuple(map(minus, self.slopes)))

    def __sub__(self, other):
        return self + -other

    def __mul__(self, other):
        if not isinstance(other, Chord):
            by = (other, other)
            return Chord(mul(self.value, by), mul(self.origin, by), tuple(mul(s, by) for s in self.slopes))
        slopes = tuple(add(mul(s, other.value), mul(self.origin, t)) for s, t in zip(self.slopes, other.slopes))
        return Chord(mul(self.value, other.value), mul(self.origin, other.origin), slopes)

    def __truediv__(self, other):
        origin, inverse = div(self.origin, other.origin), div(ONE, other.value)
        slopes = tuple(mul(add(s, minus(mul(origin, t))), inverse) for s, t in zip(self.slopes, other.slopes))
        return Chord(mul(self.value, inverse), origin, slopes)

    def then(self, values, origin, slope):
        if self.origin != ZERO:
            slope = UNKNOWN
        return Chord(values, (origin, origin), tuple(mul(s, slope) for s in self.slopes))

    def most(self):
        return max(self.value[1], -self.value[0]) if self.value[0] == self.value[0] else inf


def sine(angle):
    if angle.most() > 1.5:
        return angle.then((-1.0, 1.0), 0.0, falling_ratio(math.sin, angle.value) if angle.most() < 3 else UNKNOWN)
    return angle.then(of_values(*map(math.sin, angle.value)), 0.0, falling_ratio(math.sin, angle.value))


def cosine(angle):
    most = angle.most()
    if most > 2.2:
        return angle.then(UNKNOWN, 1.0, UNKNOWN)
    least = max(angle.value[0], -angle.value[1], 0.0)
    ratio = lambda z: -2 * math.sin(z / 2) ** 2 / z if z else 0.0
    values = of_values(math.cos(most), math.cos(least))
    return angle.then((values[0], min(values[1], 1.0)), 1.0, of_values(*map(ratio, angle.value)))


def odd(function, x):
    return x.then(of_values(*map(function, x.value)), 0.0, falling_ratio(function, x.value))


def positive(x):
    return x if x.value[0] > 0 else Chord(UNKNOWN)


def field(given, state):
    """The slope of yaw, yaw rate, sideslip and steering: equation 8, then Newton's equations."""
    car = given["vehicle"]
    mass, inertia, front, rear = (car[key] for key in (
        "mass_kg", "yaw_inertia_kg_m2", "front_axle_distance_m", "rear_axle_distance_m"))
    yaw, rate, slip, steering = state
    v, most_rate = given["speed_m_s"], given["max_steering_rate_rad_s"]
    number = lambda value: Chord((value, value))
    believed = number(front) + number(given["dl_m"])
    opening = positive(cosine(slip - steering))
    sines, cosines = sine(steering), cosine(steering)
    along_car = cosine(slip)
    speed = positive((cosine(yaw + steering) * v - rate * sines * believed) / opening)
    turning = (-sine(yaw + slip) * v - rate * believed * along_car) / (opening * given["point_distance_m"]) - rate
    if most_rate is not None:
        turning = odd(lambda x: max(-most_rate, min(most_rate, x)), turning)
    # Velocities of G and of both axles, along and across the car, then those of the front wheels.
    along, across = speed * along_car, speed * sine(slip)
    front_across, rear_across = across + rate * front, across - rate * rear
    rolling = positive(along * cosines + front_across * sines)
    sliding = front_across * cosines - along * sines

    def force(angle, key, other):
        stiffness = car[key]
        share = div(mul((car["friction"],) * 2, mul((mass * 1.0,) * 2, mul((GRAVITY,) * 2, (other,) * 2))),
                    add((front, front), (rear, rear)))
        limit = Chord(share)
        return odd(math.tanh, odd(math.atan, angle) * stiffness / limit) * limit
    at_front = -force(sliding / rolling, "front_cornering_stiffness_n_rad", rear) * cosines
    at_rear = -force(rear_across / positive(along), "rear_cornering_stiffness_n_rad", front)
    yaw_acceleration = (at_front * front - at_rear * rear) / number(inertia)
    slip_rate = ((at_front + at_rear) / (speed * mass) - rate * along_car) * along_car
    return [rate, yaw_acceleration, slip_rate, turning]


def total(terms):
    result = ZERO
    for term in terms:
        result = add(result, term)
    return result


def product(one, other):
    columns = list(zip(*other))
    return [[total(map(mul, row, column)) for column in columns] for row in one]


def bound(form, region):
    """Of y'My above, for y in the region but zero: negative squares are split off one by one."""
    form, left, least = [list(row) for row in form], [0, 1, 2, 3], inf
    while True:
        rest = total([mul(form[i][i], square(region[i])) for i in left]
                     + [mul(mul(add(form[i][j], form[i][j]), region[i]), region[j]) for i in left for j in left if j < i])
        least = min(rest[1], least)
        pivot = min(left, key=lambda i: form[i][i][1], default=None)
        if pivot is None:
            return min(least, -1e-300)
        weight = form[pivot][pivot]
        if not weight[1] < 0:
            return least
        left.remove(pivot)
        for i in left:
            for j in left:
                if j < i:
                    form[i][j] = add(form[i][j], minus(div(mul(form[i][pivot], form[j][pivot]), weight)))
                    form[j][i] = form[i][j]
            form[i][i] = add(form[i][i], minus(div(square(form[i][pivot]), weight)))


def coordinates(form):
    """The upper triangular Y, in floating point, with Y'PY near one: the inverse of Cholesky's factor."""
    factor = [[0.0] * 4 for _ in range(4)]
    for i in range(4):
        for j in range(i + 1):
            rest = form[i][j] - sum(factor[i][k] * factor[j][k] for k in range(j))
            require(i != j or rest > 0, "P is not positive definite")
            factor[i][j] = math.sqrt(rest) if i == j else rest / factor[j][j]
    inverse = [[0.0] * 4 for _ in range(4)]
    for column in range(4):
        for i in range(column, 4):
            rest = float(i == column) - sum(factor[i][k] * inverse[k][column] for k in range(column, i))
            inverse[i][column] = rest / factor[i][i]
    return [list(row) for row in zip(*inverse)]


def require(holds, what):
    if not holds:
        raise ValueError(what)


def check(given):
    """How many boxes prove it; ValueError if it is not."""
    require(set(given) == KEYS and given["coordinates"] == COORDINATES, "other keys")
    kind = given["law"], given["tyres"], given["slip_angles"]
    require(kind == ("front-point", "saturating", "exact"), "another loop than is checked here")
    form, level, stop = given["form"], given["level"], given["max_steering_rad"]
    numbers = [level, given["speed_m_s"], given["point_distance_m"], *given["vehicle"].values()]
    require(all(type(x) is float and 0 < x < inf for x in numbers), "a number is not above zero")
    require(all(form[i][j] == form[j][i] for i in range(4) for j in range(4)), "P is not symmetric")
    yaw = math.sqrt(level / form[0][0])
    require(abs(given["yaw_rad"] - yaw) < 1e-9 * yaw, "the yaw error is not that of the level")
    states = coordinates(form)
    exact = lambda matrix: [[(x, x) for x in row] for row in matrix]
    gradient = product(exact(zip(*states)), exact(form))
    outside = product(gradient, exact([[-x for x in row] for row in states]))
    rest = [[add(x, (0.999, 0.999)) if i == j else x for j, x in enumerate(row)] for i, row in enumerate(outside)]
    require(bound(rest, [(-1.0, 1.0)] * 4) < 0, "P is too near to a singular matrix")
    most = math.sqrt(level) * 1.001
    end = inf if stop is None else stop / states[3][3] * (1 + 1e-12)
    open_regions, boxes = [((-most, most),) * 3 + ((0.0, min(most, end)),)], 0
    while open_regions:
        region = open_regions.pop()
        if bound(outside, region) < -level:
            continue
        boxes += 1
        require(boxes < MOST_BOXES, "more boxes than are tried")
        if falls(given, states, gradient, region, region[3][1] >= end):
            continue
        axis = max(range(4), key=lambda k: region[k][1] - region[k][0])
        low, high = region[axis]
        require(high - low > 1e-3 * most, f"x'Px need not fall at {region}")
        for half in (low, (low + high) / 2), ((low + high) / 2, high):
            open_regions.append(region[:axis] + (half,) + region[axis + 1:])
    return boxes


def falls(given, states, gradient, region, at_stop):
    rows = [tuple((x, x) for x in row) for row in states]
    slope = field(given, [Chord(total(map(mul, row, region)), ZERO, row) for row in rows])

    def of(rows):
        form = product(gradient, rows)
        return bound([[add(form[i][j], form[j][i]) for j in range(4)] for i in range(4)], region) < 0
    rows = [row.slopes for row in slope]
    if not of(rows):
        return False
    # On the stop the steering is held unless it turns back.
    return not at_stop or slope[3].value[1] < 0 or of(rows[:3] + [(ZERO,) * 4])


def changes(given):
    """Certificates of what is not so: of forms that rise somewhere, of other cars and speeds, and with other figures."""
    def changed(path, factor):
        other = copy.deepcopy(given)
        within = other
        for key in path[:-1]:
            within = within[key]
        within[path[-1]] *= factor
        if path[0] == "form":
            other["form"][path[2]][path[1]] = other["form"][path[1]][path[2]]
        return f"{'.'.join(map(str, path))} times {factor}", other
    yield changed(("level",), 1.1)
    yield changed(("yaw_rad",), 1.1)
    yield changed(("form", 0, 0), 1.1)
    for i in 1, 2, 3:
        for j in range(i + 1):
            yield changed(("form", i, j), 5 if i == j else -3)
    yield changed(("speed_m_s",), 3)
    yield changed(("point_distance_m",), 0.1)
    yield changed(("vehicle", "rear_cornering_stiffness_n_rad"), 0.1)
    yield changed(("max_steering_rate_rad_s",), 0.01)


REFUSALS = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, OSError, RecursionError)


def main(arguments):
    try:
        certificates = json.loads(open(arguments[-1], encoding="utf-8").read())["certificates"]
        require(certificates, "no certificate")
        for given in certificates:
            if arguments[0] == "--changed":
                for what, other in changes(given):
                    try:
                        check(other)
                    except REFUSALS as refused:
                        print(f"refused: {what}: {refused}")
                        continue
                    raise ValueError(f"accepted with {what}")
            else:
                boxes = check(given)
                print(f"proved: at {given['speed_m_s']} m/s up to {given['yaw_rad']:.4f} rad, {boxes} boxes")
        return 0
    except REFUSALS as error:
        print(f"NOT proved: {arguments[-1]}: {error}")
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) if len(sys.argv) > 1 else __doc__)
