//! The board's own code, seen from the simulator.

use singletrack_protocol::ResetCause;

use crate::car::ImuReading;

#[derive(Clone, Copy, Debug)]
pub(crate) struct FirmwareInputs {
    pub(crate) pulse_count: u16,
    pub(crate) last_pulse_us: Option<u32>,
    pub(crate) pulse_period_us: Option<u32>,
    pub(crate) imu: Option<(u32, ImuReading)>,
    pub(crate) battery_mv: u16,
    pub(crate) stop_input_open: bool,
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FirmwareOutputs {
    pub(crate) servo_us: u16,
    pub(crate) esc_us: u16,
}

impl FirmwareOutputs {
    pub(crate) fn supervised(self, _board_time_us: u32) -> Self {
        self
    }
}

#[derive(Debug)]
pub(crate) struct Firmware;

impl Firmware {
    pub(crate) fn new(_cause: ResetCause) -> Self {
        Self
    }

    pub(crate) fn poll(
        &mut self,
        _now_us: u32,
        inputs: &FirmwareInputs,
        _received: &[u8],
        _send: &mut dyn FnMut(&[u8]) -> bool,
    ) -> FirmwareOutputs {
        let _ = (
            inputs.pulse_count,
            inputs.last_pulse_us,
            inputs.pulse_period_us,
            inputs.imu,
            inputs.battery_mv,
            inputs.stop_input_open,
        );
        FirmwareOutputs {
            servo_us: 0,
            esc_us: 1500,
        }
    }
}
