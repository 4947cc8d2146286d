//! Lab 3: stability and delay.

use singletrack_analysis::stability::{
    ClosedLoop, Law, MarginLimits, SampledLoop, Search, Servo, first_unstable_speed,
    least_point_distance,
};
use singletrack_control::VehicleParameters;
use singletrack_scenario::simulate::PlantKind;

use super::{
    error::LabError,
    exercise::{Exercise, Finding, Judge, Quantity},
    law::usable_gain,
    rig::{CircleDrive, POINT_DISTANCE},
    student::{Student, grid},
};

const LAB: u8 = 3;
/// The period of the controller, in s.
const PERIOD: f64 = 0.01;
/// The distances p that are searched, in m.
const DISTANCES: Search = Search {
    from: 0.005,
    to: 5.0,
};
/// The speeds that are searched, in m/s.
const SPEEDS: Search = Search {
    from: 0.1,
    to: 20.0,
};

pub(super) fn exercises(student: &Student) -> Vec<Exercise> {
    let number = |name, grid| student.number(LAB, name, grid);
    let speed = number("speed", grid(0.5, 0.1, 11));
    let delay_ms = number("delay", grid(80.0, 10.0, 8));
    let servo_delay_ms = number("servo delay", grid(6.0, 2.0, 8));
    let lag_ms = number("lag", grid(30.0, 5.0, 8));
    let fast = number("fast", grid(1.0, 0.25, 9));
    let short = number("short", grid(0.06, 0.02, 10));
    vec![
        Exercise {
            id: "3.1",
            points: 2,
            text: format!(
                "The paper's car, law and p = {POINT_DISTANCE} m, wheels that follow at once, control every 10 ms, \
                 no position loop.\nWhich delay from the measurement to the command makes the motion at {speed} \
                 m/s unstable?"
            ),
            quantities: vec![Quantity {
                key: "delay_margin_ms",
                unit: "ms",
            }],
            hint: "The law closes a loop of its own: `singletrack stability sampled` prints the margin.",
            judge: Judge::Number {
                truth: Box::new(move || {
                    let margin = sampled(speed, 0.0)?.delay_margin(MarginLimits::default());
                    Ok(1e3 * margin.ok_or(LabError::NotFound("delay margin"))?)
                }),
                tolerance: 0.03,
            },
        },
        Exercise {
            id: "3.2",
            points: 3,
            text: format!(
                "The same loop at 0.5 m/s with a delay of {delay_ms} ms and a position loop.\nWhat is the largest \
                 stable gain? First estimate it for two integrators with the delay alone; the law's own loop takes \
                 a part of it."
            ),
            quantities: vec![Quantity {
                key: "largest_gain_per_s",
                unit: "1/s",
            }],
            hint: "Two integrators with a delay T are stable up to K T = pi/2. Then bisect with \
                   `singletrack stability sampled --position-gain K --delay-ms T`: the spectral radius is one at \
                   the limit.",
            judge: Judge::Number {
                truth: Box::new(move || largest_gain(0.5, 1e-3 * delay_ms)),
                tolerance: 0.03,
            },
        },
        Exercise {
            id: "3.3",
            points: 2,
            text: format!(
                "A steering servo now: {servo_delay_ms} ms from the tick to the servo, 12 ms of dead time, a lag of \
                 {lag_ms} ms.\nWithout a position loop: which is the least p with which {fast} m/s is stable?"
            ),
            quantities: vec![Quantity {
                key: "least_p_m",
                unit: "m",
            }],
            hint: "`singletrack stability least-p --law front-point` with your delay, dead time and lag.",
            judge: Judge::Number {
                truth: Box::new(move || {
                    let servo = with_servo(fast, servo_delay_ms, lag_ms)?;
                    least_point_distance(&servo, &[0.0], DISTANCES)?
                        .ok_or(LabError::NotFound("least p"))
                }),
                tolerance: 0.03,
            },
        },
        Exercise {
            id: "3.4",
            points: 2,
            text: format!(
                "The same servo with p = {short} m, without a position loop: what is the first unstable speed?"
            ),
            quantities: vec![Quantity {
                key: "first_unstable_m_s",
                unit: "m/s",
            }],
            hint: "`singletrack stability first-unstable-speed`. Compare v/p with that of 3.3: what bounds it?",
            judge: Judge::Number {
                truth: Box::new(move || {
                    let servo = with_servo(SPEEDS.from, servo_delay_ms, lag_ms)?;
                    let at = servo.closed_loop().with_point_distance(short)?;
                    first_unstable_speed(&servo.around(at), &[0.0], SPEEDS)?
                        .ok_or(LabError::NotFound("unstable speed"))
                }),
                tolerance: 0.03,
            },
        },
        choose_gain(student),
        choose_for_the_car(student),
    ]
}

fn choose_gain(student: &Student) -> Exercise {
    let ticks = student.number(LAB, "ticks", grid(10.0, 2.0, 6));
    let delay_ms = 10.0 * ticks;
    let rate = student.number(LAB, "rate", grid(0.4, 0.05, 5));
    // Between the errors with K T = 0.8, where the loop is sluggish to settle, and 0.5.
    let most = (1e3 * rate * 1e-3 * delay_ms / 0.5).round() / 1e3;
    let delay_ticks = ticks as u32;
    Exercise {
        id: "3.5",
        points: 4,
        text: format!(
            "Choose a gain. The ideal car on a circle of 1 m at {rate} rad/s, p = {POINT_DISTANCE} m, without \
             feed-forward,\ncontrolled every 10 ms with a delay of {delay_ms} ms (delay_ticks = {ticks}).\nWhen P has \
             settled, it must be at most {most} m from its reference (root mean square over a turn)."
        ),
        quantities: vec![Quantity {
            key: "gain_per_s",
            unit: "1/s",
        }],
        hint: "The error falls with the gain, as in lab 1, until the delay makes P oscillate: stay well below \
               the largest stable gain.",
        judge: Judge::Choice(Box::new(move |values| {
            let gain = values.first().copied().unwrap_or(f64::NAN);
            let drive = CircleDrive {
                period_ms: 10,
                delay_ticks,
                ..CircleDrive::ideal(1.0, rate, gain)
            };
            tried(vec![usable_gain(gain)], &drive, most)
        })),
    }
}

fn choose_for_the_car(student: &Student) -> Exercise {
    let rate = student.number(LAB, "car rate", grid(0.5, 0.05, 9));
    let most = 0.01;
    let longest = student.number(LAB, "longest", grid(0.15, 0.01, 11));
    Exercise {
        id: "3.6",
        points: 4,
        text: format!(
            "Choose p and a gain for the whole simulated car (plant kind \"car\": servo, motor, tyres, cameras,\n\
             estimator) on a circle of 1 m at {rate} rad/s with feed-forward. p must be at most {longest} m, and P \
             at most {most} m\nfrom its reference (root mean square over the last turn)."
        ),
        quantities: vec![
            Quantity {
                key: "car_p_m",
                unit: "m",
            },
            Quantity {
                key: "car_gain_per_s",
                unit: "1/s",
            },
        ],
        hint: "Write the scenario (tools/scenarios/circle-car.toml is one) and try. A small p is a high gain \
               of the law: see 3.3.",
        judge: Judge::Choice(Box::new(move |values| {
            let &[point_distance, gain] = values else {
                return Ok(Vec::new());
            };
            let p = Finding {
                what: "p in m",
                value: point_distance,
                least: DISTANCES.from,
                most: longest,
            };
            let drive = CircleDrive {
                plant: PlantKind::Car,
                feed_forward: true,
                point_distance,
                period_ms: 10,
                ..CircleDrive::ideal(1.0, rate, gain)
            };
            tried(vec![p, usable_gain(gain)], &drive, most)
        })),
    }
}

/// The findings, and if they are right, the error of the drive. A drive that ends early, or whose
/// equations have no solution, is no failure of the marker: it tracks nothing.
fn tried(
    mut findings: Vec<Finding>,
    drive: &CircleDrive,
    most: f64,
) -> Result<Vec<Finding>, LabError> {
    if findings.iter().all(Finding::is_right) {
        let value = match drive.tracking() {
            Ok(tracking) => tracking.rms_error_m,
            Err(LabError::Simulate(_) | LabError::NotFound(_)) => f64::INFINITY,
            Err(error) => return Err(error),
        };
        findings.push(Finding {
            what: "the error in m",
            value,
            least: f64::NEG_INFINITY,
            most,
        });
    }
    Ok(findings)
}

fn sampled(speed: f64, delay: f64) -> Result<SampledLoop, LabError> {
    let car = VehicleParameters::paper();
    let closed = ClosedLoop::new(car, Law::FrontPoint, POINT_DISTANCE, speed, 0.0)?;
    Ok(SampledLoop::new(closed, PERIOD, delay)?)
}

fn with_servo(speed: f64, delay_ms: f64, lag_ms: f64) -> Result<SampledLoop, LabError> {
    let servo = Servo {
        lag: 1e-3 * lag_ms,
        dead_time: 0.012,
    };
    Ok(sampled(speed, 1e-3 * delay_ms)?.with_servo(servo)?)
}

/// The largest stable position gain, in 1/s, by bisection.
fn largest_gain(speed: f64, delay: f64) -> Result<f64, LabError> {
    let at = sampled(speed, delay)?;
    let (mut stable, mut unstable) = (0.0, 100.0);
    while unstable - stable > 1e-6 {
        let middle = 0.5 * (stable + unstable);
        if at.with_position_gain(middle)?.is_stable() {
            stable = middle;
        } else {
            unstable = middle;
        }
    }
    Ok(stable)
}
