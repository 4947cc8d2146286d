//! Why a test did not pass.

/// Why a test did not pass.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Something is not as it must be.
    #[error("{0}")]
    Failed(String),
    /// The harness could not see what it had to see: nothing is shown, neither
    /// good nor bad.
    #[error("void: {0}")]
    Void(String),
    /// The system does not do its part.
    #[error("{what}: {source}")]
    System {
        /// What was tried.
        what: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The simulator does not do its part.
    #[error("the simulator: {0}")]
    Simulator(#[from] singletrack_sim::RealTimeError),
}

/// What a test or a part of it comes to.
pub type Outcome<T = ()> = Result<T, Failure>;

impl Failure {
    /// Something is not as it must be.
    pub fn new(what: impl Into<String>) -> Self {
        Self::Failed(what.into())
    }

    /// For `map_err`: says what was tried.
    pub fn system(what: impl Into<String>) -> impl FnOnce(std::io::Error) -> Self {
        |source| Self::System {
            what: what.into(),
            source,
        }
    }
}

/// Fails the test with a formatted message unless the condition holds.
#[macro_export]
macro_rules! ensure {
    ($condition:expr, $($message:tt)+) => {
        if !$condition {
            return Err($crate::Failure::new(format!($($message)+)));
        }
    };
}
