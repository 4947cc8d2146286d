"""Checks the theorem behind `singletrack stability one-length` in exact arithmetic, and its numbers for a car.

    python3 check_one_length.py [one-length.json ...]

1. As identities of polynomials, for every car: the characteristic polynomial of equations 1, 2 and 8 about
   straight motion, its Hurwitz determinant, and the form of the theorem (docs/theorems.md).
2. For each file (`singletrack stability one-length --format json`), with rational numbers: just inside of the
   ranges of p the motion is stable for 200 dl at the speed of the row, just outside of them it is not; and with
   an actuator as slow as `actuation_s` says, |q|^2 - tau^2 w^2 |n|^2 is above zero for all w (Sturm).

Shares nothing with the program that found them. Exit status 1 if something does not hold.
"""

import json
import sys
from fractions import Fraction

# Of a term: the exponents of 1/m, 1/I_z, 1/p, 1/v^2, l_f, l_r, C_f, C_r and x = l_f + dl.
COUNT = 9


class Polynomial(dict):
    """From the exponents of a term to its coefficient, without zeros."""

    def __add__(self, other):
        total = Polynomial(self)
        for term, value in other.items():
            total[term] = total.get(term, 0) + value
            if total[term] == 0:
                del total[term]
        return total

    def __neg__(self):
        return Polynomial({term: -value for term, value in self.items()})

    def __sub__(self, other):
        return self + -other

    def __mul__(self, other):
        product = Polynomial()
        for one, a in self.items():
            for two, b in other.items():
                product = product + Polynomial({tuple(map(sum, zip(one, two))): a * b})
        return product


def number(value):
    return Polynomial({(0,) * COUNT: value}) if value else Polynomial()


SYMBOLS = [Polynomial({tuple(int(i == j) for j in range(COUNT)): 1}) for i in range(COUNT)]


def characteristic(rows, one, zero):
    """The coefficients of det(s - A), from the constant one on (Faddeev and LeVerrier, exact)."""
    size = len(rows)
    coefficients, power = [one], [[zero] * size for _ in range(size)]
    for count in range(1, size + 1):
        # power <- A power + c I
        power = [
            [
                sum((rows[i][k] * power[k][j] for k in range(size)), zero)
                + (coefficients[-1] if i == j else zero)
                for j in range(size)
            ]
            for i in range(size)
        ]
        trace = sum((rows[i][k] * power[k][i] for i in range(size) for k in range(size)), zero)
        if isinstance(trace, Polynomial):
            coefficients.append(Polynomial({t: Fraction(-v, count) for t, v in trace.items()}))
        else:
            coefficients.append(-trace / count)
    return coefficients[::-1]


def theorem():
    """The identities, in units of time of 1 m / v."""
    mu, iota, pi, n, lf, lr, cf, cr, x = SYMBOLS
    one, zero = number(1), number(0)
    both, turn = cf * lf * lf + cr * lr * lr, cr * lr - cf * lf
    wheelbase = lf + lr
    rows = [
        [zero, one, zero, zero],
        [zero, -both * iota * n, turn * iota * n, cf * lf * iota * n],
        [zero, turn * mu * n - one, -(cf + cr) * mu * n, cf * mu * n],
        # Equation 8: u = -((l_f + dl)/p + 1) r - (v/p)(yaw + sideslip).
        [-pi, -(x * pi) - one, -pi, zero],
    ]
    a0, a1, a2, a3, _ = characteristic(rows, one, zero)
    kappa, damping = cf * cr * wheelbase * mu * iota, (cf + cr) * mu + both * iota
    reach = (lr + x) * pi + one
    assert a0 == kappa * pi * n * n
    assert a1 == kappa * reach * n * n
    assert a3 == damping * n
    hurwitz = a1 * (a3 * a2 - a1) - a3 * a3 * a0
    front = -turn * mu + lf * both * iota
    rear = turn * mu + lr * both * iota + damping * cf * wheelbase * wheelbase * mu * n
    # I_z e_r contains 1/I_z once more than the other terms: g and the products are divided by I_z.
    constant = cf * mu * ((cf + cr) * mu - lf * turn * iota)
    form = reach * (constant * pi + cf * front * iota * x * pi + cr * rear * iota) - damping * damping * pi
    scale = kappa * n * n * n * n
    assert hurwitz == scale * form, "the form of the theorem"
    print("the theorem's identities hold for every car")


def check(path):
    given = json.load(open(path))
    car = given["vehicle"]
    m, inertia, lf, lr, cf, cr = (
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
    turn, both = cr * lr - cf * lf, cf * lf**2 + cr * lr**2
    fast = 10**9

    def polynomial(v, p, x):
        rows = [
            [0, 1, 0, 0],
            [0, -both / (inertia * v), turn / inertia, cf * lf / inertia],
            [0, turn / (m * v**2) - 1, -(cf + cr) / (m * v), cf / (m * v)],
            [-v / p, -x / p - 1, -v / p, 0],
        ]
        return characteristic([[Fraction(e) for e in row] for row in rows], Fraction(1), Fraction(0))

    def is_stable(v, p, x):
        a0, a1, a2, a3, _ = polynomial(v, p, x)
        return min(a0, a1, a2, a3) > 0 and a1 * (a3 * a2 - a1) > a3 * a3 * a0

    def all_stable(v, p):
        return all(is_stable(v, p, (lf + lr) * k / 200) for k in range(201))

    inside, outside = 1 + Fraction(1, 10**6), 1 - Fraction(1, 10**6)
    for row in given["points"]:
        v = Fraction(str(row["speed_m_s"] or fast))
        start, low, high = (row[k] for k in ("p_from_m", "other_from_m", "other_to_m"))
        good, bad = [], []
        if start is not None:
            start = Fraction(repr(start))
            good += [max(start * inside, Fraction(1, 1000)), 2 * start + 1, 100 * start + 1]
            bad += [start * outside] if start > 0 else []
        if high is not None:
            good += [Fraction(repr(high)) * outside]
            bad += [Fraction(repr(high)) * inside]
        if low:
            good += [Fraction(repr(low)) * inside]
            bad += [Fraction(repr(low)) * outside]
        if start is None and high is None:
            bad += [Fraction(k, 10) for k in range(1, 30)]
        for p in good:
            assert all_stable(v, p), f"{path}: not stable at p = {float(p)} m, {float(v)} m/s"
        for p in bad:
            assert not all_stable(v, p), f"{path}: stable at p = {float(p)} m, {float(v)} m/s"
        if row["actuation_s"] is not None:
            p = Fraction(str(given["point_distance_m"]))
            for k in range(41):
                x = (lf + lr) * k / 40
                a0, a1, a2, a3, _ = polynomial(v, p, x)
                n2 = cf / (m * p) + cf * lf * (x + p) / (inertia * p)
                t2 = (Fraction(repr(row["actuation_s"])) * outside) ** 2
                room = [
                    a0**2,
                    a1**2 - 2 * a0 * a2 - t2 * a0**2,
                    a2**2 + 2 * a0 - 2 * a1 * a3 - t2 * (a1**2 - 2 * a0 * n2),
                    a3**2 - 2 * a2 - t2 * n2**2,
                    Fraction(1),
                ]
                assert roots_above_zero(room) == 0, f"{path}: actuation at {float(v)} m/s"
    print(f"{path}: {len(given['points'])} speeds hold")


def roots_above_zero(coefficients):
    """How many distinct roots above zero a polynomial has, by Sturm's chain."""

    def trimmed(f):
        while f and f[-1] == 0:
            f = f[:-1]
        return f

    def rest(f, g):
        f = f[:]
        while len(f) >= len(g):
            factor = f[-1] / g[-1]
            for at, value in enumerate(g):
                f[len(f) - len(g) + at] -= factor * value
            f = f[:-1]
        return trimmed(f)

    chain = [trimmed(coefficients), trimmed([k * c for k, c in enumerate(coefficients)][1:])]
    while chain[-1]:
        chain.append([-value for value in rest(chain[-2], chain[-1])])
    chain = chain[:-1]
    changes = lambda signs: sum(a * b < 0 for a, b in zip(signs, signs[1:]))
    nonzero = lambda values: [value for value in values if value != 0]
    return changes(nonzero([f[0] for f in chain])) - changes(nonzero([f[-1] for f in chain]))


if __name__ == "__main__":
    try:
        theorem()
        for path in sys.argv[1:]:
            check(path)
    except AssertionError as error:
        sys.exit(f"NOT proved: {error}")
