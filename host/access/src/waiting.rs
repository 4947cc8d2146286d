//! Connections that have yet to send their first line: a bounded number.
//!
//! A newer one takes the place of the oldest, so that connections which send nothing keep nobody
//! out, and cost a bounded number of files.

use std::{
    collections::VecDeque,
    sync::{Mutex, PoisonError},
};

use tokio::sync::oneshot::{Receiver, Sender, channel};

/// The places, oldest first.
#[derive(Debug)]
pub struct WaitingRoom {
    places: usize,
    taken: Mutex<VecDeque<Sender<()>>>,
}

/// A place. It ends when this value is dropped.
#[derive(Debug)]
pub struct Place(Receiver<()>);

impl WaitingRoom {
    /// A room with this number of places.
    #[must_use]
    pub const fn new(places: usize) -> Self {
        Self {
            places,
            taken: Mutex::new(VecDeque::new()),
        }
    }

    /// Takes a place, that of the oldest if there is no other.
    pub fn enter(&self) -> Place {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        taken.retain(|place| !place.is_closed());
        while taken.len() >= self.places {
            taken.pop_front();
        }
        let (sender, place) = channel();
        taken.push_back(sender);
        Place(place)
    }
}

impl Place {
    /// What `first` gives; `None` if the place is lost before. What has arrived by then counts.
    pub async fn until_lost<T>(&mut self, first: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            biased;
            result = first => Some(result),
            _ = &mut self.0 => None,
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use std::future::{pending, ready};

    use super::*;

    #[tokio::test]
    async fn a_newer_one_takes_the_place_of_the_oldest() {
        let room = WaitingRoom::new(3);
        let mut places: Vec<Place> = (0..3).map(|_| room.enter()).collect();
        // A place that was left is taken first.
        drop(places.remove(1));
        places.push(room.enter());
        places.push(room.enter());
        let lost = places.first_mut().unwrap();
        assert_eq!(lost.until_lost(ready(7)).await, Some(7));
        assert_eq!(lost.until_lost(pending::<()>()).await, None);
        for place in places.iter_mut().skip(1) {
            assert!(place.0.try_recv() == Err(tokio::sync::oneshot::error::TryRecvError::Empty));
        }
    }
}
