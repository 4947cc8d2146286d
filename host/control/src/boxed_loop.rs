//! An outer loop of another crate, behind a pointer.

use alloc::boxed::Box;
use core::{any::Any, fmt::Debug};

use crate::{
    Velocity,
    outer_loop::{OuterLoop, TrackingInput},
};

/// What a loop derives, without its type.
trait AnyLoop: OuterLoop + Any + Debug + Send + Sync {
    fn boxed(&self) -> Box<dyn AnyLoop>;

    /// Takes over the state of a loop of the same type; whether it is one.
    fn assign(&mut self, source: &dyn AnyLoop) -> bool;

    fn equals(&self, other: &dyn AnyLoop) -> bool;
}

impl<L: OuterLoop + Clone + Debug + PartialEq + Send + Sync + 'static> AnyLoop for L {
    fn boxed(&self) -> Box<dyn AnyLoop> {
        Box::new(self.clone())
    }

    fn assign(&mut self, source: &dyn AnyLoop) -> bool {
        let source = (source as &dyn Any).downcast_ref::<Self>();
        source.is_some_and(|source| {
            self.clone_from(source);
            true
        })
    }

    fn equals(&self, other: &dyn AnyLoop) -> bool {
        (other as &dyn Any).downcast_ref() == Some(self)
    }
}

/// An outer loop of another crate.
///
/// To assign it (`clone_from`) from one of the same type allocates nothing, unless the loop's own
/// `Clone` does: the pilot does so in every tick that looks ahead. To make or clone it allocates.
#[derive(Debug)]
pub struct BoxedLoop(Box<dyn AnyLoop>);

impl BoxedLoop {
    /// The loop in a box.
    pub fn new(own: impl OuterLoop + Clone + Debug + PartialEq + Send + Sync + 'static) -> Self {
        Self(Box::new(own))
    }
}

impl Clone for BoxedLoop {
    fn clone(&self) -> Self {
        Self(self.0.boxed())
    }

    fn clone_from(&mut self, source: &Self) {
        if !self.0.assign(&*source.0) {
            *self = source.clone();
        }
    }
}

impl PartialEq for BoxedLoop {
    fn eq(&self, other: &Self) -> bool {
        self.0.equals(&*other.0)
    }
}

impl OuterLoop for BoxedLoop {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        self.0.step(input)
    }

    fn reset(&mut self) {
        self.0.reset();
    }

    fn plans(&self) -> bool {
        self.0.plans()
    }
}
