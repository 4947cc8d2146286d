//! Identification of the car's parameters from a drive.
//!
//! Cornering stiffnesses, yaw inertia and whatever else is asked for are those with
//! which the drive is predicted best: the model of the paper (equation 1), with tyres
//! that slide and a servo that lags, is driven by what the servo was told and by the
//! acceleration forward; a Kalman filter predicts each pose and each inertial sample
//! from those before it; and the sum of the squares of the prediction errors, each over
//! the standard deviation that it should have, is minimised. Unlike the errors of a
//! simulation, these are white if the model is right, so that the inverse of the
//! information is the estimates' covariance; a second covariance holds for errors
//! that are coloured over up to half a second, and the wider of the two is told.
//!
//! What a drive does not tell otherwise is estimated along: lag, delay and trim of the
//! steering, the delay and the biases of the IMU, and the levels of all noise, by
//! their likelihood.

mod channel;
mod data;
mod error;
mod estimate;
mod filter;
mod fit;
mod identify;
mod model;
mod noise;
mod noise_fit;
mod parameter;
mod predictor;
mod residuals;
mod score;
mod settings;
mod simulation;
mod timeline;
mod uncertainty;
mod warning;

pub use channel::Channel;
pub use data::{DriveData, Inertial, Pose, ServoFrames, ServoTarget, Span};
pub use error::IdentificationError;
pub use estimate::Estimate;
pub use filter::TrackPoint;
pub use identify::{Identification, LEAST_SECONDS, cramer_rao, identify, identify_from, validate};
pub use noise::NoiseLevels;
pub use parameter::{Parameter, UnknownParameter, Values};
pub use residuals::Residuals;
pub use score::{Output, OutputScore, Score};
pub use settings::Settings;
pub use simulation::{Simulation, SimulationPoint};
pub use singletrack_control::Tyres;
pub use warning::Warning;
