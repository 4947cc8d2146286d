//! The person beside the car: scripted hands, and eyes with reading errors.

use core::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
use std::collections::VecDeque;

use singletrack_commissioning::{Answer, Answers, Question};
use singletrack_sim::{HandCommand, HandMotion, Seen as View, StartPose, World};

use crate::Random;

/// A car that a person stands beside.
pub trait Hands {
    /// The time, in µs.
    fn now_us(&self) -> u64;

    /// What is seen of the car now.
    fn look(&self) -> View;

    /// Whether the car is being moved by hand.
    fn is_moving(&self) -> bool;

    /// Does something to the car, or begins with it.
    fn apply(&mut self, command: HandCommand);

    /// Distance of the rear axle from the centre of mass, in m.
    fn rear_axle_m(&self) -> f64;
}

impl Hands for World {
    fn now_us(&self) -> u64 {
        self.now_us
    }

    fn look(&self) -> View {
        View::of(self)
    }

    fn is_moving(&self) -> bool {
        self.car.is_in_motion_by_hand()
    }

    fn apply(&mut self, command: HandCommand) {
        command.apply(self);
    }

    fn rear_axle_m(&self) -> f64 {
        self.config.car.vehicle.rear_axle_distance_m
    }
}

/// The person. What it does is the same in virtual time and in real time.
#[derive(Debug)]
pub struct Person {
    random: Random,
    /// It neither thinks nor looks twice.
    hurries: bool,
    /// What is still to be done before the answer, or after it.
    tasks: VecDeque<Task>,
    /// What is done after the answer.
    later: Vec<Task>,
    /// Until when nothing is done, in µs.
    idle_until_us: u64,
    /// What is done so long after the wheels have begun to turn, in s.
    trigger: Option<(f64, HandCommand)>,
    /// Since when the wheels turn, in µs.
    turning_since_us: Option<u64>,
    /// When the last such action was done, in µs.
    acted_us: Option<u64>,
    seen: Seen,
    /// The motor was driven until the cable was plugged in again.
    drove_on: bool,
    /// When it last looked, in µs.
    looked_us: Option<u64>,
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
    Act(HandCommand),
}

/// The longest stretch in which the car is rolled without a pause, in m: the board takes wheels
/// that turn for longer for a motor that runs.
const STRETCH_M: f64 = 0.6;
/// Speed of a hand that rolls the car, in m/s.
const ROLL_M_S: f64 = 0.4;

impl Person {
    /// A person with habits of its own.
    pub fn new(seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x6861_6e64);
        let has_kill_switch = random.happens(0.6);
        Self {
            random,
            hurries: false,
            tasks: VecDeque::new(),
            later: Vec::new(),
            idle_until_us: 0,
            trigger: None,
            turning_since_us: None,
            acted_us: None,
            seen: Seen::default(),
            drove_on: false,
            looked_us: None,
            has_kill_switch,
        }
    }

    /// A person who answers at once and carries the car quickly. What it does with the car is
    /// as slow as ever.
    pub fn in_a_hurry(seed: u64) -> Self {
        Self {
            hurries: true,
            ..Self::new(seed)
        }
    }

    /// Begins with what a question asks for, and says how long the person thinks, in s; none
    /// if the question is not known.
    pub fn consider(&mut self, question: &Question, hands: &impl Hands) -> Option<f64> {
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
                self.carry_to(to);
            }
            "cover-markers" => {
                self.trigger = Some((self.random.between(3.0, 6.0), HandCommand::Markers(true)));
            }
            "uncover-markers" => self.do_now(&[Task::Act(HandCommand::Markers(false))]),
            // Doctor.
            "voltmeter" => {}
            "press-reset" => self.later.push(Task::Act(HandCommand::Reset)),
            "unplug-battery" => self.later.push(Task::Act(HandCommand::Battery(false))),
            "plug-battery" => self.later.push(Task::Act(HandCommand::Battery(true))),
            "open-stop-switch" => self.later.push(Task::Act(HandCommand::StopSwitch(true))),
            "close-stop-switch" => self.later.push(Task::Act(HandCommand::StopSwitch(false))),
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
                let rear = hands.rear_axle_m();
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
            "cut-supply" => self.trigger = Some((1.0, HandCommand::Esc(false))),
            "open-switch" => self.trigger = Some((1.0, HandCommand::StopSwitch(true))),
            "unplug" => self.trigger = Some((1.0, HandCommand::Cable(false))),
            "reset-at-speed" => self.trigger = Some((1.0, HandCommand::Reset)),
            "restore-supply" => {
                self.do_now(&[Task::Act(HandCommand::Esc(true)), Task::Pause(3.0)]);
            }
            "esc-after-board" => self.do_now(&[
                Task::Act(HandCommand::Esc(false)),
                Task::Pause(0.5),
                Task::Act(HandCommand::Reset),
                Task::Pause(3.0),
                Task::Act(HandCommand::Esc(true)),
                Task::Pause(2.5),
            ]),
            "board-after-esc" | "clear-latch" => {
                self.do_now(&[Task::Act(HandCommand::Reset), Task::Pause(3.0)]);
            }
            "close-switch" => self.do_now(&[
                Task::Act(HandCommand::StopSwitch(false)),
                Task::Act(HandCommand::Reset),
                Task::Pause(3.0),
            ]),
            "plug-in" => self.do_now(&[Task::Act(HandCommand::Cable(true)), Task::Pause(3.0)]),
            _ => return None,
        }
        if self.hurries {
            return Some(0.0);
        }
        Some(match question.answers {
            Answers::Number { .. } => self.random.between(3.0, 8.0),
            _ => self.random.between(1.0, 3.0),
        })
    }

    /// The answer, after the time to think.
    pub fn answer(&mut self, question: &Question, hands: &impl Hands) -> Answer {
        let view = hands.look();
        let [forward, backward] = self.seen.wheels;
        let answer = match question.id {
            "voltmeter" => {
                let read = view.battery_v * (1.0 + self.random.normal(0.003));
                Answer::Number((read * 100.0).round() / 100.0)
            }
            "on-stand" => Answer::YesNo(view.wheels_up),
            "esc-dark" => Answer::YesNo(!view.esc),
            "esc-woke" => Answer::YesNo(self.seen.esc_was_on),
            "kill-switch" => Answer::YesNo(self.has_kill_switch),
            "wheels-still" => Answer::YesNo(forward + backward < 0.003),
            "front-wheels" => {
                let angle = view.steering_deg + self.random.normal(0.75).clamp(-1.5, 1.5);
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
                let angle = view.steering_deg + self.random.normal(1.0).clamp(-2.0, 2.0);
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
                        _ if view.driven || self.drove_on => "not",
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
        // What happens from now on belongs to the next question. How the motor stops without
        // its cable is asked when that is plugged in again.
        if question.id == "plug-in" {
            self.drove_on = view.driven;
        } else {
            self.seen = Seen::default();
            self.drove_on = false;
        }
        self.tasks.extend(self.later.drain(..));
        answer
    }

    /// Looks, and goes on with what is under way. It is called often, in virtual
    /// time in every tick.
    pub fn act(&mut self, hands: &mut impl Hands) {
        let now_us = hands.now_us();
        self.look(hands);
        if let (Some(since_us), Some((after_s, action))) = (self.turning_since_us, self.trigger)
            && now_us.saturating_sub(since_us) as f64 * 1e-6 > after_s
        {
            hands.apply(action);
            self.acted_us = Some(now_us);
            self.trigger = None;
        }
        while now_us >= self.idle_until_us && !hands.is_moving() {
            match self.tasks.pop_front() {
                None => break,
                Some(Task::Move(motion)) => hands.apply(HandCommand::Move(motion)),
                Some(Task::Pause(seconds)) => {
                    self.idle_until_us = now_us + (seconds * 1e6) as u64;
                }
                Some(Task::Act(action)) => hands.apply(action),
            }
        }
    }

    fn look(&mut self, hands: &impl Hands) {
        let now_us = hands.now_us();
        let view = hands.look();
        let since_us = now_us.saturating_sub(self.looked_us.unwrap_or(now_us));
        self.looked_us = Some(now_us);
        let turned = view.wheels_m_s * since_us as f64 * 1e-6;
        self.seen.wheels[usize::from(turned < 0.0)] += turned.abs();
        self.seen.buzzed |= view.buzzes;
        self.seen.esc_was_on |= view.esc;
        if view.driven {
            self.seen.driven_us = now_us;
        }
        if view.wheels_m_s.abs() < 0.05 {
            self.turning_since_us = None;
        } else {
            self.turning_since_us.get_or_insert(now_us);
        }
    }

    /// Whether the hands are at work.
    pub fn is_busy(&self, hands: &impl Hands) -> bool {
        !self.tasks.is_empty() || hands.now_us() < self.idle_until_us || hands.is_moving()
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
        self.carry_to(to);
    }

    fn carry_to(&mut self, to: StartPose) {
        let for_s = if self.hurries { 1.0 } else { 4.0 };
        self.do_now(&[
            Task::Move(HandMotion::Carry { to, for_s }),
            Task::Pause(for_s / 4.0),
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
