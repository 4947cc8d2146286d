//! Cost of the codec and of a poll. Not flashed: the simulator counts the cycles
//! between the markers of each section.
//!
//! | Section | Work |
//! |---|---|
//! | 1 | decode a Drive frame, all bytes of it |
//! | 2 | decode a Configure frame |
//! | 3 | encode a Telemetry frame |
//! | 4 | encode a Status frame |
//! | 5 | a poll with nothing to do |
//! | 6 | a poll with control and telemetry due |

#![no_std]
#![no_main]
#![feature(asm_experimental_arch)]

#[path = "../shared.rs"]
mod shared;

use core::{arch::asm, hint::black_box, panic::PanicInfo};

use singletrack_board::{Board, Inputs};
use singletrack_protocol::{
    BoardMode, Configuration, Configure, Decoder, Drive, EscCalibration, EscKind, FailsafeAction,
    Frame, ImuAxes, ImuState, LONGEST_ROLL_OUT_MS, RefusalReason, ResetCause, Sequence,
    ServoCalibration, SpeedLoop, Status, StopCause, Telemetry, ToBoard, ToHost,
};

use shared::{InPlace, measured};

const ROUNDS: u8 = 100;

const CONFIGURATION: Configuration = Configuration {
    servo: ServoCalibration {
        centre_us: 1_490,
        gain_us_per_rad: -800,
        min_us: 1_100,
        max_us: 1_900,
        slew_us_per_20ms: 90,
    },
    esc: EscCalibration {
        kind: EscKind::Car,
        neutral_us: 1_500,
        deadband_us: 30,
        min_us: 1_000,
        max_us: 2_000,
        slew_us_per_20ms: 60,
        brake_us: 1_200,
    },
    speed: SpeedLoop {
        pulse_distance_um: 5_000,
        feed_forward_us_per_m_s: 100,
        proportional_us_per_m_s: 50,
        integral_us_per_m: 200,
        integral_limit_us: 80,
        max_forward_mm_s: 3_000,
        max_reverse_mm_s: 500,
    },
    failsafe: FailsafeAction::Brake,
    max_pose_age_ms: 900,
    stop_input: true,
    kill_output: false,
    max_roll_out_ms: LONGEST_ROLL_OUT_MS,
    car_id: 0,
    imu_axes: ImuAxes::AS_PRINTED,
};

/// Entered from the C runtime's start-up code.
// SAFETY: the name is the one that the start-up code calls, and nothing else has it.
#[allow(unsafe_code)]
#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    for round in 0..ROUNDS {
        let number = i16::from(round) * 321;
        measure_codec(round, number);
    }
    measure_polls();
    stop()
}

fn measure_codec(round: u8, number: i16) {
    let drive = ToBoard::Drive(Drive {
        sequence: Sequence(round),
        speed_mm_s: number,
        steering_100urad: -number,
        telemetry_time_us: u32::from(number.unsigned_abs()) << 12,
        pose_age_ms: 12,
        brake: false,
    });
    measure_decoding(1, &drive.encode());
    let configure = ToBoard::Configure(Configure {
        request: Sequence(round),
        configuration: CONFIGURATION,
    });
    measure_decoding(2, &configure.encode());

    let telemetry = ToHost::Telemetry(Telemetry {
        board_time_us: u32::from(number.unsigned_abs()) << 12,
        mode: BoardMode::Driving,
        stop_cause: StopCause::None,
        last_sequence: Sequence(round),
        imu: ImuState::Fresh,
        imu_age_100us: 12,
        linear_acceleration_mm_s2: [number, 0, -number],
        angular_velocity_mrad_s: [0, number, 1],
        attitude_q14: [16_384, 0, -number, number],
        motor_speed_mm_s: number,
        servo_us: 1_490,
        esc_us: 1_540,
    });
    let telemetry = black_box(telemetry);
    black_box(measured(3, || telemetry.encode()));

    let status = ToHost::Status(Status {
        board_time_us: u32::from(number.unsigned_abs()) << 12,
        configuration_hash: 0x1234_0056,
        reset_cause: ResetCause::PowerOn,
        stop_input_open: false,
        battery_mv: 7_400,
        frames_received: number.unsigned_abs(),
        frames_damaged: 0,
        drives_refused: 1,
        last_refusal: RefusalReason::None,
        frames_dropped: 0,
        bytes_overrun: 0,
        imu_errors: 3,
        supply_mv: 5_000,
        battery_open: false,
        power_on: false,
        edges_refused: 0,
        imu_calibration: 0xFF,
        imu_status: 5,
        imu_error: 0,
        imu_self_test: 0x0F,
    });
    let status = black_box(status);
    black_box(measured(4, || status.encode()));
}

fn measure_decoding(section: u8, frame: &Frame) {
    let mut decoder = black_box(Decoder::new());
    let frame = black_box(frame.as_bytes());
    measured(section, || {
        for &byte in frame {
            if let Some(Ok(packet)) = decoder.push(byte) {
                let _ = black_box(ToBoard::decode(packet));
            }
        }
    });
}

/// Polls of a configured board that does not drive, which would need a host.
fn measure_polls() {
    const POLL_US: u32 = 1_000;
    const POLLS_PER_CONTROL: u8 = 10;
    const POLLS_PER_STATUS: u8 = 200;

    static BOARD: InPlace<Board> = InPlace::new(Board::new(ResetCause::PowerOn, [0; 3], 0));

    // SAFETY: this function is called only once.
    #[allow(unsafe_code)]
    let board = unsafe { BOARD.take() };
    let inputs = black_box(Inputs::default());
    let configure = ToBoard::Configure(Configure {
        request: Sequence(1),
        configuration: CONFIGURATION,
    });
    let mut now_us = 0_u32;
    let mut transmit = |frame: &[u8]| {
        black_box(frame);
        true
    };
    board.poll(
        now_us,
        &inputs,
        configure.encode().as_bytes(),
        &mut transmit,
    );
    for poll in 1..=POLLS_PER_STATUS {
        now_us += POLL_US;
        let section = if poll == POLLS_PER_STATUS {
            0
        } else if poll % POLLS_PER_CONTROL == 0 {
            6
        } else {
            5
        };
        let now_us = black_box(now_us);
        black_box(measured(section, || {
            board.poll(now_us, &inputs, &[], &mut transmit)
        }));
    }
}

/// Sleeping with interrupts masked also ends the simulator.
fn stop() -> ! {
    loop {
        // SAFETY: stopping the processor is always sound.
        #[allow(unsafe_code)]
        unsafe {
            asm!("cli", "sleep");
        }
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    stop()
}
