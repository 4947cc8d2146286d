"""Checks the proofs of `singletrack stability losses --certificates FILE`.

    python3 check_losses.py [--changed] FILE

With --changed it checks instead that each is refused once it is changed: a claim that goes too far, a car
that is another one, and matrices that are not what they were.

It shares nothing with the program that found them: it reads the parameters of the loop and the matrices P,
derives the maps of the loop from the paper's equations 1, 2 and 8 (or the appendix), and checks with
intervals of 220 binary digits that every P is positive definite and that x' P x falls: with every step, if
the claim is one about every pattern; on average over the steps from a node, if it is one about random
losses. Prints a line for each certificate. Exit status 1 if one is not a proof.
"""

import json
import sys
from fractions import Fraction

DIGITS = 220
ONE = 1 << DIGITS


class Ball:
    """All numbers at most `radius` from `middle`, in units of 2^-DIGITS."""

    __slots__ = ("middle", "radius")

    def __init__(self, middle, radius=0):
        self.middle, self.radius = middle, radius

    @staticmethod
    def of(number):
        scaled = Fraction(number) * ONE
        return Ball(round(scaled), 0 if scaled.denominator == 1 else 1)

    def __add__(self, other):
        return Ball(self.middle + other.middle, self.radius + other.radius)

    def __sub__(self, other):
        return Ball(self.middle - other.middle, self.radius + other.radius)

    def __mul__(self, other):
        spread = abs(self.middle) * other.radius + self.radius * (abs(other.middle) + other.radius)
        exact = self.middle * other.middle & (ONE - 1) == 0 and spread == 0
        return Ball(self.middle * other.middle >> DIGITS, 0 if exact else (spread >> DIGITS) + 2)

    def __truediv__(self, other):
        low = abs(other.middle) - other.radius
        if low <= 0:
            raise ZeroDivisionError
        middle = (self.middle << DIGITS) // other.middle
        spread = (self.radius << DIGITS) + (abs(middle) + 1) * other.radius
        return Ball(middle, spread // low + 2)

    def is_zero(self):
        return self.middle == 0 and self.radius == 0

    def is_positive(self):
        return self.middle > self.radius


ZERO, UNIT = Ball(0), Ball(ONE)


def zeros(rows, columns):
    return [[ZERO] * columns for _ in range(rows)]


def unit(size):
    return [[UNIT if row == column else ZERO for column in range(size)] for row in range(size)]


def plus(a, b):
    return [[x + y for x, y in zip(*rows)] for rows in zip(a, b)]


def times(a, b):
    columns = list(zip(*b))
    product = []
    for row in a:
        terms = [(at, x) for at, x in enumerate(row) if not x.is_zero()]
        line = []
        for column in columns:
            total = ZERO
            for at, x in terms:
                if not column[at].is_zero():
                    total = total + x * column[at]
            line.append(total)
        product.append(line)
    return product


def transposed(a):
    return [list(row) for row in zip(*a)]


def exponential(a):
    """exp(a) by its series; what is left out is bounded by a geometric one."""
    size = len(a)
    norm = max(sum(Fraction(abs(x.middle) + x.radius, ONE) for x in row) for row in a)
    total, term, bound, count = unit(size), unit(size), Fraction(1), 0
    while bound > Fraction(1, ONE) or count < 2 * norm:
        count += 1
        step = Ball.of(Fraction(1, count))
        term = [[x * step for x in row] for row in times(term, a)]
        total = plus(total, term)
        bound = bound * norm / count
        bound = Fraction(int(bound * ONE) + 1, ONE)
    # The terms from here on are less than halved by each other.
    rest = int(2 * bound * ONE) + 2
    return [[Ball(x.middle, x.radius + rest) if not x.is_zero() or norm else x for x in row] for row in total]


def is_positive_definite(a):
    """By elimination: every pivot is above zero."""
    a = [row[:] for row in a]
    for pivot in range(len(a)):
        if not a[pivot][pivot].is_positive():
            return False
        for row in range(pivot + 1, len(a)):
            factor = a[row][pivot] / a[pivot][pivot]
            for column in range(pivot, len(a)):
                a[row][column] = a[row][column] - factor * a[pivot][column]
    return True


class Loop:
    """The sampled loop about straight motion, as linear forms in the coordinates of its state."""

    def __init__(self, given):
        car = given["vehicle"]
        number = lambda name: Fraction(str(given[name]))
        m, inertia, l_f, l_r, c_f, c_r = (
            Fraction(str(car[name]))
            for name in (
                "mass_kg",
                "yaw_inertia_kg_m2",
                "front_axle_distance_m",
                "rear_axle_distance_m",
                "front_cornering_stiffness_n_rad",
                "rear_cornering_stiffness_n_rad",
            )
        )
        p, v, dl = number("point_distance_m"), number("speed_m_s"), number("dl_m")
        ms = lambda name: number(name) / 1000
        gain = number("position_gain_per_s")
        lag, dead_time = ms("steering_lag_ms"), ms("steering_dead_time_ms")
        self.period, self.frame = ms("period_ms"), given["servo_frame"]
        self.predicted = given["predicted_ticks"]
        if given["compensate"] or given["predict"]:
            raise ValueError("a loop with a prediction is not covered by this program")
        if min(m, inertia, l_f, l_r, c_f, c_r, p, v, self.period) <= 0 or self.frame < 1:
            raise ValueError("a parameter that must be above zero is not")
        if given["law"] not in ("front-point", "velocity-point"):
            raise ValueError("an unknown law")
        self.is_rate_law = given["law"] == "front-point"
        self.has_servo = lag > 0
        self.has_wheels = self.has_servo or self.is_rate_law

        # Equations 1 and 2, linearised: y, yaw, yaw rate, sideslip, and the angle of the wheels.
        turn = c_r * l_r - c_f * l_f
        rows = [
            [0, v, 0, v, 0],
            [0, 0, 1, 0, 0],
            [0, 0, -(c_f * l_f**2 + c_r * l_r**2) / (inertia * v), turn / inertia, c_f * l_f / inertia],
            [0, 0, turn / (m * v**2) - 1, -(c_f + c_r) / (m * v), c_f / (m * v)],
        ]
        if self.has_servo:
            rows = [row + [0] for row in rows] + [[0, 0, 0, 0, -1 / lag, 1 / lag], [0] * 6]
        elif self.is_rate_law:
            rows = [row + [0] for row in rows] + [[0, 0, 0, 0, 0, 1], [0] * 6]
        else:
            rows = rows + [[0] * 5]
        self.dynamics = rows

        # The linearised law, of y, yaw, yaw rate, sideslip and steering.
        believed = l_f + dl
        if self.is_rate_law:
            law = [-gain / p, -(gain * (believed + p) + v) / p, -believed / p - 1, -v / p, -gain]
        else:
            rear = l_r - dl if given["wrong"] == "centre-of-mass" else l_r
            course = -m * v / c_f * (gain + v / p)
            law = [
                -m * v / c_f * gain / p,
                course,
                -(c_r * rear - c_f * believed) / (c_f * v),
                course + (c_r + c_f) / c_f,
                0,
            ]
        self.law = [Ball.of(x) for x in law]
        self.is_position_free = gain == 0

        whole = lambda time: (int(time / self.period), time % self.period)
        self.delay_ticks, self.late = whole(ms("delay_ms") + (dead_time if self.has_servo else 0))
        self.ages = {
            state: whole(age)
            for state, age in ((2, ms("yaw_rate_age_ms")), (3, ms("sideslip_age_ms")))
            if age > 0
        }
        plant = ["y", "yaw", "yaw_rate", "sideslip", "wheels"]
        self.names = plant[: 4 + self.has_wheels]
        pending = [str(age + 1) for age in range(1 + self.delay_ticks)]
        self.names += ["command_" + age for age in pending]
        if self.frame > 1:
            self.names += ["pulse_" + age for age in pending]
        self.names += ["held_y", "held_yaw"]
        for state, (ticks, _) in self.ages.items():
            self.names += [f"{plant[state]}_{tick + 1}" for tick in range(ticks + 1)]
        self.flows = {}

    def flow(self, time):
        if time not in self.flows:
            self.flows[time] = exponential([[Ball.of(x * time) for x in row] for row in self.dynamics])
        return self.flows[time]

    def tick(self, state, is_known, takes):
        """The state after a tick: from the name of each coordinate to a linear form."""
        after = {}
        plant = self.names[: 4 + self.has_wheels]
        measured = [state[name] for name in ("y", "yaw", "yaw_rate", "sideslip")]
        for place, name in enumerate(("y", "yaw")):
            if not is_known:
                measured[place] = state["held_" + name]
            after["held_" + name] = measured[place]
        for place, (ticks, _) in self.ages.items():
            measured[place] = state[f"{plant[place]}_{ticks + 1}"]
        own_angle = self.is_rate_law and not self.has_servo
        measured.append(state["wheels" if own_angle else "command_1"])
        command = combined(self.law, measured)
        if self.is_rate_law and self.has_servo:
            command = combined([UNIT, Ball.of(self.period)], [state["command_1"], command])
        sent = command if takes else state["pulse_1"]

        given = lambda kind, newest, age: newest if age == 0 else state[f"{kind}_{age}"]
        lines = ["command"] if self.frame == 1 else ["command", "pulse"]
        for kind, newest in zip(lines, (command, sent)):
            for age in range(1 + self.delay_ticks):
                after[f"{kind}_{age + 1}"] = given(kind, newest, age)

        # The plant, from event to event.
        looks = {self.period - late for _, late in self.ages.values()}
        events = sorted({self.late, self.period} | looks)
        forms, time, seen = [state[name] for name in plant], Fraction(0), {}
        for event in events:
            if event > time:
                age = self.delay_ticks + (time < self.late)
                forms = forms + [given(lines[-1], sent, age)]
                forms = [combined(row, forms) for row in self.flow(event - time)[:-1]]
                time = event
            seen[event] = forms
        after.update(zip(plant, forms))
        for place, (ticks, late) in self.ages.items():
            name = plant[place]
            after[name + "_1"] = seen[self.period - late][place]
            for tick in range(ticks):
                after[f"{name}_{tick + 2}"] = state[f"{name}_{tick + 1}"]
        return after

    def start(self):
        return dict(zip(self.names, unit(len(self.names))))

    def matrix(self, state, kept):
        """The map to this state, of the kept coordinates; they must not depend on the others."""
        rows = []
        for name in kept:
            form = dict(zip(self.names, state[name]))
            free = ("y", "held_y") if self.is_position_free else ()
            lost = [x for other, x in form.items() if other not in kept and other not in free]
            if any(not x.is_zero() for x in lost):
                raise ValueError(f"the coordinates are not all: {name} depends on others")
            rows.append([form[other] for other in kept])
        return rows


def combined(weights, forms):
    return times([weights], forms)[0]


def conditions(loop, claim, kept):
    """For each node the lists of (probability, next node, map), each of which must fall on average."""
    frame = loop.frame
    if "every_pattern_up_to_ticks" in claim:
        nodes = [[] for _ in range(frame)]
        for phase in range(frame):
            state = loop.start()
            for tick in range(claim["every_pattern_up_to_ticks"]):
                state = loop.tick(state, tick <= loop.predicted, (phase + tick) % frame == 0)
                to = (phase + tick + 1) % frame
                nodes[phase].append([(UNIT, to, loop.matrix(state, kept))])
        return nodes
    share, mean = (Fraction(str(claim["mean_square"][name])) for name in ("share", "mean_ticks"))
    found = 1 / max(mean, Fraction(1))
    lost = found * share / (1 - share)
    if not 0 < lost <= 1:
        raise ValueError("no bursts of this length make this share")
    last, nodes = loop.predicted + 1, []
    maps = {
        (known, takes): loop.matrix(loop.tick(loop.start(), known, takes), kept)
        for known in (True, False)
        for takes in ((True, False) if frame > 1 else (True,))
    }
    for missing in range(last + 1):
        for phase in range(frame):
            chances = [(0, found), (min(missing + 1, last), 1 - found)]
            if missing == 0:
                chances = [(0, 1 - lost), (1, lost)]
            of = maps[missing < last, phase == 0]
            to = lambda other: other * frame + (phase + 1) % frame
            nodes.append([[(Ball.of(chance), to(other), of) for other, chance in chances]])
    return nodes


def check(given):
    """The claim that is proved, in words; an error if it is not."""
    loop = Loop(given)
    kept = given["coordinates"]
    if len(set(kept)) != len(kept) or not set(kept) <= set(loop.names):
        raise ValueError("unknown coordinates")
    nodes = conditions(loop, given["claim"], kept)
    functions = []
    for rows in given["functions"]:
        if len(rows) != len(kept) or any(len(row) != len(kept) for row in rows):
            raise ValueError("a matrix of another size")
        p = [[Ball.of(Fraction(repr(x))) for x in row] for row in rows]
        if rows != [list(row) for row in zip(*rows)] or not is_positive_definite(p):
            raise ValueError("a matrix is not symmetric and positive definite")
        functions.append(p)
    if len(functions) != len(nodes):
        raise ValueError("another number of matrices than of nodes")
    count = 0
    for p, steps in zip(functions, nodes):
        for choices in steps:
            left = p
            for chance, to, of in choices:
                later = times(times(transposed(of), functions[to]), of)
                left = [[x - chance * y for x, y in zip(*rows)] for rows in zip(left, later)]
            if not is_positive_definite(left):
                raise ValueError("the function does not fall over a step")
            count += 1
    return f"proved, {count} conditions: {given['speed_m_s']} m/s, dl {given['dl_m']} m: {given['claim']}"


def changed(given):
    """What each change makes of a certificate; none of it is a proof any more."""

    def copy(change):
        other = json.loads(json.dumps(given))
        change(other)
        return other

    size = len(given["coordinates"])
    for place in range(size):

        def negative(other):
            other["functions"][0][place][place] *= -1

        def lopsided(other):
            other["functions"][-1][place][place - 1] *= 1.001

        def missing(other):
            del other["coordinates"][place]
            for matrix in other["functions"]:
                del matrix[place]
                for row in matrix:
                    del row[place]

        yield from map(copy, (negative, lopsided, missing))

    def farther(other):
        other["claim"]["every_pattern_up_to_ticks"] *= 2

    def faster(other):
        other["speed_m_s"] *= 2

    def without(other):
        other["functions"].pop()

    # Of random losses a claim that goes farther may hold as well.
    yield from map(copy, (without,) if "mean_square" in given["claim"] else (without, farther, faster))


def main(arguments):
    failed = 0
    for given in json.load(open(arguments[-1]))["certificates"]:
        if arguments[0] == "--changed":
            accepted = count = 0
            for other in changed(given):
                count += 1
                try:
                    print("accepted, although it was changed:", check(other))
                    accepted += 1
                except (ValueError, KeyError, ZeroDivisionError):
                    pass
            failed += accepted
            print(f"{count - accepted} of {count} changed certificates refused: {given['claim']}")
            continue
        try:
            print(check(given))
        except (ValueError, KeyError, ZeroDivisionError) as error:
            failed += 1
            print(f"NOT proved: {given.get('speed_m_s')} m/s: {given.get('claim')}: {error!r}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) if len(sys.argv) > 1 else __doc__)
