//! Set-points from another program, with a deadman's switch.

use super::{ReferenceError, ReferencePoint, positive};
use crate::{
    Demand, MAX_TRAJECTORY_POINTS, Setpoint, SetpointError, SetpointStamp, Time, Trajectory,
    TrajectoryPiece, Velocity, setpoint::decay,
};

/// The time in which the offset to a trajectory that replaces another one decays, s.
const BLEND: f64 = 0.5;

/// The newest set-point, valid until a time-out.
///
/// It trusts no sender: it refuses by itself what is not finite, out of range, too old, or
/// from the future, which would never become stale.
#[derive(Clone, Debug, PartialEq)]
pub struct External {
    timeout: f64,
    newest: Option<Newest>,
    /// The trajectory that is followed, if the newest set-point is one.
    followed: Trajectory,
    blend: Option<Blend>,
    /// The trajectory whose points are coming in.
    assembled: Trajectory,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Newest {
    stamp: SetpointStamp,
    /// None for a trajectory.
    demand: Option<Demand>,
}

/// The offset at a change of trajectories, from the new one to the old one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Blend {
    since: Time,
    position: Velocity,
    velocity: Velocity,
}

impl External {
    /// Set-points that are valid for `timeout` seconds each.
    ///
    /// # Errors
    ///
    /// A time-out that is not finite and above zero.
    pub fn new(timeout: f64) -> Result<Self, ReferenceError> {
        Ok(Self {
            timeout: positive("setpoint_timeout", timeout)?,
            newest: None,
            followed: Trajectory::default(),
            blend: None,
            assembled: Trajectory::default(),
        })
    }

    /// Stores a set-point.
    ///
    /// # Errors
    ///
    /// Why it is not obeyed; the stored one remains.
    pub fn handle(&mut self, setpoint: &Setpoint, now: Time) -> Result<(), SetpointError> {
        setpoint.check(now, self.timeout)?;
        self.supersedes(&setpoint.stamp)?;
        self.newest = Some(Newest {
            stamp: setpoint.stamp,
            demand: Some(setpoint.demand),
        });
        self.blend = None;
        Ok(())
    }

    /// Stores a point of a trajectory. The last one puts the trajectory in force.
    ///
    /// # Errors
    ///
    /// Why the trajectory is not obeyed; the set-point in force remains.
    pub fn handle_piece(
        &mut self,
        piece: &TrajectoryPiece,
        now: Time,
    ) -> Result<(), SetpointError> {
        let place = usize::from(piece.index);
        let points = &mut self.assembled.points;
        if place == 0 {
            self.assembled.stamp = piece.stamp;
            points.clear();
        }
        let fits = self.assembled.stamp == piece.stamp
            && points.len() == place
            && place < usize::from(piece.count)
            && usize::from(piece.count) <= MAX_TRAJECTORY_POINTS
            && points.push(piece.point).is_ok();
        if !fits {
            points.clear();
            return Err(SetpointError::Incomplete);
        }
        if points.len() < usize::from(piece.count) {
            return Ok(());
        }
        let checked = self
            .assembled
            .check(now, self.timeout)
            .and_then(|()| self.supersedes(&piece.stamp));
        if checked.is_ok() {
            self.follow_assembled(now);
        }
        self.assembled.points.clear();
        checked
    }

    /// Whether the set-point in force is older than the time-out, or there is none. So is a
    /// trajectory after its last point.
    pub fn is_stale(&self, now: Time) -> bool {
        self.newest.is_none_or(|newest| {
            let is_over = newest.demand.is_none()
                && self.followed.points.last().is_none_or(|end| end.time < now);
            is_over || newest.stamp.check(now, self.timeout).is_err()
        })
    }

    /// The stamp of the set-point in force.
    pub fn in_force(&self) -> Option<SetpointStamp> {
        self.newest.map(|newest| newest.stamp)
    }

    /// The demand in force at `now`; standstill before the first.
    pub fn demand(&self, now: Time) -> Demand {
        let Some(newest) = self.newest else {
            return STAND;
        };
        let followed = || self.trajectory_at(now).map_or(STAND, Demand::Point);
        newest.demand.unwrap_or_else(followed)
    }

    /// The point demanded `ahead` seconds after `now`; none for steering and speed. A point of
    /// a set-point moves on with its velocity.
    pub(super) fn point_ahead(&self, now: Time, ahead: f64) -> Option<ReferencePoint> {
        if self.follows() {
            return self.trajectory_at(now.after(ahead));
        }
        match self.demand(now) {
            Demand::Actuation { .. } => None,
            Demand::Point(ReferencePoint { position, velocity }) => Some(ReferencePoint {
                position: position.map(|position| position + ahead * velocity),
                velocity,
            }),
        }
    }

    /// How long a set-point is valid, s.
    pub const fn timeout(&self) -> f64 {
        self.timeout
    }

    /// Whether the newest is a trajectory.
    fn follows(&self) -> bool {
        self.newest.is_some_and(|newest| newest.demand.is_none())
    }

    fn supersedes(&self, stamp: &SetpointStamp) -> Result<(), SetpointError> {
        match self.newest {
            Some(newest) if newest.stamp.time > stamp.time => Err(SetpointError::Superseded),
            _ => Ok(()),
        }
    }

    /// Puts the assembled trajectory in force. If it replaces one that is followed, the
    /// reference goes on from there: the offset of position and velocity decays.
    fn follow_assembled(&mut self, now: Time) {
        let before = self.trajectory_at(now);
        let before = before.filter(|_| self.follows() && !self.is_stale(now));
        self.newest = Some(Newest {
            stamp: self.assembled.stamp,
            demand: None,
        });
        core::mem::swap(&mut self.followed, &mut self.assembled);
        let ends = before.zip(self.followed.at(now));
        self.blend = ends.and_then(|(old, new)| {
            Some(Blend {
                since: now,
                position: old.position? - new.position?,
                velocity: old.velocity - new.velocity,
            })
        });
    }

    fn trajectory_at(&self, now: Time) -> Option<ReferencePoint> {
        let point = self.followed.at(now)?;
        let Some(blend) = self.blend else {
            return Some(point);
        };
        let part = now.seconds_since(blend.since) / BLEND;
        if !(0.0..1.0).contains(&part) {
            return Some(point);
        }
        let (left, rate) = decay(part);
        Some(ReferencePoint {
            position: point.position.map(|position| {
                position + blend.position * left.position + blend.velocity * (BLEND * left.velocity)
            }),
            velocity: point.velocity
                + blend.position * (rate.position / BLEND)
                + blend.velocity * rate.velocity,
        })
    }
}

/// The demand without a set-point.
const STAND: Demand = Demand::Point(ReferencePoint {
    position: None,
    velocity: Velocity::new(0.0, 0.0),
});

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Position, SpeedDemand, SteeringDemand, TrajectoryPoint};

    const fn at(ms: u64) -> Time {
        Time(ms * 1_000_000)
    }

    const fn stamp(ms: u64) -> SetpointStamp {
        SetpointStamp {
            time: at(ms),
            sequence: None,
        }
    }

    fn velocity(ms: u64, v_x: f64) -> Setpoint {
        Setpoint {
            stamp: stamp(ms),
            demand: Demand::Point(ReferencePoint {
                position: None,
                velocity: Velocity::new(v_x, 0.0),
            }),
        }
    }

    fn wanted(external: &External, ms: u64) -> ReferencePoint {
        match external.demand(at(ms)) {
            Demand::Point(point) => point,
            Demand::Actuation { .. } => unreachable!("no test here demands one"),
        }
    }

    /// Along x with this speed, at the time 0 at x = `offset`; a point every 0.1 s from `ms` on.
    fn trajectory(ms: u64, offset: f64, speed: f64) -> Trajectory {
        Trajectory {
            stamp: stamp(ms),
            points: (0..20)
                .map(|index| {
                    let ms = ms + 100 * index;
                    TrajectoryPoint {
                        time: at(ms),
                        position: Position::new(offset + speed * 1e-3 * ms as f64, 0.0),
                        velocity: Velocity::new(speed, 0.0),
                    }
                })
                .collect(),
        }
    }

    fn give(
        external: &mut External,
        trajectory: &Trajectory,
        ms: u64,
    ) -> Result<(), SetpointError> {
        let mut result = Err(SetpointError::Incomplete);
        for piece in trajectory.pieces() {
            result = external.handle_piece(&piece, at(ms));
        }
        result
    }

    #[test]
    fn a_set_point_is_valid_until_the_time_out() {
        let mut external = External::new(0.2).unwrap();
        assert!(external.is_stale(at(0)));
        assert_eq!(wanted(&external, 0).velocity, Velocity::zeros());
        external.handle(&velocity(1_000, 0.5), at(1_000)).unwrap();
        assert!(!external.is_stale(at(1_200)));
        assert!(external.is_stale(at(1_201)));
        assert_eq!(wanted(&external, 1_000).velocity.x, 0.5);
        assert_eq!(external.in_force(), Some(stamp(1_000)));
    }

    #[test]
    fn what_must_not_be_obeyed_is_refused_and_the_set_point_in_force_remains() {
        let mut external = External::new(0.2).unwrap();
        external.handle(&velocity(1_000, 0.5), at(1_000)).unwrap();
        let position = Setpoint {
            demand: Demand::Point(ReferencePoint {
                position: Some(Position::new(0.0, f64::INFINITY)),
                velocity: Velocity::zeros(),
            }),
            ..velocity(1_050, 0.0)
        };
        let actuation = |steering, speed| Setpoint {
            demand: Demand::Actuation { steering, speed },
            ..velocity(1_050, 0.0)
        };
        let (angle, speed) = (SteeringDemand::Angle, SpeedDemand::Speed);
        for (setpoint, error) in [
            (velocity(1_050, f64::NAN), SetpointError::NotFinite),
            (position, SetpointError::NotFinite),
            (
                actuation(angle(f64::NAN), speed(0.1)),
                SetpointError::NotFinite,
            ),
            (
                actuation(angle(0.1), speed(f64::NEG_INFINITY)),
                SetpointError::NotFinite,
            ),
            (
                actuation(SteeringDemand::Rate(f64::NAN), speed(0.1)),
                SetpointError::NotFinite,
            ),
            (
                actuation(angle(0.1), SpeedDemand::Acceleration(f64::NAN)),
                SetpointError::NotFinite,
            ),
            (velocity(1_051, 0.1), SetpointError::Future),
            (velocity(u64::MAX / 1_000_000, 0.1), SetpointError::Future),
            (velocity(999, 0.1), SetpointError::Superseded),
            (velocity(849, 0.1), SetpointError::Old),
        ] {
            assert_eq!(external.handle(&setpoint, at(1_050)), Err(error));
        }
        assert!(matches!(
            external.handle(&actuation(angle(2.0), speed(0.1)), at(1_050)),
            Err(SetpointError::OutOfRange(_))
        ));
        assert_eq!(external.in_force(), Some(stamp(1_000)));
        external.handle(&velocity(1_000, 0.2), at(1_050)).unwrap();
        assert_eq!(wanted(&external, 1_050).velocity.x, 0.2);
        assert!(External::new(0.0).is_err() && External::new(f64::NAN).is_err());
    }

    #[test]
    fn a_trajectory_is_followed_from_its_last_piece_on_and_only_when_complete() {
        let mut external = External::new(0.2).unwrap();
        let way = trajectory(1_000, 0.0, 0.5);
        for piece in way.pieces().take(19) {
            external.handle_piece(&piece, at(1_010)).unwrap();
            assert!(external.is_stale(at(1_010)));
        }
        external
            .handle_piece(&way.pieces().last().unwrap(), at(1_020))
            .unwrap();
        assert!(!external.is_stale(at(1_020)));
        let point = wanted(&external, 1_050);
        assert!((point.position.unwrap().x - 0.525).abs() < 1e-12);
        assert!((point.velocity.x - 0.5).abs() < 1e-12);
        // It ages as every set-point does.
        assert!(external.is_stale(at(1_201)));

        // A piece is lost: the trajectory does not come into force, and renews nothing.
        let later = trajectory(1_150, 0.0, 0.5);
        for piece in later.pieces().filter(|piece| piece.index != 7) {
            let _ = external.handle_piece(&piece, at(1_160));
        }
        assert_eq!(external.in_force(), Some(stamp(1_000)));
        // Pieces of two trajectories do not make one.
        for (piece, other) in later.pieces().zip(trajectory(1_160, 3.0, 0.5).pieces()) {
            let piece = if piece.index < 10 { piece } else { other };
            let _ = external.handle_piece(&piece, at(1_170));
        }
        assert_eq!(external.in_force(), Some(stamp(1_000)));
    }

    #[test]
    fn a_trajectory_that_is_over_or_disordered_or_far_away_is_refused() {
        let mut external = External::new(0.2).unwrap();
        let good = trajectory(1_000, 0.0, 0.5);
        let with = |change: fn(&mut Trajectory)| {
            let mut changed = good.clone();
            change(&mut changed);
            changed
        };
        let range = |result| matches!(result, Err(SetpointError::OutOfRange(_)));
        assert!(range(give(
            &mut external,
            &with(|way| way.points.truncate(1)),
            1_000
        )));
        assert!(range(give(
            &mut external,
            &with(|way| way.points.swap(3, 4)),
            1_000
        )));
        let leap = with(|way| way.points[3].position.x = 5_000.0);
        assert!(range(give(&mut external, &leap, 1_000)));
        let nan = with(|way| way.points[3].velocity.y = f64::NAN);
        assert_eq!(
            give(&mut external, &nan, 1_000),
            Err(SetpointError::NotFinite)
        );
        let future = with(|way| way.stamp = stamp(1_001));
        assert_eq!(
            give(&mut external, &future, 1_000),
            Err(SetpointError::Future)
        );
        let late = Trajectory {
            stamp: stamp(1_000),
            ..trajectory(2_001, 0.0, 0.5)
        };
        assert_eq!(
            give(&mut external, &late, 1_000),
            Err(SetpointError::Future)
        );
        let over = Trajectory {
            stamp: stamp(3_000),
            ..good.clone()
        };
        assert_eq!(give(&mut external, &over, 3_000), Err(SetpointError::Old));
        assert!(external.is_stale(at(1_000)));
        // Its end comes before the time-out.
        let mut short = good.clone();
        short.points.truncate(2);
        give(&mut external, &short, 1_000).unwrap();
        assert!(!external.is_stale(at(1_100)) && external.is_stale(at(1_101)));
    }

    #[test]
    fn replacing_a_trajectory_is_no_jump_and_the_new_one_is_reached() {
        let mut external = External::new(10.0).unwrap();
        give(&mut external, &trajectory(1_000, 0.0, 0.5), 1_000).unwrap();
        let before = wanted(&external, 1_300);
        let other = trajectory(1_300, 0.2, 0.3);
        give(&mut external, &other, 1_300).unwrap();
        let after = wanted(&external, 1_300);
        assert!((before.position.unwrap() - after.position.unwrap()).norm() < 1e-12);
        assert!((before.velocity - after.velocity).norm() < 1e-12);
        let mut last = after;
        for ms in 1_301..=1_800 {
            let point = wanted(&external, ms);
            let step = (point.position.unwrap() - last.position.unwrap()) * 1e3;
            // The velocity is that of the position.
            assert!((step - 0.5 * (point.velocity + last.velocity)).norm() < 1e-3);
            assert!((point.velocity - last.velocity).norm() < 5e-3);
            last = point;
        }
        assert_eq!(Some(last), other.at(at(1_800)));
    }

    #[test]
    fn the_velocity_of_a_trajectory_is_the_slope_of_its_position() {
        let mut way = trajectory(1_000, 0.0, 0.5);
        for (index, point) in way.points.iter_mut().enumerate() {
            let angle = 0.3 * index as f64;
            point.position = Position::new(libm::sin(angle), libm::cos(angle));
            point.velocity = Velocity::new(3.0 * libm::cos(angle), -3.0 * libm::sin(angle));
        }
        for ms in 1_000..2_800 {
            let point = |us: u64| way.at(Time(us * 1_000)).unwrap();
            let (early, late) = (point(ms * 1_000 + 100), point(ms * 1_000 + 200));
            let slope = (late.position.unwrap() - early.position.unwrap()) / 1e-4;
            assert!((slope - late.velocity).norm() < 0.01, "{ms}");
            assert!((late.position.unwrap().coords.norm() - 1.0).abs() < 1e-3);
        }
    }
}
