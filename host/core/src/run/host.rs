//! The host: all parts that run the car, connected by their rings.
//!
//! ```text
//! serial reader ----ring---\                      /--ring--> ticks
//! camera receiver --ring----> control loop ------<---ring--> reports
//! requests ---------ring---/   |                  \--> the port's write half
//! set-points, jog --slot--/
//! ```
//!
//! The daemon gives each part a thread of its own. Simulations and tests poll them in
//! virtual time, see [`VirtualHost`](crate::virtual_host::VirtualHost).

use std::sync::{Arc, atomic::AtomicI64};

use rtrb::{Consumer, RingBuffer};
use singletrack_link::Session as LinkSession;
use singletrack_mocap::planar::PlanarSession;
use singletrack_pilot::{Jog, Pilot, Tuning};
use singletrack_record::{TickOutput, tick_feed};

use crate::{
    cameras::NeighbourFeed,
    cameras::{CameraReceiver, CameraReport},
    config::{Config, ConfigError},
    control_loop::{ControlLoop, Rings},
    controller::Controller,
    line::Line,
    reconfigure::Configurations,
    run::proof::{Proofs, configuration_hash},
    run::report::Report,
    run::requests::Requests,
    serial::SerialReader,
    slot::{SetpointSender, setpoint_slot},
    slot::{SlotSender, slot},
};

/// Capacities of the rings. A stall of the control loop loses nothing up to half a second,
/// a stall of the record up to two seconds.
const SERIAL_EVENTS: usize = 512;
const OBSERVATIONS: usize = 256;
const NEIGHBOURS: usize = 1_024;
const TICKS: usize = 256;
const REPORTS: usize = 512;
/// Write halves: the one in use and its successor.
const LINES: usize = 2;
/// One is underway at a time.
const RECONFIGURATIONS: usize = 2;
/// A tick has room for all of them among its events, see `controller::RESERVED`.
const REQUESTS: usize = 12;

/// Options of a host that are not in its configuration.
#[derive(Clone, Debug, Default)]
pub struct HostOptions {
    /// It must differ from one start to the next: by it the board detects a restarted host.
    pub nonce_seed: u64,
    /// Arms once, as soon as the pilot is ready.
    pub arm_when_ready: bool,
    /// Takes a configuration that the daemon refuses: only for studies of what its checks
    /// prevent. The board checks its part in any case.
    pub skip_validation: bool,
    /// The configurations that have been proved. A newly proved one is reported
    /// ([`Report::Proved`]).
    pub proofs: Proofs,
}

/// The parts of a host.
#[derive(Debug)]
pub struct Host<L> {
    /// The control loop.
    pub control: ControlLoop<L>,
    /// Reads the board's port.
    pub reader: SerialReader<L>,
    /// The session with the cameras.
    pub receiver: CameraReceiver,
    /// Sends requests to the control loop.
    pub requests: Requests,
    /// Sends set-points to the control loop.
    pub setpoints: SetpointSender,
    /// Sends the pulses of the operator who jogs to the control loop.
    pub jogs: SlotSender<Jog>,
    /// Sends values to tune to the control loop.
    pub tunings: SlotSender<Tuning>,
    /// The configuration in force.
    pub configurations: Configurations,
    /// The record of every tick.
    pub ticks: TickOutput,
    /// All other reports of the control loop.
    pub reports: Consumer<Report>,
    /// Reports of the camera receiver.
    pub camera_reports: Consumer<CameraReport>,
}

impl<L: Line> Host<L> {
    /// Checks the configuration, reads the files that it names, and connects the parts.
    ///
    /// # Errors
    ///
    /// The configuration is invalid; the error names the key.
    pub fn new(mut config: Config, options: HostOptions) -> Result<Self, ConfigError> {
        if !options.skip_validation {
            config.validate()?;
        }
        // Read once, so that pilot and record have the same waypoints.
        config.reference = config.reference.with_points_inlined()?;
        let controller = Controller::new(
            LinkSession::new(config.link(options.nonce_seed))?,
            config.steering_map()?,
            Pilot::new(config.pilot()?),
            configuration_hash(&config)?,
            options.proofs,
        );
        let mut session = config.motion_capture.session()?;
        session.tells_others = config.neighbours.enabled;
        let session = PlanarSession::new(session)
            .map_err(|error| ConfigError::value("motion_capture", "refused", error.to_string()))?;
        let stamp_offset_ns = Arc::new(AtomicI64::new(
            session.config().session.timing.stamp_offset_ns,
        ));
        let aligns = config.control.align_to_cameras;
        let aligned_ns = aligns.then(|| config.control.period_ns());

        let (serial_in, serial) = RingBuffer::new(SERIAL_EVENTS);
        let (returned, returned_out) = RingBuffer::new(LINES);
        let (observations_in, observations) = RingBuffer::new(OBSERVATIONS);
        let (neighbours_in, neighbours) = RingBuffer::new(NEIGHBOURS);
        let feed = config
            .neighbours
            .enabled
            .then(|| NeighbourFeed::new(&config.neighbours, neighbours_in));
        let (requests_in, requests) = RingBuffer::new(REQUESTS);
        let (setpoints_in, setpoints) = setpoint_slot();
        let (jogs_in, jogs) = slot();
        let (tunings_in, tunings) = slot();
        let (reconfigured, reconfigured_out) = RingBuffer::new(RECONFIGURATIONS);
        let (ticks, ticks_out) = tick_feed(TICKS);
        let (reports, reports_out) = RingBuffer::new(REPORTS);
        let (camera_reports, camera_reports_out) = RingBuffer::new(REPORTS);
        let control = ControlLoop::new(
            controller,
            Rings {
                serial,
                returned,
                observations,
                neighbours,
                requests,
                setpoints,
                jogs,
                tunings,
                reconfigured,
                ticks,
                reports,
            },
            options.arm_when_ready,
            aligned_ns,
        );
        Ok(Self {
            control,
            reader: SerialReader::new(serial_in, returned_out),
            receiver: CameraReceiver::new(
                session,
                Arc::clone(&stamp_offset_ns),
                observations_in,
                camera_reports,
            )
            .with_neighbours(feed)
            .with_fresh(f64::from(config.supervisor.fresh_ms) * 1e-3),
            requests: Requests::new(requests_in),
            setpoints: setpoints_in,
            jogs: jogs_in,
            tunings: tunings_in,
            configurations: Configurations::new(config, reconfigured_out, stamp_offset_ns),
            ticks: ticks_out,
            reports: reports_out,
            camera_reports: camera_reports_out,
        })
    }
}
