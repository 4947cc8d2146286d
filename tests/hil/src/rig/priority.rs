//! Priority of the threads that stand for hardware.

/// Raises the priority of this thread and of those that it starts: they stand for
/// hardware, which shares no processor.
pub(super) fn raise_priority() {
    // Without permission, the rig is late more often, which it reports.
    let _ = rustix::process::setpriority_process(None, -20);
}
