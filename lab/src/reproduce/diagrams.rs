//! The paper's drawings of the single-track model, to scale: the quantities, a wrong centre of mass,
//! and the points P of both laws.

use singletrack_figures::figure::{Callout, Callouts, Curve, Figure, Look, Mark, MarkKind, Panel};

use super::{Setup, section::Picture};

/// The pose that is drawn, in rad: yaw, steering and sideslip.
const YAW: f64 = 0.35;
const STEERING: f64 = 0.45;
const SIDESLIP: f64 = 0.25;

/// The diameter of a wheel, in wheelbases.
const WHEEL: f64 = 0.28;

/// A drawing of the car with G at the origin.
struct Drawing {
    panel: Panel,
    front: [f64; 2],
    rear: [f64; 2],
    /// Wheelbase, `l_f` and p, in m.
    wheelbase: f64,
    front_axle: f64,
    p: f64,
}

fn along([x, y]: [f64; 2], angle: f64, length: f64) -> [f64; 2] {
    let (sin, cos) = angle.sin_cos();
    [x + length * cos, y + length * sin]
}

impl Drawing {
    fn new(setup: &Setup) -> Self {
        let vehicle = &setup.vehicle;
        let mut drawing = Self {
            panel: Panel {
                height_mm: 70.0,
                ..Panel::floor("")
            },
            front: along([0.0; 2], YAW, vehicle.front_axle_distance_m),
            rear: along([0.0; 2], YAW, -vehicle.rear_axle_distance_m),
            wheelbase: vehicle.wheelbase_m(),
            front_axle: vehicle.front_axle_distance_m,
            p: setup.point_distance_m(),
        };
        drawing.panel.callouts = vec![Callouts {
            name: String::new(),
            points: Vec::new(),
        }];
        let (front, rear) = (drawing.front, drawing.rear);
        drawing.line("car", Look::Actual, &[rear, front]);
        for (axle, angle) in [(rear, YAW), (front, YAW + STEERING)] {
            let half = WHEEL / 2.0 * drawing.wheelbase;
            let wheel = [along(axle, angle, -half), along(axle, angle, half)];
            drawing.line("", Look::Boundary, &wheel);
        }
        drawing
    }

    fn line(&mut self, name: &'static str, look: Look, points: &[[f64; 2]]) {
        let x = points.iter().map(|point| point[0]).collect();
        let y = points.iter().map(|point| point[1]).collect();
        self.panel.curves.push(Curve::new(name, look, &x, y));
    }

    fn label(&mut self, point: [f64; 2], text: &str) {
        if let Some(labels) = self.panel.callouts.first_mut() {
            labels.points.push(Callout {
                point,
                label: text.to_owned(),
            });
        }
    }

    fn mark(&mut self, name: &'static str, kind: MarkKind, point: [f64; 2]) {
        self.panel.marks.push(Mark { name, kind, point });
    }

    /// An arrow, in wheelbases.
    fn arrow(&mut self, name: &'static str, from: [f64; 2], angle: f64, length: f64) -> [f64; 2] {
        let tip = along(from, angle, length * self.wheelbase);
        let length = -0.06 * self.wheelbase;
        let barb = |turn| along(tip, angle + turn, length);
        self.line(name, Look::Other, &[from, tip]);
        self.line("", Look::Actual, &[barb(0.4), tip, barb(-0.4)]);
        tip
    }

    /// An angle between two directions, with the lines that it lies between.
    fn angle(&mut self, at: [f64; 2], [from, to]: [f64; 2], radius: f64, text: &str) {
        let radius = radius * self.wheelbase;
        let arc =
            (0..=20).map(|step| along(at, from + (to - from) * f64::from(step) / 20.0, radius));
        let arc: Vec<_> = arc.collect();
        self.line("", Look::Measured, &[at, along(at, from, 1.15 * radius)]);
        self.line("", Look::Actual, &arc);
        self.label(arc[10], text);
    }

    fn picture(self, name: &str, title: &str, caption: &str) -> Picture {
        let figure = Figure::column(title, caption, vec![self.panel]);
        Picture::new(name, "", figure)
    }

    /// P of the proposed law for a front axle at a distance from G.
    fn point(&mut self, name: &'static str, kind: MarkKind, front: [f64; 2]) -> [f64; 2] {
        let point = along(front, YAW + STEERING, self.p);
        self.line("p", Look::Truth, &[front, point]);
        self.mark(name, kind, point);
        point
    }
}

/// The quantities of equations 1 to 3.
pub(super) fn single_track(setup: &Setup) -> Picture {
    let mut drawing = Drawing::new(setup);
    let (front, rear, origin) = (drawing.front, drawing.rear, [0.0; 2]);
    drawing.point("P", MarkKind::End, front);
    drawing.mark("G", MarkKind::Found, origin);
    let tip = drawing.arrow("velocity of G", origin, YAW + SIDESLIP, 0.9);
    drawing.label(tip, "$v$");
    drawing.angle(origin, [YAW, YAW + SIDESLIP], 0.42, "$β$");
    drawing.angle(front, [YAW, YAW + STEERING], 0.4, "$δ$");
    drawing.angle(rear, [0.0, YAW], 0.4, "$ψ$");
    let middle = |one: [f64; 2]| [0.5 * one[0], 0.5 * one[1]];
    drawing.label(middle(front), "$l_f$");
    drawing.label(middle(rear), "$l_r$");
    drawing.picture(
        "diagram-single-track",
        "Single-track model",
        "Yaw, sideslip and steering, the distances of the axles from the centre of mass G, and P at \
         the distance p from the front wheel.",
    )
}

/// What the law believes with a wrong `l_f`: another G on the car, or another P from the true one.
pub(super) fn uncertainty(setup: &Setup) -> Picture {
    let mut drawing = Drawing::new(setup);
    let deviation = 0.5 * setup.rear_deviation_m();
    drawing.mark("G", MarkKind::Found, [0.0; 2]);
    let believed = along([0.0; 2], YAW, -deviation);
    drawing.mark("believed G", MarkKind::Diamond, believed);
    drawing.label(along([0.0; 2], YAW, -0.5 * deviation), "dl");
    let front = drawing.front;
    let point = drawing.point("P", MarkKind::End, front);
    let other = along([0.0; 2], YAW, drawing.front_axle + deviation);
    let wrong = drawing.point("P that the law steers", MarkKind::Square, other);
    drawing.line("", Look::Measured, &[point, wrong]);
    drawing.picture(
        "diagram-uncertainty",
        "A wrong centre of mass",
        "With the centre of mass believed behind its place by dl, the law moves a point that is \
         ahead of P by dl along the car.",
    )
}

/// The points P of the proposed law and of the appendix's.
pub(super) fn points(setup: &Setup) -> Picture {
    let mut drawing = Drawing::new(setup);
    let front = drawing.front;
    drawing.mark("G", MarkKind::Found, [0.0; 2]);
    drawing.point("P of the proposed law", MarkKind::End, front);
    let tip = drawing.arrow("velocity of G", [0.0; 2], YAW + SIDESLIP, 0.6);
    drawing.label(tip, "$v$");
    let other = along([0.0; 2], YAW + SIDESLIP, drawing.p);
    drawing.line("p", Look::Truth, &[[0.0; 2], other]);
    drawing.mark("P of the appendix's", MarkKind::Square, other);
    drawing.angle([0.0; 2], [YAW, YAW + SIDESLIP], 0.42, "$β$");
    drawing.angle(front, [YAW, YAW + STEERING], 0.4, "$δ$");
    drawing.picture(
        "diagram-points",
        "The points P of both laws",
        "The proposed law's is ahead of the front wheel in the direction of steering, the \
         appendix's ahead of G in the direction of motion.",
    )
}
