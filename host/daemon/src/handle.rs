//! Access to the running daemon for every thread but the control thread, and a copy of its status.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use serde_json::{Value, json};
use singletrack_api::{Board, Configuration, Tunable, Tuning, TuningBounds, record_trouble};
use singletrack_core::{Requests, config::TuningRule, slot::SetpointSender, slot::SlotSender};
use singletrack_pilot::{Jog, Mode, Output, Reason, Tuned};

use crate::{
    commissioned_file::CommissionedFile,
    control_thread::ControlThreadState,
    realtime::RealTimeStatus,
    reconfigure::Reconfigurer,
    shared_status::{Latest, SharedStatus},
    socket::{Drives, Newest},
    summary::Figures,
};

/// Reads the daemon's status and passes requests to the control thread.
#[derive(Clone, Debug)]
pub(crate) struct DaemonHandle {
    pub(crate) status: Arc<SharedStatus>,
    /// Whether the control thread lives; what it does is in the status, which may be late.
    pub(crate) control: ControlThreadState,
    pub(crate) requests: Requests,
    pub(crate) setpoints: SetpointSender,
    /// Which client gives the set-points.
    pub(crate) newest_setpoint: Arc<Mutex<Newest>>,
    pub(crate) jogs: SlotSender<Jog>,
    pub(crate) tunings: SlotSender<singletrack_pilot::Tuning>,
    /// The file of the configuration, for a reload.
    pub(crate) config_path: Option<PathBuf>,
    /// The file of the record.
    pub(crate) record: Option<PathBuf>,
    pub(crate) reconfigurer: Reconfigurer,
    pub(crate) realtime: RealTimeStatus,
    /// What the cars have passed.
    pub(crate) commissioned: CommissionedFile,
    /// Numbers the drives that clients arm.
    pub(crate) drives: Drives,
}

impl DaemonHandle {
    /// Why nothing is recorded, or soon will not be; `None` if all is well with the record.
    pub(crate) fn record_trouble(&self) -> Option<String> {
        let latest = self.status.latest();
        record_trouble(
            latest.record_error.as_deref(),
            latest.record_warning.as_deref(),
        )
    }

    /// Copies the present status.
    pub(crate) fn snapshot(&self) -> Snapshot {
        let latest = self.status.latest().clone();
        let published = self.reconfigurer.published();
        Snapshot {
            latest,
            figures: self.status.tally().figures(),
            realtime: self.realtime.clone(),
            configuration: published.view.clone(),
            tuning: published.config.tuning_rule(),
            commissioned: published
                .subject
                .map(|subject| self.commissioned.view(subject)),
            config_path: self.config_path.clone(),
            record: self.record.clone(),
        }
    }
}

/// The status of the daemon: the last tick, the last messages of the board, and the
/// figures so far.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// What the threads have reported.
    pub latest: Latest,
    /// The figures so far.
    pub figures: Figures,
    /// What the system granted the control thread.
    pub realtime: RealTimeStatus,
    /// The configuration in force.
    pub configuration: Configuration,
    /// What may be tuned in it.
    pub tuning: TuningRule,
    /// What the car of this configuration has passed.
    pub commissioned: Option<Value>,
    /// The file of the configuration.
    pub config_path: Option<PathBuf>,
    /// The file of the record.
    pub record: Option<PathBuf>,
}

impl Snapshot {
    /// What the pilot decided in the last tick.
    pub fn output(&self) -> Option<&Output> {
        self.latest.tick.as_ref().map(|tick| &tick.output)
    }

    /// The pilot's mode; disconnected before the first tick.
    pub fn mode(&self) -> Mode {
        self.output()
            .map_or(Mode::Disconnected, |output| output.mode)
    }

    /// Why the car does not drive, or stopped.
    pub fn reason(&self) -> Option<Reason> {
        self.output().and_then(|output| output.reason)
    }

    /// The status as the control socket gives it.
    pub(crate) fn status(&self) -> singletrack_api::Status {
        let latest = self.latest.clone();
        // That of another configuration says nothing of this one.
        let of_this = |(number, _): &(u32, _)| *number == self.configuration.number;
        let calibration = latest.calibration.filter(of_this);
        singletrack_api::Status {
            board: latest.board.map(|(mode, cause)| Board {
                battery_mv: latest.board_status.map(|status| status.battery_mv),
                mode: mode.name().into(),
                stop_cause: cause.name().into(),
                stop_input_open: latest.board_status.map(|status| status.stop_input_open),
            }),
            calibration: calibration.map(|(_, calibration)| calibration),
            cameras: latest.cameras,
            commissioned: self.commissioned.clone(),
            config_path: self.config_path.as_deref().map(shown),
            configuration: self.configuration.clone(),
            figures: json!(self.figures),
            learned: latest.learned.map(|it| singletrack_api::Learned {
                body_yaw_rad: it.body_yaw,
                pivot_m: [it.pivot_forward, it.pivot_left],
                stamp_offset_s: it.stamp_offset,
                steering_gain: it.steering_gain,
                steering_trim_rad: it.steering_trim,
            }),
            proved: latest.proved,
            realtime: json!(self.realtime),
            record: self.record.as_deref().map(shown),
            record_error: latest.record_error,
            record_warning: latest.record_warning,
            serial_error: latest.serial_error,
            state: latest.state,
            tuning: self.tunable(),
        }
    }

    /// What can be tuned; `None` if nothing can be.
    fn tunable(&self) -> Option<Tunable> {
        let rule = &self.tuning;
        let tuned = self.output()?.tuned?;
        let bounds = rule.bounds?;
        Some(Tunable {
            bounds: TuningBounds {
                gain_per_s: bounds.gain,
                point_distance_m: bounds.point_distance,
            },
            configured: Tuning {
                gain_per_s: rule.gain.map(|gain| [gain.x, gain.y]),
                point_distance_m: rule.point_distance,
                wanted_point_distance_m: None,
            },
            differs: rule.differs(&tuned),
        })
    }
}

/// The values in force.
pub(crate) fn tuning_of(tuned: &Tuned) -> Tuning {
    Tuning {
        gain_per_s: tuned.gain.map(|gain| [gain.x, gain.y]),
        point_distance_m: tuned.point_distance,
        wanted_point_distance_m: Some(tuned.wanted_point_distance),
    }
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use singletrack_api::{Calibration, Cameras, Change, Correction};
    use singletrack_control::{
        Actuation, Estimate, Position, ReferencePoint, SlowedBy, Time, Velocity,
    };
    use singletrack_core::{Config, state_stream::States};
    use singletrack_pilot::{Filtering, Learned};
    use singletrack_protocol::{BoardMode, StopCause};
    use singletrack_record::{LinkPhase, TickRecord};

    use super::*;

    /// With every value that there can be.
    fn snapshot() -> Snapshot {
        let mut config: Config =
            toml::from_str(include_str!("../singletrackd.example.toml")).unwrap();
        config.tuning.enabled = true;
        config.tuning.gain_per_s = Some([0.5, 4.0]);
        config.tuning.point_distance_m = Some([0.3, 0.5]);
        let velocity = Velocity::new(0.5, -0.25);
        let tick = TickRecord {
            index: 7,
            scheduled_ns: 0,
            start_ns: 1_000,
            finish_ns: 0,
            skipped: 0,
            pilot_time: Time(0),
            events: Default::default(),
            events_dropped: 0,
            output: Output {
                reason: Some(Reason::NoPose),
                preflight: Some(Reason::BatteryLow),
                drive_time: Some(1.25),
                looked_ahead: Some(0.0625),
                filtering: Filtering::Scaled,
                filtered_ticks: 3,
                tuned: Some(Tuned {
                    gain: Some(Velocity::new(2.0, 1.5)),
                    point_distance: 0.375,
                    wanted_point_distance: 0.5,
                }),
                path: Some(4.5),
                slowed_by: Some(SlowedBy::Tyres),
                estimate: Some(Estimate {
                    time: Time(20_000_000),
                    position: Position::new(1.0, -2.0),
                    yaw: 0.5,
                    yaw_rate: 0.25,
                    sideslip: 0.125,
                    speed: 0.75,
                    pose_time: Time(10_000_000),
                }),
                point: Some(Position::new(1.5, -1.5)),
                reference: Some(ReferencePoint {
                    position: Some(Position::new(1.25, -1.0)),
                    velocity,
                }),
                actuation: Actuation {
                    steering: 0.0625,
                    speed: 0.5,
                    steering_rate: 0.0,
                },
                ..Output::neutral(Mode::Driving)
            },
            drive: None,
            link: LinkPhase::Configuring,
        };
        let calibration = Calibration {
            advice: vec!["the steering trim is off".to_owned()],
            corrections: vec![Correction {
                configured: json!(1_500),
                key: "board.servo.centre_us".to_owned(),
                value: json!(1_542),
            }],
        };
        let latest = Latest {
            state: Some(States::default().state(&tick)),
            tick: Some(Arc::new(tick)),
            board: Some((BoardMode::Neutral, StopCause::Disarmed)),
            proved: Some(true),
            calibration: Some((2, calibration)),
            learned: Some(Learned {
                steering_gain: -0.125,
                pivot_left: 0.0078125,
                ..Learned::default()
            }),
            cameras: Cameras {
                neighbour: Some("\"wand\" is near".to_owned()),
                ..Cameras::default()
            },
            record_error: Some("disk full".to_owned()),
            ..Latest::default()
        };
        Snapshot {
            latest,
            figures: Figures::default(),
            realtime: RealTimeStatus {
                fifo_priority: Some(80),
                memory_locked: true,
                idle_bounded: false,
                refusals: vec!["no file".to_owned()],
            },
            configuration: Configuration {
                number: 2,
                last_change: Some(Change {
                    by: "reload".into(),
                    error: Some("no file".to_owned()),
                }),
            },
            tuning: config.tuning_rule(),
            commissioned: Some(json!({ "missing": "doctor" })),
            config_path: Some("/etc/car.toml".into()),
            record: Some("records/one.mcap".into()),
        }
    }

    #[test]
    fn the_status_is_written_as_in_the_golden_file() {
        let nothing = Snapshot {
            latest: Latest {
                cameras: snapshot().latest.cameras,
                ..Latest::default()
            },
            commissioned: None,
            config_path: None,
            record: None,
            ..snapshot()
        };
        let written = [snapshot(), nothing]
            .map(|snapshot| serde_json::to_string(&snapshot.status()).unwrap() + "\n")
            .concat();
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/status.jsonl");
        if std::env::var_os("SINGLETRACK_RENEW").is_some() {
            std::fs::write(path, &written).unwrap();
        }
        assert!(
            written == std::fs::read_to_string(path).unwrap(),
            "{written}"
        );
    }
}
