//! A straight metre: what contradicts the configuration, before the car drives bends.

use singletrack_control::direction;

use super::floor::{self, Drive, SLOW, Wanted};
use crate::{Bench, Finding, Step, Trouble, finding::failed};

/// The way, m.
const WAY: f64 = 1.2;
/// The largest angle between the body and the course, rad.
const COURSE: f64 = 0.17;
/// The largest difference of the ways by pulses and cameras, as a fraction.
const PULSES: f64 = 0.15;

pub(super) const STEP: Step = Step::new(
    "straight",
    "A straight metre: signs, pulses, course",
    measure,
)
.expecting(
    "it moves along its own axis within 10 degrees, and by what the motor's pulses say within 15 %",
);

fn measure(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let stands = floor::begin(bench, SLOW)?;
    let yaw = stands.pose.map_or(0.0, |(_, yaw)| yaw);
    let Some(point) = stands.point else {
        return Err(failed("no estimate", "run it again"));
    };
    let velocity = SLOW * direction(yaw);
    floor::room_ahead(bench, point, WAY * direction(yaw))?;
    let wanted = |time: f64| Wanted {
        position: point + time * velocity,
        velocity,
        rolls: false,
    };
    let mut drive = floor::drive(bench, WAY / SLOW, "a straight metre", &wanted)?.completed()?;
    let begin = drive.on_track(1.5);
    let end = drive.on_track(WAY / SLOW - 0.2);
    let Drive { track, .. } = &drive;
    let body_yaw = bench.configuration().motion_capture.marker_yaw_rad;
    let motion = track.motion(0.0);
    let inside: Vec<usize> = (0..motion.time.len())
        .filter(|&index| (begin..=end).contains(&motion.time[index]))
        .collect();
    let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else {
        let fix = "check that all markers are visible, and run it again";
        return Err(failed("the cameras saw too little of it", fix));
    };
    let [along, across] = motion.displacement(body_yaw)[first..last]
        .iter()
        .fold([0.0; 2], |sum, moved| {
            [sum[0] + moved[0], sum[1] + moved[1]]
        });
    let course = across.atan2(along);
    let way = track.way();
    let pulses = way.at(motion.time[last]) - way.at(motion.time[first]);
    let ratio = pulses / along.hypot(across);
    let turn = motion.yaw[last] - motion.yaw[first];
    let is_good = course.abs() < COURSE && (ratio - 1.0).abs() < PULSES;
    let found = format!(
        "{:.2} m at {:.1} degrees to its axis, turned by {:.1} degrees; the pulses say {:.1} % of \
         that way",
        along.hypot(across),
        course.to_degrees(),
        turn.to_degrees(),
        100.0 * ratio
    );
    let fix = "run `singletrack doctor` again: its step geometry measures the body and the pulses";
    Ok(Finding::check(is_good, found, fix))
}
