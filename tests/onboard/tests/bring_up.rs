//! The bring-up of cars that are not on their stand, by hands that do not lift them.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_commissioning::{
    Answer, Attendance, Bench, Interrupted, Jog, Live, Observation, Question, Refused, Verdict,
    bring_up, run,
};
use singletrack_control::{Position, Velocity};
use singletrack_core::Config;
use singletrack_onboard::{NoJournal, OnboardCar, VirtualBench};

/// A person who says that the car is on its stand and leaves it on the floor.
struct OnTheFloor {
    bench: VirtualBench,
    emergency_stops: u32,
    /// The farthest that the cameras saw it from where it stood, m.
    farthest_m: f64,
    place: Option<[f64; 2]>,
}

impl Bench for OnTheFloor {
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted> {
        let from = observed.len();
        self.bench.wait(observed)?;
        for observation in observed.iter().skip(from) {
            if let Observation::Pose(pose) = observation {
                let [x, y, _] = pose.position;
                let [from_x, from_y] = *self.place.get_or_insert([x, y]);
                self.farthest_m = self.farthest_m.max((x - from_x).hypot(y - from_y));
            }
        }
        Ok(())
    }

    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted> {
        if question.id == "on-stand" {
            return Ok(Answer::YesNo(true));
        }
        self.bench.ask(question)
    }

    fn show(&mut self, live: &Live<'_>) {
        self.bench.show(live);
    }

    fn arm(&mut self, attendance: Attendance) -> Result<(), Refused> {
        self.bench.arm(attendance)
    }

    fn jog(&mut self, jog: Jog) -> Result<(), Refused> {
        self.bench.jog(jog)
    }

    fn drive(&mut self, velocity: Velocity, position: Option<Position>) -> Result<(), Refused> {
        self.bench.drive(velocity, position)
    }

    fn disarm(&mut self) -> Result<(), Refused> {
        self.bench.disarm()
    }

    fn emergency_stop(&mut self) -> Result<(), Refused> {
        self.emergency_stops += 1;
        self.bench.emergency_stop()
    }

    fn configuration(&self) -> &Config {
        self.bench.configuration()
    }

    fn change(&mut self, values: &[(&str, toml_edit::Value)]) -> Result<(), Refused> {
        self.bench.change(values)
    }
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn a_car_on_the_floor_is_stopped_within_15_cm() {
        for seed in 0..12 {
            let car = OnboardCar::planted(seed, None);
            let mut bench = OnTheFloor {
                bench: VirtualBench::new(&car).unwrap(),
                emergency_stops: 0,
                farthest_m: 0.0,
                place: None,
            };
            let findings = run(&bring_up::steps_with::<5>(), &mut bench, &mut NoJournal).unwrap();
            let last = findings.last().unwrap();
            assert_eq!(last.verdict, Verdict::Failed, "{seed}: {}", last.found);
            assert!(
                last.found.contains("the cameras saw the car move"),
                "{seed} {}: {}",
                last.step,
                last.found
            );
            assert_eq!(bench.emergency_stops, 1, "{seed}");
            // It rolls out after the stop.
            let mut observed = Vec::new();
            for _ in 0..300 {
                bench.wait(&mut observed).unwrap();
            }
            assert!(bench.farthest_m < 0.15, "{seed}: {} m", bench.farthest_m);
        }
    }
}
