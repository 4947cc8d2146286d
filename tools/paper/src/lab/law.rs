//! Lab 1: the law on the ideal car.

use super::{
    exercise::{Exercise, Finding, Judge, Quantity},
    rig::CircleDrive,
    student::{Student, grid},
};

const LAB: u8 = 1;

pub(super) fn exercises(student: &Student) -> Vec<Exercise> {
    let number = |name, grid| student.number(LAB, name, grid);
    let radius = number("radius", grid(0.8, 0.05, 9));
    let rate = number("rate", grid(0.3, 0.05, 9));
    let gain = number("gain", grid(0.6, 0.1, 15));
    let drive = CircleDrive::ideal(radius, rate, gain);
    let circle = format!(
        "The ideal car under continuous control. The reference runs round a circle of {radius} m at \
         {rate} rad/s.\nThe position loop has a gain of {gain} 1/s and no feed-forward; the law is the paper's."
    );
    vec![
        Exercise {
            id: "1.1",
            points: 2,
            text: format!("{circle}\nWhat is the radius of the circle on which P settles?"),
            quantities: vec![Quantity {
                key: "amplitude_m",
                unit: "m",
            }],
            hint: "Under the law P is two integrators. Which transfer function leads from the \
                   reference to P, and what is its magnitude at this angular velocity?",
            judge: Judge::Number {
                truth: Box::new(move || Ok(drive.tracking()?.amplitude_m)),
                tolerance: 0.01,
            },
        },
        Exercise {
            id: "1.2",
            points: 2,
            text: "On the same circle: by which angle does P stay behind its reference?".to_owned(),
            quantities: vec![Quantity {
                key: "lag_rad",
                unit: "rad",
            }],
            hint: "The phase of the same transfer function. Mind the unit.",
            judge: Judge::Number {
                truth: Box::new(move || Ok(drive.tracking()?.lag_rad)),
                tolerance: 0.01,
            },
        },
        Exercise {
            id: "1.3",
            points: 2,
            text: "On the same circle: how far is P from its reference, when it has settled?"
                .to_owned(),
            quantities: vec![Quantity {
                key: "distance_m",
                unit: "m",
            }],
            hint: "It is not the difference of the radii: draw P, its reference and the centre.",
            judge: Judge::Number {
                truth: Box::new(move || Ok(drive.tracking()?.rms_error_m)),
                tolerance: 0.01,
            },
        },
        gain_for_error(student, radius, rate),
        gain_for_decay(student, radius, rate),
        Exercise {
            id: "1.6",
            points: 3,
            text: format!(
                "The same circle of {radius} m at {rate} rad/s with feed-forward, so that P is on its \
                 reference.\nWhich sideslip does the car have, when it has settled? Left is positive."
            ),
            quantities: vec![Quantity {
                key: "sideslip_rad",
                unit: "rad",
            }],
            hint: "In steady motion neither sideslip nor yaw rate change, and the yaw rate is that of \
                   the reference. Speed and steering follow from where P is. Check the sign with the rear axle.",
            judge: Judge::Number {
                truth: Box::new(move || {
                    let drive = CircleDrive {
                        feed_forward: true,
                        ..drive
                    };
                    let rows = drive.settled()?;
                    Ok(rows.last().map_or(f64::NAN, |row| row.sideslip))
                }),
                tolerance: 0.02,
            },
        },
    ]
}

fn gain_for_error(student: &Student, radius: f64, rate: f64) -> Exercise {
    let share = student.number(LAB, "share", grid(0.1, 0.02, 8));
    let wanted = (1e3 * share * radius).round() / 1e3;
    Exercise {
        id: "1.4",
        points: 3,
        text: format!(
            "The same circle, without feed-forward. With which gain does P settle {wanted} m from its \
             reference?\nYour gain is simulated; the distance may differ by 2 %."
        ),
        quantities: vec![Quantity {
            key: "gain_per_s",
            unit: "1/s",
        }],
        hint: "Solve your formula of 1.3 for the gain.",
        judge: Judge::Choice(Box::new(move |values| {
            let gain = values.first().copied().unwrap_or(f64::NAN);
            let mut findings = vec![usable_gain(gain)];
            if findings.iter().all(Finding::is_right) {
                let found = CircleDrive::ideal(radius, rate, gain)
                    .tracking()?
                    .rms_error_m;
                findings.push(Finding {
                    what: "the distance in m",
                    value: found,
                    least: 0.98 * wanted,
                    most: 1.02 * wanted,
                });
            }
            Ok(findings)
        })),
    }
}

fn gain_for_decay(student: &Student, radius: f64, rate: f64) -> Exercise {
    let offset = student.number(LAB, "offset", grid(0.15, 0.01, 11));
    let remaining = student.number(LAB, "remaining", grid(0.01, 0.005, 5));
    let duration = student.number(LAB, "duration", grid(1.5, 0.25, 9));
    Exercise {
        id: "1.5",
        points: 3,
        text: format!(
            "The same circle with feed-forward. P starts {offset} m outside of its reference.\n\
             With which gain is it {remaining} m away after {duration} s? Your gain is simulated; the \
             distance may differ by 3 %."
        ),
        quantities: vec![Quantity {
            key: "decay_gain_per_s",
            unit: "1/s",
        }],
        hint: "With feed-forward the error obeys a differential equation of first order.",
        judge: Judge::Choice(Box::new(move |values| {
            let gain = values.first().copied().unwrap_or(f64::NAN);
            let mut findings = vec![usable_gain(gain)];
            if findings.iter().all(Finding::is_right) {
                let drive = CircleDrive {
                    feed_forward: true,
                    ..CircleDrive::ideal(radius, rate, gain)
                };
                findings.push(Finding {
                    what: "the distance in m",
                    value: drive.error_after(offset, duration)?,
                    least: 0.97 * remaining,
                    most: 1.03 * remaining,
                });
            }
            Ok(findings)
        })),
    }
}

/// Gains that can be simulated in reasonable time.
pub(super) const fn usable_gain(gain: f64) -> Finding {
    Finding {
        what: "the gain in 1/s",
        value: gain,
        least: 0.05,
        most: 50.0,
    }
}
