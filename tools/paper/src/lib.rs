//! The paper's analyses as commands: stability, identification, the reproduction of its
//! experiments, the comparison of controllers, and the exercises of the course.

pub mod compare;
pub mod identify;
pub mod lab;
pub mod reproduce;
pub mod stability;
pub mod vehicle_file;
