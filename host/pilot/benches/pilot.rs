//! Cost of a control tick: one pose and one board record in, one command out.

use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_control::{
    Circle, EstimatorConfig, FrontPointLaw, InertialSample, Limits, Motion, PoseSample, Position,
    ProportionalLoop, Reference, Time, TrackingLoop, VehicleParameters, Velocity,
};
use singletrack_pilot::{
    BoardHealth, BoardSample, BoardState, Compensation, Event, Fence, LinkState, Mode, Pilot,
    PilotConfig, PilotRequest, RealTimeState, SupervisorConfig, WatchConfig,
};

const TICK_NS: u64 = 10_000_000;

fn pilot() -> Option<Pilot> {
    let vehicle = VehicleParameters::paper();
    Some(Pilot::new(PilotConfig {
        law: law()?,
        tracking: TrackingLoop::Proportional(ProportionalLoop {
            gain: Velocity::new(1.0, 1.0),
            feed_forward: true,
        }),
        reference: Reference::Circle(Circle::new(Position::origin(), 1.0, 0.5).ok()?),
        governor: None,
        limits: Limits::paper(),
        estimator: EstimatorConfig::for_vehicle(&vehicle),
        supervisor: SupervisorConfig::paper(),
        // The samples below repeat themselves.
        watch: WatchConfig {
            stuck_samples: 0,
            ..WatchConfig::paper()
        },
        fence: Fence::rectangle(Position::origin(), Velocity::new(4.0, 4.0), 0.0).ok()?,
        braking: 1.5,
        stop_deceleration: 1.5,
        compensation: Compensation::off(vehicle),
        safety: None,
        period: 0.01,
    }))
}

fn law() -> Option<FrontPointLaw> {
    FrontPointLaw::new(0.1368, 0.35, 0.26).ok()
}

/// Telemetry and a pose of a standing car.
fn events(tick: u64, state: BoardState) -> [Event; 2] {
    let now = Time(tick * TICK_NS);
    [
        Event::Board(BoardSample {
            time: now.before(0.004),
            inertial: Some(InertialSample {
                time: now.before(0.005),
                yaw_rate: 0.0,
                forward_acceleration: 0.0,
                left_acceleration: 0.0,
            }),
            motor_speed: 0.0,
            state,
        }),
        Event::Pose(PoseSample {
            capture: now.before(0.010),
            receive: now.before(0.002),
            frame: 0,
            position: Position::new(0.5, 0.5),
            yaw: 0.1,
        }),
    ]
}

fn control_tick(criterion: &mut Criterion) {
    let Some(mut pilot) = pilot() else { return };
    let mut tick = 100;
    pilot.step(
        Time(tick * TICK_NS),
        &[
            Event::RealTime(RealTimeState {
                fifo: true,
                memory_locked: true,
            }),
            Event::Link(LinkState::Ready),
            Event::Health(BoardHealth {
                battery_mv: 7_400,
                stop_input_open: false,
                battery_open: false,
                imu_fault: false,
            }),
        ],
    );
    let mut step = |state, request: Option<PilotRequest>| {
        tick += 1;
        let [board, pose] = events(tick, state);
        // The board reports its status every 0.2 s; without it the supervisor stops the car.
        let health = Event::Health(BoardHealth {
            battery_mv: 7_400,
            stop_input_open: false,
            battery_open: false,
            imu_fault: false,
        });
        match request {
            Some(request) => pilot.step(
                Time(tick * TICK_NS),
                &[board, pose, health, Event::Request(request)],
            ),
            None => pilot.step(Time(tick * TICK_NS), &[board, pose, health]),
        }
    };
    for _ in 0..200 {
        step(BoardState::Neutral, None);
    }
    step(BoardState::Neutral, Some(PilotRequest::Arm));
    let output = step(BoardState::Armed, None);
    assert_eq!(output.mode, Mode::Driving, "{:?}", output.reason);
    criterion.bench_function(
        "pilot step, driving, one pose and one board record",
        |bencher| {
            bencher.iter(|| step(BoardState::Driving, None));
        },
    );
}

fn law_alone(criterion: &mut Criterion) {
    let Some(law) = law() else { return };
    let motion = Motion {
        yaw: 0.3,
        yaw_rate: 0.5,
        sideslip: 0.15,
    };
    criterion.bench_function("front-point law", |bencher| {
        bencher.iter(|| {
            law.command(
                std::hint::black_box(&motion),
                0.33,
                std::hint::black_box(&Velocity::new(0.3, 0.2)),
            )
        });
    });
}

criterion_group!(benches, control_tick, law_alone);
criterion_main!(benches);
