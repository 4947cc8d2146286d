//! A simulated Arduino for the real board code: clock, bytes, pins.

use singletrack_board::{Board, ImuHealth, ImuSample, Inputs, MotorPulses, VERSION, axis_map};
use singletrack_protocol::{ImuAxes, ResetCause};
use singletrack_simavr::Motion;

use super::{BoardParameters, Environment, battery_mv, local_time, supply_mv};
use crate::pulses::{PulseRecord, SERVO_FRAME_US};

/// Time after which a silent main loop counts as hung, as in the image's
/// pulse guard.
const HANG_TIMEOUT_US: u32 = 19_000;

/// Edges of the motor's sensor that are accepted in a tick, and its duration, as in
/// the image's interrupts.
const EDGES_PER_TICK: u64 = 16;
const TICK_US: u64 = 1_000;

/// The edges of the motor's sensor that the interrupt accepts.
#[derive(Debug, Default)]
struct Edges {
    /// The sensor's count at the last call; `None` before the first.
    seen: Option<u16>,
    tick: u64,
    /// Edges that are still accepted in this tick.
    left: u64,
    accepted: u16,
    /// Ticks with more edges, wrapping.
    refused: u16,
}

impl Edges {
    /// Takes the sensor's count in a tick.
    fn take(&mut self, count: u16, tick: u64) {
        if tick > self.tick {
            // Several, if the main loop was late.
            self.left = EDGES_PER_TICK.saturating_mul(tick - self.tick);
            self.tick = tick;
        }
        let new = u64::from(count.wrapping_sub(self.seen.unwrap_or(count)));
        self.seen = Some(count);
        let accepted = new.min(self.left);
        self.accepted = self.accepted.wrapping_add(accepted as u16);
        // Once in a tick.
        if accepted < new && self.left > 0 {
            self.refused = self.refused.wrapping_add(1);
        }
        self.left -= accepted;
    }
}

/// The board's code with its inputs.
#[derive(Debug)]
pub(super) struct Native {
    parameters: BoardParameters,
    pub(super) board: Board,
    /// Numbers of main loop rounds and servo frames so far.
    polls: u64,
    frames: u64,
    /// When the next of them is due, in µs of the simulation.
    pub(super) next_event_us: u64,
    edges: Edges,
    inputs: Inputs,
    pub(super) hung: bool,
    /// Board time of the last round of the main loop.
    last_poll_us: u32,
    pub(super) imu_is_silent: bool,
    received: Vec<u8>,
}

impl Native {
    pub(super) fn new(parameters: BoardParameters, cause: ResetCause) -> Self {
        Self {
            parameters,
            board: Board::new(cause, VERSION, parameters.car_id),
            polls: 0,
            frames: 0,
            next_event_us: 0,
            edges: Edges::default(),
            inputs: Inputs::default(),
            hung: false,
            last_poll_us: 0,
            imu_is_silent: false,
            received: Vec::new(),
        }
    }

    pub(super) fn restart(&mut self, cause: ResetCause) {
        *self = Self {
            imu_is_silent: self.imu_is_silent,
            ..Self::new(self.parameters, cause)
        };
    }

    pub(super) fn take_imu(&mut self, board_time_us: u32, reading: Motion) {
        if !self.imu_is_silent {
            // The sensor turns its values to the car's axes.
            let known = self.board.configuration();
            let axes = known.map_or(ImuAxes::AS_PRINTED, |known| known.imu_axes);
            let motion = reading.remapped(axis_map(axes));
            self.inputs.imu = Some(ImuSample {
                time_us: board_time_us,
                linear_acceleration_mm_s2: motion.linear_acceleration_mm_s2,
                angular_velocity_mrad_s: motion.angular_velocity_mrad_s,
                attitude_q14: motion.attitude_q14,
            });
        }
    }

    pub(super) fn run(&mut self, mut environment: Environment<'_>) {
        let Environment { now_us, clock, .. } = environment;
        let started_us = environment.started_us;
        let board_time_us = local_time(&clock, started_us, now_us);
        let elapsed = clock.at(now_us - started_us) - clock.at(0);
        if self.polls * self.parameters.poll_period_us <= elapsed {
            self.polls = elapsed / self.parameters.poll_period_us + 1;
            if !self.hung {
                self.last_poll_us = board_time_us;
                let car = &*environment.car;
                let edges = car.motor_pulses();
                self.edges.take(edges.count, elapsed / TICK_US);
                self.inputs.edges_refused = self.edges.refused;
                self.inputs.motor = MotorPulses {
                    count: self.edges.accepted,
                    last_edge_us: local_time(&clock, started_us, edges.last_us.unwrap_or(0)),
                };
                self.inputs.battery_mv = battery_mv(car, environment.battery_noise);
                self.inputs.supply_mv = supply_mv(car);
                self.inputs.battery_open = car.parameters.battery.divider_open;
                let health = car.parameters.imu.registers();
                self.inputs.imu_health = ImuHealth {
                    calibration: health.calibration,
                    self_test: health.self_test,
                    status: health.status,
                    error: health.error,
                };
                self.inputs.stop_input_open = environment.stop_input_open;
                self.received.clear();
                environment.wire.board_read(now_us, &mut self.received);
                let room = self.parameters.receive_buffer;
                let lost = self.received.len().saturating_sub(room);
                self.received.truncate(room);
                self.inputs.bytes_overrun = self.inputs.bytes_overrun.wrapping_add(lost as u16);
                let Environment { wire, monitor, .. } = &mut environment;
                for &byte in &self.received {
                    monitor.host_byte(byte, now_us, board_time_us);
                }
                let room = self.parameters.transmit_buffer;
                let mut send = |frame: &[u8]| {
                    let fits = wire.board_backlog(now_us) + frame.len() <= room;
                    if fits {
                        wire.board_write(now_us, frame);
                        frame.iter().for_each(|byte| monitor.board_byte(*byte));
                    }
                    fits
                };
                let (inputs, received) = (&self.inputs, &self.received);
                self.board.poll(board_time_us, inputs, received, &mut send);
            }
        }
        let mut power_on = self.power_on(board_time_us);
        environment.filter.power(&mut power_on);
        environment.car.set_kill_output(power_on);
        if self.frames * SERVO_FRAME_US <= elapsed {
            self.frames = elapsed / SERVO_FRAME_US + 1;
            let (servo_us, esc_us) = self.pulses(board_time_us);
            let mut frame = PulseRecord {
                time_us: now_us,
                board_time_us,
                servo_us,
                esc_us,
                cut: false,
            };
            environment.filter.frame(&mut frame);
            environment.car.apply_pulses(frame.servo_us, frame.esc_us);
            environment.pulses.push(frame);
        }
        if self.next_event_us <= now_us {
            let poll = self.polls * self.parameters.poll_period_us;
            let elapsed = poll.min(self.frames * SERVO_FRAME_US);
            self.next_event_us = started_us + clock.when_elapsed(elapsed);
        }
    }

    /// The pulses on the pins, after the supervising timer interrupt: neutral once
    /// the command has expired, and once the main loop has been silent for longer
    /// than [`HANG_TIMEOUT_US`]. A silent ESC stays silent.
    fn pulses(&self, board_time_us: u32) -> (u16, u16) {
        let outputs = self.board.outputs();
        let esc_us = match outputs.esc_us {
            Some(_) if !self.is_valid(board_time_us) => outputs.esc_neutral_us,
            esc_us => esc_us.unwrap_or(0),
        };
        (outputs.servo_us.unwrap_or(0), esc_us)
    }

    /// The kill output, after the same interrupt.
    fn power_on(&self, board_time_us: u32) -> bool {
        self.board.outputs().power_on && self.is_valid(board_time_us)
    }

    /// Whether the outputs of the main loop are in force.
    fn is_valid(&self, board_time_us: u32) -> bool {
        let deadline_us = self.board.outputs().drive_deadline_us;
        let is_over = |deadline_us| board_time_us.wrapping_sub(deadline_us) as i32 > 0;
        let expired = deadline_us.is_some_and(is_over);
        let stalled = board_time_us.wrapping_sub(self.last_poll_us) > HANG_TIMEOUT_US;
        !expired && !stalled
    }
}

#[cfg(test)]
mod tests {
    use super::Edges;

    #[test]
    fn sixteen_edges_are_accepted_in_a_tick() {
        let mut edges = Edges::default();
        // What came before the first call is not counted.
        edges.take(65_530, 0);
        let mut take = |new: u16, tick| {
            let count = edges.seen.unwrap().wrapping_add(new);
            edges.take(count, tick);
            (edges.accepted, edges.refused)
        };
        assert_eq!(take(16, 1), (16, 0));
        assert_eq!(take(17, 2), (32, 1));
        assert_eq!(take(10, 3), (42, 1));
        assert_eq!(take(10, 3), (48, 2));
        assert_eq!(take(10, 3), (48, 2));
        // Three ticks at once.
        assert_eq!(take(40, 6), (88, 2));
        assert_eq!(take(200, 7), (104, 3));
    }
}
