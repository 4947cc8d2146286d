//! Failures of a test.

/// Failures of a test.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// A requirement is violated.
    #[error("{0}")]
    Failed(String),
    /// The harness missed what it had to observe: the test has no result.
    #[error("void: {0}")]
    Void(String),
    /// An operation of the system failed.
    #[error("{what}: {source}")]
    System {
        /// The operation.
        what: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// The simulator failed.
    #[error("the simulator: {0}")]
    Simulator(#[from] singletrack_sim::RealTimeError),
}

/// Result of a test or a part of it.
pub type Outcome<T = ()> = Result<T, Failure>;

impl Failure {
    /// A violated requirement.
    pub fn new(what: impl Into<String>) -> Self {
        Self::Failed(what.into())
    }

    /// For `map_err`: adds the operation.
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
