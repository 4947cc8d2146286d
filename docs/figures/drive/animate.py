#!/usr/bin/env python3
"""Draws an animated SVG of a drive from the CSV that `singletrack simulate` prints.

    singletrack simulate tools/scenarios/circle-car.toml > circle-car.csv
    python3 docs/figures/drive/animate.py circle-car.csv > docs/figures/drive/circle-car.svg

The picture holds no script: the motion is SMIL, one value every 0.1 s, in real time.
"""

import csv
import math
import sys

DURATION_S = 20.0
STEP_S = 0.1
FRONT_AXLE_M = 0.1368
REAR_AXLE_M = 0.1232
POINT_M = 0.35
HALF_WIDTH_M = 0.09
WHEEL_M = 0.035
# The part of the floor that is shown: left, bottom, width, height, in metres.
VIEW_M = (-1.25, -1.2, 3.35, 2.4)


def rows(path):
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            row = {name: float(text) for name, text in row.items()}
            steps = row["t"] / STEP_S
            if row["t"] <= DURATION_S and abs(steps - round(steps)) < 1e-6:
                yield row


def animation(kind, values):
    return (
        f'<animateTransform attributeName="transform" type="{kind}" dur="{DURATION_S:g}s" '
        f'repeatCount="indefinite" values="{";".join(values)}"/>'
    )


def place(row, x, y):
    return f"{row[x]:.3f} {row[y]:.3f}"


def wheel(x, y):
    return f'<path class="wheel" d="M{x - WHEEL_M:g} {y:g}h{2 * WHEEL_M:g}"/>'


def main():
    drive = list(rows(sys.argv[1]))
    car = animation("translate", [place(row, "x_g", "y_g") for row in drive])
    yaw = animation("rotate", [f"{math.degrees(row['yaw']):.1f}" for row in drive])
    steering = animation("rotate", [f"{math.degrees(row['steering']):.1f}" for row in drive])
    reference = animation("translate", [place(row, "x_ref", "y_ref") for row in drive])
    path = "M" + "L".join(place(row, "x_p", "y_p") for row in drive)
    length = sum(
        math.dist((a["x_p"], a["y_p"]), (b["x_p"], b["y_p"])) for a, b in zip(drive, drive[1:])
    )
    # How much of the path is drawn, by the way that P has gone.
    gone, offsets = 0.0, [f"{length:.3f}"]
    for a, b in zip(drive, drive[1:]):
        gone += math.dist((a["x_p"], a["y_p"]), (b["x_p"], b["y_p"]))
        offsets.append(f"{length - gone:.3f}")

    left, bottom, width, height = VIEW_M
    body = (
        f'<rect class="body" x="{-REAR_AXLE_M - 0.05:g}" y="{-HALF_WIDTH_M:g}" '
        f'width="{REAR_AXLE_M + FRONT_AXLE_M + 0.1:g}" height="{2 * HALF_WIDTH_M:g}" rx="0.03"/>'
    )
    rear = "".join(wheel(-REAR_AXLE_M, side * HALF_WIDTH_M) for side in (-1, 1))
    front = "".join(
        f'<g transform="translate({FRONT_AXLE_M:g} {side * HALF_WIDTH_M:g})">'
        f"<g>{steering}{wheel(0, 0)}</g></g>"
        for side in (-1, 1)
    )
    point = (
        f'<g transform="translate({FRONT_AXLE_M:g} 0)"><g>{steering}'
        f'<path class="arm" d="M0 0h{POINT_M:g}"/><circle class="point" cx="{POINT_M:g}" r="0.03"/>'
        "</g></g>"
    )
    print(
        f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {200 * width:g} {200 * height:g}" role="img">
<title>The simulated car drives the paper's circle; P stays behind its reference</title>
<style>
.floor {{ fill: #fff }} .circle {{ fill: none; stroke: #999; stroke-width: .012 }}
.body {{ fill: #dde6f0; stroke: #234; stroke-width: .012 }} .wheel {{ stroke: #111; stroke-width: .035 }}
.arm {{ stroke: #234; stroke-width: .01 }} .point {{ fill: #c00 }}
.path {{ fill: none; stroke: #c00; stroke-width: .014 }} .reference {{ fill: #fff; stroke: #555; stroke-width: .02 }}
text {{ font: 15px sans-serif; fill: #333 }}
</style>
<rect class="floor" width="{200 * width:g}" height="{200 * height:g}"/>
<g transform="scale(200 -200) translate({-left:g} {-bottom - height:g})">
<circle class="circle" r="1"/>
<path class="path" d="{path}" stroke-dasharray="{length:.3f}">
<animate attributeName="stroke-dashoffset" dur="{DURATION_S:g}s" repeatCount="indefinite" values="{";".join(offsets)}"/></path>
<g>{reference}<circle class="reference" r="0.035"/></g>
<g>{car}<g>{yaw}{body}{rear}{front}{point}</g></g>
</g>
<circle cx="470" cy="28" r="7" fill="#fff" stroke="#555" stroke-width="4"/><text x="486" y="33">reference</text>
<circle cx="470" cy="52" r="6" fill="#c00"/><text x="486" y="57">P of the simulated car</text>
</svg>"""
    )


if __name__ == "__main__":
    main()
