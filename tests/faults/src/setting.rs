//! Converts a situation to the world's and the daemon's configuration, and the effects of faults to
//! the simulated world: line, board, sensors, supply.

use singletrack_control::SteeringTable;
use singletrack_core::config::{self, BoardSection, Config, FailsafeAction};
use singletrack_protocol::ResetCause;
use singletrack_sim::{
    BoardParameters, CameraParameters, CarBody, CarParameters, EscKind, Hang, ImuFault,
    MotorSensorFault, NatNetServer, Push, SimulationConfig, StartPose, WIDE_US, WireFaults,
    WireParameters, World, crooked_steering, default_board_configuration,
};

use crate::{
    SetupError,
    schedule::{Deviation, Fault, FaultKind, ReferenceKind, Schedule, Situation, TrueCar},
    setting,
};

/// The content of the daemon's configuration file. Each reload finds the other one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum ConfigurationFile {
    /// That of the situation.
    #[default]
    Initial,
    /// With lower limits, for the host and for the board, and a slower reference.
    Slower,
}

impl ConfigurationFile {
    pub(crate) const fn other(self) -> Self {
        match self {
            Self::Initial => Self::Slower,
            Self::Slower => Self::Initial,
        }
    }

    const fn speed_share(self) -> f64 {
        match self {
            Self::Initial => 1.0,
            Self::Slower => 0.8,
        }
    }
}

/// The daemon's configuration. Keys that are not set here have their defaults.
///
/// # Errors
///
/// The daemon refuses the configuration.
pub(crate) fn config(situation: &Situation, file: ConfigurationFile) -> Result<Config, SetupError> {
    let speed = file.speed_share() * f64::from(situation.speed_mm_s) * 1e-3;
    let marker_loss = if situation.coast {
        "dead-reckon"
    } else {
        "hold"
    };
    let (outer_loop, reference) = match situation.reference {
        ReferenceKind::Circle => {
            let radius = radius(speed);
            (
                "kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = true",
                format!(
                    "kind = \"circle\"\nradius_m = {radius}\nangular_velocity_rad_s = {}",
                    speed / radius
                ),
            )
        }
        ReferenceKind::Eight => {
            // The fastest and the most curved point of a lemniscate differ; with this
            // length both stay within the tyres' grip.
            let length = 1.5 * radius(speed);
            (
                "kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = true",
                format!(
                    "kind = \"figure-of-eight\"\nhalf_length_m = {length}\nhalf_width_m = {}\n\
                     angular_velocity_rad_s = {}",
                    0.5 * length,
                    speed / (1.5 * length)
                ),
            )
        }
        ReferenceKind::External => (
            "kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = true",
            "kind = \"external\"\nsetpoint_timeout_ms = 200".to_owned(),
        ),
        ReferenceKind::Steps => (
            "kind = \"open-loop\"",
            format!(
                "kind = \"velocity-steps\"\nsteps = [{}]",
                [(1.0, 0.0), (0.8, 0.6), (0.0, 1.0), (-0.8, 0.6), (-1.0, 0.0)]
                    .map(|(x, y)| format!(
                        "{{ duration_s = 1.2, v_x_m_s = {}, v_y_m_s = {} }}",
                        x * speed,
                        y * speed
                    ))
                    .join(", ")
            ),
        ),
    };
    let h = (reach(situation) + f64::from(situation.fence_mm) * 1e-3).max(0.3);
    let text = format!(
        "[serial]\nport = \"simulated\"\n\
         [motion_capture]\nserver = \"127.0.0.1\"\nrigid_body = \"car\"\nup_axis = \"y\"\n\
         [law]\nkind = \"front-point\"\npoint_distance_m = 0.35\nfront_axle_distance_m = 0.1368\n\
         [outer_loop]\n{outer_loop}\n\
         [reference]\n{reference}\n\
         [fence]\ncorners_m = [[-{h}, -{h}], [{h}, -{h}], [{h}, {h}], [-{h}, {h}]]\n\
         margin_m = 0.0\nbraking_m_s2 = {}\n\
         [supervisor]\nprove_first_metre = {}\n\
         [estimator]\nmarker_loss = \"{marker_loss}\"\n\
         [safety_filter]\nenabled = {}\n\
         {BOARD}",
        f64::from(situation.braking_mm_s2) * 1e-3,
        !situation.proved,
        situation.safety_filter
    );
    let mut config = Config::from_toml(&text).map_err(SetupError::Config)?;
    // A kill output takes the supply, without which nothing brakes.
    let brakes =
        situation.brake && situation.esc_kind != EscKind::ForwardReverse && !situation.kill_output;
    config.board = BoardSection {
        failsafe: if brakes {
            FailsafeAction::Brake
        } else {
            FailsafeAction::Coast
        },
        stop_input: situation.stop_input,
        kill_output: situation.kill_output,
        ..BoardSection::from(&default_board_configuration())
    };
    config.board.esc.kind = Some(match situation.esc_kind {
        EscKind::Car | EscKind::LearnsNeutral => config::EscKind::Car,
        EscKind::ForwardReverse => config::EscKind::ForwardReverse,
        EscKind::Vesc => config::EscKind::Vesc,
    });
    let esc = &mut config.board.esc;
    esc.neutral_us = situation.neutral_us;
    esc.deadband_us = esc.deadband_us.max(situation.neutral_us.abs_diff(1_500));
    if situation.steering_table {
        let servo = &config.board.servo;
        let line = [servo.centre_us.into(), servo.gain_us_per_rad.into()];
        let ends = [servo.min_us, servo.max_us].map(f64::from);
        config.actuators.steering_table = Some(crooked_steering(line, ends, CROOKED));
        config.limits.max_steering_rad = 0.4;
    }
    config.board.speed.pulse_distance_um =
        u16::try_from(situation.pulse_distance_um).unwrap_or(u16::MAX);
    if situation.tuning {
        config.tuning.enabled = true;
        config.tuning.gain_per_s = Some(TUNED_GAIN);
    }
    if situation.live && !situation.safety_filter {
        config.online_calibration.mode = config::OnlineCalibrationMode::Live;
    }
    if file == ConfigurationFile::Slower {
        config.limits.max_speed_m_s *= file.speed_share();
        config.limits.max_acceleration_m_s2 *= file.speed_share();
        config.board.speed.max_forward_mm_s = 1_250;
    }
    config.validate().map_err(SetupError::Config)?;
    Ok(config)
}

/// How much farther to the left the wheels turn, as a fraction, and the width of the dead band, in
/// µs, of the configuration with `steering_table`.
const CROOKED: [f64; 2] = [0.15, 8.0];

/// What a driver reports of its output queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Reported {
    /// Nothing, as a pseudo-terminal.
    #[default]
    Nothing,
    /// The bytes.
    Bytes,
    /// Whole transfers.
    Transfers,
}

/// What the port reports of its queue. One that resets the board is that of a genuine UNO.
pub(crate) const fn reported(situation: &Situation) -> Reported {
    match (situation.queue_shows, situation.reset_on_open) {
        (false, _) => Reported::Nothing,
        (true, false) => Reported::Bytes,
        (true, true) => Reported::Transfers,
    }
}

/// Bounds of the gain that clients tune, 1/s.
pub(crate) const TUNED_GAIN: [f64; 2] = [0.8, 1.2];

/// Mandatory keys of the board; the simulated car's calibration replaces their values.
const BOARD: &str = "[board.servo]\ncentre_us = 1500\ngain_us_per_rad = -800\nmin_us = 1080\n\
                     max_us = 1920\n\
                     [board.esc]\nneutral_us = 1500\ndeadband_us = 30\nmin_us = 1200\n\
                     max_us = 1700\nbrake_us = 1350\n\
                     [board.speed]\npulse_distance_um = 3000\nfeed_forward_us_per_m_s = 80\n\
                     proportional_us_per_m_s = 80\nintegral_us_per_m = 250\n\
                     integral_limit_us = 60\nmax_forward_mm_s = 1500\n";

/// The radius of a circle within the tyres' grip, in m: 1.5 m/s² of 2.45 m/s².
pub(crate) fn radius(speed: f64) -> f64 {
    (speed * speed / 1.5).max(0.8)
}

/// The largest distance of P from the origin, in m.
fn reach(situation: &Situation) -> f64 {
    let speed = f64::from(situation.speed_mm_s) * 1e-3;
    match situation.reference {
        ReferenceKind::Circle | ReferenceKind::External => radius(speed),
        ReferenceKind::Eight => 1.5 * radius(speed),
        // Each step takes 1.2 s.
        ReferenceKind::Steps => 1.2 * 2.2 * speed,
    }
}

/// The simulation of a schedule.
pub(crate) fn simulation(schedule: &Schedule) -> SimulationConfig {
    let situation = &schedule.situation;
    SimulationConfig {
        seed: schedule.seed,
        car: CarParameters {
            start: start(situation),
            ..true_car(schedule)
        },
        board: BoardParameters {
            kind: situation.board,
            own_supply: situation.own_supply,
            clock_skew_ppm: situation.board_skew_ppm,
            clock_offset_us: situation.board_clock_ms.wrapping_mul(1_000),
            ..BoardParameters::default()
        },
        wire: WireParameters {
            faults: wire_faults(situation),
            ..WireParameters::default()
        },
        cameras: CameraParameters {
            latency_us: u64::from(situation.camera_latency_ms) * 1_000,
            car: true_body(&schedule.truth),
            stamp_bias_ms: 1e-3 * f64::from(schedule.truth.get(Deviation::StampBias).unwrap_or(0)),
            stamp_drift_ppm: f64::from(schedule.truth.get(Deviation::StampDrift).unwrap_or(0)),
            ..CameraParameters::default()
        },
        ..SimulationConfig::default()
    }
}

fn true_car(schedule: &Schedule) -> CarParameters {
    let Schedule {
        situation, truth, ..
    } = schedule;
    let mut car = CarParameters::default();
    let value = |deviation| f64::from(truth.get(deviation).unwrap_or(0));
    let stated = |deviation| truth.get(deviation).map(f64::from);
    let factor = |deviation| 1.0 + 1e-3 * value(deviation);
    car.servo.centre_us += value(Deviation::ServoTrim);
    car.servo.gain_us_per_rad *= factor(Deviation::ServoGain);
    let [mut farther, mut band] = [
        1e-3 * value(Deviation::ServoAsymmetry),
        value(Deviation::ServoDeadBand),
    ];
    if situation.steering_table {
        farther += CROOKED[0];
        band += CROOKED[1];
    }
    if farther != 0.0 || band != 0.0 {
        let line = [car.servo.centre_us, car.servo.gain_us_per_rad];
        let pairs = crooked_steering(line, WIDE_US, [farther, band]);
        // A gain of zero has no table.
        car.servo.table = SteeringTable::new(&pairs).ok();
    }
    if let Some(rate) = stated(Deviation::ServoRate) {
        car.servo.max_rate_rad_s = 1e-3 * rate;
    }
    car.motor_sensor.pulse_distance_um =
        f64::from(situation.pulse_distance_um) * factor(Deviation::PulseDistance);
    let motor = &mut car.motor;
    motor.gain_m_s_per_us *= factor(Deviation::MotorGain);
    if let Some(rolling) = stated(Deviation::Rolling) {
        motor.coasting_m_s2 = 1e-3 * rolling;
    }
    if let Some(viscous) = stated(Deviation::Viscous) {
        motor.viscous_per_s = 1e-3 * viscous;
    }
    if let Some(dead_time) = stated(Deviation::EscDeadTime) {
        motor.dead_time_us = (1e3 * dead_time) as u64;
    }
    if let Some(lag) = stated(Deviation::MotorLag) {
        motor.lag_s = 1e-3 * lag;
    }
    motor.kind = truth.esc.unwrap_or(situation.esc_kind);
    motor.signal_loss_us = motor.kind.signal_loss_us();
    motor.kill_relay = situation.kill_output;
    motor.slope_deg = 1e-2 * value(Deviation::Slope);
    motor.slope_heading_deg = value(Deviation::SlopeHeading);
    let longer =
        |us: u16, deviation| us.saturating_add_signed(truth.get(deviation).unwrap_or(0) as i16);
    motor.neutral_us = longer(motor.neutral_us, Deviation::EscNeutral);
    motor.deadband_us = longer(motor.deadband_us, Deviation::EscDeadband);
    if let Some(ms) = stated(Deviation::SignalLoss) {
        motor.signal_loss_us = (1e3 * ms) as u64;
    }
    car.servo.backlash_us = value(Deviation::ServoBacklash);
    let sensor = &mut car.motor_sensor;
    sensor.emi_driven_hz = value(Deviation::EmiDriven);
    sensor.emi_standstill_hz = value(Deviation::EmiStanding);
    sensor.ringing_edges = value(Deviation::Ringing) as u16;
    let imu = &mut car.imu;
    imu.mounting_deg = [Deviation::ImuRoll, Deviation::ImuPitch, Deviation::ImuYaw]
        .map(|deviation| 0.1 * value(deviation));
    imu.gyro_scale = factor(Deviation::GyroScale);
    imu.acceleration_scale = factor(Deviation::AccelerationScale);
    if let Some(vibration) = stated(Deviation::Vibration) {
        imu.vibration_m_s2 = 1e-3 * vibration;
    }
    imu.leak_s = stated(Deviation::ImuLeak).map(|ms| 1e-3 * ms);
    imu.torn = 1e-3 * value(Deviation::ImuTorn);
    let register = |deviation| truth.get(deviation).map(|value| value as u8);
    imu.calibration =
        register(Deviation::ImuCalibration).map_or(imu.calibration, |value| [value; 3]);
    imu.system_status = register(Deviation::ImuStatus).unwrap_or(imu.system_status);
    imu.system_error = register(Deviation::ImuError).unwrap_or(imu.system_error);
    imu.self_test = register(Deviation::ImuSelfTest).unwrap_or(imu.self_test);
    car.battery.divider_open = value(Deviation::DividerOpen) > 0.0;
    if let Some(mv) = stated(Deviation::Supply) {
        car.battery.supply_v = 1e-3 * mv;
    }
    for fault in schedule.faults.iter().rev() {
        happen(&mut car, fault);
    }
    car.battery.start_v -= 1e-3 * value(Deviation::Drained) * car.battery.fall_v_per_ah;
    car
}

/// Enters a fault of the car that happens once. The earliest is entered last.
fn happen(car: &mut CarParameters, fault: &Fault) {
    let at_s = 1e-3 * f64::from(fault.at_ms);
    let severity = f64::from(fault.severity);
    match fault.kind {
        FaultKind::ServoStuck => car.servo.stuck_from_s = Some(at_s),
        FaultKind::EscStuck => car.motor.stuck_from_s = Some(at_s),
        FaultKind::EscReboot => {
            car.motor.reboot_at_s = Some(at_s);
            car.motor.reboot_ms = f64::from(fault.for_ms);
        }
        FaultKind::BecDip => {
            car.battery.dip_at_s = Some(at_s);
            car.battery.dip_ms = f64::from(fault.for_ms);
        }
        FaultKind::Push => {
            car.motor.push = Some(Push {
                at_s,
                speed_m_s: (severity - 500.0) / 500.0,
                for_s: 1e-3 * f64::from(fault.for_ms),
            });
        }
        FaultKind::WheelSlip => {
            car.motor.slip = severity / 2_000.0;
            car.motor.slip_from_s = Some(at_s);
        }
        _ => {}
    }
}

fn true_body(truth: &TrueCar) -> CarBody {
    let value = |deviation| f64::from(truth.get(deviation).unwrap_or(0));
    let body = CarBody::default();
    let [forward, left] = body.to_centre_of_mass_m;
    CarBody {
        to_centre_of_mass_m: [
            forward - 1e-3 * value(Deviation::PivotForward),
            left - 1e-3 * value(Deviation::PivotLeft),
        ],
        height_m: truth
            .get(Deviation::BodyHeight)
            .map_or(body.height_m, |mm| 1e-3 * f64::from(mm)),
        yaw_rad: body.yaw_rad + 1e-3 * value(Deviation::BodyYaw),
        ..body
    }
}

/// The line without faults.
fn wire_faults(situation: &Situation) -> WireFaults {
    WireFaults {
        delay_us: u64::from(situation.serial_delay_us),
        ..WireFaults::default()
    }
}

/// A start with P near the beginning of the reference, and the car almost parallel to it.
fn start(situation: &Situation) -> StartPose {
    const REACH_M: f64 = 0.1368 + 0.35;
    let speed = f64::from(situation.speed_mm_s) * 1e-3;
    match situation.reference {
        ReferenceKind::Circle | ReferenceKind::External => StartPose {
            x_m: radius(speed),
            y_m: -REACH_M,
            yaw_rad: core::f64::consts::FRAC_PI_2,
        },
        ReferenceKind::Eight => StartPose {
            x_m: -REACH_M,
            y_m: 0.0,
            yaw_rad: 0.5,
        },
        ReferenceKind::Steps => StartPose::default(),
    }
}

/// The car's streaming id, and the one it gets by [`FaultKind::CameraModelChange`].
pub(crate) const CAR_IDS: [i32; 2] = [CAR_ID, OTHER_CAR_ID];
const CAR_ID: i32 = 11;
const OTHER_CAR_ID: i32 = 12;

/// Charge that lowers the battery voltage by 1 V, in Ah; see `BatteryParameters`.
const AH_PER_VOLT: f64 = 2.0;

/// Applies the onset of a fault.
pub(crate) fn begin(world: &mut World, fault: &Fault) {
    match fault.kind {
        FaultKind::BoardPowerOn => world.reset_board(ResetCause::PowerOn),
        FaultKind::BoardReset => world.reset_board(ResetCause::External),
        FaultKind::BoardBrownOut => world.reset_board(ResetCause::BrownOut),
        FaultKind::BoardWatchdog => world.reset_board(ResetCause::Watchdog),
        FaultKind::BoardHang if world.board.is_running() => {
            world.board.hang(Hang::MainLoop);
        }
        FaultKind::CameraModelChange => world.set_car_body_id(OTHER_CAR_ID),
        FaultKind::BatteryLow => world.car.drain_battery(charge_ah(fault)),
        _ => {}
    }
}

/// Reverts a fault at its end.
pub(crate) fn end(world: &mut World, fault: &Fault) {
    match fault.kind {
        FaultKind::CameraModelChange => world.set_car_body_id(CAR_ID),
        FaultKind::CameraServerRestart => {
            let parameters = world.natnet.parameters;
            world.natnet = NatNetServer::new(parameters);
        }
        FaultKind::BatteryLow => world.car.drain_battery(-charge_ah(fault)),
        _ => {}
    }
}

fn charge_ah(fault: &Fault) -> f64 {
    AH_PER_VOLT * f64::from(fault.severity) / 250.0
}

/// Sets the continuous effects of the active faults. Of several faults on one
/// subject, the latest wins.
pub(crate) fn hold(world: &mut World, situation: &Situation, faults: &[Fault]) {
    let is_active = |kind| faults.iter().any(|fault| fault.kind == kind);
    let mut wire = setting::wire_faults(situation);
    let mut imu = ImuFault::None;
    let mut motor = MotorSensorFault::None;
    for fault in faults {
        let s = fault.severity;
        match fault.kind {
            FaultKind::LineDrop => wire.drop = f64::from(s) / 5_000.0,
            FaultKind::LineCorrupt => wire.corrupt = f64::from(s) / 5_000.0,
            FaultKind::LineDelay => wire.delay_us += u64::from(s) * 200,
            FaultKind::LineStuck => {
                wire = WireFaults {
                    stuck: true,
                    ..wire
                };
            }
            FaultKind::ImuSilent => imu = ImuFault::Silent,
            FaultKind::ImuStuck => imu = ImuFault::Stuck,
            FaultKind::ImuBiased => {
                let bias = i16::try_from(s).unwrap_or(i16::MAX);
                imu = ImuFault::Biased {
                    yaw_rate_mrad_s: bias,
                    forward_mm_s2: bias,
                };
            }
            FaultKind::ImuSaturated => imu = ImuFault::Saturated,
            FaultKind::ImuErratic => imu = ImuFault::Erratic,
            FaultKind::ImuWrongBit => {
                let every = 1_020_u16.saturating_sub(u16::try_from(s).unwrap_or(u16::MAX));
                imu = ImuFault::WrongBit { every };
            }
            FaultKind::PulsesGone => motor = MotorSensorFault::Gone,
            FaultKind::PulsesDoubled => motor = MotorSensorFault::Doubled,
            FaultKind::PulsesHalved => motor = MotorSensorFault::Halved,
            FaultKind::PulsesErratic => motor = MotorSensorFault::Erratic,
            _ => {}
        }
    }
    world.wire.faults = wire;
    world.set_cable(!is_active(FaultKind::LineUnplugged));
    world.set_board_power(!is_active(FaultKind::BoardOff));
    world.imu_fault = imu;
    world.car.sensor_fault = motor;
    world.car.set_esc_power(!is_active(FaultKind::EscOff));
    world.board.stop_input_open = is_active(FaultKind::StopInputOpen);
}
