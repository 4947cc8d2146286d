//! Runs small programs whose behaviour on the hardware is known to the cycle.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{
    io::BufReader,
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio},
};

use singletrack_simavr::{
    Bno055, BusFault, Hang, Motion, Pin, Pulse, Reply, Report, Request, ResetFlags, Run, receive,
    send,
};

/// Ten bits at 115200 baud, as generated from 16 MHz with U2X.
const BYTE: u64 = 10 * 17 * 8;
const VECTOR_TIMER0_COMPA: u8 = 14;

#[test]
fn bytes_are_echoed_after_one_byte_time() {
    let mut uno = Uno::started("echo.c");
    let sent = spaced(uno.cycle() + MS, BYTE, b"hello");
    let report = uno.run(Run {
        received: sent.clone(),
        ..uno.until(5 * MS)
    });
    assert_eq!(bytes(&report.transmitted), b"hello");
    for ((sent, _), (back, _)) in sent.iter().zip(&report.transmitted) {
        let cycles = back - sent - BYTE;
        assert!(cycles < 60, "{cycles} cycles of interrupt");
    }
    assert_eq!(report.bytes_overrun, 0);
}

#[test]
fn the_transmitter_sends_back_to_back() {
    let mut uno = Uno::started("burst.c");
    let report = uno.pass(5 * MS);
    assert_eq!(bytes(&report.transmitted), [0, 1, 2, 3]);
    for pair in report.transmitted.windows(2) {
        assert_eq!(pair[1].0 - pair[0].0, BYTE);
    }
}

#[test]
fn the_fourth_unread_byte_is_lost_and_reported() {
    let mut uno = Uno::started("deaf.c");
    let start = uno.cycle() + MS;
    let report = uno.run(Run {
        received: spaced(start, BYTE, &[1, 2, 3, 4, 5]),
        ..uno.until(8 * MS)
    });
    assert_eq!(report.bytes_overrun, 2);
    // Reported with the first byte read after the loss.
    assert_eq!(bytes(&report.transmitted), [8, 1, 0, 2, 0, 3]);
}

#[test]
fn three_unread_bytes_are_kept() {
    let mut uno = Uno::started("deaf.c");
    let start = uno.cycle() + MS;
    let report = uno.run(Run {
        received: spaced(start, BYTE, &[1, 2, 3]),
        ..uno.until(8 * MS)
    });
    assert_eq!(report.bytes_overrun, 0);
    assert_eq!(bytes(&report.transmitted), [0, 1, 0, 2, 0, 3]);
}

fn pulses_on(pulses: &[Pulse], pin: Pin) -> Vec<(u64, u64)> {
    pulses
        .iter()
        .filter(|pulse| pulse.pin == pin)
        .map(|pulse| (pulse.start, pulse.width))
        .collect()
}

#[test]
fn pulses_are_exact_to_the_cycle() {
    let mut uno = Uno::started("pulses.c");
    let report = uno.pass(200 * MS);
    let servo = pulses_on(&report.pulses, Pin::Servo);
    let esc = pulses_on(&report.pulses, Pin::Esc);
    assert_eq!((servo.len(), esc.len()), (10, 10));
    // The width of the first comes from the registers before the start of the timer.
    for ((servo, servo_width), (esc, esc_width)) in servo.iter().zip(&esc) {
        assert_eq!(servo, esc);
        assert_eq!((*servo_width, *esc_width), (1_500 * 16, 2_000 * 16));
    }
    for pair in servo.windows(2) {
        assert_eq!(pair[1].0 - pair[0].0, 20 * MS);
    }
}

#[test]
fn a_width_written_during_a_pulse_applies_from_the_next_one() {
    let mut uno = Uno::started("pulses.c");
    let mut pulses = uno.pass(21 * MS).pulses;
    let report = uno.run(Run {
        // In the middle of the second pulse.
        received: vec![(uno.cycle() + MS / 4, 0)],
        ..uno.until(60 * MS)
    });
    pulses.extend(report.pulses);
    let widths: Vec<_> = pulses_on(&pulses, Pin::Esc)
        .into_iter()
        .map(|(_, width)| width / 16)
        .collect();
    assert_eq!(widths, [2_000, 2_000, 1_000, 1_000]);
}

#[test]
fn a_reset_cuts_a_pulse() {
    let mut uno = Uno::started("pulses.c");
    uno.pass(20 * MS);
    let report = uno.pass(MS);
    assert_eq!(report.pulses, []);
    uno.ask(&Request::Hold);
    let held = uno.cycle();
    let report = uno.pass(100 * MS);
    let [servo, esc] = report.pulses.try_into().unwrap();
    assert_eq!(servo.start + servo.width, held);
    assert_eq!(servo.width, esc.width);
    assert!(esc.width < 2_000 * 16);
    // After the reset the program restarts.
    uno.ask(&Request::Start(ResetFlags::EXTERNAL));
    let report = uno.pass(30 * MS);
    assert_eq!(pulses_on(&report.pulses, Pin::Esc)[0].1, 2_000 * 16);
}

#[test]
fn the_watchdog_resets_after_64_ms_and_holds_the_processor() {
    let mut uno = Uno::started("watchdog.c");
    let start = uno.cycle();
    let mut report = uno.pass(100 * MS);
    let watchdog_reset = report.watchdog_reset.unwrap();
    let late = (watchdog_reset - start).checked_sub(64 * MS).unwrap();
    assert!(late < 3 * BYTE, "{late} cycles");
    let pulse = report.pulses.pop().unwrap();
    assert_eq!(pulse.start + pulse.width, watchdog_reset);
    assert_eq!(bytes(&report.transmitted), [ResetFlags::POWER_ON.0, 0]);

    let report = uno.pass(500 * MS);
    assert_eq!(report.watchdog_reset, None);
    assert_eq!(report.transmitted, []);

    uno.ask(&Request::Start(ResetFlags::WATCHDOG));
    let start = uno.cycle();
    let report = uno.pass(100 * MS);
    assert_eq!(bytes(&report.transmitted), [ResetFlags::WATCHDOG.0, 0]);
    assert_eq!(report.watchdog_reset.unwrap() - start, 64 * MS + late);
}

#[test]
fn edges_voltage_and_switch_reach_the_program() {
    let mut uno = Uno::started("inputs.c");
    let now = uno.cycle();
    for (edges, battery_mv, open) in [(0_u8, 7_400, false), (3, 8_400, true), (200, 0, true)] {
        let now = now.max(uno.cycle());
        let report = uno.run(Run {
            motor_edges: (0..u64::from(edges)).map(|n| now + MS + n * 400).collect(),
            received: vec![(now + 8 * MS, 0)],
            battery_mv,
            stop_input_open: open,
            ..uno.until(12 * MS)
        });
        let [counted, low, high, switch] = bytes(&report.transmitted).try_into().unwrap();
        assert_eq!(
            counted,
            [0, 3, 203][usize::from(edges.min(3) / 3 + edges / 200)]
        );
        // Half of the voltage, relative to 5 V, in 1024 steps.
        let counts = u32::from(battery_mv) / 2 * 1_024 / 5_000;
        assert_eq!(u32::from(u16::from_le_bytes([low, high])), counts);
        assert_eq!(switch != 0, open);
    }
}

#[test]
fn the_converter_measures_against_the_supply_and_its_reference_does_not() {
    let mut uno = Uno::started("supply.c");
    for (supply_mv, battery_mv, divider_open) in [
        (5_000, 7_400, false),
        (4_500, 7_400, false),
        (5_000, 0, true),
    ] {
        let report = uno.run(Run {
            received: vec![(uno.cycle() + MS, 0)],
            battery_mv,
            supply_mv,
            divider_open,
            ..uno.until(12 * MS)
        });
        let words: Vec<_> = bytes(&report.transmitted)
            .chunks(2)
            .map(|word| u32::from(u16::from_le_bytes([word[0], word[1]])))
            .collect();
        let [pin, pulled_up, bandgap] = words[..] else {
            panic!("{words:?}")
        };
        let supply = u32::from(supply_mv);
        assert!(
            bandgap.abs_diff(1_100 * 1_024 / supply) <= 1,
            "{supply}: {bandgap}"
        );
        if divider_open {
            assert_eq!(pulled_up, 1_023);
            assert!(pin < 1_000, "{pin}");
        } else {
            assert_eq!(pin, u32::from(battery_mv) / 2 * 1_024 / supply);
            assert!(pin < pulled_up && pulled_up < 950, "{pin} {pulled_up}");
        }
    }
}

#[test]
fn the_kill_output_is_reported_with_its_times() {
    let mut uno = Uno::started("kill.c");
    let start = uno.cycle();
    let report = uno.run(Run {
        received: vec![
            (start + 2 * MS, 1),
            (start + 5 * MS, 0),
            (start + 8 * MS, 1),
        ],
        ..uno.until(10 * MS)
    });
    let [(on, true), (off, false), (_, true)] = report.kill_output[..] else {
        panic!("{:?}", report.kill_output)
    };
    assert!(on - start - 2 * MS < MS / 10 && off - start - 5 * MS < MS / 10);
    // The pin floats, and the pull-down holds it.
    uno.ask(&Request::Hold);
    let held = uno.cycle();
    assert_eq!(uno.pass(MS).kill_output, [(held, false)]);
}

#[test]
fn edges_around_a_restart_cause_no_interrupts() {
    let mut uno = Uno::started("inputs.c");
    uno.pass(MS);
    assert_eq!(uno.ask(&Request::Hold), Reply::Done);
    let edge_at = |cycle, until| Run {
        motor_edges: vec![cycle],
        ..until
    };
    uno.run(edge_at(uno.cycle() + MS, uno.until(2 * MS)));
    let restart = Request::Start(ResetFlags::WATCHDOG);
    assert_eq!(uno.ask(&restart), Reply::Done);
    uno.run(edge_at(uno.cycle() + 1, uno.until(5 * MS)));
    let report = uno.run(Run {
        received: vec![(uno.cycle() + 10, 0)],
        ..uno.until(4 * MS)
    });
    assert!(bytes(&report.transmitted)[0] <= 1);
}

fn talk(uno: &mut Uno, commands: &[u8]) -> Vec<u8> {
    let report = uno.run(Run {
        received: spaced(uno.cycle() + MS, MS, commands),
        ..uno.until((commands.len() as u64 + 4) * MS)
    });
    bytes(&report.transmitted)
}

const WRITE: u8 = Bno055::ADDRESS << 1;
const READ: u8 = WRITE | 1;

fn with_a_ready_imu() -> Uno {
    let mut uno = Uno::started("imu.c");
    uno.pass(700 * MS);
    uno
}

#[test]
fn a_transaction_gives_the_status_codes_of_the_data_sheet() {
    let mut uno = with_a_ready_imu();
    let answers = talk(
        &mut uno,
        &[
            b's', b'w', WRITE, b'w', 0, b's', b'w', READ, b'r', 1, b'r', 0, b'p',
        ],
    );
    assert_eq!(
        answers,
        [0x08, 0x18, 0x28, 0x10, 0x40, 0x50, 0xA0, 0x58, 0xFB]
    );
}

#[test]
fn the_imu_returns_the_motion_of_the_car() {
    let mut uno = with_a_ready_imu();
    let now = uno.cycle();
    uno.run(Run {
        motion: vec![
            (now, Motion::default()),
            (
                now + MS,
                Motion {
                    angular_velocity_mrad_s: [0, 0, 1_000],
                    ..Motion::default()
                },
            ),
        ],
        ..uno.until(2 * MS)
    });
    // Selects the fusion without magnetometer, then reads the gyroscope's z.
    assert_eq!(
        talk(&mut uno, &[b's', b'w', WRITE, b'w', 0x3D, b'w', 0x08, b'p']),
        [0x08, 0x18, 0x28, 0x28]
    );
    uno.pass(10 * MS);
    let answers = talk(
        &mut uno,
        &[
            b's', b'w', WRITE, b'w', 0x18, b's', b'w', READ, b'r', 1, b'r', 0, b'p',
        ],
    );
    assert_eq!(i16::from_le_bytes([answers[6], answers[8]]), 917);
}

#[test]
fn an_absent_imu_acknowledges_nothing() {
    let mut uno = with_a_ready_imu();
    assert_eq!(talk(&mut uno, &[b's', b'w', 0x52, b'p']), [0x08, 0x20]);
    uno.ask(&Request::SetBus(BusFault::Absent));
    assert_eq!(talk(&mut uno, &[b's', b'w', WRITE, b'p']), [0x08, 0x20]);
    assert_eq!(talk(&mut uno, &[b's', b'w', READ, b'p']), [0x08, 0x48]);
    uno.ask(&Request::SetBus(BusFault::None));
    assert_eq!(talk(&mut uno, &[b's', b'w', WRITE, b'p']), [0x08, 0x18]);
}

#[test]
fn nine_pulses_free_a_jammed_bus_but_not_a_shorted_one() {
    let mut uno = with_a_ready_imu();
    uno.ask(&Request::SetBus(BusFault::Jammed));
    assert_eq!(talk(&mut uno, b"s"), [0xFF]);
    assert_eq!(talk(&mut uno, b"c"), [0x10]);
    assert_eq!(talk(&mut uno, b"sp"), [0x08]);
    uno.ask(&Request::SetBus(BusFault::ShortCircuit));
    assert_eq!(talk(&mut uno, b"s"), [0xFF]);
    assert_eq!(talk(&mut uno, b"c"), [0]);
    assert_eq!(talk(&mut uno, b"s"), [0xFF]);
    uno.ask(&Request::SetBus(BusFault::None));
    assert_eq!(talk(&mut uno, b"sp"), [0x08]);
}

#[test]
fn an_imu_that_restarted_is_in_its_configuration_mode() {
    let mut uno = with_a_ready_imu();
    let read_mode = [
        b's', b'w', WRITE, b'w', 0x3D, b's', b'w', READ, b'r', 0, b'p',
    ];
    talk(&mut uno, &[b's', b'w', WRITE, b'w', 0x3D, b'w', 0x08, b'p']);
    assert_eq!(talk(&mut uno, &read_mode).last(), Some(&0x08));
    uno.ask(&Request::SetBus(BusFault::Restarted));
    assert_eq!(talk(&mut uno, &read_mode).last(), Some(&0x00));
}

#[test]
fn a_hung_main_loop_still_serves_interrupts() {
    let mut uno = Uno::started("hang.c");
    uno.pass(3 * MS);
    assert_eq!(bytes(&uno.pass(10 * MS).transmitted), [1; 10]);
    uno.ask(&Request::Hang(Hang::MainLoop));
    let report = uno.pass(10 * MS);
    // The first one still reports the time before the hang.
    assert_eq!(bytes(&report.transmitted)[1..], [0; 9]);
    uno.ask(&Request::Start(ResetFlags::WATCHDOG));
    uno.pass(3 * MS);
    assert_eq!(bytes(&uno.pass(10 * MS).transmitted), [1; 10]);
}

#[test]
fn with_interrupts_disabled_only_the_watchdog_ends_a_hang() {
    let mut uno = Uno::started("hang.c");
    uno.pass(3 * MS + MS / 2);
    uno.ask(&Request::Hang(Hang::Everything));
    let report = uno.pass(10 * MS);
    assert!(report.transmitted.len() <= 1, "{:?}", report.transmitted);
    assert_eq!(uno.pass(MS).transmitted, []);

    let mut uno = Uno::started("watchdog.c");
    uno.pass(MS);
    uno.ask(&Request::Hang(Hang::Everything));
    assert!(uno.pass(100 * MS).watchdog_reset.is_some());
}

#[test]
fn time_advances_during_resets() {
    let mut uno = Uno::started("echo.c");
    let mut last = uno.cycle();
    for request in [
        Request::Hold,
        Request::Start(ResetFlags::EXTERNAL),
        Request::Start(ResetFlags::WATCHDOG),
        Request::Hold,
    ] {
        uno.ask(&request);
        let report = uno.pass(MS);
        assert!((last + MS..last + MS + 4).contains(&report.cycle));
        last = report.cycle;
    }
}

#[test]
fn figures_match_the_program() {
    let mut uno = Uno::started("figures.S");
    let start = uno.cycle();
    let now = uno.pass(100 * MS).cycle;
    let Reply::Figures(figures) = uno.ask(&Request::Measure) else {
        panic!("no figures");
    };
    assert_eq!(figures.cycles, now - start);
    // Main program and interrupt take about 70 cycles per millisecond.
    let awake = figures.cycles - figures.cycles_asleep;
    assert!((5_000..9_000).contains(&awake), "{awake}");
    // Return address, sixteen pushes, return address of the interrupt.
    assert_eq!(figures.stack_bytes, 20);
    assert_eq!(figures.longest_critical_section, 10);
    let [interrupt] = figures.interrupts.try_into().unwrap();
    assert_eq!(interrupt.number, VECTOR_TIMER0_COMPA);
    assert!((99..=100).contains(&interrupt.count));
    // Waking the processor takes four more.
    assert_eq!(interrupt.most_cycles, 36);
    assert_eq!(interrupt.all_cycles, 36 * interrupt.count);
    let [section] = figures.sections.try_into().unwrap();
    assert_eq!((section.number, section.most_cycles), (3, 7));
    assert_eq!(section.all_cycles, 7 * section.count);
}

#[test]
fn instructions_take_the_cycles_of_the_data_sheet() {
    let mut uno = Uno::started("cycles.S");
    uno.pass(MS);
    let Reply::Figures(figures) = uno.ask(&Request::Measure) else {
        panic!("no figures");
    };
    let cycles: Vec<_> = figures
        .sections
        .iter()
        .map(|section| {
            assert_eq!(section.count, 1);
            (section.number, section.most_cycles - 1)
        })
        .collect();
    // CALL and RCALL and ICALL with the RET.
    let expected = [
        1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 2, 3, 2, 3, 8, 7, 7, 1, 2, 2, 3, 2, 2, 2, 1, 1,
    ];
    assert_eq!(cycles, (1..).zip(expected).collect::<Vec<_>>());
}

#[test]
fn a_crash_is_reported_with_cycle_and_address_until_the_next_start() {
    for (command, place) in [(b'j', "0x6000"), (b'x', "0x00")] {
        let mut uno = Uno::started("crash.c");
        assert_eq!(uno.pass(MS).transmitted, []);
        let run = Run {
            received: vec![(uno.cycle() + MS, command)],
            ..uno.until(2 * MS)
        };
        let Reply::Failed(reason) = uno.ask(&Request::Run(run)) else {
            panic!("no failure");
        };
        assert!(reason.contains("crashed in cycle 3"), "{reason}");
        assert!(reason.contains(place), "{reason}");
        let run = uno.until(MS);
        assert!(matches!(uno.ask(&Request::Run(run)), Reply::Failed(_)));
        uno.ask(&Request::Start(ResetFlags::EXTERNAL));
        uno.pass(4 * MS);
    }
}

#[test]
fn an_invalid_image_is_refused_with_its_name() {
    for (path, reason) in [
        ("/nonexistent/uno.elf", "can't read /nonexistent/uno.elf"),
        ("/bin/sh", "/bin/sh is not an ELF file of 32 bits"),
    ] {
        let output = command().arg(path).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert_eq!(output.stdout, []);
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(error.contains(reason), "{error}");
    }
}

#[test]
fn the_process_ends_with_its_pipe() {
    let uno = Uno::started("echo.c");
    assert_eq!(uno.close().code(), Some(0));
}

/// A millisecond in cycles.
const MS: u64 = 16_000;

fn command() -> Command {
    Command::new(env!("CARGO_BIN_EXE_singletrack-simavr"))
}

/// The process running a program.
pub(crate) struct Uno {
    process: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    cycle: u64,
}

impl Uno {
    /// A process with the program started after power-on.
    fn started(source: &str) -> Self {
        let mut process = command()
            .arg(built(source))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut uno = Self {
            input: process.stdin.take().unwrap(),
            output: BufReader::new(process.stdout.take().unwrap()),
            process,
            cycle: 0,
        };
        assert_eq!(uno.ask(&Request::Start(ResetFlags::POWER_ON)), Reply::Done);
        uno
    }

    fn ask(&mut self, request: &Request) -> Reply {
        send(&mut self.input, request).unwrap();
        receive(&mut self.output).unwrap().unwrap()
    }

    fn run(&mut self, run: Run) -> Report {
        let until = run.until;
        match self.ask(&Request::Run(run)) {
            Reply::Ran(report) => {
                assert!((until..until + 12).contains(&report.cycle), "{report:?}");
                self.cycle = report.cycle;
                report
            }
            other => panic!("{other:?}"),
        }
    }

    /// Runs for a number of cycles without inputs.
    fn pass(&mut self, cycles: u64) -> Report {
        self.run(self.until(cycles))
    }

    /// A run of a number of cycles without inputs.
    fn until(&self, cycles: u64) -> Run {
        Run {
            until: self.cycle + cycles,
            battery_mv: 7_400,
            ..Run::default()
        }
    }

    const fn cycle(&self) -> u64 {
        self.cycle
    }

    fn close(self) -> ExitStatus {
        let Self {
            mut process, input, ..
        } = self;
        drop(input);
        process.wait().unwrap()
    }
}

/// Bytes at regular intervals.
fn spaced(start: u64, interval: u64, bytes: &[u8]) -> Vec<(u64, u8)> {
    (start..)
        .step_by(interval as usize)
        .zip(bytes.iter().copied())
        .collect()
}

fn bytes(dated: &[(u64, u8)]) -> Vec<u8> {
    dated.iter().map(|(_, byte)| *byte).collect()
}

fn built(source: &str) -> std::path::PathBuf {
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/programs");
    // Tests run in parallel: each has its own file.
    let name = std::thread::current().name().unwrap_or("test").to_owned();
    let image = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{source}.elf"));
    let status = Command::new("avr-gcc")
        .args([
            "-mmcu=atmega328p",
            "-Os",
            "-Wall",
            "-Werror",
            "-DF_CPU=16000000UL",
        ])
        .arg(sources.join(source))
        .arg("-o")
        .arg(&image)
        .status()
        .expect("avr-gcc, from Debian's gcc-avr and avr-libc");
    assert!(status.success());
    image
}
