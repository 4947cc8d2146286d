//! Runs units on all cores.

use core::num::NonZero;
use std::{
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

/// Runs units on some threads and returns the results in the order of `units`. `progress` is
/// called after each, from any thread.
///
/// # Errors
///
/// The error of the first unit, in the order of `units`, that failed. The others are not
/// begun any more.
pub fn run_units<R: Send, E: Send>(
    units: &[u64],
    threads: usize,
    work: impl Fn(u64) -> Result<R, E> + Sync,
    progress: impl Fn() + Sync,
) -> Result<Vec<(u64, R)>, E> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::with_capacity(units.len()));
    let worker = || {
        loop {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(&unit) = units.get(place) else {
                return;
            };
            let result = work(unit);
            if result.is_err() {
                next.store(units.len(), Ordering::Relaxed);
            }
            results
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push((place, unit, result));
            progress();
        }
    };
    thread::scope(|scope| {
        for _ in 0..threads.min(units.len()).max(1) {
            scope.spawn(worker);
        }
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|(place, ..)| *place);
    let results = results.into_iter();
    results
        .map(|(_, unit, result)| Ok((unit, result?)))
        .collect()
}

/// One thread per core that this process may use.
#[must_use]
pub fn thread_count() -> usize {
    thread::available_parallelism().map_or(1, NonZero::get)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_results_are_in_order_on_any_number_of_threads() {
        let units: Vec<u64> = (0..100).rev().collect();
        let run = |threads| run_units(&units, threads, |unit| Ok::<_, ()>(unit * unit), || ());
        let one = run(1).unwrap();
        assert_eq!(one.first(), Some(&(99, 99 * 99)));
        assert_eq!(one.len(), units.len());
        for threads in [0, 3, 200] {
            assert_eq!(run(threads).unwrap(), one);
        }
    }

    #[test]
    fn the_first_failure_ends_the_campaign() {
        let units: Vec<u64> = (0..1_000_000).collect();
        let fail = |unit| if unit < 10 { Ok(()) } else { Err(unit) };
        assert_eq!(run_units(&units, 4, fail, || ()), Err(10));
    }
}
