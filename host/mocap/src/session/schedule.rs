//! When each message is due.

/// Until the definitions have been read they are requested at this interval; while
/// a body that is needed is not in them, at the longer one.
const UNREAD_MODELS_NS: u64 = 100_000_000;
const INCOMPLETE_MODELS_NS: u64 = 500_000_000;

/// When each message is due next, on the local clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Schedule {
    /// CONNECT, or the bitstream request.
    pub(super) handshake_ns: u64,
    pub(super) bitstream_attempts: u32,
    pub(super) echo_ns: u64,
    pub(super) models_ns: u64,
    /// When the definitions are requested again if they lack a body.
    models_retry_ns: u64,
    pub(super) keep_alive_ns: u64,
    /// Silence counts from here when no frame arrived.
    pub(super) listening_since_ns: u64,
}

impl Schedule {
    /// CONNECT is due at `now_ns`, and nothing else.
    pub(super) fn connect_at(now_ns: u64) -> Self {
        Self {
            handshake_ns: now_ns,
            ..Self::default()
        }
    }

    /// Every message is due at `now_ns`.
    pub(super) const fn begin(now_ns: u64) -> Self {
        Self {
            handshake_ns: now_ns,
            bitstream_attempts: 0,
            echo_ns: now_ns,
            models_ns: now_ns,
            models_retry_ns: now_ns,
            keep_alive_ns: now_ns,
            listening_since_ns: now_ns,
        }
    }

    /// The definitions are due at `at_ns` or earlier.
    pub(super) fn models_by(&mut self, at_ns: u64) {
        self.models_ns = self.models_ns.min(at_ns);
    }

    /// The definitions were requested.
    pub(super) fn models_requested(&mut self, now_ns: u64, poll_ns: u64, have_been_read: bool) {
        let retry_ns = if have_been_read {
            INCOMPLETE_MODELS_NS
        } else {
            UNREAD_MODELS_NS
        };
        self.models_ns = now_ns.saturating_add(retry_ns.min(poll_ns));
    }

    /// The definitions were read: they are due again after the polling interval.
    pub(super) const fn models_read(&mut self, now_ns: u64, poll_ns: u64) {
        self.models_retry_ns = self.models_ns;
        self.models_ns = now_ns.saturating_add(poll_ns);
    }

    /// The definitions that were read lack a body: they are due as if they had not
    /// been read.
    pub(super) const fn models_incomplete(&mut self) {
        self.models_ns = self.models_retry_ns;
    }
}
