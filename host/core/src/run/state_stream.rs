//! The view of a tick that the control socket gives.

use singletrack_api::{SetpointInForce, State};
use singletrack_control::{Estimate, Position, Velocity};
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
    pub fn state<const EVENTS: usize>(&self, tick: &TickRecord<EVENTS>) -> State {
        let output = &tick.output;
        let estimate = output.estimate.as_ref();
        let tuned = output.tuned.as_ref();
        let now_ns = tick.pilot_time.0;
        let since = |ns: u64| now_ns.wrapping_sub(ns) as i64 as f64 * 1e-9;
        let position = |position: Position| [position.x, position.y];
        let velocity = |velocity: Velocity| [velocity.x, velocity.y];
        State {
            topic: "state".into(),
            tick: tick.index,
            t_s: self.first_ns.map_or(0.0, since),
            time_ns: now_ns,
            mode: output.mode.name().into(),
            reason: output.reason.map(|reason| reason.name().into()),
            preflight: output.preflight.map(|reason| reason.name().into()),
            link: tick.link.name().into(),
            drive_time_s: output.drive_time,
            x_m: estimate.map(|estimate| estimate.position.x),
            y_m: estimate.map(|estimate| estimate.position.y),
            yaw_rad: estimate.map(|estimate| estimate.yaw),
            speed_m_s: estimate.map(|estimate| estimate.speed),
            sideslip_rad: estimate.map(|estimate| estimate.sideslip),
            yaw_rate_rad_s: estimate.map(|estimate| estimate.yaw_rate),
            pose_age_s: estimate.map(Estimate::pose_age),
            held: output.held,
            point_m: output.point.map(position),
            point_velocity_m_s: output.point_velocity.map(velocity),
            reference_m: output.reference.and_then(|it| it.position).map(position),
            path_s: output.path,
            slowed_by: output.slowed_by.map(|why| why.name().into()),
            steering_rad: output.actuation.steering,
            commanded_speed_m_s: output.actuation.speed,
            looked_ahead_s: output.looked_ahead,
            board_age_s: self.board_ns.map(since),
            setpoint: output.setpoint.map(|stamp| SetpointInForce {
                sequence: stamp.sequence,
                age_s: since(stamp.time.0),
            }),
            setpoint_refused: output.setpoint_refused.map(|why| why.name().into()),
            filtering: output.filtering.name().into(),
            filtered_ticks: output.filtered_ticks,
            gain_per_s: tuned.and_then(|tuned| tuned.gain).map(velocity),
            point_distance_m: tuned.map(|tuned| tuned.point_distance),
            wanted_point_distance_m: tuned.map(|tuned| tuned.wanted_point_distance),
        }
    }
}
