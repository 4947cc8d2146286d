//! The physics of cars that differ from what is believed of them, without board or host.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use singletrack_sim::{
    Car, CarParameters, CarTruth, EscKind, MotorParameters, Push, SimulationConfig, StartPose,
};

/// Time of a servo frame, in µs.
const FRAME_US: u64 = 20_000;

/// The parameters of a car of which this table is true.
fn parameters(truth: &str) -> CarParameters {
    let mut simulation = SimulationConfig::default();
    let truth: CarTruth = toml::from_str(truth).unwrap();
    truth.apply(&mut simulation).unwrap();
    simulation.car
}

/// A car under constant pulses, with the time.
struct Bench {
    car: Car,
    now_us: u64,
}

impl Bench {
    fn new(truth: &str) -> Self {
        Self {
            car: Car::new(parameters(truth)),
            now_us: 0,
        }
    }

    /// A car whose ESC has seen neutral for longer than it needs.
    fn armed(truth: &str) -> Self {
        let mut bench = Self::new(truth);
        let neutral_us = bench.car.parameters.motor.neutral_us;
        // A second, and what learning takes.
        bench.drive(1.5, 1_500, neutral_us);
        assert!(bench.car.esc_is_armed());
        bench
    }

    /// Applies pulses for a time; an ESC pulse of zero is no pulse.
    fn drive(&mut self, seconds: f64, servo_us: u16, esc_us: u16) {
        for _ in 0..(seconds * 1e6) as u64 / FRAME_US {
            self.car.apply_pulses(servo_us, esc_us);
            self.now_us += FRAME_US;
            self.car.advance_to(self.now_us);
        }
    }

    /// Speed of the wheels, in m/s.
    fn rolling(&self) -> f64 {
        self.car.truth().wheel_speed
    }

    fn now_s(&self) -> f64 {
        self.now_us as f64 * 1e-6
    }

    /// The way until it stands, without pulses if `esc_us` is zero.
    fn roll_out(&mut self, esc_us: u16) -> f64 {
        let begin = self.car.truth().way;
        for _ in 0..1_000 {
            self.drive(0.02, 1_500, esc_us);
            if self.rolling() == 0.0 {
                break;
            }
        }
        self.car.truth().way - begin
    }
}

/// The way of a car that rolls out from `v` with `rolling + viscous · v`.
fn roll_out(v: f64, rolling: f64, viscous: f64) -> f64 {
    (v - rolling / viscous * (1.0 + v * viscous / rolling).ln()) / viscous
}

#[test]
fn an_inverted_servo_steers_right_for_left() {
    for (truth, sign) in [("", 1.0), ("[servo]\ngain_us_per_rad = 800", -1.0)] {
        let mut bench = Bench::armed(truth);
        // 0.25 rad to the left for the default car.
        bench.drive(1.0, 1_300, 1_560);
        let truth = bench.car.truth();
        assert!((truth.steering - sign * 0.25).abs() < 0.01);
        assert!(sign * truth.yaw_rate > 0.0);
    }
}

#[test]
fn trim_gain_and_rate_are_the_servos_own() {
    let angle = |truth, pulse| {
        let mut bench = Bench::new(truth);
        bench.drive(1.0, pulse, 0);
        bench.car.truth().steering
    };
    assert!((angle("[servo]\ncentre_us = 1540", 1_500) - 40.0 / 800.0).abs() < 1e-6);
    assert!((angle("[servo]\ngain_us_per_rad = -400", 1_440) - 0.15).abs() < 1e-6);
    // 0.1 rad/s for a second less the dead time of 2 ms.
    let slow = angle("[servo]\nmax_rate_rad_s = 0.1", 1_200);
    assert!((slow - 0.0998).abs() < 1e-6, "{slow}");
}

#[test]
fn a_stuck_servo_keeps_its_angle() {
    let mut bench = Bench::new("[servo]\nstuck_from_s = 1.0");
    bench.drive(1.0, 1_340, 0);
    let before = bench.car.truth().steering;
    assert!((before - 0.2).abs() < 1e-6);
    bench.drive(1.0, 1_660, 0);
    assert!((bench.car.truth().steering - before).abs() < 1e-6);
}

#[test]
fn a_dip_of_its_supply_leaves_the_servo_without_force() {
    let mut bench = Bench::new("[battery]\ndip_at_s = 1.0\ndip_ms = 400.0\ndip_v = 5.0");
    bench.drive(1.0, 1_340, 0);
    let before = bench.car.truth().steering;
    bench.drive(0.3, 1_660, 0);
    assert!(bench.car.supply_dips());
    assert!((bench.car.truth().steering - before).abs() < 1e-3);
    assert_eq!(bench.car.truth().battery_v, 5.0);
    bench.drive(0.7, 1_660, 0);
    assert!(!bench.car.supply_dips());
    assert!((bench.car.truth().steering + 0.2).abs() < 1e-3);
    assert!(bench.car.truth().battery_v > 7.0);
}

/// Drives forward, then with a pulse below neutral; the speeds before, after 0.2 s and at
/// the end.
fn below_neutral(kind: &str) -> [f64; 3] {
    let mut bench = Bench::armed(&format!("[esc]\nkind = \"{kind}\""));
    bench.drive(2.0, 1_500, 1_560);
    let before = bench.rolling();
    bench.drive(0.2, 1_500, 1_400);
    let then = bench.rolling();
    bench.drive(3.0, 1_500, 1_400);
    [before, then, bench.rolling()]
}

#[test]
fn a_pulse_below_neutral_brakes_or_drives_in_reverse_according_to_the_kind() {
    for kind in ["car", "vesc", "learns-neutral"] {
        let [before, then, end] = below_neutral(kind);
        assert!(before > 0.25 && then < 0.1, "{kind}: {before} {then}");
        assert_eq!(end, 0.0, "{kind}");
    }
    let [before, _, end] = below_neutral("forward-reverse");
    assert!(before > 0.25 && end < -0.5, "{end}");
}

#[test]
fn a_vesc_never_drives_in_reverse_and_a_car_does_after_neutral() {
    for (kind, reverse) in [("car", true), ("vesc", false)] {
        let mut bench = Bench::armed(&format!("[esc]\nkind = \"{kind}\""));
        bench.drive(1.0, 1_500, 1_400);
        assert_eq!(bench.rolling() < 0.0, reverse, "{kind}");
    }
}

#[test]
fn a_wrong_neutral_drives_an_armed_esc_and_keeps_another_from_arming() {
    // The neutral that is believed, 1560, is 30 us beyond the true band and breakaway.
    let mut bench = Bench::armed("[esc]\nneutral_us = 1500");
    bench.drive(2.0, 1_500, 1_560);
    assert!((bench.rolling() - 0.30).abs() < 0.02, "{}", bench.rolling());
    let mut bench = Bench::new("[esc]\nneutral_us = 1500");
    bench.drive(4.0, 1_500, 1_560);
    assert_eq!((bench.rolling(), bench.car.esc_is_armed()), (0.0, false));
}

#[test]
fn an_esc_that_learns_its_neutral_takes_the_first_pulses_for_it() {
    let mut bench = Bench::new("[esc]\nkind = \"learns-neutral\"");
    bench.drive(2.0, 1_500, 1_560);
    assert!(bench.car.esc_is_armed());
    assert_eq!(bench.rolling(), 0.0);
    // What everybody else calls neutral is full reverse for it.
    bench.drive(2.0, 1_500, 1_500);
    assert!(bench.rolling() < -0.1);
}

#[test]
fn a_restart_of_the_esc_ends_its_drive_until_neutral() {
    let mut bench = Bench::armed("[esc]\nreboot_at_s = 3.0\nreboot_ms = 200.0");
    bench.drive(1.4, 1_500, 1_560);
    assert!(bench.rolling() > 0.25);
    bench.drive(2.0, 1_500, 1_560);
    assert_eq!((bench.rolling(), bench.car.esc_is_armed()), (0.0, false));
    bench.drive(1.2, 1_500, 1_500);
    bench.drive(1.0, 1_500, 1_560);
    assert!(bench.rolling() > 0.2);
}

#[test]
fn a_restart_while_driving_teaches_the_wrong_neutral() {
    let mut bench = Bench::new("[esc]\nkind = \"learns-neutral\"\nreboot_at_s = 3.0");
    bench.drive(1.5, 1_500, 1_500);
    bench.drive(1.6, 1_500, 1_560);
    assert!(bench.car.esc_is_armed() || bench.now_s() >= 3.0);
    bench.drive(2.0, 1_500, 1_560);
    assert_eq!(bench.rolling(), 0.0);
    bench.drive(1.0, 1_500, 1_500);
    assert!(bench.rolling() < -0.1, "{}", bench.rolling());
}

#[test]
fn without_pulses_each_kind_goes_on_for_its_own_time() {
    for (truth, loss_s) in [
        ("", 0.1),
        ("[esc]\nkind = \"vesc\"", 1.0),
        ("[esc]\nsignal_loss_ms = 500.0", 0.5),
    ] {
        let mut bench = Bench::armed(truth);
        let loss_us = bench.car.parameters.motor.signal_loss_us;
        assert_eq!(loss_us, (loss_s * 1e6) as u64, "{truth}");
        bench.drive(3.0, 1_500, 1_620);
        let v = bench.rolling();
        let way = bench.roll_out(0);
        // The last pulse takes effect a dead time of 20 ms after it, and was a frame
        // before the end; the ESC counts from there.
        let p = bench.car.parameters.motor;
        let expected = v * loss_s + roll_out(v, p.coasting_m_s2, p.viscous_per_s);
        assert!((way - expected).abs() < v * 0.03, "{way} {expected}");
    }
}

#[test]
fn a_stuck_throttle_ends_only_with_its_supply() {
    let mut bench = Bench::armed("[esc]\nstuck_from_s = 4.0");
    bench.drive(3.0, 1_500, 1_560);
    let before = bench.rolling();
    for esc_us in [1_500, 1_300, 0] {
        bench.drive(2.0, 1_500, esc_us);
        assert!((bench.rolling() - before).abs() < 0.01, "{esc_us}");
    }
    bench.car.set_esc_power(false);
    bench.roll_out(0);
    assert_eq!(bench.rolling(), 0.0);
    // A switch that does not open any more.
    bench.car.set_esc_power(true);
    bench.drive(1.0, 1_500, 1_500);
    assert!(bench.rolling() > 0.2);
}

#[test]
fn a_relay_supplies_the_esc_only_while_it_is_held() {
    let mut bench = Bench::new("[esc]\nkill_relay = true\nstuck_from_s = 4.0");
    bench.drive(1.2, 1_500, 1_500);
    assert!(!bench.car.esc_has_power() && !bench.car.esc_is_armed());
    bench.car.set_kill_output(true);
    bench.drive(1.2, 1_500, 1_500);
    bench.drive(2.0, 1_500, 1_560);
    assert!(bench.rolling() > 0.25);
    bench.drive(1.0, 1_500, 1_500);
    assert!(bench.rolling() > 0.25, "it is stuck");
    bench.car.set_kill_output(false);
    bench.roll_out(0);
    assert_eq!(bench.rolling(), 0.0);
    // Without a relay the output has no effect.
    let mut bench = Bench::armed("");
    bench.car.set_kill_output(false);
    bench.drive(2.0, 1_500, 1_560);
    assert!(bench.rolling() > 0.25);
}

#[test]
fn a_car_rolls_out_by_its_own_friction() {
    let truth = "[drive_train]\nrolling_m_s2 = 0.3\nviscous_per_s = 0.2";
    let mut bench = Bench::armed(truth);
    bench.drive(4.0, 1_500, 1_650);
    let v = bench.rolling();
    assert!(v > 0.8);
    let way = bench.roll_out(1_500);
    // It goes on for the dead time.
    let expected = v * 0.02 + roll_out(v, 0.3, 0.2);
    assert!((way - expected).abs() < 0.01, "{way} {expected}");
    assert!(way > 1.0);
}

#[test]
fn a_slope_pulls_a_car_and_friction_holds_it_up_to_its_own_size() {
    let downhill = |slope_deg: f64, yaw_rad: f64| {
        let mut parameters = parameters(&format!("[drive_train]\nslope_deg = {slope_deg:?}"));
        parameters.start = StartPose {
            yaw_rad,
            ..StartPose::default()
        };
        let mut car = Car::new(parameters);
        car.advance_to(2_000_000);
        car.truth()
    };
    // 0.8 m/s² holds up to asin(0.8 / 9.81), 4.7 degrees.
    let held = downhill(4.5, 0.0);
    assert_eq!((held.way, held.wheel_speed), (0.0, 0.0));
    assert_eq!(held.longitudinal_acceleration, 0.0);
    // It stands uphill and rolls backward; downhill it rolls forward.
    let rolls = downhill(6.0, 0.0);
    assert!(rolls.wheel_speed < -0.1 && rolls.pitch < -0.1, "{rolls:?}");
    assert!(downhill(6.0, core::f64::consts::PI).wheel_speed > 0.1);
    // Across it stands; its left side is up if it faces right of uphill.
    let across = downhill(6.0, -core::f64::consts::FRAC_PI_2);
    assert!(across.way < 1e-9 && across.roll > 0.1, "{across:?}");
}

#[test]
fn on_a_slope_a_slowing_car_comes_to_rest() {
    let mut bench = Bench::armed("[drive_train]\nslope_deg = 3.0\nslope_heading_deg = 180.0");
    bench.drive(2.0, 1_500, 1_570);
    bench.roll_out(1_500);
    let way = bench.car.truth().way;
    bench.drive(5.0, 1_500, 1_500);
    assert_eq!(bench.car.truth().way, way);
}

#[test]
fn slipping_wheels_give_more_pulses_than_way() {
    let count = |truth: &str| {
        let mut bench = Bench::armed(truth);
        bench.drive(4.0, 1_500, 1_560);
        f64::from(bench.car.motor_pulses().count) * 0.003 / bench.car.truth().way
    };
    assert!((count("") - 1.0).abs() < 0.01);
    let slipping = count("[drive_train]\nslip = 0.3");
    assert!((slipping - 1.0 / 0.7).abs() < 0.01, "{slipping}");
    let late = count("[drive_train]\nslip = 0.3\nslip_from_s = 100.0");
    assert!((late - 1.0).abs() < 0.01, "{late}");
}

#[test]
fn a_push_moves_a_standing_car() {
    let mut blow = Bench::armed("[drive_train.push]\nat_s = 2.0\nspeed_m_s = 0.5");
    blow.drive(2.0, 1_500, 1_500);
    // v - rolling and viscous friction.
    let way = blow.car.truth().way;
    let expected = roll_out(0.5, 0.8, 1.0);
    assert!((way - expected).abs() < 0.005, "{way} {expected}");
    let mut hand = Bench::armed("[drive_train.push]\nat_s = 2.0\nspeed_m_s = -0.3\nfor_s = 2.0");
    hand.drive(2.2, 1_500, 1_500);
    assert!((hand.rolling() + 0.3).abs() < 1e-9);
    hand.drive(2.0, 1_500, 1_500);
    assert_eq!(hand.rolling(), 0.0);
    assert!(hand.car.truth().x < -0.6, "{}", hand.car.truth().x);
    assert!(hand.car.motor_pulses().count > 200);
}

#[test]
fn the_way_is_that_of_the_centre_of_mass_in_both_directions() {
    let mut bench = Bench::armed("[esc]\nkind = \"forward-reverse\"");
    bench.drive(2.0, 1_500, 1_560);
    bench.roll_out(1_500);
    let forward = bench.car.truth();
    assert!((forward.way - forward.x).abs() < 1e-6);
    bench.drive(2.0, 1_500, 1_440);
    bench.roll_out(1_500);
    let back = bench.car.truth();
    assert!((back.way - (forward.x + (forward.x - back.x))).abs() < 1e-6);
}

#[test]
fn interference_counts_at_standstill_with_one_seed_always_alike() {
    let count = || {
        let mut bench = Bench::new("[motor_sensor]\nemi_standstill_hz = 50.0");
        bench.drive(20.0, 1_500, 1_500);
        bench.car.motor_pulses().count
    };
    assert_eq!(count(), count());
    // Four standard deviations.
    assert!(count().abs_diff(1_000) < 130, "{}", count());
}

#[test]
fn what_can_not_be_is_refused_by_name() {
    for (change, name) in [
        (
            MotorParameters {
                slip: 1.0,
                ..MotorParameters::default()
            },
            "car.motor.slip",
        ),
        (
            MotorParameters {
                stuck_from_s: Some(-1.0),
                ..MotorParameters::default()
            },
            "car.motor.stuck_from_s",
        ),
        (
            MotorParameters {
                push: Some(Push {
                    at_s: f64::NAN,
                    speed_m_s: 1.0,
                    for_s: 0.0,
                }),
                ..MotorParameters::default()
            },
            "car.motor.push.at_s",
        ),
    ] {
        let mut simulation = SimulationConfig::default();
        simulation.car.motor = change;
        let error = simulation.validate().unwrap_err().to_string();
        assert!(error.starts_with(name), "{error}");
    }
}

#[test]
fn the_kinds_have_the_names_of_the_configuration() {
    for (name, kind) in [
        ("car", EscKind::Car),
        ("forward-reverse", EscKind::ForwardReverse),
        ("vesc", EscKind::Vesc),
        ("learns-neutral", EscKind::LearnsNeutral),
    ] {
        let parameters = parameters(&format!("[esc]\nkind = \"{name}\""));
        assert_eq!(parameters.motor.kind, kind);
    }
}

/// A force over the force of a linear tyre, both over the limit.
type Curve = fn(f64) -> f64;

/// In a steady bend the forces of the axles are in balance with the curve and the slip angles
/// that the truth names, and with no others.
#[test]
fn the_tyres_have_the_curve_and_the_slip_angles_of_the_truth() {
    let curves: [(&str, Curve); 3] = [
        ("saturating", f64::tanh),
        ("linear", |x| x),
        ("magic-formula", |x| (1.3 * (x / 1.3).atan()).sin()),
    ];
    for (curve, force) in curves {
        for angles in ["small", "exact"] {
            let truth =
                format!("[vehicle]\ntyre_curve = \"{curve}\"\nslip_angles = \"{angles}\"\n");
            let mut bench = Bench::armed(&truth);
            bench.drive(8.0, 1_290, 1_670);
            let truth = bench.car.truth();
            let vehicle = bench.car.parameters.vehicle;
            let (l_f, l_r) = (vehicle.front_axle_distance_m, vehicle.rear_axle_distance_m);
            let weight = vehicle.friction * vehicle.mass_kg * 9.806_65 / (l_f + l_r);
            let unbalanced = |exact: bool, force: Curve| {
                let (across, along) = truth.sideslip.sin_cos();
                let [across, along] = [across, along].map(|part| part * truth.speed);
                let (front, rear) = if exact {
                    (
                        truth.steering - (across + l_f * truth.yaw_rate).atan2(along),
                        -(across - l_r * truth.yaw_rate).atan2(along),
                    )
                } else {
                    let turn = truth.yaw_rate / truth.speed;
                    (
                        truth.steering - truth.sideslip - l_f * turn,
                        -truth.sideslip + l_r * turn,
                    )
                };
                let axle =
                    |slip: f64, stiffness: f64, limit: f64| force(slip * stiffness / limit) * limit;
                let front = axle(front, vehicle.front_cornering_stiffness_n_rad, weight * l_r);
                let rear = axle(rear, vehicle.rear_cornering_stiffness_n_rad, weight * l_f);
                let turned = if exact { truth.steering.cos() } else { 1.0 };
                let moment = front * turned * l_f - rear * l_r;
                let across = front * turned + rear;
                let speed = if exact { along } else { truth.speed };
                let needed = vehicle.mass_kg * truth.yaw_rate * speed;
                moment.abs() / l_f + (across - needed).abs()
            };
            assert!(truth.yaw_rate > 0.7 && truth.speed > 0.6, "{truth:?}");
            let own = unbalanced(angles == "exact", force);
            assert!(own < 1e-3, "{curve} {angles}: {own} N");
            let other = unbalanced(angles != "exact", force);
            assert!(other > 5e-3, "{curve} {angles}: {other} N");
            for (name, force) in curves.iter().filter(|(name, _)| *name != curve) {
                let other = unbalanced(angles == "exact", *force);
                assert!(other > 5e-3, "{name} for {curve}: {other} N");
            }
        }
    }
}
