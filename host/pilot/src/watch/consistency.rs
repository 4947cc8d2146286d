//! Consistency of poses, estimate and clock during every drive, and whether the estimated sideslip is
//! one that a car on its tyres can have.

use libm::{atan, atan2, fabs, sin, tan};
use singletrack_control::{Estimate, EstimatorConfig, Limits, PoseSample, Time};

use super::{WatchConfig, count, steps::Step};

/// Poses that repeat to the last bit.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FrozenWatch {
    last: Option<PoseSample>,
    since: Option<Time>,
    /// Whether the poses repeat for too long.
    pub(crate) is_frozen: bool,
}

impl FrozenWatch {
    /// A pose of the cameras, accepted or not.
    pub(crate) fn pose(&mut self, pose: &PoseSample, config: &WatchConfig) {
        let bits =
            |pose: &PoseSample| [pose.position.x, pose.position.y, pose.yaw].map(f64::to_bits);
        let equal = self.last.is_some_and(|last| bits(&last) == bits(pose));
        if equal {
            let since = *self
                .since
                .get_or_insert(self.last.map_or(pose.capture, |last| last.capture));
            self.is_frozen = config.frozen_poses > 0.0
                && pose.capture.seconds_since(since) >= config.frozen_poses;
        } else {
            self.since = None;
            self.is_frozen = false;
        }
        self.last = Some(*pose);
    }
}

/// The angle between the motion of the rear axle and the yaw, as a mean over a way.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SideslipWatch {
    along: f64,
    across: f64,
    allowed: f64,
    way: f64,
    exceeded: u32,
}

/// The way of one mean, m.
const WAY: f64 = 0.25;
/// The number of means in a row beyond the limit.
const MEANS: u32 = 2;
/// What the tyres of a car add, rad per m/s² of lateral acceleration.
const SLIP: f64 = 0.03;

impl SideslipWatch {
    /// A step of a drive.
    pub(crate) fn step(&mut self, step: &Step, config: &WatchConfig) {
        let way = step.rear.norm();
        // The noise of a pose; and a car in reverse slides the other way.
        if way < 0.003 || step.motor_way < 0.0 {
            return;
        }
        let lateral = fabs(way * step.turn) / (step.time * step.time);
        self.along += step.along();
        self.across += step.across();
        self.allowed += way * (config.max_sideslip + SLIP * lateral);
        self.way += way;
        // A NaN is no way that is too short, and exceeds the limit.
        if self.way < WAY {
            return;
        }
        let angle = fabs(atan2(self.across, self.along));
        let fits = angle <= self.allowed / self.way;
        count(&mut self.exceeded, !fits);
        *self = Self {
            exceeded: self.exceeded,
            ..Self::default()
        };
    }

    /// Whether the sideslip is implausible.
    pub(crate) const fn is_exceeded(&self) -> bool {
        self.exceeded >= MEANS
    }
}

/// The normalised innovation squared of the poses, as a running mean.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct InnovationWatch {
    mean: f64,
    /// Poses in a row with too high a mean.
    exceeded: u32,
}

/// The share of a new pose in the mean: 0.5 s at 100 Hz.
const SHARE: f64 = 0.02;
/// One pose counts at most as this multiple of the limit.
const MOST: f64 = 5.0;
/// The number of poses for which the mean must exceed its limit, 0.5 s at 100 Hz: other
/// watches name the cause by then.
const POSES: u32 = 50;

impl InnovationWatch {
    /// An accepted pose with this innovation.
    pub(crate) fn pose(&mut self, innovation: f64, config: &WatchConfig) {
        // The estimator weighs an outlier down; ten in a row say nothing yet of the estimate.
        let most = MOST * config.max_innovation;
        let innovation = if innovation > most { most } else { innovation };
        self.mean += SHARE * (innovation - self.mean);
        // A NaN exceeds it.
        let fits = self.mean <= config.max_innovation;
        count(&mut self.exceeded, !fits);
    }

    /// Whether the innovations exceed their limit.
    pub(crate) const fn is_inconsistent(&self) -> bool {
        self.exceeded >= POSES
    }
}

/// What sliding tyres add to the sideslip of a car that rolls, rad: the law is far from singular
/// there.
const SLIDES: f64 = 0.6;
/// The speed across the car up to which the noise of an IMU may make it while the markers are lost, m/s:
/// a tick below counts a tenth.
const NOISE: f64 = 0.2;
/// Excess of the ticks with a sideslip beyond the limit over those within, in tenths of ticks.
const TENTHS: u32 = 20;

/// Watches the sideslip of every tick. One that is too large is an error of cameras or estimate: the
/// car keeps its command for it, and stops if it lasts.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SlideWatch {
    /// Whether the sideslip of this tick is too large to act on.
    pub(crate) is_beyond: bool,
    /// The ticks beyond it less those within, in tenths.
    more: u32,
}

impl SlideWatch {
    /// A tick of a car with these parameters and limits.
    pub(crate) fn tick(
        &mut self,
        estimate: Option<&Estimate>,
        car: &EstimatorConfig,
        limits: &Limits,
    ) {
        let rolls = atan(car.rear_axle_distance / car.wheelbase * tan(limits.max_steering));
        // A NaN is beyond it.
        let fits = estimate.is_none_or(|estimate| fabs(estimate.sideslip) <= rolls + SLIDES);
        self.is_beyond = !fits;
        let across = estimate.map_or(0.0, |estimate| {
            fabs(estimate.speed * sin(estimate.sideslip))
        });
        self.more = if fits {
            self.more.saturating_sub(10)
        } else if across <= NOISE {
            self.more.saturating_add(1)
        } else {
            self.more.saturating_add(10)
        };
    }

    /// Whether it has been for too long, or too often.
    pub(crate) const fn is_exceeded(&self) -> bool {
        self.more > TENTHS
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{Position, Time, VehicleParameters, direction};

    use super::*;

    fn at(ms: u64) -> Time {
        Time(1_000_000_000 + ms * 1_000_000)
    }

    fn pose(ms: u64, x: f64, y: f64, yaw: f64) -> PoseSample {
        PoseSample {
            capture: at(ms),
            receive: at(ms + 5),
            frame: 0,
            position: Position::new(x, y),
            yaw,
        }
    }

    fn frozen(poses: impl IntoIterator<Item = PoseSample>, config: &WatchConfig) -> bool {
        let mut watch = FrozenWatch::default();
        for pose in poses {
            watch.pose(&pose, config);
        }
        watch.is_frozen
    }

    #[test]
    fn poses_that_repeat_for_three_tenths_of_a_second_are_frozen() {
        let config = WatchConfig::paper();
        for still in [[1.0, 2.0, 3.0], [f64::NAN; 3]] {
            let same = |ms| pose(ms, still[0], still[1], still[2]);
            assert!(!frozen([same(0)], &config));
            assert!(!frozen([same(0), same(100), same(299)], &config));
            assert!(frozen([same(0), same(100), same(300)], &config));
            assert!(frozen([same(0), same(300), same(310)], &config));
        }
    }

    #[test]
    fn a_pose_that_differs_by_one_bit_ends_and_restarts_the_repetition() {
        let config = WatchConfig::paper();
        let same = |ms| pose(ms, 0.0, 0.0, 0.0);
        for other in [
            pose(300, -0.0, 0.0, 0.0),
            pose(300, 0.0, -0.0, 0.0),
            pose(300, 0.0, 0.0, -0.0),
        ] {
            let before = [same(0), same(200), other];
            assert!(!frozen(before, &config));
            let after = [same(310), same(609)];
            assert!(!frozen(before.into_iter().chain(after), &config));
            let after = [same(310), same(610)];
            assert!(frozen(before.into_iter().chain(after), &config));
            assert!(!frozen([same(0), same(290), same(301), other], &config));
        }
    }

    #[test]
    fn a_time_of_zero_disables_the_watch_for_frozen_poses() {
        let off = WatchConfig {
            frozen_poses: 0.0,
            ..WatchConfig::paper()
        };
        assert!(!frozen((0..100).map(|i| pose(10 * i, 1.0, 2.0, 3.0)), &off));
    }

    /// A step of a sixteenth of a metre, and of a second, at `angle` to the yaw.
    fn slid(angle: f64) -> Step {
        Step {
            time: 0.0625,
            rear: 0.0625 * direction(0.7 + angle),
            yaw: 0.7,
            turn: 0.0,
            gyro_turn: 0.0,
            forward: 0.0,
            left: 0.0,
            steering: 0.0,
            motor_way: 0.0625,
        }
    }

    /// The number of equal steps after which the sideslip is exceeded.
    fn sideslip(step: Step) -> Option<usize> {
        let mut watch = SideslipWatch::default();
        (1..=1_000).find(|_| {
            watch.step(&step, &WatchConfig::paper());
            watch.is_exceeded()
        })
    }

    #[test]
    fn two_means_of_the_sideslip_beyond_the_limit_are_implausible() {
        // The sum of sixteenths is not exact for every angle.
        let soon = 8..=10;
        for (angle, exceeded) in [
            (0.0, false),
            (0.139, false),
            (-0.139, false),
            (0.141, true),
            (-0.141, true),
            (3.0, true),
        ] {
            let steps = sideslip(slid(angle));
            assert_eq!(steps.is_some(), exceeded, "{angle}");
            assert!(steps.is_none_or(|steps| soon.contains(&steps)), "{steps:?}");
        }
    }

    #[test]
    fn a_car_in_a_bend_may_slide_by_what_its_tyres_add() {
        // A lateral acceleration of 2 m/s² adds 0.06 rad.
        for turn in [0.125, -0.125] {
            let slid = |angle| Step {
                turn,
                ..slid(angle)
            };
            assert_eq!(sideslip(slid(0.199)), None);
            assert!(sideslip(slid(0.201)).is_some());
        }
        let slid = Step {
            turn: f64::NAN,
            ..slid(0.0)
        };
        assert!(sideslip(slid).is_some());
    }

    #[test]
    fn a_way_that_is_no_number_exceeds_the_limit_of_the_sideslip() {
        let lost = Step {
            rear: f64::NAN * direction(0.7),
            ..slid(0.0)
        };
        assert_eq!(sideslip(lost), Some(2));
    }

    #[test]
    fn short_steps_and_steps_in_reverse_have_no_sideslip() {
        // Along the world's axis, so that the length of a step is exact.
        let short = |way| Step {
            rear: Position::new(way, 0.0).coords,
            yaw: 0.3,
            ..slid(0.0)
        };
        assert_eq!(sideslip(short(0.0029)), None);
        assert!(sideslip(short(0.003)).is_some());
        let motor = |motor_way| Step {
            motor_way,
            ..slid(0.3)
        };
        assert_eq!(sideslip(motor(-0.001)), None);
        assert!(sideslip(motor(0.0)).is_some());
    }

    #[test]
    fn a_good_mean_and_a_reset_forget_the_sideslip() {
        let mut watch = SideslipWatch::default();
        let mut slide = |angle: f64, reset: bool| {
            if reset {
                watch = SideslipWatch::default();
            }
            // One long step makes a mean.
            let step = Step {
                rear: 0.3 * direction(0.7 + angle),
                ..slid(0.0)
            };
            watch.step(&step, &WatchConfig::paper());
            watch.is_exceeded()
        };
        for (angle, reset, exceeded) in [
            (0.3, false, false),
            (0.0, false, false),
            (0.3, false, false),
            (0.3, false, true),
            (0.3, false, true),
            (0.3, true, false),
            (0.3, false, true),
            (0.0, false, false),
        ] {
            assert_eq!(slide(angle, reset), exceeded);
        }
    }

    #[test]
    fn the_angle_is_that_of_the_whole_way() {
        let mut watch = SideslipWatch::default();
        for i in 0..40 {
            let angle = if i % 2 == 0 { 0.5 } else { -0.5 };
            watch.step(&slid(angle), &WatchConfig::paper());
            assert!(!watch.is_exceeded());
        }
    }

    /// The number of poses with the innovation after which they are inconsistent.
    fn innovations(watch: &mut InnovationWatch, innovation: f64) -> Option<usize> {
        (1..=1_000).find(|_| {
            watch.pose(innovation, &WatchConfig::paper());
            watch.is_inconsistent()
        })
    }

    #[test]
    fn fifty_poses_with_too_high_a_mean_innovation_are_inconsistent() {
        let first = |innovation| innovations(&mut InnovationWatch::default(), innovation);
        assert_eq!(first(199.0), None);
        // The mean is 400 (1 - 0.98^n): above 200 from the 35th pose on.
        assert_eq!(first(400.0), Some(84));
        assert_eq!(first(f64::NAN), Some(50));
        // However far off: above 200 from the twelfth pose on.
        assert_eq!(first(1e9), Some(61));
    }

    #[test]
    fn ten_outliers_in_a_row_are_none_of_the_estimate() {
        let config = WatchConfig::paper();
        let mut watch = InnovationWatch::default();
        for index in 0..500 {
            watch.pose(if index % 100 < 10 { 1e9 } else { 3.0 }, &config);
            assert!(!watch.is_inconsistent());
        }
    }

    #[test]
    fn a_mean_within_its_limit_and_a_reset_forget_the_innovations() {
        let config = WatchConfig::paper();
        let mut watch = InnovationWatch::default();
        for _ in 0..83 {
            watch.pose(400.0, &config);
        }
        // The mean of 325 is within its limit again after 25 poses.
        for _ in 0..40 {
            watch.pose(0.0, &config);
        }
        assert!(!watch.is_inconsistent());
        watch = InnovationWatch::default();
        assert_eq!(innovations(&mut watch, 400.0), Some(84));
        assert!(watch.is_inconsistent());
        watch = InnovationWatch::default();
        assert!(!watch.is_inconsistent());
        assert_eq!(innovations(&mut watch, 400.0), Some(84));
    }

    #[test]
    fn a_sideslip_that_no_car_has_counts_from_the_third_tick_also_with_others_between() {
        let mut tick = ticks(0.4);
        assert_eq!(tick(0.8), (false, false));
        assert_eq!(tick(-0.9), (true, false));
        assert_eq!(tick(0.9), (true, false));
        assert_eq!(tick(0.2), (false, false));
        assert_eq!(tick(f64::NAN), (true, false));
        assert_eq!(tick(1.2), (true, true));
        assert_eq!(tick(0.0), (false, false));
    }

    #[test]
    fn a_slow_car_whose_sideslip_is_noise_has_a_fifth_of_a_second() {
        let mut tick = ticks(0.15);
        for _ in 0..20 {
            assert_eq!(tick(1.0), (true, false));
        }
        assert_eq!(tick(1.0), (true, true));
    }

    /// Ticks of the paper's car at a speed, in m/s.
    fn ticks(speed: f64) -> impl FnMut(f64) -> (bool, bool) {
        let vehicle = VehicleParameters::paper();
        let car = EstimatorConfig::for_vehicle(&vehicle);
        let limits = Limits {
            max_steering: 0.45,
            ..Limits::paper()
        };
        let mut watch = SlideWatch::default();
        move |sideslip: f64| {
            let estimate = Estimate {
                time: Time(0),
                position: Position::origin(),
                yaw: 0.0,
                yaw_rate: 0.0,
                sideslip,
                speed,
                pose_time: Time(0),
            };
            watch.tick(Some(&estimate), &car, &limits);
            (watch.is_beyond, watch.is_exceeded())
        }
    }
}
