//! Limits and hash of a configuration.

use proptest::prelude::*;
use singletrack_protocol::{
    Configuration, ConfigurationField as Field, EscKind, FailsafeAction, ImuAxes, ImuAxis,
};

use crate::samples::configuration;

type Change = fn(&mut Configuration, i32);

#[test]
fn the_sample_is_valid() {
    assert_eq!(configuration().validate(), Ok(()));
}

/// Every field with its smallest and largest value, given the sample's other
/// values.
#[test]
fn values_are_accepted_at_their_limits_and_refused_beyond() {
    let cases: [(Field, i32, i32, Change); 20] = [
        (Field::ServoMin, 800, 1_490, |c, v| {
            c.servo.min_us = v as u16;
        }),
        (Field::ServoMax, 1_490, 2_200, |c, v| {
            c.servo.max_us = v as u16;
        }),
        (Field::ServoCentre, 1_100, 1_905, |c, v| {
            c.servo.centre_us = v as u16;
        }),
        (Field::ServoGainMagnitude, 50, 5_000, |c, v| {
            c.servo.gain_us_per_rad = v as i16;
        }),
        (Field::ServoGainMagnitude, 50, 5_000, |c, v| {
            c.servo.gain_us_per_rad = -v as i16;
        }),
        (Field::ServoSlew, 1, 1_400, |c, v| {
            c.servo.slew_us_per_20ms = v as u16;
        }),
        // Within this deadband of the 1500 µs of the start.
        (Field::EscNeutral, 1_475, 1_525, |c, v| {
            c.esc.neutral_us = v as u16;
        }),
        (Field::EscDeadband, 0, 200, |c, v| {
            c.esc.deadband_us = v as u16;
            // The brake must be below the widest deadband.
            c.esc.brake_us = 1_250;
        }),
        (Field::EscMin, 800, 1_300, |c, v| {
            c.esc.min_us = v as u16;
        }),
        (Field::EscMax, 1_525, 2_200, |c, v| {
            c.esc.max_us = v as u16;
        }),
        (Field::EscSlew, 1, 1_400, |c, v| {
            c.esc.slew_us_per_20ms = v as u16;
        }),
        (Field::EscBrake, 1_150, 1_474, |c, v| {
            c.esc.brake_us = v as u16;
        }),
        (Field::PulseDistance, 100, 30_000, |c, v| {
            c.speed.pulse_distance_um = v as u16;
            (c.speed.max_forward_mm_s, c.speed.max_reverse_mm_s) = (1_200, 0);
        }),
        (Field::FeedForward, 0, 5_000, |c, v| {
            c.speed.feed_forward_us_per_m_s = v as u16;
        }),
        (Field::Proportional, 0, 5_000, |c, v| {
            c.speed.proportional_us_per_m_s = v as u16;
        }),
        (Field::Integral, 0, 5_000, |c, v| {
            c.speed.integral_us_per_m = v as u16;
        }),
        (Field::IntegralLimit, 0, 700, |c, v| {
            c.speed.integral_limit_us = v as u16;
        }),
        (Field::MaxForward, 1, 20_000, |c, v| {
            c.speed.max_forward_mm_s = v as u16;
        }),
        (Field::MaxPoseAge, 1, 1_000, |c, v| {
            c.max_pose_age_ms = v as u16;
        }),
        (Field::MaxRollOut, 200, 30_000, |c, v| {
            c.max_roll_out_ms = v as u16;
        }),
    ];
    for (field, lowest, highest, change) in cases {
        for (value, good) in [
            (lowest - 1, false),
            (lowest, true),
            (highest, true),
            (highest + 1, false),
        ] {
            if !(0..=65_535).contains(&value) {
                continue;
            }
            let mut changed = configuration();
            change(&mut changed, value);
            assert_eq!(
                changed.validate().is_ok(),
                good,
                "{field} = {value}: {:?}",
                changed.validate()
            );
        }
    }
}

#[test]
fn the_top_speeds_are_at_most_12_pulses_a_millisecond() {
    for (distance, fastest) in [(100, 1_200), (125, 1_500), (1_666, 19_992), (1_667, 20_000)] {
        let changes: [(Field, Change); 2] = [
            (Field::MaxForward, |c, v| {
                c.speed.max_forward_mm_s = v as u16;
            }),
            (Field::MaxReverse, |c, v| {
                c.speed.max_reverse_mm_s = v as u16;
            }),
        ];
        for (field, change) in changes {
            let mut changed = configuration();
            changed.speed.pulse_distance_um = distance;
            (
                changed.speed.max_forward_mm_s,
                changed.speed.max_reverse_mm_s,
            ) = (1, 0);
            change(&mut changed, fastest);
            assert_eq!(changed.validate(), Ok(()), "{field}, {distance} um");
            change(&mut changed, fastest + 1);
            let error = changed.validate().unwrap_err();
            assert_eq!((error.field, error.highest), (field, fastest));
        }
    }
}

#[test]
fn an_error_contains_field_value_and_limits() {
    let mut wrong = configuration();
    wrong.speed.max_reverse_mm_s = 20_001;
    let error = wrong.validate().unwrap_err();
    assert_eq!(error.field, Field::MaxReverse);
    assert_eq!(
        error.to_string(),
        "speed.max_reverse_mm_s is 20001, but must be 0 to 20000"
    );
}

#[test]
fn the_steepest_servo_gain_does_not_overflow_its_magnitude() {
    let mut wrong = configuration();
    wrong.servo.gain_us_per_rad = i16::MIN;
    assert_eq!(wrong.validate().unwrap_err().value, 32_768);
}

#[test]
fn an_esc_without_brake_is_asked_for_none_and_one_without_reverse_for_none() {
    let mut without_brake = configuration();
    without_brake.esc.kind = EscKind::ForwardReverse;
    assert_eq!(without_brake.validate().unwrap_err().field, Field::Failsafe);
    without_brake.failsafe = FailsafeAction::Coast;
    // The pulse that would brake is never sent.
    without_brake.esc.brake_us = 0;
    assert_eq!(without_brake.validate(), Ok(()));

    let mut without_reverse = configuration();
    without_reverse.esc.kind = EscKind::Vesc;
    assert_eq!(
        without_reverse.validate().unwrap_err().field,
        Field::MaxReverse
    );
    without_reverse.speed.max_reverse_mm_s = 0;
    assert_eq!(without_reverse.validate(), Ok(()));
}

/// The directions as vectors in the chip's axes.
fn vector(axis: ImuAxis) -> [i32; 3] {
    let mut vector = [0; 3];
    vector[usize::from(axis.index())] = if axis.is_negative() { -1 } else { 1 };
    vector
}

#[test]
fn the_mountings_are_the_24_right_handed_ones() {
    let mut mountings = 0;
    for forward in ImuAxis::ALL {
        for left in ImuAxis::ALL {
            for up in ImuAxis::ALL {
                let ([a, b, c], [d, e, f]) = (vector(forward), vector(left));
                let product = [b * f - c * e, c * d - a * f, a * e - b * d];
                let axes = ImuAxes { forward, left, up };
                assert_eq!(axes.is_mounting(), product == vector(up), "{axes:?}");
                mountings += u32::from(axes.is_mounting());
                let mut changed = configuration();
                changed.imu_axes = axes;
                let accepted = changed.validate().map_err(|error| error.field);
                let expected = axes.is_mounting().then_some(()).ok_or(Field::ImuAxes);
                assert_eq!(accepted, expected, "{axes:?}");
            }
        }
    }
    assert_eq!(mountings, 24);
}

#[test]
fn every_change_changes_the_hash() {
    let changes: [fn(&mut Configuration); 11] = [
        |c| c.servo.centre_us += 1,
        |c| c.esc.brake_us -= 1,
        |c| c.speed.max_reverse_mm_s = 0,
        |c| c.failsafe = FailsafeAction::Coast,
        |c| c.max_pose_age_ms -= 1,
        |c| c.stop_input = false,
        |c| c.esc.kind = EscKind::ForwardReverse,
        |c| c.kill_output = false,
        |c| c.max_roll_out_ms += 1,
        |c| c.car_id += 1,
        |c| c.imu_axes = ImuAxes::AS_PRINTED,
    ];
    for change in changes {
        let mut changed = configuration();
        change(&mut changed);
        assert_ne!(changed.hash(), configuration().hash());
    }
}

proptest! {
    #[test]
    fn the_hash_is_never_zero(centre: u16, gain: i16, neutral: u16, stop: bool) {
        let mut any = configuration();
        any.servo.centre_us = centre;
        any.servo.gain_us_per_rad = gain;
        any.esc.neutral_us = neutral;
        any.stop_input = stop;
        prop_assert_ne!(any.hash(), 0);
    }
}
