//! Requests to arm that come at a bad moment.

use core::{
    pin::pin,
    task::{Context, Poll, Waker},
};
use std::sync::{Arc, mpsc};

use rtrb::{Consumer, RingBuffer};
use singletrack_core::{Config, ControlRequest, Host, HostOptions, Requests, certificate};
use singletrack_pilot::{Arming, Mode, PilotRequest};
use tokio::{
    io::{AsyncBufReadExt, AsyncWriteExt, BufReader},
    net::UnixStream,
    runtime::{Builder, Runtime},
};

use super::{
    answers::end,
    arm::begin,
    command::{Arm, Attendance},
    drives::Drives,
    serve::serve,
};
use crate::{
    clock::monotonic_ns, commissioned_file::CommissionedFile, control_thread::ControlThreadState,
    handle::DaemonHandle, realtime::RealTimeStatus, reconfigure::Reconfigurer,
    shared_status::SharedStatus,
};

const UNATTENDED: Arm = Arm {
    attendance: Attendance::Unattended,
    hold: None,
    start_ns: None,
    uncalibrated: true,
};

const HELD: Arm = Arm {
    attendance: Attendance::Hold,
    hold: None,
    start_ns: None,
    uncalibrated: true,
};

/// A daemon without threads: the test sets the mode, and requests stay in their ring.
struct Bench {
    daemon: DaemonHandle,
    requests: Consumer<ControlRequest>,
    runtime: Runtime,
}

impl Bench {
    /// With the example's circle, which can be driven.
    fn ready() -> Self {
        let text = include_str!("../../singletrackd.example.toml");
        Self::with(Config::from_toml(text).unwrap())
    }

    fn with(mut config: Config) -> Self {
        config.state.directory = "/nonexistent".into();
        let commissioned = CommissionedFile::load(&config.state.directory);
        let host =
            Host::<crate::serial_port::WriteHalf>::new(config, HostOptions::default()).unwrap();
        let (ring, requests) = RingBuffer::new(16);
        let ring = Requests::new(ring);
        let (entries, _) = mpsc::channel();
        let daemon = DaemonHandle {
            status: Arc::new(SharedStatus::new(singletrack_record::ClockMapping {
                monotonic_ns: 0,
                wall_ns: 0,
            })),
            control: ControlThreadState::default(),
            reconfigurer: Reconfigurer::new(host.configurations, ring.clone(), entries),
            requests: ring,
            setpoints: host.setpoints,
            newest_setpoint: Arc::default(),
            jogs: host.jogs,
            tunings: host.tunings,
            config_path: None,
            record: None,
            realtime: RealTimeStatus {
                fifo_priority: None,
                memory_locked: false,
                idle_bounded: false,
                refusals: Vec::new(),
            },
            commissioned,
            drives: Drives::default(),
        };
        let bench = Self {
            daemon,
            requests,
            runtime: Builder::new_current_thread().enable_all().build().unwrap(),
        };
        bench.tick(Mode::Ready);
        bench
    }

    /// The pilot has this mode after a tick.
    fn tick(&self, mode: Mode) {
        self.daemon.status.tick(monotonic_ns(), mode, |_| {});
    }

    /// The outcome of an `arm` during whose judgement something happens.
    fn arm_while(&self, happens: impl FnOnce(&Self)) -> Result<(), String> {
        let _context = self.runtime.enter();
        let judging = self.daemon.reconfigurer.pause();
        let mut begun = pin!(begin(&self.daemon, UNATTENDED));
        // It runs up to the judgement, which waits for the configuration.
        let polled = begun.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        assert!(polled.is_pending());
        happens(self);
        drop(judging);
        let begun = self.runtime.block_on(begun);
        begun.map(drop).map_err(|refused| refused.text)
    }

    /// The refusal of an `arm`, without waiting for anything.
    fn refusal_now(&self) -> String {
        let begun = pin!(begin(&self.daemon, UNATTENDED));
        match begun.poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(Err(error)) => error.text,
            Poll::Ready(Ok(_)) => "armed".to_owned(),
            Poll::Pending => "judged".to_owned(),
        }
    }

    fn ask(&self, request: PilotRequest) {
        let answered = end(request, &self.daemon);
        assert!(answered.ok);
    }

    /// The requests that have reached the pilot.
    fn requests(&mut self) -> Vec<ControlRequest> {
        core::iter::from_fn(|| self.requests.pop().ok()).collect()
    }
}

#[test]
fn an_arm_is_refused_without_the_certificate_that_the_configuration_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("filter-certificate.json");
    let text = include_str!("../../singletrackd.example.toml");
    let mut config = Config::from_toml(text).unwrap();
    config.safety_filter.enabled = true;
    config.safety_filter.certificate = Some(path.clone());
    let mut bench = Bench::with(config.clone());
    let error = bench.arm_while(|_| {}).unwrap_err();
    for part in [
        "can't arm",
        "filter-certificate.json",
        "singletrack certify",
    ] {
        assert!(error.contains(part), "{part}: {error}");
    }
    assert_eq!(bench.requests().len(), 0);
    std::fs::write(&path, certificate::certificate(&config).unwrap()).unwrap();
    bench.arm_while(|_| {}).unwrap();
    assert_eq!(bench.requests().len(), 1);
}

#[test]
fn a_second_arm_is_refused_while_the_first_is_judged_and_until_it_has_reached_the_pilot() {
    let mut bench = Bench::ready();
    let result = bench.arm_while(|bench| {
        let error = bench.refusal_now();
        assert!(error.contains("another client is being judged"), "{error}");
    });
    assert_eq!(result, Ok(()));
    let error = bench.refusal_now();
    assert!(error.contains("another client has just armed"), "{error}");
    assert_eq!(
        bench.requests(),
        [ControlRequest::Pilot(PilotRequest::Arm(Arming::Unattended))]
    );
}

#[test]
fn a_stop_is_obeyed_by_a_control_thread_that_ticks_however_old_its_last_known_tick_is() {
    let mut bench = Bench::ready();
    let now_ns = monotonic_ns();
    let told = |bench: &Bench, request| end(request, &bench.daemon);
    // The collector is late, and the thread is not.
    bench.daemon.status.tick(1, Mode::Ready, |_| {});
    bench.daemon.control.ticked(now_ns);
    let requests = [
        PilotRequest::Disarm,
        PilotRequest::EmergencyStop,
        PilotRequest::Halt,
    ];
    for request in requests {
        assert_eq!(told(&bench, request).error, None);
    }
    assert_eq!(bench.requests().len(), 3);
    // The other way round.
    bench.tick(Mode::Ready);
    bench.daemon.control.ticked(now_ns - 600_000_000);
    for request in requests {
        let error = told(&bench, request).error.unwrap();
        assert!(error.contains("the control thread is stuck"), "{error}");
    }
    assert_eq!(bench.requests().len(), 3, "it may come round");
}

#[test]
fn what_comes_while_an_arm_is_judged_ends_it() {
    type Happens = fn(&Bench);
    let cases: [(Happens, &str, Option<PilotRequest>); 4] = [
        (
            |bench| bench.ask(PilotRequest::Disarm),
            "a disarm or a stop has come meanwhile",
            Some(PilotRequest::Disarm),
        ),
        (
            |bench| bench.ask(PilotRequest::EmergencyStop),
            "a disarm or a stop has come meanwhile",
            Some(PilotRequest::EmergencyStop),
        ),
        (
            |bench| bench.daemon.reconfigurer.renumber(),
            "the configuration has changed meanwhile",
            None,
        ),
        (|bench| bench.tick(Mode::Idle), "mode idle", None),
    ];
    for (happens, refusal, request) in cases {
        let mut bench = Bench::ready();
        let error = bench.arm_while(happens).unwrap_err();
        assert!(error.contains(refusal), "{refusal}: {error}");
        let passed: Vec<_> = request.into_iter().map(ControlRequest::Pilot).collect();
        assert_eq!(bench.requests(), passed, "{refusal}");
        if request.is_some() {
            // It voids no later one.
            assert_eq!(bench.arm_while(|_| {}), Ok(()), "{refusal}");
        }
    }
}

#[test]
fn a_car_that_has_passed_no_procedure_is_not_armed_unless_the_client_says_so() {
    let mut bench = Bench::ready();
    let calibrated = Arm {
        uncalibrated: false,
        ..UNATTENDED
    };
    let error = bench
        .runtime
        .block_on(begin(&bench.daemon, calibrated))
        .map(drop)
        .unwrap_err();
    assert!(error.text.contains("Run `singletrack doctor`"), "{error}");
    assert_eq!(bench.requests(), []);
    assert_eq!(bench.arm_while(|_| {}), Ok(()));
}

#[test]
fn a_procedure_is_refused_before_its_first_step_as_an_arm_is() {
    use super::answers::commissioned;
    use singletrack_core::commissioned::{
        Procedure::{BringUp, Calibrate, Doctor},
        ProcedureResult::{Begun, Passed, Resumed},
    };
    let folder = tempfile::tempdir().unwrap();
    let mut bench = Bench::ready();
    bench.daemon.commissioned = CommissionedFile::load(folder.path());
    let report = |procedure, result, uncalibrated| {
        let answer = commissioned(procedure, result, uncalibrated, &bench.daemon);
        bench.runtime.block_on(answer).error
    };
    for (procedure, result) in [(BringUp, Begun), (Calibrate, Begun), (Calibrate, Resumed)] {
        let refusal = report(procedure, result, false).unwrap();
        assert!(refusal.contains("Run `singletrack doctor`"), "{refusal}");
        assert_eq!(report(procedure, result, true), None);
    }
    for procedure in [Doctor, BringUp] {
        let refusal = report(Calibrate, Begun, false).unwrap();
        assert!(refusal.contains("Run `singletrack"), "{refusal}");
        for result in [Begun, Passed] {
            assert_eq!(report(procedure, result, false), None);
        }
    }
    assert_eq!(report(Calibrate, Begun, false), None);
}

#[test]
fn an_arm_says_that_nothing_is_recorded_or_soon_will_not_be() {
    for (error, warning, warnings) in [
        (None, None, vec![]),
        (None, Some("nearly full"), vec!["nearly full"]),
        (
            Some("full"),
            Some("nearly full"),
            vec!["nothing is recorded: full"],
        ),
    ] {
        for attendance in ["\"unattended\"", "\"hold\""] {
            let bench = Bench::ready();
            let mut latest = bench.daemon.status.latest();
            latest.record_error = error.map(str::to_owned);
            latest.record_warning = warning.map(str::to_owned);
            drop(latest);
            let answer = bench.runtime.block_on(async {
                let (mut client, server) = UnixStream::pair().unwrap();
                let line = format!(
                    "{{\"version\":3,\"command\":\"arm\",\"attendance\":{attendance},\
                     \"uncalibrated\":true}}\n"
                );
                client.write_all(line.as_bytes()).await.unwrap();
                let mut answer = String::new();
                let read = async {
                    BufReader::new(client).read_line(&mut answer).await.unwrap();
                };
                let drives = async {
                    while bench.requests.is_empty() {
                        tokio::time::sleep(core::time::Duration::from_millis(1)).await;
                    }
                    bench.tick(Mode::Driving);
                    std::future::pending::<()>().await;
                };
                tokio::select! {
                    served = serve(server.into(), &bench.daemon) => served.unwrap(),
                    () = read => {}
                    () = drives => {}
                }
                answer
            });
            let answer: singletrack_api::Answer = serde_json::from_str(&answer).unwrap();
            assert!(answer.ok);
            assert_eq!(answer.warnings, warnings, "{attendance}");
        }
    }
}

#[test]
fn a_client_that_hangs_up_while_its_arm_is_judged_arms_nothing() {
    let mut bench = Bench::ready();
    {
        let _context = bench.runtime.enter();
        let judging = bench.daemon.reconfigurer.pause();
        let mut begun = Box::pin(begin(&bench.daemon, HELD));
        let polled = begun.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        assert!(polled.is_pending());
        drop(begun);
        // The judgement goes on for its own sake, one at a time.
        let error = bench.refusal_now();
        assert!(error.contains("another client is being judged"), "{error}");
        drop(judging);
    }
    let judging = bench.daemon.drives.judging();
    drop(bench.runtime.block_on(judging.lock()));
    assert_eq!(bench.requests(), []);
    assert_eq!(bench.arm_while(|_| {}), Ok(()));
}

#[test]
fn a_set_point_that_has_no_effect_is_answered_so_on_a_connection_that_holds_a_drive_too() {
    let mut bench = Bench::ready();
    let answers = bench.runtime.block_on(async {
        let (client, server) = UnixStream::pair().unwrap();
        let client = async move {
            let (read, mut write) = client.into_split();
            let lines = concat!(
                r#"{"version":3,"command":"arm","attendance":"hold","uncalibrated":true}"#,
                "\n",
                r#"{"version":3,"command":"setpoint","velocity_m_s":[0.3,0.0]}"#,
                "\n",
                r#"{"version":3,"command":"watch"}"#,
                "\n",
            );
            write.write_all(lines.as_bytes()).await.unwrap();
            let mut read = BufReader::new(read).lines();
            [
                read.next_line().await.unwrap().unwrap(),
                read.next_line().await.unwrap().unwrap(),
            ]
        };
        let (served, answers) = tokio::join!(serve(server.into(), &bench.daemon), client);
        served.unwrap();
        answers
    });
    assert!(
        answers[0].contains("set-points are not in use"),
        "{answers:?}"
    );
    assert!(answers[1].contains("it takes hold, status"), "{answers:?}");
    let requests = [PilotRequest::Arm(Arming::Held), PilotRequest::OperatorGone];
    assert_eq!(bench.requests(), requests.map(ControlRequest::Pilot));
}

#[test]
fn a_stop_waits_for_a_line_of_each_client_that_sends_without_a_pause() {
    const FLOODERS: usize = 20;
    let mut bench = Bench::ready();
    let served = bench.runtime.block_on(async {
        let serve_with = |theirs: UnixStream| {
            let daemon = bench.daemon.clone();
            tokio::spawn(async move { serve(theirs.into(), &daemon).await })
        };
        let mut flooders = Vec::new();
        for _ in 0..FLOODERS {
            let (mut mine, theirs) = UnixStream::pair().unwrap();
            mine.write_all("{}\n".repeat(1_000).as_bytes())
                .await
                .unwrap();
            serve_with(theirs);
            flooders.push(mine);
        }
        let (mut mine, theirs) = UnixStream::pair().unwrap();
        mine.write_all(b"{\"version\":3,\"command\":\"disarm\"}\n")
            .await
            .unwrap();
        serve_with(theirs);
        let mut answer = String::new();
        BufReader::new(mine).read_line(&mut answer).await.unwrap();
        assert!(answer.contains("\"ok\":true"), "{answer}");
        let mut lines = 0;
        for flooder in flooders {
            flooder.readable().await.unwrap();
            let mut answers = vec![0; 1 << 20];
            let length = flooder.try_read(&mut answers).unwrap();
            lines += answers[..length]
                .iter()
                .filter(|&&byte| byte == b'\n')
                .count();
        }
        lines
    });
    assert!(served <= 4 * FLOODERS, "{served} lines were served first");
    assert_eq!(
        bench.requests(),
        [ControlRequest::Pilot(PilotRequest::Disarm)]
    );
}

/// What a client is told that arms a drive, which has these modes before the client's task runs
/// again.
fn told_of(modes: &[Mode]) -> Vec<String> {
    let bench = Bench::ready();
    bench.runtime.block_on(async {
        let (client, server) = UnixStream::pair().unwrap();
        let client = async {
            let (read, mut write) = client.into_split();
            let arm = r#"{"version":3,"command":"arm","attendance":"hold","uncalibrated":true}"#;
            write.write_all(arm.as_bytes()).await.unwrap();
            write.write_all(b"\n").await.unwrap();
            while bench.requests.is_empty() {
                tokio::time::sleep(core::time::Duration::from_millis(1)).await;
            }
            // Nothing is awaited between these ticks.
            modes.iter().for_each(|mode| bench.tick(*mode));
            let mut lines = BufReader::new(read).lines();
            let mut told = Vec::new();
            while !told
                .last()
                .is_some_and(|line: &String| line.contains("ended") || line.contains("error"))
            {
                told.push(lines.next_line().await.unwrap().unwrap());
            }
            told
        };
        tokio::select! {
            served = serve(server.into(), &bench.daemon) => panic!("{served:?}"),
            told = client => told,
        }
    })
}

#[test]
fn a_drive_that_begins_and_ends_between_two_looks_is_told_with_its_begin_and_its_end() {
    use Mode::{Arming, Driving, Fault, Idle, Ready, Stopping};
    for (modes, end) in [
        (&[Arming, Driving, Stopping, Idle][..], "idle"),
        (&[Driving, Fault], "fault"),
        // Another client has armed meanwhile.
        (
            &[Arming, Driving, Stopping, Ready, Arming, Driving],
            "ready",
        ),
    ] {
        let told = told_of(modes);
        assert_eq!(told.len(), 2, "{told:?}");
        assert!(told[0].contains(r#""ok":true"#), "{told:?}");
        assert!(told[1].contains(&format!(r#""mode":"{end}""#)), "{told:?}");
    }
    // Refused, and then armed by another client.
    let told = told_of(&[Arming, Idle, Ready, Arming, Driving]);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].contains("can't arm: mode idle"), "{told:?}");
}
