//! The cameras: poses of the car with noise, latency and losses.

use std::collections::VecDeque;

use libm::{cos, sin};
use serde::{Deserialize, Serialize};
use singletrack_mocap::codec::{CameraTicks, RigidBody};

use crate::{
    attitude,
    car::Truth,
    clock::SkewedClock,
    epoch::Epoch,
    loss::{LossPattern, LossWindow},
    random::{Random, Stream},
};

/// Ticks of the server's clock per second, as Motive's on Windows.
pub const TICKS_PER_SECOND: u64 = 10_000_000;

/// The cameras and the tracked bodies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraParameters {
    /// Time between exposures on the server's clock, in µs.
    pub period_us: u64,
    /// Time of the first exposure on the server's clock since its start, in µs.
    pub phase_us: u64,
    /// Reading of the server's clock at simulation time zero, in µs.
    pub clock_offset_us: u64,
    /// Rate error of the server's clock, in ppm; positive is fast.
    pub clock_skew_ppm: i32,
    /// Mean time from mid-exposure to the packet on the network, in µs.
    pub latency_us: u64,
    /// Standard deviation of that time, in µs; truncated at three deviations.
    pub latency_jitter_us: u64,
    /// Standard deviation of each coordinate, in m.
    pub position_noise_m: f64,
    /// Standard deviation of roll, pitch and yaw, in rad.
    pub orientation_noise_rad: f64,
    /// The axes in which poses are streamed.
    pub up_axis: UpAxis,
    /// The car's rigid body.
    pub car: CarBody,
    /// Further rigid bodies, which do not move.
    pub decoys: Vec<DecoyBody>,
    /// Periodic losses.
    pub loss: Option<LossPattern>,
    /// Single losses.
    pub loss_windows: Vec<LossWindow>,
    /// Representation of a loss on the wire.
    pub loss_kind: LossKind,
    /// Error of the mid-exposure stamps, in ms. Positive is late: the pose is older than
    /// its stamp, and the frame leaves later by as much.
    pub stamp_bias_ms: f64,
    /// Growth of that error since the start of the simulation, in ppm.
    pub stamp_drift_ppm: f64,
    /// The stream's poses of the car are those of another body: the first of `decoys`, or
    /// one at the origin.
    pub other_body: bool,
    /// The same from this time on, in s.
    pub other_body_from_s: Option<f64>,
    /// From this time on, for `frozen_ms`, the pose of the car repeats bit by bit in new
    /// frames, in s.
    pub frozen_from_s: Option<f64>,
    /// Duration of that, in ms.
    pub frozen_ms: f64,
    /// From this time on, for good, the car's body is found turned by `flip_deg`, in s.
    pub flip_from_s: Option<f64>,
    /// Angle about the up axis by which it is turned, in degrees.
    pub flip_deg: f64,
    /// From this time on somebody else sends frames from the server's own address, in s.
    pub forged_from_s: Option<f64>,
    /// Position of the car in those frames less its true one, in m.
    pub forged_offset_m: [f64; 2],
    /// Growth of that difference, in m/s.
    pub forged_drift_m_s: [f64; 2],
}

impl Default for CameraParameters {
    fn default() -> Self {
        Self {
            period_us: 10_000,
            phase_us: 6_300,
            clock_offset_us: 86_400_000_000,
            clock_skew_ppm: 40,
            latency_us: 8_000,
            latency_jitter_us: 300,
            position_noise_m: 0.000_2,
            // 0.1 degrees.
            orientation_noise_rad: 0.001_745,
            up_axis: UpAxis::Y,
            car: CarBody::default(),
            decoys: vec![
                DecoyBody {
                    name: "wand".to_owned(),
                    id: 3,
                    position_m: [3.0, 2.0, 1.0],
                },
                DecoyBody {
                    name: "carrier".to_owned(),
                    id: 17,
                    position_m: [-2.5, 2.5, 0.2],
                },
            ],
            loss: None,
            loss_windows: Vec::new(),
            loss_kind: LossKind::Occluded,
            stamp_bias_ms: 0.0,
            stamp_drift_ppm: 0.0,
            other_body: false,
            other_body_from_s: None,
            frozen_from_s: None,
            frozen_ms: 1_000.0,
            flip_from_s: None,
            flip_deg: 180.0,
            forged_from_s: None,
            forged_offset_m: [0.5, 0.0],
            forged_drift_m_s: [0.0; 2],
        }
    }
}

/// The up axis of the streamed poses: a setting of the server that is not on
/// the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum UpAxis {
    /// The server's default: the world's z is streamed as y.
    #[default]
    Y,
    /// The world's axes.
    Z,
}

impl UpAxis {
    /// The world's vector in the streamed axes.
    fn stream(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Y => [x, z, -y],
            Self::Z => [x, y, z],
        }
    }
}

/// The car's rigid body: its name, and its pose on the car.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CarBody {
    /// Name in the model definitions.
    pub name: String,
    /// Streaming id.
    pub id: i32,
    /// Vector from the body's pivot to the centre of mass, forward and left along the
    /// body's axes, in m.
    pub to_centre_of_mass_m: [f64; 2],
    /// Yaw of the body's axes relative to the car's, in rad.
    pub yaw_rad: f64,
    /// Height of the pivot above the floor, in m.
    pub height_m: f64,
}

impl Default for CarBody {
    fn default() -> Self {
        Self {
            name: "car".to_owned(),
            id: 11,
            to_centre_of_mass_m: [0.0, 0.0],
            yaw_rad: 0.0,
            height_m: 0.12,
        }
    }
}

impl CarBody {
    /// Position of the pivot from the centre of mass: forward, left, in m.
    #[must_use]
    pub fn pivot(&self) -> [f64; 2] {
        let [forward, left] = self.to_centre_of_mass_m;
        let (c, s) = (cos(self.yaw_rad), sin(self.yaw_rad));
        [-(c * forward - s * left), -(s * forward + c * left)]
    }

    /// Sets the position of the pivot from the centre of mass: forward, left, in m.
    pub fn set_pivot(&mut self, [forward, left]: [f64; 2]) {
        let (c, s) = (cos(self.yaw_rad), sin(self.yaw_rad));
        self.to_centre_of_mass_m = [-(c * forward + s * left), -(c * left - s * forward)];
    }

    /// Turns the body about its pivot to this yaw on the car, in rad.
    pub fn set_yaw(&mut self, yaw_rad: f64) {
        let pivot = self.pivot();
        self.yaw_rad = yaw_rad;
        self.set_pivot(pivot);
    }
}

/// A rigid body at a fixed position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecoyBody {
    /// Name in the model definitions.
    pub name: String,
    /// Streaming id.
    pub id: i32,
    /// Position in the world, in m.
    pub position_m: [f64; 3],
}

/// Representation of a loss of the markers on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LossKind {
    /// The body keeps its old pose and the tracking-valid bit is cleared.
    #[default]
    Occluded,
    /// The body is not in the frame.
    Absent,
    /// No frame is sent.
    Silent,
}

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
    parameters: CameraParameters,
    clock: SkewedClock,
    noise: Random,
    latency: Random,
    faults: CameraFaults,
    loss_epoch_us: Option<u64>,
    epoch: Epoch,
    exposures: u64,
    last_pose: RigidBody,
    under_way: VecDeque<CameraFrame>,
    counters: CameraCounters,
}

impl Cameras {
    pub(crate) fn new(parameters: CameraParameters, seed: u64) -> Self {
        Self {
            clock: SkewedClock::new(parameters.clock_offset_us, parameters.clock_skew_ppm),
            noise: Random::new(seed, Stream::CameraNoise),
            latency: Random::new(seed, Stream::CameraLatency),
            faults: CameraFaults::default(),
            loss_epoch_us: Some(0),
            epoch: Epoch::default(),
            exposures: 0,
            // A body that has never been tracked.
            last_pose: RigidBody::tracked(parameters.car.id, [0.0; 3], [0.0, 0.0, 0.0, 1.0])
                .with_tracking_valid(false),
            under_way: VecDeque::new(),
            counters: CameraCounters::default(),
            parameters,
        }
    }

    /// The parameters, with ids changed since.
    #[must_use]
    pub const fn parameters(&self) -> &CameraParameters {
        &self.parameters
    }

    /// The server's clock.
    #[must_use]
    pub const fn clock(&self) -> &SkewedClock {
        &self.clock
    }

    /// The server's high-resolution clock at a simulation time.
    #[must_use]
    pub fn ticks(&self, simulation_us: u64) -> u64 {
        self.clock.at(simulation_us) * (TICKS_PER_SECOND / 1_000_000)
    }

    /// The counters so far.
    #[must_use]
    pub const fn counters(&self) -> CameraCounters {
        self.counters
    }

    /// Mutable access to the faults.
    pub const fn faults_mut(&mut self) -> &mut CameraFaults {
        &mut self.faults
    }

    /// Sets the epoch of the scheduled losses; `None` stops them. The default is
    /// the start of the simulation.
    pub const fn set_loss_epoch(&mut self, epoch_us: Option<u64>) {
        self.loss_epoch_us = epoch_us;
    }

    /// Sets the zero of the times in the parameters, except the losses', in µs of the
    /// simulation.
    pub(crate) const fn set_epoch(&mut self, epoch_us: Option<u64>) {
        self.epoch = Epoch::new(epoch_us);
    }

    /// Replaces the periodic losses.
    pub const fn set_loss(&mut self, loss: Option<LossPattern>) {
        self.parameters.loss = loss;
    }

    /// Adds a single loss, in µs since the losses' epoch.
    pub fn add_loss_window(&mut self, window: LossWindow) {
        self.parameters.loss_windows.push(window);
    }

    /// Changes the streaming id of the car's body, as an operator can.
    pub(crate) const fn set_car_id(&mut self, id: i32) {
        self.parameters.car.id = id;
        self.last_pose.id = id;
    }

    /// Simulation time of the next exposure, in µs.
    pub(crate) fn next_exposure_us(&self) -> u64 {
        let p = &self.parameters;
        self.clock
            .when_elapsed(p.phase_us + self.exposures * p.period_us.max(1))
    }

    /// Simulation time of sending the next frame, in µs.
    pub(crate) fn next_send_us(&self) -> Option<u64> {
        Some(self.under_way.front()?.sent_us)
    }

    /// Makes one exposure.
    pub(crate) fn expose(&mut self, truth: &Truth) {
        let now_us = truth.time_us;
        self.exposures += 1;
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
        let mut bodies: Vec<RigidBody> = self
            .parameters
            .decoys
            .iter()
            .map(|decoy| {
                let position = self.parameters.up_axis.stream(decoy.position_m);
                RigidBody::tracked(decoy.id, position.map(|x| x as f32), [0.0, 0.0, 0.0, 1.0])
            })
            .collect();
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
        let offset = p.up_axis.stream([x, y, 0.0]).map(|x| x as f32);
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
        if self.under_way.front()?.sent_us > now_us {
            return None;
        }
        let frame = self.under_way.pop_front()?;
        if !frame.silent {
            self.counters.sent += 1;
        }
        Some(frame)
    }

    fn scheduled_loss(&self, now_us: u64) -> Option<LossKind> {
        let since_epoch_us = now_us.checked_sub(self.loss_epoch_us?)?;
        let p = &self.parameters;
        let lost = p.loss.is_some_and(|loss| loss.is_lost(since_epoch_us))
            || p.loss_windows
                .iter()
                .any(|window| window.is_lost(since_epoch_us));
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
        let (c, s) = (cos(yaw), sin(yaw));
        let [forward, left] = p.car.to_centre_of_mass_m;
        let mut pivot = [
            truth.x - (c * forward - s * left),
            truth.y - (s * forward + c * left),
            p.car.height_m,
        ];
        // Along the body's axes.
        let (c, s) = (cos(p.car.yaw_rad), sin(p.car.yaw_rad));
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
        let [w, x, y, z] =
            attitude::quaternion_wxyz(yaw + yaw_noise, roll + tilt[0], pitch + tilt[1]);
        let [x, y, z] = p.up_axis.stream([x, y, z]);
        let mut body = RigidBody::tracked(
            p.car.id,
            p.up_axis.stream(position).map(|x| x as f32),
            [x, y, z, w].map(|x| x as f32),
        );
        body.mean_error_m = p.position_noise_m as f32;
        body
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(parameters: CameraParameters, truth: Truth, until_us: u64) -> Vec<CameraFrame> {
        let mut cameras = Cameras::new(parameters, 1);
        while cameras.next_exposure_us() < until_us {
            cameras.expose(&Truth {
                time_us: cameras.next_exposure_us(),
                ..truth
            });
        }
        core::iter::from_fn(|| cameras.take_frame(u64::MAX)).collect()
    }

    fn exact() -> CameraParameters {
        CameraParameters {
            position_noise_m: 0.0,
            orientation_noise_rad: 0.0,
            clock_skew_ppm: 0,
            phase_us: 0,
            ..CameraParameters::default()
        }
    }

    #[test]
    fn poses_are_streamed_in_the_selected_axes_about_the_pivot() {
        let truth = Truth {
            x: 1.0,
            y: 2.0,
            yaw: core::f64::consts::FRAC_PI_2,
            ..Truth::default()
        };
        let mut parameters = exact();
        parameters.car.to_centre_of_mass_m = [0.1, 0.0];
        let half = core::f32::consts::FRAC_1_SQRT_2;
        for (up_axis, position, attitude) in [
            (UpAxis::Y, [1.0, 0.12, -1.9], [0.0, half, 0.0, half]),
            (UpAxis::Z, [1.0, 1.9, 0.12], [0.0, 0.0, half, half]),
        ] {
            parameters.up_axis = up_axis;
            let frame = frames(parameters.clone(), truth, 1).remove(0);
            let car = frame.bodies.last().unwrap();
            for i in 0..3 {
                assert!((car.position_m[i] - position[i]).abs() < 1e-6, "{car:?}");
                assert!((car.orientation_xyzw[i] - attitude[i]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn scheduled_losses_repeat_the_last_pose_without_the_tracking_bit() {
        let mut parameters = CameraParameters {
            loss: Some("200ms@2s".parse().unwrap()),
            ..CameraParameters::default()
        };
        parameters.clock_skew_ppm = 0;
        let frames = frames(parameters, Truth::default(), 5_000_000);
        let lost: Vec<_> = frames
            .iter()
            .filter(|frame| !frame.car_tracked)
            .map(|frame| frame.exposed_us)
            .collect();
        assert_eq!(lost.len(), 40);
        assert!(
            lost[..20]
                .iter()
                .all(|us| (2_000_000..2_200_000).contains(us))
        );
        assert!(
            lost[20..]
                .iter()
                .all(|us| (4_000_000..4_200_000).contains(us))
        );
        let first = frames.iter().position(|frame| !frame.car_tracked).unwrap();
        let (before, after) = (frames[first - 1].bodies[2], frames[first + 5].bodies[2]);
        assert!(before.tracking_valid() && !after.tracking_valid());
        assert_eq!(before.position_m, after.position_m);
    }

    #[test]
    fn losses_can_be_absent_or_silent_and_start_at_their_epoch() {
        let window = LossWindow {
            start_us: 100_000,
            end_us: 200_000,
        };
        let mut cameras = Cameras::new(exact(), 1);
        cameras.add_loss_window(window);
        cameras.set_loss_epoch(Some(1_000_000));
        cameras.parameters.loss_kind = LossKind::Absent;
        for _ in 0..200 {
            let time_us = cameras.next_exposure_us();
            cameras.expose(&Truth {
                time_us,
                ..Truth::default()
            });
        }
        let frames: Vec<_> = core::iter::from_fn(|| cameras.take_frame(u64::MAX)).collect();
        for frame in &frames {
            let lost = (1_100_000..1_200_000).contains(&frame.exposed_us);
            assert_eq!(frame.bodies.len(), if lost { 2 } else { 3 });
        }
        assert_eq!(cameras.counters().lost, 10);
        assert_eq!(cameras.counters().sent, 200);

        cameras.faults_mut().loss = Some(LossKind::Silent);
        let time_us = cameras.next_exposure_us();
        cameras.expose(&Truth {
            time_us,
            ..Truth::default()
        });
        assert!(cameras.take_frame(u64::MAX).unwrap().silent);
        assert_eq!(cameras.counters().sent, 200);
    }

    #[test]
    fn noise_and_latency_have_the_configured_size() {
        let frames = frames(CameraParameters::default(), Truth::default(), 100_000_000);
        let n = frames.len() as f64;
        let sum = |f: &dyn Fn(&CameraFrame) -> f64| frames.iter().map(f).sum::<f64>() / n;
        let x = sum(&|frame| f64::from(frame.bodies[2].position_m[0]).powi(2));
        assert!((x.sqrt() - 0.000_2).abs() < 0.000_01, "{x}");
        let yaw = sum(&|frame| (2.0 * f64::from(frame.bodies[2].orientation_xyzw[1])).powi(2));
        assert!((yaw.sqrt() - 0.001_745).abs() < 0.000_1, "{yaw}");
        let latency = sum(&|frame| (frame.sent_us - frame.exposed_us) as f64);
        assert!((latency - 8_000.0).abs() < 20.0, "{latency}");
        assert!(
            frames
                .windows(2)
                .all(|pair| pair[0].sent_us <= pair[1].sent_us)
        );
    }

    #[test]
    fn faults_that_keep_the_tracking_bit_are_on_the_wire() {
        let mut cameras = Cameras::new(exact(), 1);
        let next = |cameras: &mut Cameras| {
            let time_us = cameras.next_exposure_us();
            cameras.expose(&Truth {
                time_us,
                ..Truth::default()
            });
            cameras.take_frame(u64::MAX).unwrap()
        };
        cameras.faults_mut().jump_m = [0.5, 0.0, 0.0];
        let car = next(&mut cameras).bodies[2];
        assert!(car.tracking_valid() && (car.position_m[0] - 0.5).abs() < 1e-6);
        *cameras.faults_mut() = CameraFaults {
            swapped: true,
            ..CameraFaults::default()
        };
        let bodies = next(&mut cameras).bodies;
        assert_eq!((bodies[0].id, bodies[2].id), (11, 3));
        *cameras.faults_mut() = CameraFaults {
            not_a_number: true,
            ..CameraFaults::default()
        };
        assert!(next(&mut cameras).bodies[2].position_m[0].is_nan());
    }

    /// The frames of a car that drives along x with 1 m/s for two seconds.
    fn driven(change: impl FnOnce(&mut CameraParameters)) -> (Cameras, Vec<CameraFrame>) {
        let mut parameters = exact();
        change(&mut parameters);
        let mut cameras = Cameras::new(parameters, 1);
        while cameras.next_exposure_us() < 2_000_000 {
            let time_us = cameras.next_exposure_us();
            cameras.expose(&Truth {
                time_us,
                x: time_us as f64 * 1e-6,
                ..Truth::default()
            });
        }
        let frames = core::iter::from_fn(|| cameras.take_frame(u64::MAX)).collect();
        (cameras, frames)
    }

    fn x(frame: &CameraFrame) -> f64 {
        frame.bodies.last().unwrap().position_m[0].into()
    }

    #[test]
    fn a_late_stamp_is_on_an_older_pose() {
        for (bias_ms, drift_ppm) in [(20.0, 0.0), (-20.0, 0.0), (0.0, 1_000.0)] {
            let (cameras, frames) = driven(|p| {
                (p.stamp_bias_ms, p.stamp_drift_ppm) = (bias_ms, drift_ppm);
            });
            for frame in frames {
                let error_us = bias_ms * 1e3 + drift_ppm * 1e-6 * frame.exposed_us as f64;
                let error =
                    frame.ticks.mid_exposure as f64 - cameras.ticks(frame.exposed_us) as f64;
                assert!((error - error_us * 10.0).abs() <= 1.0, "{error}");
                // No stamp is in the future of its packet.
                assert!(frame.ticks.mid_exposure < frame.ticks.transmit);
            }
        }
    }

    #[test]
    fn frozen_poses_repeat_in_new_frames() {
        let (_, frames) = driven(|p| (p.frozen_from_s, p.frozen_ms) = (Some(1.0), 500.0));
        for frame in &frames {
            let seen_us = match frame.exposed_us {
                at @ 1_000_000..1_500_000 => at.min(990_000),
                at => at,
            };
            assert!((x(frame) - seen_us as f64 * 1e-6).abs() < 1e-6);
            assert!(frame.car_tracked && frame.bodies.last().unwrap().tracking_valid());
        }
        assert!(
            frames
                .windows(2)
                .all(|pair| pair[0].number < pair[1].number)
        );
    }

    #[test]
    fn a_flip_lasts_and_another_body_stands_still() {
        let (_, frames) = driven(|p| p.flip_from_s = Some(1.0));
        for frame in &frames {
            // Up is y: half the yaw's sine.
            let half = f64::from(frame.bodies.last().unwrap().orientation_xyzw[1]);
            let expected = if frame.exposed_us < 1_000_000 {
                0.0
            } else {
                1.0
            };
            assert!((half - expected).abs() < 1e-6);
            assert!((x(frame) - frame.exposed_us as f64 * 1e-6).abs() < 1e-6);
        }
        let (_, frames) = driven(|p| p.other_body_from_s = Some(1.0));
        let decoy = CameraParameters::default().decoys[0].position_m;
        for frame in &frames {
            let expected = match frame.exposed_us {
                at @ ..1_000_000 => at as f64 * 1e-6,
                _ => decoy[0],
            };
            assert!((x(frame) - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn forged_frames_follow_the_true_ones_and_drift_away() {
        let (cameras, frames) = driven(|p| {
            p.forged_from_s = Some(0.5);
            p.forged_offset_m = [0.1, -0.2];
            p.forged_drift_m_s = [0.0, 1.0];
        });
        assert_eq!(cameras.forge(&frames[10]), None);
        let last = frames.last().unwrap();
        let forged = cameras.forge(last).unwrap();
        assert_eq!(forged.number, last.number + 1);
        assert!(forged.ticks.mid_exposure > last.ticks.mid_exposure);
        let [x, _, minus_y] = forged.bodies.last().unwrap().position_m;
        let elapsed_s = last.sent_us as f64 * 1e-6 - 0.5;
        assert!((f64::from(x) - (last.exposed_us as f64 * 1e-6 + 0.1)).abs() < 1e-6);
        assert!((f64::from(-minus_y) - (elapsed_s - 0.2)).abs() < 1e-6);
    }

    #[test]
    fn nothing_timed_happens_before_its_epoch() {
        let mut cameras = Cameras::new(
            CameraParameters {
                flip_from_s: Some(0.0),
                ..exact()
            },
            1,
        );
        let mut half = |epoch| {
            cameras.set_epoch(epoch);
            let time_us = cameras.next_exposure_us();
            cameras.expose(&Truth {
                time_us,
                ..Truth::default()
            });
            let frame = cameras.take_frame(u64::MAX).unwrap();
            frame.bodies.last().unwrap().orientation_xyzw[1]
        };
        assert!(half(None).abs() < 1e-6);
        assert!(half(Some(1_000_000)).abs() < 1e-6);
        assert!((half(Some(0)) - 1.0).abs() < 1e-6);
    }
}
