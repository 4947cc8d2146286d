//! The real board, with a motor that turns when it is driven.

use singletrack_board::{Board, ImuSample, Inputs, Outputs};
use singletrack_protocol::{BoardMode, Configuration, ResetCause, UNNAMED};

/// Time between two motor pulses at about 0.4 m/s.
const PULSE_US: u32 = 12_000;

pub(crate) struct TestBoard {
    board: Board,
    inputs: Inputs,
    outputs: Outputs,
    /// How often it went from not armed to armed.
    pub(crate) armed: u32,
    /// Commands obeyed, distinguished by the end of their time to live.
    pub(crate) driven: u32,
}

impl TestBoard {
    pub(crate) fn started() -> Self {
        let board = Board::new(ResetCause::External, [0, 1, 0], UNNAMED);
        Self {
            outputs: board.outputs(),
            board,
            inputs: Inputs {
                battery_mv: 7_400,
                ..Inputs::default()
            },
            armed: 0,
            driven: 0,
        }
    }

    pub(crate) fn mode(&self) -> BoardMode {
        self.board.mode()
    }

    pub(crate) fn configuration(&self) -> Option<&Configuration> {
        self.board.configuration()
    }

    /// What the board says at `now_us` to the bytes that have arrived.
    pub(crate) fn poll(&mut self, now_us: u32, bytes: &[u8]) -> Vec<u8> {
        let turning = self.mode() == BoardMode::Driving;
        if turning && now_us.wrapping_sub(self.inputs.motor.last_edge_us) >= PULSE_US {
            self.inputs.motor.count = self.inputs.motor.count.wrapping_add(1);
            self.inputs.motor.last_edge_us = now_us;
        }
        self.inputs.imu = Some(ImuSample {
            time_us: now_us,
            ..ImuSample::default()
        });
        let was_armed = self.is_armed();
        let mut said = Vec::new();
        let outputs = self.board.poll(now_us, &self.inputs, bytes, &mut |frame| {
            said.extend_from_slice(frame);
            true
        });
        let deadline_us = outputs.drive_deadline_us;
        self.armed += u32::from(!was_armed && self.is_armed());
        self.driven +=
            u32::from(deadline_us.is_some() && deadline_us != self.outputs.drive_deadline_us);
        self.outputs = outputs;
        said
    }

    fn is_armed(&self) -> bool {
        matches!(self.mode(), BoardMode::Armed | BoardMode::Driving)
    }
}
