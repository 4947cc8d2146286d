//! The map of stability of the car at hand under the front-point law.

use std::error::Error;

use serde::Deserialize;
use serde_json::{Value, json};
use singletrack_analysis::stability::{
    Ages, Belief, ClosedLoop, Law, SampledLoop, Servo, Timing, critical_speed,
    first_unstable_speed, hopf_points,
};
use singletrack_control::VehicleParameters;

/// Points of the Hopf curve.
const SPEEDS: u32 = 100;
/// The searched speeds of the sampled loop, in m/s.
const SEARCHED: [f64; 2] = [0.1, 20.0];

/// A steady motion.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Steady {
    /// The car; the paper's if left out.
    #[serde(default)]
    vehicle: VehicleParameters,
    /// p, in m.
    point_distance_m: f64,
    /// Speed, in m/s.
    speed_m_s: f64,
    /// Error of `l_f` in the law, in m.
    deviation_m: f64,
    /// The largest speed of the map, in m/s.
    largest_speed_m_s: f64,
}

/// Eigenvalues at the steady motion, the Hopf curve over speed and dl, and the speeds from which on
/// the motion is unstable: of the paper's loop, and of the loop in ticks with the simulated car's
/// servo and delays.
pub(crate) fn map(steady: &Steady) -> Result<Value, Box<dyn Error>> {
    let Steady {
        vehicle,
        point_distance_m: p,
        speed_m_s: speed,
        deviation_m: deviation,
        ..
    } = *steady;
    vehicle.validate()?;
    let (law, belief) = (Law::FrontPoint, Belief::FrontAxle);
    let closed = ClosedLoop::new(vehicle, law, p, speed, deviation)?.believing(belief);
    let eigenvalues = closed.eigenvalues();
    let eigenvalues: Vec<_> = eigenvalues.iter().map(|it| [it.re, it.im]).collect();
    let mut hopf = Vec::new();
    for index in 1..=SPEEDS {
        let speed = steady.largest_speed_m_s * f64::from(index) / f64::from(SPEEDS);
        let points = hopf_points(vehicle, law, belief, p, speed)?;
        let ends = points.iter().filter(|it| it.ends_stability());
        hopf.extend(ends.map(|it| [it.deviation, speed]));
    }
    let servo = Servo {
        lag: 0.04,
        dead_time: 0.002,
    };
    // The timing of the simulated car, as `singletrack stability first-unstable-speed` has it.
    let timing = Timing {
        predicted_pose: 2,
        servo_frame: 2,
        ages: Ages {
            yaw_rate: 0.005,
            sideslip: 0.0,
        },
        servo: Some(servo),
        ..Timing::new(0.01, 0.007)
    };
    let sampled = SampledLoop::new(closed, timing)?;
    Ok(json!({
        "eigenvalues": eigenvalues,
        "stable": closed.is_stable(),
        "hopf": hopf,
        "meaningful_m": ClosedLoop::meaningful_deviations(&vehicle),
        "critical_speed_m_s": critical_speed(vehicle, p, [deviation; 2])?,
        "first_unstable_speed_m_s": first_unstable_speed(&sampled, &[deviation], SEARCHED)?,
    }))
}
