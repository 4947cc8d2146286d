//! The keys of a line: read all at once, and taken by the command that has them.

use core::time::Duration;

use serde::Deserialize;
use serde_json::Value;
use singletrack_control::Velocity;
use singletrack_core::{
    commissioned::{Procedure, ProcedureResult},
    config::ReferenceSection,
};
use singletrack_pilot::{Jog, Tuning};
use singletrack_record::Channel;

use super::{
    super::setpoint::{PointKeys, SetpointKeys},
    Attendance, Command,
};

/// The keys of a line, before validation.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Line {
    pub(super) version: u32,
    pub(super) command: String,
    attendance: Option<String>,
    for_s: Option<f64>,
    pub(super) uncalibrated: Option<bool>,
    procedure: Option<String>,
    result: Option<String>,
    pub(super) topics: Option<Vec<String>>,
    pub(super) reference: Option<ReferenceSection>,
    velocity_m_s: Option<[f64; 2]>,
    position_m: Option<[f64; 2]>,
    steering_rad: Option<f64>,
    steering_rate_rad_s: Option<f64>,
    speed_m_s: Option<f64>,
    acceleration_m_s2: Option<f64>,
    trajectory: Option<Vec<PointKeys>>,
    time_ns: Option<u64>,
    sequence: Option<u32>,
    pub(super) jog: Option<bool>,
    servo_us: Option<u16>,
    esc_us: Option<u16>,
    pub(super) at_once: Option<bool>,
    pub(super) carried: Option<bool>,
    gain_per_s: Option<Value>,
    point_distance_m: Option<f64>,
}
/// The shortest and the longest time of a timed drive, s.
const MIN_TIME: f64 = 0.5;
const MAX_TIME: f64 = 86_400.0;
impl Line {
    pub(super) fn take_attendance(&mut self) -> Result<Attendance, String> {
        let time = self.for_s.take();
        let attendance = self.attendance.take();
        match (attendance.as_deref(), time) {
            (Some("hold"), None) => Ok(Attendance::Hold),
            (Some("unattended"), None) => Ok(Attendance::Unattended),
            (Some("timed"), Some(seconds)) if (MIN_TIME..=MAX_TIME).contains(&seconds) => {
                Ok(Attendance::Timed(Duration::from_secs_f64(seconds)))
            }
            (Some("timed"), Some(seconds)) => Err(format!(
                "for_s is {seconds}: it must lie between {MIN_TIME} and {MAX_TIME}"
            )),
            (Some("timed"), None) => {
                Err("attendance \"timed\" needs for_s, such as \"for_s\":60".to_owned())
            }
            (Some("hold" | "unattended"), Some(_)) => {
                Err("only attendance \"timed\" takes for_s".to_owned())
            }
            (Some(other), _) => Err(format!(
                "attendance is {other:?}: use \"hold\", \"timed\" or \"unattended\""
            )),
            (None, _) => Err(
                "arm needs an attendance: \"hold\" (send {\"command\":\"hold\"} every 100 ms on \
                 this connection; the drive ends when it does), \"timed\" with for_s, or \
                 \"unattended\" (no client holds it: the drive continues until a stop, a disarm or \
                 a safeguard ends it)"
                    .to_owned(),
            ),
        }
    }

    pub(super) fn take_commissioned(&mut self) -> Result<Command, String> {
        let procedure = self.procedure.take().unwrap_or_default();
        let result = self.result.take().unwrap_or_default();
        Ok(Command::Commissioned {
            procedure: Procedure::named(&procedure).ok_or_else(|| {
                format!("procedure is {procedure:?}: use \"doctor\", \"bring-up\" or \"calibrate\"")
            })?,
            result: ProcedureResult::named(&result).ok_or_else(|| {
                format!(
                    "result is {result:?}: use \"begun\", \"resumed\", \"changed\", \"passed\" or \
                     \"failed\""
                )
            })?,
        })
    }

    pub(super) fn take_jog(&mut self) -> Result<Jog, String> {
        match (self.servo_us.take(), self.esc_us.take()) {
            (Some(servo_us), Some(esc_us)) => Ok(Jog { servo_us, esc_us }),
            _ => Err("jog needs servo_us and esc_us, such as 1500 and 1500".to_owned()),
        }
    }

    /// The gain is a number for both axes, or one for each.
    pub(super) fn take_tuning(&mut self) -> Result<Tuning, String> {
        let gain = self.gain_per_s.take().map(|given| {
            let numbers: Option<Vec<f64>> = match &given {
                Value::Array(axes) => axes.iter().map(Value::as_f64).collect(),
                one => one.as_f64().map(|gain| vec![gain, gain]),
            };
            match numbers.as_deref() {
                Some(&[x, y]) => Ok(Velocity::new(x, y)),
                _ => Err(format!(
                    "gain_per_s is {given}: give a number, or two for x and y, such as [2.0, 2.0]"
                )),
            }
        });
        Ok(Tuning {
            gain: gain.transpose()?,
            point_distance: self.point_distance_m.take(),
        })
    }

    pub(super) fn take_setpoint(&mut self) -> SetpointKeys {
        SetpointKeys {
            velocity_m_s: self.velocity_m_s.take(),
            position_m: self.position_m.take(),
            steering_rad: self.steering_rad.take(),
            steering_rate_rad_s: self.steering_rate_rad_s.take(),
            speed_m_s: self.speed_m_s.take(),
            acceleration_m_s2: self.acceleration_m_s2.take(),
            trajectory: self.trajectory.take(),
            time_ns: self.time_ns.take(),
            sequence: self.sequence.take(),
        }
    }

    /// Refuses the keys that the command does not have.
    pub(super) fn refuse_other_keys(&self) -> Result<(), String> {
        for (key, is_there, owner) in [
            ("attendance", self.attendance.is_some(), "arm"),
            ("for_s", self.for_s.is_some(), "arm"),
            ("uncalibrated", self.uncalibrated.is_some(), "arm"),
            ("procedure", self.procedure.is_some(), "commissioned"),
            ("result", self.result.is_some(), "commissioned"),
            ("topics", self.topics.is_some(), "watch"),
            ("reference", self.reference.is_some(), "set-reference"),
            ("velocity_m_s", self.velocity_m_s.is_some(), "setpoint"),
            ("position_m", self.position_m.is_some(), "setpoint"),
            ("steering_rad", self.steering_rad.is_some(), "setpoint"),
            (
                "steering_rate_rad_s",
                self.steering_rate_rad_s.is_some(),
                "setpoint",
            ),
            ("speed_m_s", self.speed_m_s.is_some(), "setpoint"),
            (
                "acceleration_m_s2",
                self.acceleration_m_s2.is_some(),
                "setpoint",
            ),
            ("trajectory", self.trajectory.is_some(), "setpoint"),
            ("time_ns", self.time_ns.is_some(), "setpoint"),
            ("sequence", self.sequence.is_some(), "setpoint"),
            ("jog", self.jog.is_some(), "arm"),
            ("servo_us", self.servo_us.is_some(), "jog"),
            ("esc_us", self.esc_us.is_some(), "jog"),
            ("at_once", self.at_once.is_some(), "disarm"),
            ("carried", self.carried.is_some(), "disarm"),
            ("gain_per_s", self.gain_per_s.is_some(), "tune"),
            ("point_distance_m", self.point_distance_m.is_some(), "tune"),
        ] {
            if is_there {
                return Err(format!(
                    "{} takes no {key}; only {owner} does",
                    self.command
                ));
            }
        }
        Ok(())
    }
}
pub(super) fn channel(topic: &str) -> Result<Channel, String> {
    Channel::all()
        .find(|channel| channel.topic() == topic)
        .ok_or_else(|| {
            let known: Vec<_> = Channel::all().map(Channel::topic).collect();
            format!("no topic {topic:?}: use {}", known.join(", "))
        })
}
