//! Cost of a tick of each outer loop.

mod ticks;

use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_control::{
    Circle, ConvexArea, Estimate, Filtered, FrontPointLaw, LimitedLaw, Limits, LqiAxis, LqiConfig,
    LqiLoop, MpcConfig, MpcLoop, OuterLoop, Position, ProportionalLoop, Reference, SafetyConfig,
    SafetyFilter, SafetyInput, Time, TrackingInput, Velocity,
};

use ticks::measure;

const PERIOD: f64 = 0.01;

fn lqi() -> Option<LqiLoop> {
    let axis = |lag| LqiAxis {
        lag,
        integral_weight: 1.0,
        error_weight: 1.0,
        velocity_weight: 0.0625,
    };
    LqiLoop::new(LqiConfig {
        along: axis(0.08),
        across: axis(0.04),
        integral_limit: 0.5,
        turn_rate: 3.0,
        period: PERIOD,
    })
    .ok()
}

fn mpc(iterations: usize) -> Option<MpcLoop<4, 25>> {
    let half = 1.5;
    let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
    MpcLoop::new(MpcConfig {
        lag: 0.08,
        period: PERIOD,
        ticks_per_stage: 3,
        position_weight: 1.0,
        velocity_weight: 0.02,
        acceleration_weight: 0.004,
        max_speed: 1.2,
        max_acceleration: 2.0,
        max_deceleration: 2.0,
        area: Some(ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).ok()?),
        iterations,
        disturbance_gain: 0.02,
    })
    .ok()
}

/// P after a reference on a circle that reaches beyond the area, as an ideal integrator.
struct Drive<L> {
    tracking: L,
    reference: Reference,
    point: Position,
    applied: Velocity,
    tick: u32,
}

impl<L: OuterLoop> Drive<L> {
    fn new(tracking: L) -> Option<Self> {
        Some(Self {
            tracking,
            reference: Reference::Circle(Circle::new(Position::new(0.6, 0.0), 1.0, 0.8).ok()?),
            point: Position::new(1.4, 0.0),
            applied: Velocity::zeros(),
            tick: 0,
        })
    }

    // By its own name in the profile of callgrind, which counts instructions.
    #[inline(never)]
    fn tick(&mut self) -> Velocity {
        self.tick += 1;
        let time = f64::from(self.tick) * PERIOD;
        self.applied = self.tracking.step(&TrackingInput {
            point: self.point,
            reference: &|ahead| self.reference.at(time + ahead),
            applied: self.applied,
            period: PERIOD,
        });
        self.point += self.applied * PERIOD;
        self.applied
    }
}

/// A car in the corner of its area that wants to go out: every candidate is tried.
fn hostile() -> Option<impl FnMut() -> Velocity> {
    let corners = [(-1.5, -1.5), (1.5, -1.5), (1.5, 1.5), (-1.5, 1.5)];
    let mut filter = SafetyFilter::new(SafetyConfig {
        area: ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).ok()?,
        reaction: 0.15,
        steering_ticks: 20,
        position_error: 0.01,
        course_error: 0.02,
        curvature_error: 0.1,
        curvature_error_growth: 0.0,
        speed_error: 0.0,
        max_speed: 1.5,
        max_lateral_acceleration: 2.0,
        slip: 0.0,
        wheelbase: 0.26,
    })
    .ok()?;
    let law = LimitedLaw::new(
        FrontPointLaw::new(0.1368, 0.35, 0.26).ok()?,
        Limits::paper(),
    );
    let estimate = Estimate {
        time: Time(0),
        position: Position::new(1.4, 1.4),
        yaw: 0.8,
        yaw_rate: 0.5,
        sideslip: 0.05,
        speed: 0.8,
        pose_time: Time(0),
    };
    Some(move || {
        let input = SafetyInput {
            estimate: &estimate,
            law: &law,
            wheels: 0.0,
            wave: 0.0,
            blind: 0.01,
            braking: 0.9,
            period: PERIOD,
            neighbours: &[],
        };
        filter.observe(0.8, 0.0, 0.9, PERIOD);
        let wanted = Velocity::new(1.0, 1.1);
        match filter.step(&input, &wanted, |law, velocity| {
            law.step(&estimate.motion(), estimate.speed, velocity, PERIOD)
        }) {
            Filtered::Limited(velocity) | Filtered::Scaled(velocity) => velocity,
            _ => Velocity::zeros(),
        }
    })
}

fn outer_loops(criterion: &mut Criterion) {
    let proportional = ProportionalLoop {
        gain: Velocity::new(1.0, 1.0),
        feed_forward: true,
    };
    if let Some(mut drive) = Drive::new(proportional) {
        measure(criterion, "proportional", || drive.tick());
    }
    if let Some(mut drive) = lqi().and_then(Drive::new) {
        measure(criterion, "lqi", || drive.tick());
    }
    for iterations in [10, 30] {
        if let Some(mut drive) = mpc(iterations).and_then(Drive::new) {
            let name = format!("mpc-{iterations}-iterations");
            measure(criterion, &name, || drive.tick());
        }
    }
    if let Some(tick) = hostile() {
        measure(criterion, "safety-filter", tick);
    }
}

criterion_group!(benches, outer_loops);
criterion_main!(benches);
