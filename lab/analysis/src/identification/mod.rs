//! Identification of the car's parameters from a drive.
//!
//! This is a prediction-error method. The model is the paper's (equation 1) with tyres that
//! saturate and a servo with a lag; its inputs are the servo's targets and the measured
//! forward acceleration. A Kalman filter predicts each pose and each inertial sample from
//! those before it. The estimates of cornering stiffnesses, yaw inertia and other parameters
//! minimise the sum of squares of the prediction errors, each over its predicted standard
//! deviation. Unlike the errors of a simulation, these are white if the model is right, so
//! that the inverse of the information matrix is the covariance of the estimates. A second
//! covariance holds for errors that are correlated over up to half a second, and the wider
//! of the two is reported.
//!
//! A car that does not behave as the model does is another matter: the parameters that predict best
//! are then those that fit the corrections best. There the error of a simulation is minimised instead,
//! see [`Criterion`].
//!
//! Estimated jointly are lag, delay and trim of the steering, delay and biases of the IMU, scale of
//! the gyro, and, by their likelihood, the levels of all noise.

mod data;
mod error;
mod filter;
mod fit;
mod identify;
mod least_squares;
mod model;
mod parameter;
mod predictor;
mod settings;
mod simulation;
mod simulation_fit;
mod timeline;
mod warning;

pub use data::{Channel, DriveData, Inertial, Pose, ServoFrames, ServoTarget, Span};
pub use error::IdentificationError;
pub use filter::{Residuals, TrackPoint};
pub use fit::Estimate;
pub use identify::{Identification, cramer_rao, identify, validate};
pub use parameter::{Parameter, Values};
pub use settings::{Criterion, NoiseLevels, Settings};
pub use simulation::{Output, OutputScore, Score, SimulationPoint};
pub use singletrack_control::Tyres;
pub use warning::Warning;
