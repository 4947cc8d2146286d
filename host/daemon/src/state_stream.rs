//! The state stream: what a controller outside needs to know of a tick, as a line of JSON.

use singletrack_api::{SetpointInForce, State};
use singletrack_pilot::Event;
use singletrack_record::TickRecord;

/// Lines that a reader may be behind before it misses the oldest: 160 ms at 100 Hz. A
/// controller has no use for an older state; who wants every tick watches `tick`.
pub(crate) const STATE_LINES: usize = 16;

/// Bytes of the kernel's buffer of a reader; the kernel doubles it. It holds some six lines,
/// which a reader that is slow gets before it learns how many it has missed.
pub(crate) const STATE_BUFFER: usize = 4_096;

/// Makes the lines.
#[derive(Debug, Default)]
pub(crate) struct StateLines {
    first_ns: Option<u64>,
    board_ns: Option<u64>,
}

impl StateLines {
    /// Takes note of a tick; every one is passed in, also without readers.
    pub(crate) fn tick(&mut self, tick: &TickRecord) {
        self.first_ns.get_or_insert(tick.pilot_time.0);
        for event in &tick.events {
            if let Event::Board(sample) = event {
                self.board_ns = Some(sample.time.0);
            }
        }
    }

    /// The line of a tick.
    pub(crate) fn line(&self, tick: &TickRecord) -> Option<String> {
        let output = &tick.output;
        let estimate = output.estimate.as_ref();
        let now_ns = tick.pilot_time.0;
        let since = |ns: u64| now_ns.wrapping_sub(ns) as i64 as f64 * 1e-9;
        let state = State {
            topic: "state".into(),
            tick: tick.index,
            t: self.first_ns.map_or(0.0, since),
            time_ns: now_ns,
            mode: output.mode.name().into(),
            reason: output.reason.map(|reason| reason.name().into()),
            drive_time: output.drive_time,
            x: estimate.map(|estimate| estimate.position.x),
            y: estimate.map(|estimate| estimate.position.y),
            yaw: estimate.map(|estimate| estimate.yaw),
            speed: estimate.map(|estimate| estimate.speed),
            sideslip: estimate.map(|estimate| estimate.sideslip),
            yaw_rate: estimate.map(|estimate| estimate.yaw_rate),
            pose_age: estimate.map(singletrack_control::Estimate::pose_age),
            held: output.held,
            point: output.point.map(|point| [point.x, point.y]),
            point_velocity: output
                .point_velocity
                .map(|velocity| [velocity.x, velocity.y]),
            reference: output
                .reference
                .and_then(|reference| reference.position)
                .map(|position| [position.x, position.y]),
            steering: output.actuation.steering,
            commanded_speed: output.actuation.speed,
            board_age: self.board_ns.map(since),
            setpoint: output.setpoint.map(|stamp| SetpointInForce {
                sequence: stamp.sequence,
                age: since(stamp.time.0),
            }),
            setpoint_refused: output.setpoint_refused.map(|why| why.name().into()),
            filtering: output.filtering.name().into(),
            gain: output
                .tuned
                .and_then(|tuned| tuned.gain)
                .map(|gain| [gain.x, gain.y]),
            point_distance: output.tuned.map(|tuned| tuned.point_distance),
        };
        serde_json::to_string(&state).ok()
    }
}
