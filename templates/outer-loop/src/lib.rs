//! Pursuit with drift: P aims at the place where its reference will be, and learns what takes it aside.

use singletrack_control::{OuterLoop, TrackingInput, Velocity};
use singletrack_core::config::{LoopModel, OwnLoop};
use singletrack_settings::{ValueError, section};

section! {
    /// The keys of `[outer_loop.own]`.
    "outer_loop.own" => pub Settings: Copy;
    [default];

    /// How far ahead P aims, in s: the less, the faster an error goes to zero.
    look_ahead_s: f64 = 0.1, in up_to(2.0);
    /// The share of an error that becomes drift within a second, 1/s².
    drift_gain_per_s2: f64 = 1.0, in 0.0..=10.0;
    /// The largest drift, m/s.
    drift_limit_m_s: f64 = 0.2, in 0.0..=1.0;
}

/// The loop with its state.
#[derive(Clone, Debug, PartialEq)]
pub struct MyLoop {
    settings: Settings,
    /// The velocity that takes P aside, m/s.
    drift: Velocity,
}

impl OuterLoop for MyLoop {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        let Settings {
            look_ahead_s,
            drift_gain_per_s2,
            drift_limit_m_s,
        } = self.settings;
        let (now, later) = ((input.reference)(0.0), (input.reference)(look_ahead_s));
        let (Some(place), Some(aim)) = (now.position, later.position) else {
            return now.velocity;
        };
        let change = drift_gain_per_s2 * input.period * (place - input.point);
        self.drift = (self.drift + change).cap_magnitude(drift_limit_m_s);
        (aim - input.point) / look_ahead_s + self.drift
    }

    fn reset(&mut self) {
        self.drift = Velocity::zeros();
    }
}

impl OwnLoop for MyLoop {
    const NAME: &'static str = env!("CARGO_PKG_NAME");
    const VERSION: &'static str = env!("CARGO_PKG_VERSION");
    type Settings = Settings;

    fn new(settings: Settings, model: &LoopModel<'_>) -> Result<Self, ValueError> {
        let (key, time) = ("outer_loop.own.look_ahead_s", settings.look_ahead_s);
        if time < 2.0 * model.period {
            let fix = format!("it must be at least two ticks, {} s", 2.0 * model.period);
            return Err(ValueError::new(key, time, fix));
        }
        let drift = Velocity::zeros();
        Ok(Self { settings, drift })
    }
}
