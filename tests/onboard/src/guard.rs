//! What is watched in every tick of a campaign, and must never happen.

use singletrack_core::Config;
use singletrack_protocol::BoardMode;
use singletrack_scenario::virtual_drive::VirtualDrive;
use singletrack_sim::Truth;

/// What must never happen.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// When, in s since the car was switched on.
    pub at_s: f64,
    /// What.
    pub what: String,
}

/// The watch over the true car.
#[derive(Debug)]
pub struct Guard {
    corners: Vec<[f64; 2]>,
    cap_m_s: f64,
    violations: Vec<Violation>,
    /// Since when the motor is driven while the board is not armed, in s.
    driven_since: Option<f64>,
    /// The way of the car when the present jog began, in m.
    jog_from: Option<f64>,
    /// Sum and number of the biases of the gyro in this step, along its own axes, in rad/s.
    bias: ([f64; 3], u32),
    /// Kinds of violations that last.
    lasting: [bool; 4],
}

/// The longest time for which a motor may be driven after the board has disarmed, in s: the
/// motor controller that waits longest for pulses waits for one second.
const RUN_ON_S: f64 = 1.2;
/// The largest excess of a speed over the cap, in m/s: that of the pilot's watch.
const OVERSPEED_M_S: f64 = 0.4;
/// The longest way of a car on the floor in one jog, in m.
const JOG_WAY_M: f64 = 0.5;

impl Guard {
    pub(crate) fn new(config: &Config) -> Self {
        let mut guard = Self {
            corners: Vec::new(),
            cap_m_s: 0.0,
            violations: Vec::new(),
            driven_since: None,
            jog_from: None,
            bias: ([0.0; 3], 0),
            lasting: [false; 4],
        };
        guard.configure(config);
        guard
    }

    pub(crate) fn configure(&mut self, config: &Config) {
        self.corners = config.fence.corners_m.clone();
        self.cap_m_s = config.limits.max_speed_m_s;
    }

    /// What happened and must not.
    pub fn violations(&self) -> &[Violation] {
        &self.violations
    }

    fn note(&mut self, kind: usize, happens: bool, now_s: f64, what: impl FnOnce() -> String) {
        if happens && !self.lasting[kind] {
            self.violations.push(Violation {
                at_s: now_s,
                what: what(),
            });
        }
        self.lasting[kind] = happens;
    }

    pub(crate) fn watch(&mut self, drive: &VirtualDrive, truth: &Truth) {
        let world = &drive.world;
        let now_s = truth.time_us as f64 * 1e-6;
        let mode = world.board.telemetry().map(|telemetry| telemetry.mode);
        let armed = matches!(
            mode,
            Some(
                BoardMode::PoweringUp | BoardMode::Armed | BoardMode::Driving | BoardMode::Jogging
            )
        );
        let free = !truth.held;
        let driven = free && !armed && world.car.is_driven();
        self.driven_since = driven.then(|| self.driven_since.unwrap_or(now_s));
        let runs_on = self
            .driven_since
            .is_some_and(|since| now_s - since > RUN_ON_S);
        self.note(0, runs_on, now_s, || {
            "the motor drives an unarmed car".into()
        });

        let outside =
            free && truth.speed.abs() > 0.02 && !contains(&self.corners, [truth.x, truth.y]);
        self.note(1, outside, now_s, || "outside the fence".into());

        let most = self.cap_m_s + OVERSPEED_M_S;
        let fast = free && truth.speed.abs() > most;
        self.note(2, fast, now_s, || format!("{:.2} m/s", truth.speed));

        for (sum, bias) in self.bias.0.iter_mut().zip(world.gyro_bias_rad_s()) {
            *sum += bias;
        }
        self.bias.1 += 1;

        let jogs = free && mode == Some(BoardMode::Jogging);
        self.jog_from = jogs.then(|| self.jog_from.unwrap_or(truth.way));
        let far = self
            .jog_from
            .is_some_and(|from| truth.way - from > JOG_WAY_M);
        self.note(3, far, now_s, || {
            "a jog drives the car over the floor".into()
        });
    }

    /// Forgets the step before.
    pub(crate) fn begin_step(&mut self) {
        self.bias = ([0.0; 3], 0);
    }

    /// The mean bias of the gyro in this step about the axis that is configured to point up, in
    /// rad/s: it wanders.
    pub(crate) fn gyro_bias(&self, config: &Config) -> f64 {
        let up = config.board_configuration().imu_axes.up;
        let (sum, count) = self.bias;
        let bias = sum[usize::from(up.index())] / f64::from(count.max(1));
        if up.is_negative() { -bias } else { bias }
    }

    /// At the end of a procedure, when the car has had its time to roll out.
    pub(crate) fn end(&mut self, drive: &VirtualDrive) {
        let truth = drive.world.truth();
        let at_s = truth.time_us as f64 * 1e-6;
        let turns = truth.wheel_speed.abs() > 0.02;
        if drive.mode().is_underway() || turns {
            self.violations.push(Violation {
                at_s,
                what: format!(
                    "not stopped at the end: {}, wheels at {:.2} m/s",
                    drive.mode(),
                    truth.wheel_speed
                ),
            });
        }
    }
}

/// Whether a point lies inside a polygon.
fn contains(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let mut inside = false;
    let mut before = corners.last();
    for corner in corners {
        if let Some(&[bx, by]) = before {
            let [ax, ay] = *corner;
            if (ay > y) != (by > y) && x < (bx - ax) * (y - ay) / (by - ay) + ax {
                inside = !inside;
            }
        }
        before = Some(corner);
    }
    inside
}
