//! The first metre of a configuration that has not been proved on a car, and what is
//! remembered of it.

use singletrack_core::{
    HostOptions, Proof, Proofs,
    config::{Config, ReferenceSection, Start},
};
use singletrack_pilot::{Arming, Event, Mode, PilotRequest, Reason};
use singletrack_record::{Entry, Replay};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{SimulationConfig, StartPose};

/// The highest speed of the first metre, m/s, and what the board's speed loop adds to it.
const SLOW: f64 = 0.3 + 0.05;

fn config() -> Config {
    let mut config = daemon_config(Drive::following(ReferenceSection::Circle {
        radius_m: 1.5,
        angular_velocity_rad_s: 0.5,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    }));
    config.supervisor.prove_first_metre = true;
    config
}

fn simulation() -> SimulationConfig {
    let mut simulation = SimulationConfig::default();
    simulation.car.start = StartPose {
        x_m: 1.5,
        y_m: -0.5,
        yaw_rad: core::f64::consts::FRAC_PI_2,
    };
    simulation
}

fn options(proofs: &[Proof]) -> HostOptions {
    HostOptions {
        nonce_seed: 3,
        proofs: Proofs::of(proofs),
        ..HostOptions::default()
    }
}

fn drive(proofs: &[Proof]) -> VirtualDrive {
    VirtualDrive::with_options(config(), simulation(), options(proofs)).unwrap()
}

/// What a drive of eight seconds came to.
struct Outcome {
    /// The highest speed before the first metre was driven, m/s, and after it.
    speeds: [f64; 2],
    /// The way at which the configuration was proved, m.
    proved_at: Option<f64>,
    /// What the pilot was told.
    told: Vec<bool>,
    proof: Proof,
    entries: Vec<Entry>,
}

fn run(mut drive: VirtualDrive) -> Outcome {
    let mut outcome = Outcome {
        speeds: [0.0; 2],
        proved_at: None,
        told: Vec::new(),
        proof: Proof {
            configuration: 0,
            car_id: 0,
        },
        entries: Vec::new(),
    };
    drive.keep_entries();
    let start = drive.start().unwrap().now;
    let mut way = 0.0;
    let mut last = drive.step();
    while last.now.seconds_since(start) < 8.0 {
        let tick = drive.step();
        way += tick.truth.speed * tick.now.seconds_since(last.now);
        let output = &tick.tick.output;
        assert_eq!(output.mode, Mode::Driving, "{:?}", output.reason);
        let part = &mut outcome.speeds[usize::from(way > 1.0)];
        *part = part.max(tick.truth.speed);
        if output.proved {
            assert_eq!(outcome.proved_at.replace(way), None);
        }
        last = tick;
    }
    outcome.proof = drive.controller().proof().unwrap();
    outcome.entries = drive.entries();
    outcome.told = ticks(&outcome)
        .flat_map(|tick| tick.events.iter())
        .filter_map(|event| match event {
            Event::Proved(proved) => Some(*proved),
            _ => None,
        })
        .collect();
    outcome
}

fn ticks(outcome: &Outcome) -> impl Iterator<Item = &singletrack_record::TickRecord> {
    outcome.entries.iter().filter_map(|entry| match entry {
        Entry::Tick(tick) => Some(tick),
        _ => None,
    })
}

#[test]
fn an_unproved_car_drives_its_first_metre_slowly_and_is_proved_then() {
    let outcome = run(drive(&[]));
    let [first, later] = outcome.speeds;
    assert!(first <= SLOW && later > 0.6, "{first} {later}");
    let proved_at = outcome.proved_at.unwrap();
    assert!((0.95..1.2).contains(&proved_at), "{proved_at}");
    assert!(!outcome.told.contains(&true));
}

#[test]
fn a_proved_car_drives_as_fast_as_its_reference_from_the_start() {
    let proof = run(drive(&[])).proof;
    let outcome = run(drive(&[proof]));
    assert_eq!(outcome.told.last(), Some(&true));
    assert_eq!(outcome.proved_at, None);
    assert!(outcome.speeds[0] > 0.6, "{:?}", outcome.speeds);
}

#[test]
fn the_proof_of_another_car_or_configuration_is_none() {
    let proof = run(drive(&[])).proof;
    for other in [
        Proof {
            configuration: proof.configuration ^ 1,
            ..proof
        },
        Proof {
            car_id: proof.car_id ^ 1,
            ..proof
        },
    ] {
        let outcome = run(drive(&[other]));
        assert!(outcome.speeds[0] <= SLOW, "{:?}", outcome.speeds);
        assert!(outcome.proved_at.is_some());
    }
}

#[test]
fn a_replay_repeats_the_proving_run_bit_for_bit() {
    let outcome = run(drive(&[]));
    let mut replay = Replay::new(config().pilot().unwrap());
    let mut proved = 0;
    for tick in ticks(&outcome) {
        let output = replay.tick(tick).unwrap();
        assert!(tick.is_output(&output), "{:?}", tick.differences(&output));
        proved += usize::from(output.proved);
    }
    assert_eq!(proved, 1);
}

#[test]
fn a_contradiction_of_a_proved_car_makes_its_next_drive_slow_again() {
    let proof = run(drive(&[])).proof;
    let mut turned = simulation();
    turned.car.servo.gain_us_per_rad = 800.0;
    let mut drive = VirtualDrive::with_options(config(), turned, options(&[proof])).unwrap();
    let start = drive.start().unwrap().now;
    let mut disproved = 0;
    let mut speeds = [0.0_f64; 2];
    let mut again = false;
    loop {
        let tick = drive.step();
        let elapsed = tick.now.seconds_since(start);
        let output = &tick.tick.output;
        disproved += usize::from(output.disproved);
        let part = &mut speeds[usize::from(again)];
        *part = part.max(tick.truth.speed);
        if output.mode == Mode::Idle && !again {
            assert_eq!(output.reason, Some(Reason::SteeringDiffers));
            again = true;
            drive.request(PilotRequest::Disarm).unwrap();
        } else if again && output.mode == Mode::Ready {
            drive
                .request(PilotRequest::Arm(Arming::Unattended))
                .unwrap();
        }
        if elapsed > 8.0 {
            break;
        }
    }
    assert_eq!(disproved, 1);
    assert!(again && speeds[0] > 2.0 * SLOW, "{speeds:?}");
    assert!(speeds[1] > 0.2 && speeds[1] <= SLOW, "{speeds:?}");
}

#[test]
fn the_reference_waits_for_a_car_that_proves_its_first_metre() {
    let mut config = config();
    config.reference = ReferenceSection::Circle {
        radius_m: 1.0,
        angular_velocity_rad_s: 1.0,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    };
    let mut simulation = simulation();
    simulation.car.start.x_m = 1.0;
    let mut drive = VirtualDrive::with_options(config, simulation, options(&[])).unwrap();
    let start = drive.start().unwrap().now;
    let (mut most, mut late_s, mut proved_s) = (0.0_f64, 0.0, None);
    loop {
        let tick = drive.step();
        let output = &tick.tick.output;
        let time = tick.now.seconds_since(start);
        if time > 20.0 {
            break;
        }
        assert_eq!(output.mode, Mode::Driving, "{:?}", output.reason);
        if output.proved {
            proved_s = Some(time);
        }
        let wanted = output.reference.unwrap().position.unwrap();
        let off = (output.point.unwrap() - wanted).norm();
        most = most.max(off);
        if off > 0.05 {
            late_s = time;
        }
    }
    assert!(
        proved_s.is_some_and(|proved_s| proved_s < 5.0),
        "{proved_s:?}"
    );
    // 0.21 m and 5.5 s; 2.15 m and 14.2 s if it does not wait.
    assert!(most < 0.3 && late_s < 7.0, "{most} m, {late_s} s");
}
