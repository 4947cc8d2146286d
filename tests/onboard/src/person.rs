//! The person beside the car: scripted hands, and eyes with reading errors.

use core::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
use std::collections::VecDeque;

use singletrack_commissioning::{Answer, Answers, Question};
use singletrack_sim::{HandMotion, LossKind, StartPose, World};

use crate::random::Random;

/// The person.
#[derive(Debug)]
pub(crate) struct Person {
    random: Random,
    /// What is still to be done before the answer, or after it.
    tasks: VecDeque<Task>,
    /// What is done after the answer.
    later: Vec<Task>,
    /// Until when nothing is done, in µs.
    idle_until_us: u64,
    /// What is done so long after the wheels have begun to turn, in s.
    trigger: Option<(f64, Action)>,
    /// Since when the wheels turn, in µs.
    turning_since_us: Option<u64>,
    /// When the last such action was done, in µs.
    acted_us: Option<u64>,
    seen: Seen,
    has_kill_switch: bool,
}

/// What the eyes and ears took in since the last question.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    /// How far the wheels turned forward and backward, in m.
    wheels: [f64; 2],
    /// Whether the servo buzzed against a stop.
    buzzed: bool,
    /// Whether the ESC had its supply.
    esc_was_on: bool,
    /// When the motor was last driven, in µs.
    driven_us: u64,
}

/// A part of what is asked for.
#[derive(Clone, Copy, Debug)]
enum Task {
    Move(HandMotion),
    Pause(f64),
    Act(Action),
}

/// What is done to the electronics.
#[derive(Clone, Copy, Debug)]
enum Action {
    SwitchEsc(bool),
    PressReset,
    OpenStopSwitch(bool),
    Plug(bool),
    PlugBattery(bool),
    CoverMarkers(bool),
}

impl Action {
    fn apply(self, world: &mut World) {
        match self {
            Self::SwitchEsc(on) => world.car_mut().set_esc_power(on),
            Self::PressReset => world.press_reset(),
            Self::OpenStopSwitch(open) => world.board_mut().set_stop_input_open(open),
            Self::PlugBattery(plugged) => world.car_mut().set_battery_plugged(plugged),
            Self::CoverMarkers(covered) => {
                world.cameras_mut().faults_mut().loss = covered.then_some(LossKind::Occluded);
            }
            Self::Plug(plugged) => world.set_wire_connected(plugged),
        }
    }
}

/// The longest stretch in which the car is rolled without a pause, in m: the board takes wheels
/// that turn for longer for a motor that runs.
const STRETCH_M: f64 = 0.6;
/// Speed of a hand that rolls the car, in m/s.
const ROLL_M_S: f64 = 0.4;

impl Person {
    pub(crate) fn new(seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x6861_6e64);
        let has_kill_switch = random.happens(0.6);
        Self {
            random,
            tasks: VecDeque::new(),
            later: Vec::new(),
            idle_until_us: 0,
            trigger: None,
            turning_since_us: None,
            acted_us: None,
            seen: Seen::default(),
            has_kill_switch,
        }
    }

    /// Begins with what a question asks for, and says how long the person thinks, in s; none
    /// if the question is not known.
    pub(crate) fn consider(&mut self, question: &Question, world: &mut World) -> Option<f64> {
        self.trigger = None;
        self.later.clear();
        let id = question.id;
        match id {
            // Calibration.
            "place-on-floor" => {
                let to = StartPose {
                    x_m: self.random.normal(0.08),
                    y_m: self.random.normal(0.08),
                    // Along the longer side of the hall.
                    yaw_rad: self.random.normal(0.08),
                };
                self.do_now(&[
                    Task::Move(HandMotion::Carry { to, for_s: 4.0 }),
                    Task::Pause(1.0),
                ]);
            }
            "cover-markers" => {
                self.trigger = Some((self.random.between(3.0, 6.0), Action::CoverMarkers(true)));
            }
            "uncover-markers" => self.do_now(&[Task::Act(Action::CoverMarkers(false))]),
            // Doctor.
            "voltmeter" => {}
            "press-reset" if !world.car().wheels_are_up() => {
                self.later.push(Task::Act(Action::PressReset));
            }
            "unplug-battery" => self.later.push(Task::Act(Action::PlugBattery(false))),
            "plug-battery" => self.later.push(Task::Act(Action::PlugBattery(true))),
            "open-stop-switch" => self.later.push(Task::Act(Action::OpenStopSwitch(true))),
            "close-stop-switch" => self.later.push(Task::Act(Action::OpenStopSwitch(false))),
            "push-wheels" => self.later.push(Task::Pause(5.0)),
            "stand-still" => self.carry(0.0),
            "nose-up" => self.tilt_later([0.0, -FRAC_PI_4]),
            "left-side-up" => self.tilt_later([FRAC_PI_4, 0.0]),
            "turn-left" => {
                let angle_rad = FRAC_PI_2 + self.random.normal(0.12);
                let about_m = [self.random.normal(0.02), self.random.normal(0.01)];
                self.turn_later(angle_rad, about_m, 0.004, 3.0);
            }
            "push-forward" => {
                self.carry(0.6);
                let distance_m = 0.5 + self.random.between(-0.03, 0.05);
                self.roll_later(distance_m);
            }
            "twist" => {
                let amplitude_rad = 30_f64.to_radians() * self.random.between(0.8, 1.2);
                let about_m = [self.random.normal(0.02), self.random.normal(0.01)];
                let period_s = self.random.between(0.85, 1.2);
                self.later.extend([
                    Task::Pause(0.7),
                    Task::Move(HandMotion::Twist {
                        amplitude_rad,
                        about_m,
                        period_s,
                        for_s: 12.0 + self.random.between(0.0, 1.5),
                    }),
                ]);
            }
            "turn-left-about-rear-axle" | "turn-right-about-rear-axle" => {
                let side = if id.starts_with("turn-left") {
                    1.0
                } else {
                    -1.0
                };
                let rear = world.config().car.vehicle.rear_axle_distance_m;
                // How well the middle of the axle is held over its point.
                let about_m = [
                    -rear + self.random.normal(0.0015),
                    self.random.normal(0.0015),
                ];
                let angle_rad = side * (2.0 * PI + self.random.normal(0.2));
                self.turn_later(angle_rad, about_m, 0.001, 10.0);
            }
            "roll-forward" => {
                self.carry(2.2);
                let distance_m = 2.0 + self.random.normal(0.04);
                self.roll_later(distance_m);
            }
            // Bring-up.
            "on-stand" => self.do_now(&[Task::Move(HandMotion::Lift { height_m: 0.1 })]),
            "esc-dark" | "esc-woke" | "kill-switch" | "wheels-still" | "front-wheels"
            | "wheel-angle" | "at-stop" | "driven-wheels" | "stopped-how" => {}
            "cut-supply" => self.trigger = Some((1.0, Action::SwitchEsc(false))),
            "open-switch" => self.trigger = Some((1.0, Action::OpenStopSwitch(true))),
            "unplug" => self.trigger = Some((1.0, Action::Plug(false))),
            "press-reset" => self.trigger = Some((1.0, Action::PressReset)),
            "restore-supply" => {
                self.do_now(&[Task::Act(Action::SwitchEsc(true)), Task::Pause(3.0)]);
            }
            "esc-after-board" => self.do_now(&[
                Task::Act(Action::SwitchEsc(false)),
                Task::Pause(0.5),
                Task::Act(Action::PressReset),
                Task::Pause(3.0),
                Task::Act(Action::SwitchEsc(true)),
                Task::Pause(2.5),
            ]),
            "board-after-esc" | "clear-latch" => {
                self.do_now(&[Task::Act(Action::PressReset), Task::Pause(3.0)]);
            }
            "close-switch" => self.do_now(&[
                Task::Act(Action::OpenStopSwitch(false)),
                Task::Act(Action::PressReset),
                Task::Pause(3.0),
            ]),
            "plug-in" => self.do_now(&[Task::Act(Action::Plug(true)), Task::Pause(3.0)]),
            _ => return None,
        }
        Some(match question.answers {
            Answers::Number { .. } => self.random.between(3.0, 8.0),
            _ => self.random.between(1.0, 3.0),
        })
    }

    /// The answer, after the time to think.
    pub(crate) fn answer(&mut self, question: &Question, world: &World) -> Answer {
        let car = world.car();
        let truth = world.truth();
        let [forward, backward] = self.seen.wheels;
        let answer = match question.id {
            "voltmeter" => {
                let read = truth.battery_v * (1.0 + self.random.normal(0.003));
                Answer::Number((read * 100.0).round() / 100.0)
            }
            "on-stand" => Answer::YesNo(car.wheels_are_up()),
            "esc-dark" => Answer::YesNo(!car.esc_has_power()),
            "esc-woke" => Answer::YesNo(self.seen.esc_was_on),
            "kill-switch" => Answer::YesNo(self.has_kill_switch),
            "wheels-still" => Answer::YesNo(forward + backward < 0.003),
            "front-wheels" => {
                let angle = truth.steering.to_degrees() + self.random.normal(0.75).clamp(-1.5, 1.5);
                choice(
                    &question.answers,
                    match angle {
                        angle if angle > 2.0 => "left",
                        angle if angle < -2.0 => "right",
                        _ => "straight",
                    },
                )
            }
            "wheel-angle" => {
                let angle = truth.steering.to_degrees() + self.random.normal(1.0).clamp(-2.0, 2.0);
                Answer::Number((2.0 * angle).round() / 2.0)
            }
            "at-stop" => Answer::YesNo(self.seen.buzzed),
            "driven-wheels" => choice(
                &question.answers,
                match (forward, backward) {
                    (forward, backward) if forward.max(backward) < 0.005 => "stood",
                    (forward, backward) if forward > backward => "forward",
                    _ => "backward",
                },
            ),
            "stopped-how" => {
                let acted_us = self.acted_us.unwrap_or_default();
                let drove_us = self.seen.driven_us.saturating_sub(acted_us);
                choice(
                    &question.answers,
                    match drove_us {
                        _ if car.motor_is_driven() => "not",
                        drove_us if drove_us > 400_000 => "late",
                        _ => "at-once",
                    },
                )
            }
            _ => match question.answers {
                Answers::YesNo => Answer::YesNo(true),
                _ => Answer::Begin,
            },
        };
        // What happens from now on belongs to the next question.
        self.seen = Seen::default();
        self.tasks.extend(self.later.drain(..));
        answer
    }

    /// Looks, and goes on with what is under way. It is called in every tick.
    pub(crate) fn act(&mut self, world: &mut World) {
        let now_us = world.now_us();
        self.look(world);
        if let (Some(since_us), Some((after_s, action))) = (self.turning_since_us, self.trigger)
            && now_us.saturating_sub(since_us) as f64 * 1e-6 > after_s
        {
            action.apply(world);
            self.acted_us = Some(now_us);
            self.trigger = None;
        }
        while now_us >= self.idle_until_us && !world.car().is_in_motion_by_hand() {
            match self.tasks.pop_front() {
                None => break,
                Some(Task::Move(motion)) => world.car_mut().begin_by_hand(motion),
                Some(Task::Pause(seconds)) => {
                    self.idle_until_us = now_us + (seconds * 1e6) as u64;
                }
                Some(Task::Act(action)) => action.apply(world),
            }
        }
    }

    fn look(&mut self, world: &World) {
        const TICK_S: f64 = 0.01;
        let car = world.car();
        let truth = world.truth();
        let turned = truth.wheel_speed * TICK_S;
        self.seen.wheels[usize::from(turned < 0.0)] += turned.abs();
        self.seen.buzzed |= car.servo_strains();
        self.seen.esc_was_on |= car.esc_has_power();
        if car.motor_is_driven() {
            self.seen.driven_us = world.now_us();
        }
        if truth.wheel_speed.abs() < 0.05 {
            self.turning_since_us = None;
        } else {
            self.turning_since_us.get_or_insert(world.now_us());
        }
    }

    /// Whether the hands are at work.
    pub(crate) fn is_busy(&self, world: &World) -> bool {
        !self.tasks.is_empty()
            || world.now_us() < self.idle_until_us
            || world.car().is_in_motion_by_hand()
    }

    fn do_now(&mut self, tasks: &[Task]) {
        self.tasks.extend(tasks);
    }

    /// Rolls the car in stretches, after the answer.
    fn roll_later(&mut self, distance_m: f64) {
        let stretches = (distance_m.abs() / STRETCH_M).ceil().max(1.0);
        let each = distance_m / stretches;
        self.later.push(Task::Pause(0.7));
        for _ in 0..stretches as u32 {
            let speed_m_s = ROLL_M_S * self.random.between(0.8, 1.2);
            self.later.extend([
                Task::Move(HandMotion::Roll {
                    distance_m: each,
                    speed_m_s,
                }),
                Task::Pause(1.3),
            ]);
        }
    }

    /// Tilts the car to this roll and pitch, after the answer.
    fn tilt_later(&mut self, [roll, pitch]: [f64; 2]) {
        let share = self.random.between(0.85, 1.15);
        self.later.extend([
            Task::Pause(0.7),
            Task::Move(HandMotion::Tilt {
                roll_rad: roll * share,
                pitch_rad: pitch * share,
                for_s: self.random.between(3.0, 4.5),
            }),
        ]);
    }

    /// Turns the car, after the answer.
    fn turn_later(&mut self, angle_rad: f64, about_m: [f64; 2], wander_m: f64, for_s: f64) {
        self.later.extend([
            Task::Pause(0.7),
            Task::Move(HandMotion::Turn {
                angle_rad,
                about_m,
                wander_m: self.random.normal(wander_m),
                for_s: for_s * self.random.between(0.85, 1.2),
            }),
        ]);
    }

    /// Carries the car to where it has this much room ahead, before the answer.
    fn carry(&mut self, ahead_m: f64) {
        let yaw_rad = self.random.between(-PI, PI);
        let back = ahead_m / 2.0;
        let to = StartPose {
            x_m: -back * libm::cos(yaw_rad) + self.random.between(-0.3, 0.3),
            y_m: -back * libm::sin(yaw_rad) + self.random.between(-0.3, 0.3),
            yaw_rad,
        };
        self.do_now(&[
            Task::Move(HandMotion::Carry { to, for_s: 4.0 }),
            Task::Pause(1.0),
        ]);
    }
}

/// The answer that is this word.
fn choice(answers: &Answers, word: &str) -> Answer {
    match answers {
        Answers::Choice(words) => words
            .iter()
            .position(|known| *known == word)
            .map_or(Answer::Skip, Answer::Choice),
        _ => Answer::Skip,
    }
}
