//! What is told to people: what a reason means, what is wrong with the cameras, whether a reference can
//! be driven, and what is still to be done with a new car.

pub mod commissioned;
pub mod diagnosis;
pub mod feasibility;
pub mod reasons;
