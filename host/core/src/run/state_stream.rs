//! The state stream: what a controller outside needs to know of a tick.

use singletrack_api::{SetpointInForce, State};
use singletrack_pilot::Event;
use singletrack_record::TickRecord;

/// Makes the states.
#[derive(Debug, Default)]
pub struct States {
    first_ns: Option<u64>,
    board_ns: Option<u64>,
}

impl States {
    /// Takes note of a tick; every one is passed in, also without readers.
    pub fn tick(&mut self, tick: &TickRecord) {
        self.first_ns.get_or_insert(tick.pilot_time.0);
        for event in &tick.events {
            if let Event::Board(sample) = event {
                self.board_ns = Some(sample.time.0);
            }
        }
    }

    /// The state of a tick.
    #[must_use]
    pub fn state(&self, tick: &TickRecord) -> State {
        let output = &tick.output;
        let estimate = output.estimate.as_ref();
        let now_ns = tick.pilot_time.0;
        let since = |ns: u64| now_ns.wrapping_sub(ns) as i64 as f64 * 1e-9;
        State {
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
        }
    }
}
