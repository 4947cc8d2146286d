//! The cameras: poses of the car with noise, latency and losses.

mod parameters;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use libm::{cos, sin, sincos};
use parameters::stream;
use singletrack_mocap::codec::{CameraTicks, RigidBody};

use crate::{
    car::{self, Truth},
    clock::{Epoch, SkewedClock},
    random::{Random, Stream},
};

pub use parameters::{
    CameraParameters, CarBody, DecoyBody, LossKind, LossPattern, LossPatternError, LossWindow,
    ServerKind, parse_duration_us,
};

/// Ticks of the server's clock per second, as Motive's on Windows.
pub const TICKS_PER_SECOND: u64 = 10_000_000;

/// Faults of the cameras, besides the scheduled losses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraFaults {
    /// A loss that lasts until it is cleared.
    pub loss: Option<LossKind>,
    /// Added to the car's position in the world, in m, with tracking valid.
    pub jump_m: [f64; 3],
    /// The car's pose is NaN, with tracking valid.
    pub not_a_number: bool,
    /// The car and the first decoy have exchanged names.
    pub swapped: bool,
}

/// The motion of a decoy: another car, for instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecoyMotion {
    /// Simulation time, in µs; negative before it began.
    pub at_us: i64,
    /// Position then, in the world, in m.
    pub position_m: [f64; 2],
    /// Velocity, in m/s.
    pub velocity_m_s: [f64; 2],
    /// Whether the cameras see it.
    pub seen: Sight,
}

/// What the cameras see of a decoy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sight {
    /// Where it is.
    #[default]
    Now,
    /// Its last pose, which repeats to the bit.
    Frozen,
    /// Nothing.
    Not,
}

/// A camera frame.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFrame {
    /// Frame number.
    pub number: i32,
    /// Simulation time of mid-exposure, in µs.
    pub exposed_us: u64,
    /// Simulation time of sending, in µs.
    pub sent_us: u64,
    /// The times on the server's clock.
    pub ticks: CameraTicks,
    /// All rigid bodies in the streamed axes; the car's, if present, is last.
    pub bodies: Vec<RigidBody>,
    /// Whether the car's pose is new.
    pub car_tracked: bool,
    /// Whether the frame is not sent.
    pub silent: bool,
}

/// Numbers of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CameraCounters {
    /// Exposures.
    pub exposed: u64,
    /// Frames sent.
    pub sent: u64,
    /// Exposures without the car: occluded, absent or not sent.
    pub lost: u64,
}

/// The cameras.
#[derive(Clone, Debug)]
pub struct Cameras {
    /// The parameters, with ids changed since.
    pub parameters: CameraParameters,
    /// The server's clock.
    pub clock: SkewedClock,
    noise: Random,
    decoy_noise: Random,
    latency: Random,
    /// Mutable access to the faults.
    pub faults: CameraFaults,
    /// Motions of the first decoys; the others stand.
    motions: Vec<DecoyMotion>,
    last_decoys: Vec<RigidBody>,
    /// The zero of the scheduled losses, in µs of the simulation; `None` stops them.
    pub loss_epoch_us: Option<u64>,
    /// The zero of the other times in the parameters.
    pub(crate) epoch: Epoch,
    exposures: u64,
    /// Simulation time of the next exposure, in µs.
    pub(crate) next_exposure_us: u64,
    last_pose: RigidBody,
    under_way: VecDeque<CameraFrame>,
    /// The counters so far.
    pub counters: CameraCounters,
}

impl Cameras {
    pub(crate) fn new(parameters: CameraParameters, seed: u64) -> Self {
        let clock = SkewedClock::new(parameters.clock_offset_us, parameters.clock_skew_ppm);
        Self {
            clock,
            noise: Random::new(seed, Stream::CameraNoise),
            decoy_noise: Random::new(seed, Stream::DecoyNoise),
            latency: Random::new(seed, Stream::CameraLatency),
            faults: CameraFaults::default(),
            motions: Vec::new(),
            last_decoys: Vec::new(),
            loss_epoch_us: Some(0),
            epoch: Epoch::default(),
            exposures: 0,
            next_exposure_us: clock.when_elapsed(parameters.phase_us),
            // A body that has never been tracked.
            last_pose: RigidBody::tracked(parameters.car.id, [0.0; 3], [0.0, 0.0, 0.0, 1.0])
                .with_tracking_valid(false),
            under_way: VecDeque::new(),
            counters: CameraCounters::default(),
            parameters,
        }
    }

    /// The server's high-resolution clock at a simulation time.
    pub fn ticks(&self, simulation_us: u64) -> u64 {
        self.clock.at(simulation_us) * (TICKS_PER_SECOND / 1_000_000)
    }

    /// Moves the first decoys, in their order.
    pub fn move_decoys(&mut self, motions: impl IntoIterator<Item = DecoyMotion>) {
        self.motions.clear();
        self.motions.extend(motions);
    }

    /// The decoys, in the streamed axes.
    fn measure_decoys(&mut self, now_us: u64) -> Vec<RigidBody> {
        let (p, noise) = (&self.parameters, &mut self.decoy_noise);
        let decoys = p.decoys.iter().enumerate().map(|(index, decoy)| {
            let (motion, mut position) = (self.motions.get(index), decoy.position_m);
            // What nobody moves is no measurement: it repeats to the bit.
            if let Some(motion) = motion {
                let elapsed_s = (now_us as f64 - motion.at_us as f64) * 1e-6;
                let noise = noise.normal3(p.position_noise_m);
                for axis in 0..2 {
                    position[axis] = motion.position_m[axis]
                        + motion.velocity_m_s[axis] * elapsed_s
                        + noise[axis];
                }
            }
            let position = stream(p.up_axis, position).map(|x| x as f32);
            let now = RigidBody::tracked(decoy.id, position, [0.0, 0.0, 0.0, 1.0]);
            match motion.map_or(Sight::Now, |motion| motion.seen) {
                Sight::Now => now,
                Sight::Frozen => self.last_decoys.get(index).copied().unwrap_or(now),
                Sight::Not => now.with_tracking_valid(false),
            }
        });
        let decoys: Vec<_> = decoys.collect();
        self.last_decoys.clone_from(&decoys);
        decoys
    }

    /// Changes the streaming id of the car's body, as an operator can.
    pub(crate) const fn set_car_id(&mut self, id: i32) {
        self.parameters.car.id = id;
        self.last_pose.id = id;
    }

    /// Simulation time of sending the next frame, in µs.
    pub(crate) fn next_send_us(&self) -> Option<u64> {
        Some(self.under_way.front()?.sent_us)
    }

    /// Makes one exposure.
    pub(crate) fn expose(&mut self, truth: &Truth) {
        let now_us = truth.time_us;
        self.exposures += 1;
        let p = &self.parameters;
        let elapsed_us = p.phase_us + self.exposures * p.period_us.max(1);
        self.next_exposure_us = self.clock.when_elapsed(elapsed_us);
        self.counters.exposed += 1;
        let measured = self.measure(truth);
        let loss = self.faults.loss.or_else(|| self.scheduled_loss(now_us));
        let p = &self.parameters;
        let is_frozen = self.epoch.is_within(p.frozen_from_s, p.frozen_ms, now_us);
        let mut car = match loss {
            None if is_frozen && self.last_pose.tracking_valid() => self.last_pose,
            None => measured,
            Some(_) => self.last_pose.with_tracking_valid(false),
        };
        if loss.is_none() {
            self.last_pose = car;
        } else {
            self.counters.lost += 1;
        }
        let mut bodies = self.measure_decoys(now_us);
        if let (true, Some(decoy)) = (self.faults.swapped, bodies.first_mut()) {
            core::mem::swap(&mut decoy.id, &mut car.id);
        }
        if loss != Some(LossKind::Absent) {
            bodies.push(car);
        }
        let error_us = self.stamp_error_us(now_us);
        let sent_us = self.sending_time(now_us + error_us.max(0.0) as u64);
        let error_ticks = (error_us * TICKS_PER_SECOND as f64 * 1e-6) as i64;
        self.under_way.push_back(CameraFrame {
            // As in Motive, wraps after eight months.
            number: self.exposures as i32,
            exposed_us: now_us,
            sent_us,
            ticks: CameraTicks {
                mid_exposure: self.ticks(now_us).saturating_add_signed(error_ticks),
                received: self.ticks(now_us + (sent_us - now_us) / 2),
                transmit: self.ticks(sent_us),
            },
            bodies,
            car_tracked: loss.is_none(),
            silent: loss == Some(LossKind::Silent),
        });
    }

    /// Error of the mid-exposure stamp of an exposure at this time, in µs.
    fn stamp_error_us(&self, now_us: u64) -> f64 {
        let p = &self.parameters;
        p.stamp_bias_ms * 1e3 + p.stamp_drift_ppm * 1e-6 * now_us as f64
    }

    /// The frame that somebody else sends after this one; `None` while nobody does.
    pub(crate) fn forge(&self, frame: &CameraFrame) -> Option<CameraFrame> {
        let p = &self.parameters;
        let from_s = p.forged_from_s?;
        let elapsed_s = self.epoch.elapsed_s(frame.sent_us)? - from_s;
        if elapsed_s < 0.0 {
            return None;
        }
        let mut forged = frame.clone();
        // The next frame's number, so that the true one seems a repetition.
        forged.number = frame.number.wrapping_add(1);
        forged.silent = false;
        let half = p.period_us / 2 * (TICKS_PER_SECOND / 1_000_000);
        forged.ticks.mid_exposure += half;
        let [x, y]: [f64; 2] =
            core::array::from_fn(|i| p.forged_offset_m[i] + p.forged_drift_m_s[i] * elapsed_s);
        let offset = stream(p.up_axis, [x, y, 0.0]).map(|x| x as f32);
        let mut car = self.last_pose.with_tracking_valid(true);
        for (coordinate, offset) in car.position_m.iter_mut().zip(offset) {
            *coordinate += offset;
        }
        forged.bodies.retain(|body| body.id != car.id);
        forged.bodies.push(car);
        forged.car_tracked = true;
        Some(forged)
    }

    /// The next frame that is due.
    pub(crate) fn take_frame(&mut self, now_us: u64) -> Option<CameraFrame> {
        let is_due = |frame: &mut CameraFrame| frame.sent_us <= now_us;
        let frame = self.under_way.pop_front_if(is_due)?;
        self.counters.sent += u64::from(!frame.silent);
        Some(frame)
    }

    fn scheduled_loss(&self, now_us: u64) -> Option<LossKind> {
        let since_us = now_us.checked_sub(self.loss_epoch_us?)?;
        let p = &self.parameters;
        let lost = p.loss.is_some_and(|loss| loss.is_lost(since_us))
            || p.loss_windows.iter().any(|window| window.is_lost(since_us));
        lost.then_some(p.loss_kind)
    }

    /// Time of sending; frames keep their order.
    fn sending_time(&mut self, now_us: u64) -> u64 {
        let p = &self.parameters;
        let jitter = self.latency.normal().clamp(-3.0, 3.0) * p.latency_jitter_us as f64;
        let latency = (p.latency_us as f64 + jitter).max(0.0) as u64;
        let before = self.under_way.back().map_or(0, |frame| frame.sent_us);
        (now_us + latency).max(before)
    }

    /// The measured pose of the car's body, in the streamed axes. It draws the same
    /// noise even if the pose is then lost.
    fn measure(&mut self, truth: &Truth) -> RigidBody {
        let p = &self.parameters;
        let noise = self.noise.normal3(p.position_noise_m);
        let [roll, pitch, yaw_noise] = self.noise.normal3(p.orientation_noise_rad);
        if self.faults.not_a_number {
            return RigidBody::tracked(p.car.id, [f32::NAN; 3], [f32::NAN; 4]);
        }
        let mut yaw = truth.yaw + p.car.yaw_rad;
        let (s, c) = sincos(yaw);
        let [forward, left] = p.car.to_centre_of_mass_m;
        let mut pivot = [
            truth.x - (c * forward - s * left),
            truth.y - (s * forward + c * left),
            p.car.height_m,
        ];
        if truth.held {
            let on_car = p.car.pivot();
            // The car is tilted about the point of the floor below its centre of mass.
            let along = [
                p.car.height_m * sin(truth.pitch) - on_car[0] * (1.0 - cos(truth.pitch)),
                -p.car.height_m * sin(truth.roll) - on_car[1] * (1.0 - cos(truth.roll)),
            ];
            let (s, c) = sincos(truth.yaw);
            pivot[0] += c * along[0] - s * along[1];
            pivot[1] += s * along[0] + c * along[1];
            pivot[2] = truth.height + p.car.height_m * cos(truth.pitch) * cos(truth.roll)
                - on_car[0] * sin(truth.pitch)
                + on_car[1] * sin(truth.roll);
        }
        // Along the body's axes.
        let (s, c) = sincos(p.car.yaw_rad);
        let mut tilt = [
            c * truth.roll + s * truth.pitch,
            c * truth.pitch - s * truth.roll,
        ];
        if self.epoch.has_come(p.flip_from_s, truth.time_us) {
            yaw += p.flip_deg.to_radians();
        }
        if p.other_body || self.epoch.has_come(p.other_body_from_s, truth.time_us) {
            (yaw, tilt) = (0.0, [0.0; 2]);
            pivot = p.decoys.first().map_or([0.0; 3], |decoy| decoy.position_m);
        }
        let jump = self.faults.jump_m;
        let position: [f64; 3] = core::array::from_fn(|i| pivot[i] + noise[i] + jump[i]);
        let [w, x, y, z] = car::quaternion_wxyz(yaw + yaw_noise, roll + tilt[0], pitch + tilt[1]);
        let [x, y, z] = stream(p.up_axis, [x, y, z]);
        let mut body = RigidBody::tracked(
            p.car.id,
            stream(p.up_axis, position).map(|x| x as f32),
            [x, y, z, w].map(|x| x as f32),
        );
        body.mean_error_m = p.position_noise_m as f32;
        body
    }
}
