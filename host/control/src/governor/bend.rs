//! How much wider than its path a car goes round a bend that is too tight for its wheels.

use core::f64::consts::FRAC_PI_4;
use libm::{atan2, fabs, sqrt};

use super::STANDS;
use crate::{Reference, Velocity};

/// The path is looked at in this many pieces before and behind a place.
const PIECES: u32 = 14;
/// The longest time for a piece, s.
const LONGEST: f64 = 0.5;

/// The distance of the widened path from the reference at `path` (s), to the left, in m: 0 where
/// the bend is not too tight.
///
/// The bend is that of a quarter of the smallest circle, of this radius (m). A path that turns by
/// more than a right angle on that way is one of a smaller radius; the widened path goes round the
/// same centre. A single corner is not: a car goes through it.
pub(super) fn offset(reference: &Reference, path: f64, smallest: f64) -> f64 {
    let half = FRAC_PI_4 * smallest;
    let (ahead, way_ahead) = turns(reference, path, 1.0, half);
    let (behind, way_behind) = turns(reference, path, -1.0, half);
    let turn = ahead + behind;
    let radius = (way_ahead + way_behind) / fabs(turn);
    (radius - smallest).min(0.0).copysign(-turn)
}

/// The angle by which the reference turns on this way (m) after `path` (s), or before it; and the
/// way, which is shorter at the beginning and where the reference is slow.
fn turns(reference: &Reference, path: f64, sense: f64, way: f64) -> (f64, f64) {
    let piece = way / f64::from(PIECES);
    let mut at = path;
    let mut velocity = reference.at(at).velocity;
    let (mut angle, mut covered) = (0.0, 0.0);
    for _ in 0..PIECES {
        let speed = sqrt(velocity.norm_squared());
        let time = (piece / speed).min(LONGEST);
        at += sense * time;
        if at < 0.0 {
            break;
        }
        let next = reference.at(at).velocity;
        if !(moves(&velocity) && moves(&next)) {
            // It begins or ends here: no bend.
            covered = way;
            break;
        }
        angle += atan2(velocity.perp(&next), velocity.dot(&next));
        covered += time * speed;
        velocity = next;
    }
    (sense * angle, covered)
}

fn moves(velocity: &Velocity) -> bool {
    velocity.norm_squared() >= STANDS * STANDS
}
