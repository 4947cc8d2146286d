//! How far the path bends otherwise than it is steered: what the safety filter has to allow for.

use std::collections::VecDeque;

use serde::Serialize;
use singletrack_control::{GENTLE_BEND, GRAVITY, Time};
use singletrack_core::Config;

use super::run::{Log, Run, SLOWEST};

/// The pilot ends a drive whose path bends otherwise for this long, s.
const LASTS: f64 = 0.2;
/// The growth shows from so much beyond [`GENTLE_BEND`] on, m/s².
const BEYOND: f64 = 0.5;

/// The largest deviation of the curvature that lasts as long as the pilot bears it, in the terms of
/// `[safety_filter]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Bends {
    /// In 1/m, up to a lateral acceleration of 2.45 m/s²: `curvature_error_per_m`.
    pub curvature_error_per_m: f64,
    /// What each m/s² beyond adds to it: `curvature_error_per_m_per_m_s2`; none of a drive without.
    pub curvature_error_per_m_per_m_s2: Option<f64>,
    /// The largest lateral acceleration that was steered, within what the tyres hold, in m/s².
    pub lateral_m_s2: f64,
}

/// A tick whose motion the cameras show.
#[derive(Clone, Copy)]
struct Bend {
    time: Time,
    /// Beyond the curvatures of the angles between which the wheels stand, 1/m.
    off: f64,
    /// What the angles ask for, m/s².
    lateral: f64,
}

impl Bends {
    /// The bends of a drive; none if the cameras never show a car that drives for long enough.
    pub(super) fn of(log: &Log, run: &Run, config: &Config) -> Option<Self> {
        let (wheelbase, most) = (
            config.vehicle.wheelbase_m(),
            config.vehicle.friction * GRAVITY,
        );
        let settles = 1e-3 * config.steering_settles_ms();
        let mut angles: VecDeque<(Time, f64)> = VecDeque::new();
        let mut lasting: VecDeque<Bend> = VecDeque::new();
        let mut worst: Vec<Bend> = Vec::new();
        for tick in &log.ticks {
            let now = tick.time;
            angles.push_back((now, libm::tan(tick.commanded.steering) / wheelbase));
            while angles
                .front()
                .is_some_and(|(time, _)| now.seconds_since(*time) > settles)
            {
                angles.pop_front();
            }
            let Some(motion) = run
                .track
                .motion(now)
                .filter(|motion| motion.forward > SLOWEST)
            else {
                lasting.clear();
                continue;
            };
            let ends = [f64::INFINITY, f64::NEG_INFINITY];
            let [least, greatest] = angles.iter().fold(ends, |[least, greatest], (_, bend)| {
                [least.min(*bend), greatest.max(*bend)]
            });
            let bend = motion.yaw_rate / motion.speed();
            lasting.push_back(Bend {
                time: now,
                off: (bend - greatest).max(least - bend).max(0.0),
                lateral: (motion.speed().powi(2) * least.abs().max(greatest.abs())).min(most),
            });
            let since = |bend: &Bend| now.seconds_since(bend.time);
            while lasting.get(1).is_some_and(|bend| since(bend) >= LASTS) {
                lasting.pop_front();
            }
            if lasting.front().is_some_and(|bend| since(bend) >= LASTS) {
                let all = lasting.iter();
                worst.push(Bend {
                    time: now,
                    off: all
                        .clone()
                        .map(|bend| bend.off)
                        .fold(f64::INFINITY, f64::min),
                    lateral: all.map(|bend| bend.lateral).fold(0.0, f64::max),
                });
            }
        }
        let gentle = worst.iter().filter(|bend| bend.lateral <= GENTLE_BEND);
        let curvature_error_per_m = gentle.map(|bend| bend.off).fold(0.0, f64::max);
        let beyond = worst
            .iter()
            .filter(|bend| bend.lateral > GENTLE_BEND + BEYOND);
        let growth =
            beyond.map(|bend| (bend.off - curvature_error_per_m) / (bend.lateral - GENTLE_BEND));
        (!worst.is_empty()).then(|| Self {
            curvature_error_per_m,
            curvature_error_per_m_per_m_s2: growth.reduce(f64::max).map(|growth| growth.max(0.0)),
            lateral_m_s2: worst.iter().map(|bend| bend.lateral).fold(0.0, f64::max),
        })
    }
}
