//! The experiments of the labs: scenarios of the simulator, as a student writes them.

use std::{f64::consts::TAU, path::Path};

use singletrack_control::VehicleParameters;
use singletrack_scenario::{
    simulate::{PlantKind, Row, Scenario, simulate},
    tracking::{Sample, Tracking, last_turn},
};

use super::error::LabError;

/// The paper's distance p, in m.
pub(super) const POINT_DISTANCE: f64 = 0.35;

/// P starts this far behind its reference, in rad: at no distance from it, without
/// feed-forward, the loop commands standstill, where the model has no solution.
const BEHIND: f64 = 0.1;

/// P on a circle.
#[derive(Clone, Copy, Debug)]
pub(super) struct CircleDrive {
    pub(super) plant: PlantKind,
    /// Radius in m, and angular velocity in rad/s.
    pub(super) radius: f64,
    pub(super) rate: f64,
    /// Position gain, in 1/s.
    pub(super) gain: f64,
    pub(super) feed_forward: bool,
    /// p, in m.
    pub(super) point_distance: f64,
    /// By how much the law assumes the centre of mass too far back, in m.
    pub(super) deviation: f64,
    /// The period of the control in ms, 0 for continuous control, and its delay in ticks.
    pub(super) period_ms: u32,
    pub(super) delay_ticks: u32,
}

impl CircleDrive {
    /// The ideal car under continuous control, with the paper's law.
    pub(super) const fn ideal(radius: f64, rate: f64, gain: f64) -> Self {
        Self {
            plant: PlantKind::Ideal,
            radius,
            rate,
            gain,
            feed_forward: false,
            point_distance: POINT_DISTANCE,
            deviation: 0.0,
            period_ms: 0,
            delay_ticks: 0,
        }
    }

    /// The scenario file.
    fn scenario(&self, start: [f64; 2], yaw_deg: f64, duration: f64) -> String {
        let axle = VehicleParameters::paper().front_axle_distance_m + self.deviation;
        let kind = match self.plant {
            PlantKind::Ideal => "ideal",
            PlantKind::Car => "car",
        };
        let Self {
            radius,
            rate,
            gain,
            feed_forward,
            point_distance,
            period_ms,
            delay_ticks,
            ..
        } = self;
        let [x, y] = start;
        format!(
            "[law]\nkind = \"front-point\"\npoint_distance_m = {point_distance:?}\n\
             front_axle_distance_m = {axle:?}\n\
             [outer_loop]\nkind = \"proportional\"\ngain_per_s = [{gain:?}, {gain:?}]\n\
             feed_forward = {feed_forward}\n\
             [reference]\nkind = \"circle\"\nradius_m = {radius:?}\n\
             angular_velocity_rad_s = {rate:?}\n\
             [start]\npoint_p_m = [{x:?}, {y:?}]\nyaw_deg = {yaw_deg:?}\n\
             [control]\nperiod_ms = {period_ms}\ndelay_ticks = {delay_ticks}\n\
             [plant]\nkind = \"{kind}\"\n[run]\nduration_s = {duration:?}\n"
        )
    }

    fn rows(&self, start: [f64; 2], yaw_deg: f64, duration: f64) -> Result<Vec<Row>, LabError> {
        rows(&self.scenario(start, yaw_deg, duration))
    }

    /// The drive until P has settled, and a turn.
    pub(super) fn settled(&self) -> Result<Vec<Row>, LabError> {
        let turn = TAU / self.rate;
        let settling = (12.0 / self.gain).clamp(10.0, 60.0);
        let start = [self.radius * BEHIND.cos(), -self.radius * BEHIND.sin()];
        let duration = (20.0 * (settling + turn)).ceil() / 20.0;
        self.rows(start, 90.0 - BEHIND.to_degrees(), duration)
    }

    /// Amplitude, lag and error over the last turn.
    pub(super) fn tracking(&self) -> Result<Tracking, LabError> {
        let rows = self.settled()?;
        let samples: Vec<Sample> = rows
            .iter()
            .map(|row| Sample {
                time: row.t,
                point: [row.x_p, row.y_p],
                reference: [row.x_ref, row.y_ref],
            })
            .collect();
        last_turn(&samples, [0.0, 0.0], self.rate).ok_or(LabError::NotFound("full turn"))
    }

    /// The distance of P from its reference, in m, `duration` s after a start `offset` m outside.
    pub(super) fn error_after(&self, offset: f64, duration: f64) -> Result<f64, LabError> {
        let rows = self.rows([self.radius + offset, 0.0], 90.0, duration)?;
        let last = rows.last().ok_or(LabError::NotFound("row"))?;
        Ok(distance(last))
    }
}

/// The distance of the true P from its reference, in m.
pub(super) fn distance(row: &Row) -> f64 {
    (row.x_p - row.x_ref).hypot(row.y_p - row.y_ref)
}

/// P along a straight whose direction turns by `angle` rad to the left, without a position loop,
/// with a law that is wrong by `deviation` m: how far P ends from where it should, in m.
pub(super) fn way_off_after_turn(angle: f64, deviation: f64) -> Result<f64, LabError> {
    let axle = VehicleParameters::paper().front_axle_distance_m + deviation;
    // Larger steps bring sideslip and steering to the singularity of the law.
    let turns = (angle / 20_f64.to_radians()).ceil().max(1.0);
    let (speed, hold, settle) = (0.6, 3.0, 15.0);
    let mut steps = String::new();
    for turn in 0..=turns as u32 {
        let (v_y, v_x) = (angle * f64::from(turn) / turns).sin_cos();
        let (v_x, v_y) = (speed * v_x, speed * v_y);
        let time = if f64::from(turn) < turns {
            hold
        } else {
            settle
        };
        steps.push_str(&format!(
            "{{ duration_s = {time:?}, v_x_m_s = {v_x:?}, v_y_m_s = {v_y:?} }},\n"
        ));
    }
    let rows = rows(&format!(
        "[law]\nkind = \"front-point\"\npoint_distance_m = {POINT_DISTANCE:?}\n\
         front_axle_distance_m = {axle:?}\n\
         [outer_loop]\nkind = \"open-loop\"\n\
         [reference]\nkind = \"velocity-steps\"\nsteps = [\n{steps}]\n\
         [start]\npoint_p_m = [0.0, 0.0]\nyaw_deg = 0.0\n\
         [control]\nperiod_ms = 0\n[plant]\nkind = \"ideal\"\n\
         [run]\nduration_s = {:?}\n",
        hold * turns + settle
    ))?;
    let last = rows.last().ok_or(LabError::NotFound("row"))?;
    Ok(distance(last))
}

fn rows(scenario: &str) -> Result<Vec<Row>, LabError> {
    let scenario = Scenario::from_toml(scenario, Path::new("lab.toml"))?;
    Ok(simulate(&scenario)?.rows)
}
