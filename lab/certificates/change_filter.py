"""Changes a certificate of the safety filter in 1,000 ways; none of them may be accepted.

    python3 change_filter.py CERTIFICATE.json [SEED]

A figure anywhere, by one or by much, up or down; a box, a key or a part of a range taken away, doubled or made
wider, in one box or in all that share it; another type; other settings with the digest that they have. Exit status 1
if check_filter.py accepts one.
"""

import copy
import json
import random
import sys

import check_filter

COUNT = 1000


def other_number(number, chance):
    nudge = chance.choice([1, 1, 2, 10, 1000, abs(number) // 100 + 1, abs(number) + 1])
    return number + chance.choice([-1, 1]) * nudge


def one_number(given, chance):
    """Of a box, a range or a residual."""
    box = chance.choice(given["boxes"])
    axes = [box[axis] for axis in check_filter.AXES] + [*given["ranges"].values()]
    values = chance.choice([box["room_um"]] * 4 + axes)
    place = chance.randrange(len(values))
    values[place] = other_number(values[place], chance)


def one_residual(given, chance):
    key = chance.choice([*given["residuals"], "steering_ticks"])
    of = given if key == "steering_ticks" else given["residuals"]
    of[key] = other_number(of[key], chance)


def an_edge(given, chance):
    """Moved in all boxes that have it."""
    axis = chance.choice([*check_filter.AXES])
    edge = chance.choice(given["boxes"])[axis][chance.randrange(2)]
    other = other_number(edge, chance)
    for ends in [box[axis] for box in given["boxes"]] + [given["ranges"][axis]]:
        ends[:] = [other if end == edge else end for end in ends]


def a_box(given, chance):
    boxes = given["boxes"]
    place = chance.randrange(len(boxes))
    change = chance.choice(["without", "twice", "exchanged", "half", "none"])
    if change == "without":
        del boxes[place]
    elif change == "twice":
        boxes.append(copy.deepcopy(boxes[place]))
    elif change == "half":
        axis = chance.choice([*check_filter.AXES])
        del given["boxes"][:]
        given["boxes"] += [box for box in boxes if box[axis][0] != boxes[place][axis][0]]
    elif change == "none":
        del boxes[:]
    else:
        # The room of another box.
        others = [box for box in boxes if box["room_um"] != boxes[place]["room_um"]]
        boxes[place]["room_um"] = list(chance.choice(others)["room_um"])


def a_setting(given, chance):
    """As of another car, also with the digest of that."""
    settings = given["settings"]
    # Where these leave all figures as they are, it is the certificate of another car: CAR.toml tells them apart.
    growth = "safety_filter.curvature_error_per_m_per_m_s2"
    same = ("actuators.steering_dead_time_ms", "actuators.steering_lag_ms", "vehicle.friction", growth)
    honest = chance.random() < 0.5
    key = chance.choice([key for key in settings if not honest or key not in same])
    number = float(settings[key]) * chance.choice([0.5, 0.9, 0.999, 1.001, 1.1, 2.0])
    settings[key] = f"{number:.9f}".rstrip("0").rstrip(".")
    if honest:
        given["digest"] = check_filter.digest(settings)


def a_key(given, chance):
    of = chance.choice([given, given["settings"], given["ranges"], given["residuals"], chance.choice(given["boxes"])])
    key = chance.choice([*of])
    change = chance.choice(["without", "another", "more"])
    value = of[key] if change == "more" else of.pop(key)
    if change != "without":
        of[key + "_"] = value


def a_type(given, chance):
    box = chance.choice(given["boxes"])
    of = chance.choice([given, given["settings"], given["ranges"], given["residuals"], box, box["room_um"]])
    key = chance.randrange(len(of)) if type(of) is list else chance.choice([*of])
    others = [None, True, False, [], {}, "", "NaN", [of[key]], 1.5, str(of[key]) + " "]
    of[key] = chance.choice(others)


def the_digest(given, chance):
    place = chance.randrange(16)
    own = given["digest"]
    given["digest"] = own[:place] + chance.choice([c for c in "0123456789abcdef" if c != own[place]]) + own[place + 1 :]


CHANGES = [one_number] * 4 + [one_residual, an_edge, a_box, a_setting, a_key, a_type, the_digest]


def main(path, seed=1):
    text = open(path, encoding="utf-8").read()
    check_filter.check(check_filter.read(text))
    chance = random.Random(int(seed))
    accepted = 0
    for _ in range(COUNT):
        other = json.loads(text)
        change = chance.choice(CHANGES)
        change(other, chance)
        try:
            check_filter.check(other)
            print(f"accepted, although {change.__name__} was changed: {other['settings']}")
            accepted += 1
        except check_filter.REFUSALS:
            pass
    print(f"{COUNT - accepted} of {COUNT} changed certificates refused: {path}")
    return 1 if accepted else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) if len(sys.argv) > 1 else __doc__)
