//! Access to the running daemon for every thread but the control thread.

use std::{path::PathBuf, sync::Arc};

use singletrack_api::record_trouble;
use singletrack_core::{Requests, slot::SetpointSender, slot::SlotSender};
use singletrack_pilot::{Jog, Tuning};

use crate::{
    commissioned_file::CommissionedFile,
    control_thread::ControlThreadState,
    realtime::RealTimeStatus,
    reconfigure::Reconfigurer,
    shared_status::SharedStatus,
    snapshot::Snapshot,
    socket::{Drives, SetpointSource},
};

/// Reads the daemon's status and passes requests to the control thread.
#[derive(Clone, Debug)]
pub(crate) struct DaemonHandle {
    pub(crate) status: Arc<SharedStatus>,
    /// Whether the control thread lives; what it does is in the status, which may be late.
    pub(crate) control: ControlThreadState,
    pub(crate) requests: Requests,
    pub(crate) setpoints: SetpointSender,
    /// Which client gives the set-points.
    pub(crate) source: SetpointSource,
    pub(crate) jogs: SlotSender<Jog>,
    pub(crate) tunings: SlotSender<Tuning>,
    /// The file of the configuration, for a reload.
    pub(crate) config_path: Option<PathBuf>,
    /// The file of the record.
    pub(crate) record: Option<PathBuf>,
    pub(crate) reconfigurer: Reconfigurer,
    pub(crate) realtime: RealTimeStatus,
    /// What the cars have passed.
    pub(crate) commissioned: CommissionedFile,
    /// Numbers the drives that clients arm.
    pub(crate) drives: Drives,
}

impl DaemonHandle {
    /// Why nothing is recorded, or soon will not be; `None` if all is well with the record.
    pub(crate) fn record_trouble(&self) -> Option<String> {
        let latest = self.status.latest();
        record_trouble(
            latest.record_error.as_deref(),
            latest.record_warning.as_deref(),
        )
    }

    /// Copies the present status.
    pub(crate) fn snapshot(&self) -> Snapshot {
        let latest = self.status.latest().clone();
        let published = self.reconfigurer.published();
        Snapshot {
            latest,
            figures: self.status.tally().figures(),
            realtime: self.realtime.clone(),
            configuration: published.view.clone(),
            tuning: published.config.tuning_rule(),
            commissioned: published
                .subject
                .map(|subject| self.commissioned.view(subject)),
            config_path: self.config_path.clone(),
            record: self.record.clone(),
        }
    }
}
