//! Other rigid bodies, from the cameras' frames to the pilot's events.

use heapless::Deque;
use rtrb::Producer;
use singletrack_control::{MAX_NEIGHBOURS, NeighbourSample, Position, Time};
use singletrack_mocap::{BodyNames, planar::OtherBody};

use crate::config::NeighboursSection;

/// Passes the bodies of the frames on: all but those whose names are ignored, and those that are
/// expected also while the cameras do not list them. Of these, the ones with a higher number
/// yield to this car.
#[derive(Debug)]
pub struct NeighbourFeed {
    /// Quoted, as in [`BodyNames`].
    expected: Vec<String>,
    ignored: Vec<String>,
    samples: Producer<NeighbourSample>,
}

impl NeighbourFeed {
    pub(crate) fn new(section: &NeighboursSection, samples: Producer<NeighbourSample>) -> Self {
        let quoted = |names: &[String]| names.iter().map(|name| format!("{name:?}")).collect();
        Self {
            expected: quoted(&section.expected),
            ignored: quoted(&section.ignored),
            samples,
        }
    }

    /// Frames of which the last one arrived at `received_ns`, with the other bodies of all.
    /// `own` is the number of the car's body.
    pub(crate) fn pass(
        &mut self,
        received_ns: u64,
        own: Option<i32>,
        others: &[OtherBody],
        names: &BodyNames,
    ) {
        let is_among = |id, list: &[String]| {
            let name = names.name(id);
            name.is_some_and(|name| list.iter().any(|listed| listed == name))
        };
        // Both cars of a pair know both numbers.
        let yields = |id| own.is_some_and(|own| own < id) && is_among(id, &self.expected);
        let seen = others
            .iter()
            .filter(|other| !is_among(other.id, &self.ignored));
        let seen = seen.map(|other| NeighbourSample {
            id: other.id,
            capture: Time(other.capture_time_ns),
            position: other.position_m.map(Position::from),
            yields: yields(other.id),
        });
        // A body without a number has one that no server gives.
        let expected = (1..).zip(&self.expected);
        let expected = expected.map(|(number, name)| names.id(name).unwrap_or(-number));
        let lost = expected.filter(|id| others.iter().all(|other| other.id != *id));
        let lost = lost.map(|id| NeighbourSample {
            id,
            capture: Time(received_ns),
            position: None,
            yields: yields(id),
        });
        for sample in seen.chain(lost) {
            // One without room is as one that was not seen.
            let _ = self.samples.push(sample);
        }
    }
}

/// The newest sample of each body that the pilot has not been given.
#[derive(Clone, Debug, Default)]
pub(crate) struct NewestSamples(Deque<NeighbourSample, MAX_NEIGHBOURS>);

impl NewestSamples {
    pub(crate) fn add(&mut self, sample: NeighbourSample) {
        match self.0.iter_mut().find(|newest| newest.id == sample.id) {
            Some(newest) => *newest = sample,
            // One without room comes again with the next frame.
            None => drop(self.0.push_back(sample)),
        }
    }

    /// The one that has waited for longest.
    pub(crate) fn take(&mut self) -> Option<NeighbourSample> {
        self.0.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(id: i32, capture: u64) -> NeighbourSample {
        NeighbourSample {
            id,
            capture: Time(capture),
            position: None,
            yields: false,
        }
    }

    #[test]
    fn the_newest_of_each_body_waits_where_its_first_one_did() {
        let mut samples = NewestSamples::default();
        for (id, capture) in [(1, 10), (2, 10), (1, 20)] {
            samples.add(sample(id, capture));
        }
        assert_eq!(samples.take(), Some(sample(1, 20)));
        for id in 3..=MAX_NEIGHBOURS as i32 + 9 {
            samples.add(sample(id, 30));
        }
        let taken = core::iter::from_fn(|| samples.take()).count();
        assert_eq!(taken, MAX_NEIGHBOURS);
    }
}
