//! The safety filter before hostile outer loops.

use proptest::prelude::*;

use super::*;

/// How a hostile outer loop chooses.
#[derive(Clone, Copy, Debug)]
enum Hostile {
    /// At the nearest side, as fast as possible.
    Out,
    /// To and fro between two directions.
    BangBang,
    /// Anything, and sometimes no number.
    Random,
    /// Along the side, then suddenly at it.
    Feint,
    /// Hard into a bend towards the side.
    Bend,
}

fn hostile_kinds() -> impl Strategy<Value = Hostile> {
    prop_oneof![
        Just(Hostile::Out),
        Just(Hostile::BangBang),
        Just(Hostile::Random),
        Just(Hostile::Feint),
        Just(Hostile::Bend),
    ]
}

/// A hostile outer loop: its kind, a seed, for how many ticks it keeps to something, and how
/// fast it wants P to be (m/s).
#[derive(Clone, Copy, Debug)]
struct Attack {
    kind: Hostile,
    seed: u64,
    hold: u32,
    size: f64,
}

prop_compose! {
    fn attacks()(
        kind in hostile_kinds(),
        seed in any::<u64>(),
        hold in 1..80u32,
        size in 0.2..40.0,
    ) -> Attack {
        Attack { kind, seed, hold, size }
    }
}

impl Attack {
    fn on(self, area: ConvexArea) -> impl FnMut(u32, &Position, &Estimate) -> Velocity {
        let Self {
            kind,
            seed,
            hold,
            size,
        } = self;
        let mut state = seed | 1;
        let mut random = move || {
            // xorshift: enough to surprise.
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut held = Velocity::zeros();
        move |tick, point, estimate| {
            let nearest = area
                .sides()
                .iter()
                .min_by(|a, b| a.distance(point).total_cmp(&b.distance(point)))
                .unwrap();
            let along = Velocity::new(-nearest.outward.y, nearest.outward.x);
            match kind {
                Hostile::Out => nearest.outward * size,
                Hostile::Feint => {
                    // Along the side, the way that it already goes, and then at it.
                    let along = along * along.dot(&direction(estimate.yaw)).signum();
                    if (tick / hold) % 4 == 3 {
                        nearest.outward * size
                    } else {
                        along * size
                    }
                }
                Hostile::BangBang => {
                    let side = if (tick / hold) % 2 == 0 { 1.2 } else { -1.2 };
                    direction(estimate.yaw + side) * size
                }
                Hostile::Bend => direction(estimate.yaw + 0.5 * (size / 40.0 - 0.5)) * 1.5,
                Hostile::Random => {
                    if tick % hold == 0 {
                        held = direction(TAU * random()) * size * random();
                        if random() < 0.05 {
                            held.x = f64::NAN;
                        }
                    }
                    held
                }
            }
        }
    }
}

#[test]
fn a_velocity_from_which_no_stop_remains_is_scaled_before_the_car_is_stopped() {
    let config = config(rectangle(2.0, 2.0));
    let mut scaled = 0;
    for kind in [Hostile::Bend, Hostile::BangBang, Hostile::Feint] {
        for seed in 1..=5 {
            let attack = Attack {
                kind,
                seed,
                hold: 20,
                size: 1.5,
            }
            .on(config.area.clone());
            let mut car = Car::standing(Position::origin(), 0.3 * seed as f64);
            scaled += drive(&mut car, &config, 1500, attack).scaled;
        }
    }
    assert!(scaled > 100, "{scaled}");
}

#[test]
fn without_the_filter_the_same_outer_loop_drives_the_car_out() {
    let area = rectangle(2.0, 2.0);
    let mut attack = Attack {
        kind: Hostile::Out,
        seed: 1,
        hold: 1,
        size: 1.0,
    }
    .on(area.clone());
    let mut car = Car::standing(Position::origin(), 0.3);
    let mut law = LimitedLaw::new(
        FrontPointLaw::new(WHEELBASE - L_R, 0.35, WHEELBASE).unwrap(),
        limits(),
    );
    for tick in 0..1500 {
        let estimate = car.estimate(Time(0), Velocity::zeros());
        let steering = law.actuation().steering;
        let point = law.law().point(estimate.position, estimate.yaw, steering);
        let wanted = attack(tick, &point, &estimate);
        let actuation = law
            .step(&estimate.motion(), estimate.speed, &wanted, PERIOD)
            .unwrap();
        car.advance(actuation.speed, actuation.steering);
    }
    assert!(area.clearance(&car.centre_of_mass()) < -1.0);
}

#[test]
fn a_sideslip_that_changes_while_the_wheels_turn_is_allowed_for() {
    // Found by a search: 3 mm outside when the way began in the present direction of motion.
    let attack = Attack {
        kind: Hostile::Random,
        seed: 9_249_331_039_170_544_050,
        hold: 41,
        size: 10.291_792_330_184_54,
    };
    let area = rectangle(1.584_698_852_289_016_2, 2.839_860_194_063_053);
    let mut car = Car::standing(Position::origin(), -0.476_109_662_070_950_6);
    let drive = drive(&mut car, &config(area.clone()), 1500, attack.on(area));
    assert!(drive.clearance >= 0.0, "{drive:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn no_outer_loop_drives_the_centre_of_mass_out_of_its_area(
        attack in attacks(),
        (x, y, yaw) in (-0.6..0.6, -0.6..0.6, -3.2..3.2),
        (width, height) in (1.2..3.0, 1.2..3.0),
    ) {
        let area = rectangle(width, height);
        let mut car = Car::standing(Position::new(x, y), yaw);
        let drive = drive(&mut car, &config(area.clone()), 1500, attack.on(area));
        prop_assert!(drive.clearance >= 0.0, "{drive:?}");
        // What the car's acceleration adds to 2.0 while the wheels are on their way.
        prop_assert!(drive.lateral <= 2.2, "{drive:?}");
        prop_assert_eq!(drive.bent, 0, "{:?}", drive);
    }

    /// Tyres that hold more slip more: what is right up to a gentle bend is not beyond.
    #[test]
    fn no_outer_loop_drives_a_car_with_grip_out_of_its_area(
        attack in attacks(),
        (x, y, yaw) in (-0.6..0.6, -0.6..0.6, -3.2..3.2),
        (width, height) in (1.8..3.6, 1.8..3.6),
    ) {
        let area = rectangle(width, height);
        let vehicle = VehicleParameters {
            friction: 0.6,
            ..VehicleParameters::paper()
        };
        let config = SafetyConfig {
            curvature_error: 0.4,
            curvature_error_growth: 0.3,
            max_speed: 2.2,
            max_lateral_acceleration: vehicle.friction * GRAVITY,
            ..config(area.clone())
        };
        let mut car = Car {
            tyres: Some(RelaxedSingleTrack::new(vehicle)),
            ..Car::standing(Position::new(x, y), yaw)
        };
        let drive = drive(&mut car, &config, 1500, attack.on(area));
        prop_assert!(drive.clearance >= 0.0, "{drive:?}");
        // The pilot ends a drive after 20.
        prop_assert!(drive.bent <= 10, "{drive:?}");
    }

    /// Tyres slip: the curvature is another one than the steering's, by what the filter allows.
    #[test]
    fn no_outer_loop_drives_a_car_with_tyres_out_of_its_area(
        attack in attacks(),
        (x, y, yaw) in (-0.6..0.6, -0.6..0.6, -3.2..3.2),
        (width, height) in (1.2..3.0, 1.2..3.0),
    ) {
        let area = rectangle(width, height);
        let config = SafetyConfig {
            curvature_error: 0.5,
            ..config(area.clone())
        };
        let mut car = Car {
            tyres: Some(RelaxedSingleTrack::new(VehicleParameters::paper())),
            ..Car::standing(Position::new(x, y), yaw)
        };
        let drive = drive(&mut car, &config, 1500, attack.on(area));
        prop_assert!(drive.clearance >= 0.0, "{drive:?}");
        // The pilot ends a drive after 20.
        prop_assert!(drive.bent <= 10, "{drive:?}");
    }
}
