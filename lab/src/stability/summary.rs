//! The stability of a car in words.

use std::io::{self, Write};

use clap::Args;
use singletrack_analysis::stability::{
    ClosedLoop, Law, MarginLimits, critical_speed, infinite_speed_limit, smallest_point_distance,
};

use super::{
    arguments::{CarArgs, TimingArgs},
    limits::{RANGE_POINTS, SEARCHED_DISTANCES, SEARCHED_SPEEDS, first_unstable, least_p},
    subject::{Grid, Subject},
};
use crate::Result;

#[derive(Clone, Debug, Args)]
pub(super) struct SummaryArgs {
    #[command(flatten)]
    car: CarArgs,
    #[command(flatten)]
    timing: TimingArgs,
}

/// The speeds of the summary, in m/s.
const SPEEDS: [f64; 5] = [0.1, 0.5, 1.0, 2.0, 5.0];

pub(super) fn run(args: &SummaryArgs) -> Result {
    let own = args.car.under(Law::FrontPoint)?;
    let mut out = io::stdout().lock();
    let [from, to] = ClosedLoop::meaningful_deviations(&own.vehicle);
    writeln!(
        out,
        "meaningful dl: {from} m to {to} m (-l_f to l_r); p = {} m; l1 as Kuznetsov's (figures: \
         MatCont's)\n",
        args.car.point_distance
    )?;
    proposed(&mut out, &own)?;
    writeln!(out, "velocity-point law (appendix), l_f + dl and l_r - dl")?;
    let appendix = Subject {
        law: Law::VelocityPoint,
        ..own
    };
    hopf_lines(&mut out, &appendix)?;
    sampled(&mut out, &own, args.timing)?;
    let timing = if args.timing.steering_lag_ms == 0.0 {
        TimingArgs {
            period_ms: args.timing.period_ms,
            position_gain: args.timing.position_gain,
            ..TimingArgs::simulated_car()
        }
    } else {
        args.timing
    };
    with_servo(&mut out, &own, timing)
}

fn proposed(out: &mut impl Write, subject: &Subject) -> Result {
    writeln!(
        out,
        "front-point law (proposed), in continuous time, wheels that follow at once"
    )?;
    for limit in infinite_speed_limit(subject.vehicle, subject.point_distance)? {
        writeln!(
            out,
            "  for speeds without bounds stability ends at dl = {limit:.6} m"
        )?;
    }
    let range = ClosedLoop::meaningful_deviations(&subject.vehicle);
    match critical_speed(subject.vehicle, subject.point_distance, range)? {
        None => writeln!(
            out,
            "  stable over the whole meaningful range at every speed"
        )?,
        Some(speed) => writeln!(
            out,
            "  stable over the whole meaningful range up to {speed:.3} m/s, NOT beyond"
        )?,
    }
    match smallest_point_distance(subject.vehicle, range)? {
        None => writeln!(out, "  no p makes it so at every speed")?,
        Some(p) => writeln!(out, "  (at every speed with every p above {p:.4} m)")?,
    }
    hopf_lines(out, subject)
}

fn hopf_lines(out: &mut impl Write, subject: &Subject) -> Result {
    let [from, to] = ClosedLoop::meaningful_deviations(&subject.vehicle);
    for speed in SPEEDS {
        for point in subject.hopf_points(speed)? {
            writeln!(
                out,
                "  {speed} m/s: Hopf at dl = {:.6} m{}, {:.3} rad/s, l1 = {:.4e} ({})",
                point.deviation,
                if (from..=to).contains(&point.deviation) {
                    ""
                } else {
                    " (not meaningful)"
                },
                point.angular_frequency,
                point.lyapunov.kuznetsov,
                point.criticality(),
            )?;
        }
    }
    writeln!(out)?;
    Ok(())
}

fn sampled(out: &mut impl Write, subject: &Subject, timing: TimingArgs) -> Result {
    writeln!(
        out,
        "front-point law in ticks of {} ms, acting {} ms late{}, dl = 0",
        timing.period_ms,
        timing.delay_ms,
        servo_text(timing)
    )?;
    let limits = MarginLimits::default();
    for speed in SPEEDS {
        let sampled = timing.around(subject.at(speed, 0.0)?)?;
        let radius = sampled.spectral_radius();
        let or_more = |value: Option<f64>, limit: f64| {
            value.map_or_else(
                || format!("more than {limit:.3} s"),
                |value| format!("{value:.3} s"),
            )
        };
        writeln!(
            out,
            "  {speed} m/s: spectral radius {radius:.5}; delay margin {}; longest constant marker interval {}",
            or_more(sampled.delay_margin(limits), limits.delay),
            or_more(
                sampled.longest_constant_interval(limits),
                f64::from(limits.marker_interval) * timing.period_ms * 1e-3
            ),
        )?;
    }
    Ok(())
}

fn servo_text(timing: TimingArgs) -> String {
    let TimingArgs {
        steering_lag_ms: lag,
        steering_dead_time_ms: dead_time,
        yaw_rate_age_ms: age,
        ..
    } = timing;
    if lag == 0.0 {
        return String::new();
    }
    let controller = controller_text(timing);
    format!(
        ", servo with {dead_time} ms of dead time and {lag} ms of lag, yaw rate {age} ms old{controller}"
    )
}

fn controller_text(timing: TimingArgs) -> &'static str {
    if timing.compensate {
        ", compensated"
    } else if timing.predict {
        ", state predicted"
    } else {
        ""
    }
}

/// What a servo leaves of the stability, without and with the pilot's compensation, and with an
/// exact prediction.
fn with_servo(out: &mut impl Write, subject: &Subject, timing: TimingArgs) -> Result {
    let plain = TimingArgs {
        predict: false,
        compensate: false,
        ..timing
    };
    writeln!(
        out,
        "\nfront-point law in ticks of {} ms, acting {} ms late{}",
        plain.period_ms,
        plain.delay_ms,
        servo_text(plain)
    )?;
    let up_to = |speed: Option<f64>| {
        speed.map_or_else(
            || format!("up to {} m/s at least", SEARCHED_SPEEDS[1]),
            |speed| format!("up to {speed:.2} m/s, NOT beyond"),
        )
    };
    let range = ClosedLoop::meaningful_deviations(&subject.vehicle);
    let all = Grid::spanning(range, RANGE_POINTS);
    for (what, deviations) in [
        ("with dl = 0", &[0.0][..]),
        ("over the whole meaningful range", all.values()),
    ] {
        for (compensate, predict) in [(false, false), (true, false), (false, true)] {
            let timing = TimingArgs {
                compensate,
                predict,
                ..plain
            };
            let speed = first_unstable(subject, timing, deviations, subject.point_distance)?;
            writeln!(
                out,
                "  stable {what}{}: {}",
                controller_text(timing),
                up_to(speed)
            )?;
        }
    }
    for speed in SPEEDS {
        let least = least_p(subject, plain, &[0.0], speed)?;
        writeln!(
            out,
            "  {speed} m/s with dl = 0: stable {}",
            least.map_or_else(
                || format!("with no p up to {} m", SEARCHED_DISTANCES[1]),
                |p| format!("from p = {p:.3} m on"),
            )
        )?;
    }
    Ok(())
}
