//! A controller outside the daemon, as another program would be: the connection that holds its
//! drive, and the states that it reads.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use serde_json::{Value, json};
use singletrack_api::SOCKET_VERSION;

use crate::{Failure, Outcome, client::Client};

/// Interval of the renewals of a drive.
const RENEWAL: Duration = Duration::from_millis(100);

/// Holds a drive until it is dropped, which closes the connection.
#[derive(Debug)]
pub struct Holder {
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Holder {
    /// Asks to arm; whether the car drives is seen in its states.
    ///
    /// # Errors
    ///
    /// Fails if it can't be sent.
    pub fn arm(mut client: Client) -> Outcome<Self> {
        let arm = json!({ "version": SOCKET_VERSION, "command": "arm", "attendance": "hold" });
        client.send_lines(&format!("{arm}\n"))?;
        let ended = Arc::new(AtomicBool::new(false));
        let is_over = Arc::clone(&ended);
        let thread = thread::spawn(move || {
            while !is_over.load(Ordering::Acquire) && client.hold().is_ok() {
                thread::park_timeout(RENEWAL);
            }
        });
        Ok(Self {
            ended,
            thread: Some(thread),
        })
    }
}

impl Drop for Holder {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

/// The state of a tick.
#[derive(Clone, Debug, Default)]
pub struct State {
    /// When the tick was, on `CLOCK_MONOTONIC`.
    pub time_ns: u64,
    /// The pilot's mode.
    pub mode: String,
    /// Why it does not drive.
    pub reason: String,
    /// The estimated place of the centre of mass, in m.
    pub position_m: [f64; 2],
    /// The estimated yaw, in rad.
    pub yaw_rad: f64,
    /// The estimated speed, in m/s.
    pub speed_m_s: f64,
    /// Steering after the limits, in rad.
    pub steering_rad: f64,
    /// Speed after the limits, in m/s.
    pub commanded_speed_m_s: f64,
    /// Age of the last accepted pose, in s.
    pub pose_age_s: f64,
    /// Whether there was no new pose.
    pub is_held: bool,
    /// Age of the set-point in force, in s.
    pub setpoint_age_s: Option<f64>,
    /// The number of the set-point in force.
    pub sequence: Option<u64>,
}

impl State {
    /// The state of a line; `None` for a word about lines that were missed.
    pub fn of(line: &Value) -> Option<Self> {
        let number = |key: &str| line[key].as_f64().unwrap_or_default();
        let word = |key: &str| line[key].as_str().unwrap_or_default().to_owned();
        Some(Self {
            time_ns: line["time_ns"].as_u64()?,
            mode: word("mode"),
            reason: word("reason"),
            position_m: [number("x_m"), number("y_m")],
            yaw_rad: number("yaw_rad"),
            speed_m_s: number("speed_m_s"),
            steering_rad: number("steering_rad"),
            commanded_speed_m_s: number("commanded_speed_m_s"),
            pose_age_s: number("pose_age_s"),
            is_held: line["held"] == true,
            setpoint_age_s: line["setpoint"]["age_s"].as_f64(),
            sequence: line["setpoint"]["sequence"].as_u64(),
        })
    }
}

/// The states of all ticks, read by a thread of their own until the daemon ends.
#[derive(Clone, Debug)]
pub struct States(Arc<Mutex<Vec<State>>>);

impl States {
    /// Reads the states that this client gets.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn of(mut client: Client) -> Outcome<Self> {
        client.watch_states()?;
        let states = Self(Arc::default());
        let read = states.clone();
        thread::spawn(move || {
            while let Ok(line) = client.line() {
                read.lock().extend(State::of(&line));
            }
        });
        Ok(states)
    }

    /// The states so far.
    pub fn so_far(&self) -> Vec<State> {
        self.lock().clone()
    }

    /// The newest state.
    ///
    /// # Errors
    ///
    /// There is none yet.
    pub fn newest(&self) -> Outcome<State> {
        let newest = self.lock().last().cloned();
        newest.ok_or_else(|| Failure::new("no state has come"))
    }

    fn lock(&self) -> MutexGuard<'_, Vec<State>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
