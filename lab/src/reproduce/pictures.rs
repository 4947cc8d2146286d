//! The paper's drawings of the single-track model, to scale: the quantities, a wrong centre of mass, and the
//! points P of both laws; and its experimental figures of a drive, on either plant.

use singletrack_figures::figure::{
    Axis, Callout, Callouts, Column, Curve, Figure, Look, Mark, MarkKind, Panel, Symbol,
};
use singletrack_scenario::simulate::Row;

use super::{
    Setup,
    drive::{Run, Seen},
    section::Picture,
};

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

impl Run {
    /// A number for each row.
    pub(super) fn column(&self, value: impl Fn(&Row) -> f64) -> Column {
        self.rows.iter().map(value).collect()
    }

    /// A number for each estimate of the controller.
    fn seen_column(&self, value: impl Fn(&Seen) -> f64) -> Column {
        self.seen.iter().map(value).collect()
    }

    fn over_time(&self, y: Axis, curves: Vec<Curve>) -> Panel {
        Panel {
            spans: self.lost.clone(),
            span_name: "markers lost",
            curves,
            ..Panel::new(Axis::TIME, y)
        }
    }

    fn time(&self) -> Column {
        self.column(|row| row.t)
    }

    /// Nominal and actual path of P, in one panel.
    pub(super) fn path_panel(&self, height_mm: f64) -> Panel {
        let ends = [
            ("start", MarkKind::Start, self.rows.first()),
            ("end", MarkKind::End, self.rows.last()),
        ];
        let path = |name, look, x: fn(&Row) -> f64, y: fn(&Row) -> f64| {
            Curve::new(name, look, &self.column(x), self.column(y))
        };
        Panel {
            height_mm,
            curves: vec![
                path("nominal", Look::Nominal, |row| row.x_ref, |row| row.y_ref),
                path("actual", Look::Actual, |row| row.x_p, |row| row.y_p),
            ],
            marks: ends
                .into_iter()
                .filter_map(|(name, kind, row)| {
                    row.map(|row| Mark {
                        name,
                        kind,
                        point: [row.x_p, row.y_p],
                    })
                })
                .collect(),
            ..Panel::floor("P")
        }
    }

    pub(super) fn trajectory(&self) -> Figure {
        Figure::column(
            "Trajectory of P",
            "Where P should be and where it truly was, from the triangle to the circle.",
            vec![self.path_panel(80.0)],
        )
    }

    pub(super) fn commanded_velocity(&self) -> Figure {
        let panel = |below, value: fn(&Row) -> f64| {
            let y = Axis::new("velocity", Some(Symbol::new("v", below)), "m/s");
            let velocity = self.column(value);
            let curve = Curve::new("commanded", Look::Actual, &self.time(), velocity);
            self.over_time(y, vec![curve])
        };
        Figure::page(
            "Commanded velocity of P",
            "The velocity asked of P along x and y: the input of the law.",
            vec![panel("Px", |row| row.v_px), panel("Py", |row| row.v_py)],
        )
    }

    /// What the car does; where the controller only estimates it, beneath the estimate. The names
    /// are those of what there is alone, of the estimate, and of the truth beside it.
    fn curves(
        &self,
        [alone, seen, truth]: [&'static str; 3],
        is: fn(&Row) -> f64,
        estimate: fn(&Seen) -> f64,
    ) -> Vec<Curve> {
        let curve = |name, look| Curve::new(name, look, &self.time(), self.column(is));
        if self.seen.is_empty() {
            return vec![curve(alone, Look::Actual)];
        }
        let time = self.seen_column(|seen| seen.time);
        let estimate = self.seen_column(estimate);
        vec![
            Curve::new(seen, Look::Actual, &time, estimate),
            curve(truth, Look::Truth),
        ]
    }

    pub(super) fn steering(&self) -> Figure {
        let y = Axis::new("steering", Some(Symbol::new("δ", "")), "rad");
        let names = ["law", "law", "wheels"];
        let curves = self.curves(names, |row| row.steering, |seen| seen.steering);
        Figure::column(
            "Steering angle generated by the law",
            "What the law asks for, and on the car what the wheels do; left is positive.",
            vec![self.over_time(y, curves)],
        )
    }

    pub(super) fn speed(&self) -> Figure {
        let y = Axis::new("speed", Some(Symbol::new("v", "")), "m/s");
        let reference = self.column(|row| row.speed);
        let reference = Curve::new("reference", Look::Nominal, &self.time(), reference);
        let actual = self.curves(["actual"; 3], |row| row.speed, |seen| seen.estimate.speed);
        let curves = [reference].into_iter().chain(actual.into_iter().take(1));
        Figure::column(
            "Reference and actual speed",
            "The speed that the law asks for, and the car's.",
            vec![self.over_time(y, curves.collect())],
        )
    }

    pub(super) fn position(&self) -> Figure {
        let panel = |letter, should: fn(&Row) -> f64, is, seen| {
            let nominal = Curve::new("nominal", Look::Nominal, &self.time(), self.column(should));
            let actual = self.curves(["actual", "as measured", "true"], is, seen);
            self.over_time(
                Axis::new("position", Some(Symbol::new(letter, "P")), "m"),
                [nominal].into_iter().chain(actual).collect(),
            )
        };
        Figure::page(
            "Position of P over time",
            "Where P should be and where it was; while the markers are lost the measured \
             position stays where it was.",
            vec![
                panel("x", |row| row.x_ref, |row| row.x_p, |seen| seen.point[0]),
                panel("y", |row| row.y_ref, |row| row.y_p, |seen| seen.point[1]),
            ],
        )
    }

    pub(super) fn sideslip_and_yaw_rate(&self) -> Figure {
        let sideslip = Axis::new("sideslip", Some(Symbol::new("β", "")), "rad");
        let yaw_rate = Axis::new("yaw rate", Some(Symbol::new("r", "")), "rad/s");
        let panel =
            |y, is, seen| self.over_time(y, self.curves(["true", "measured", "true"], is, seen));
        Figure::page(
            "Sideslip angle and yaw rate",
            "From the car's axis to the velocity of its centre of mass, and how fast it \
             turns; left is positive.",
            vec![
                panel(sideslip, |row| row.sideslip, |seen| seen.estimate.sideslip),
                panel(yaw_rate, |row| row.yaw_rate, |seen| seen.estimate.yaw_rate),
            ],
        )
    }
}

/// The deviation of P.
pub(super) const DEVIATION: Axis =
    Axis::new("deviation of P", Some(Symbol::new("e", "P")), "m").including(0.0);

/// The paths of several drives towards the same reference.
pub(super) fn trajectories(runs: &[&Run]) -> Figure {
    let mut panels = runs.iter().map(|run| run.path_panel(85.0));
    let mut panel = panels
        .next()
        .unwrap_or_else(|| Panel::new(Axis::new("x", None, "m"), Axis::new("y", None, "m")));
    for other in panels {
        let actual = other.curves.into_iter().filter(|c| c.look == Look::Actual);
        panel.curves.extend(actual);
        panel.marks.extend(other.marks);
    }
    Figure::column(
        "Trajectories of P from several starts",
        "The reference and the paths of P from each triangle.",
        vec![panel],
    )
}

/// A figure of curves over time; later curves cover earlier ones.
pub(super) fn over_time(title: &str, caption: &str, y: Axis, curves: Vec<Curve>) -> Figure {
    let panel = Panel {
        curves,
        ..Panel::new(Axis::TIME, y)
    };
    Figure::column(title, caption, vec![panel])
}
