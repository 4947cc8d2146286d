//! Maps the board's clock to host time.

use heapless::Vec;

/// Time span of the estimate: long enough to see 20 ppm of skew through the noise,
/// short enough to follow a resonator that warms up.
pub const WINDOW_NS: i64 = 6_400_000_000;

/// For each span of this length one pair is kept: the one with the least delay.
const BUCKET_NS: i64 = 100_000_000;

/// Pairs kept: one for each full bucket, and one for the bucket that fills now.
const POINTS: usize = 65;

/// Over a shorter span the noise determines the skew more than the clock does.
const SHORTEST_SKEW_SPAN_NS: i64 = 300_000_000;

/// The largest rate error accepted: twice that of the worst resonator.
const MAX_SKEW: f64 = 0.01;

/// Bound on the skew before it has been measured.
const UNKNOWN_SKEW: f64 = 0.005;

/// A stamp that is further ahead of its own arrival is not a stamp of this run of the
/// board. The tolerance is the longest time for which a line may have been stuck
/// before the first pair: otherwise a stuck line would look like a restarted board.
const FUTURE_TOLERANCE_NS: i64 = 1_000_000_000;

/// This number of implausible stamps in a row means a restarted board. A single one is
/// a damaged record that the CRC did not detect.
const IMPLAUSIBLE_STAMPS_OF_A_RESTART: u8 = 2;

/// The result of [`BoardClock::observe`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampOutcome {
    /// The stamp fits.
    Mapped(Stamp),
    /// The stamp runs backwards, stands still or lies in the future: it is not of this
    /// run of the board's clock. It changes nothing.
    Implausible,
    /// Implausible again: the board's clock has started again. The mapping must be
    /// [restarted](BoardClock::restart).
    Restarted,
}

/// A board time in host time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Host time in nanoseconds: never before that of an earlier stamp, never
    /// after the receive time.
    pub host_time_ns: u64,
    /// Board time in microseconds since this run of the mapping's first stamp,
    /// not wrapping.
    pub board_elapsed_us: u64,
    /// Board time since the stamp before, in microseconds; zero for the first.
    pub since_last_us: u32,
}

/// One pair: board time, and host time minus board time, both since the first pair.
#[derive(Clone, Copy, Debug)]
struct Point {
    board_ns: i64,
    excess_ns: i64,
}

/// The estimated line: `excess = offset + skew · (board - at)`.
#[derive(Clone, Copy, Debug, Default)]
struct ExcessLine {
    at_ns: i64,
    offset_ns: f64,
    skew: f64,
    uncertainty_ns: f64,
}

impl ExcessLine {
    fn excess_at(&self, board_ns: i64) -> f64 {
        self.offset_ns + self.skew * (board_ns - self.at_ns) as f64
    }
}

/// Maps board time to host time.
///
/// The board stamps its records with its own microseconds. They wrap every
/// 71.6 minutes, start at zero with the board, and run up to 0.5 % fast or
/// slow: an UNO counts with a ceramic resonator. The host receives each record
/// *later*: transmission, the USB bridge and the scheduler delay it. The delay is
/// never negative, and from time to time it is close to its minimum.
///
/// The pairs (board time, receive time) therefore lie above a line. The estimate is
/// the supporting line of the lower convex hull of the last [`WINDOW_NS`], at the
/// middle of the window: the line that has every pair above it and the smallest sum of
/// distances to them. A record that arrives late does not move it. The minimum delay
/// itself can't be measured from one side; the caller subtracts the part that it
/// knows (the time that the frame spends on the wire).
#[derive(Clone, Debug, Default)]
pub struct BoardClock {
    origin: Option<Origin>,
    points: Vec<Point, POINTS>,
    /// The edge of their lower convex hull that spans the mean board time.
    edge: Option<(Point, Point)>,
    line: ExcessLine,
    implausible: u8,
}

#[derive(Clone, Copy, Debug)]
struct Origin {
    host_ns: u64,
    newest_raw_us: u32,
    newest_elapsed_us: u64,
    newest_mapped_ns: u64,
}

impl BoardClock {
    /// Forgets all stamps: the board's clock has started again.
    pub fn restart(&mut self) {
        *self = Self::default();
    }

    /// Takes the stamp of a record. `receive_time_ns` is the time of its arrival minus
    /// the known part of its delay. It must not run backwards.
    pub fn observe(&mut self, receive_time_ns: u64, board_time_us: u32) -> StampOutcome {
        let Some(mut origin) = self.origin else {
            return self.begin(receive_time_ns, board_time_us);
        };
        let since_last_us = board_time_us.wrapping_sub(origin.newest_raw_us);
        let elapsed_us = (origin.newest_elapsed_us).saturating_add(u64::from(since_last_us));
        let board_ns = nanoseconds(elapsed_us);
        let host_ns = signed_difference(receive_time_ns, origin.host_ns);
        let excess_ns = host_ns.saturating_sub(board_ns);
        let ahead_ns = self.line.excess_at(board_ns) - excess_ns as f64;
        // More than half the range ahead means backwards.
        if since_last_us == 0
            || since_last_us > u32::MAX / 2
            || ahead_ns > FUTURE_TOLERANCE_NS as f64
        {
            self.implausible = self.implausible.saturating_add(1);
            return if self.implausible < IMPLAUSIBLE_STAMPS_OF_A_RESTART {
                StampOutcome::Implausible
            } else {
                StampOutcome::Restarted
            };
        }
        self.implausible = 0;
        origin.newest_raw_us = board_time_us;
        origin.newest_elapsed_us = elapsed_us;

        self.keep(Point {
            board_ns,
            excess_ns,
        });
        self.fit(board_ns);

        origin.newest_mapped_ns = host_time(origin.host_ns, board_ns, &self.line)
            .max(origin.newest_mapped_ns)
            .min(receive_time_ns);
        self.origin = Some(origin);
        StampOutcome::Mapped(Stamp {
            host_time_ns: origin.newest_mapped_ns,
            board_elapsed_us: elapsed_us,
            since_last_us,
        })
    }

    /// Host time of a board time within 35 minutes of the newest stamp, by the
    /// current estimate; `None` before the first stamp.
    pub fn host_time_ns(&self, board_time_us: u32) -> Option<u64> {
        let origin = self.origin?;
        let ahead_us = board_time_us.wrapping_sub(origin.newest_raw_us);
        let distance_us = ahead_us.cast_signed();
        let board_ns = nanoseconds(origin.newest_elapsed_us)
            .saturating_add(i64::from(distance_us).saturating_mul(1_000));
        Some(host_time(origin.host_ns, board_ns, &self.line))
    }

    /// How much faster the host's clock runs than the board's, in parts per
    /// million: positive for a slow board. Zero until it has been measured.
    pub fn skew_ppm(&self) -> f64 {
        self.line.skew * 1e6
    }

    /// Uncertainty of the newest mapped stamp in nanoseconds, without the minimum
    /// delay; `None` before the first stamp. With evenly distributed delays it covers
    /// more than 98 of 100 errors; the others are in the first second.
    pub fn uncertainty_ns(&self) -> Option<u64> {
        self.origin.map(|_| self.line.uncertainty_ns as u64)
    }

    fn begin(&mut self, receive_time_ns: u64, board_time_us: u32) -> StampOutcome {
        self.origin = Some(Origin {
            host_ns: receive_time_ns,
            newest_raw_us: board_time_us,
            newest_elapsed_us: 0,
            newest_mapped_ns: receive_time_ns,
        });
        self.keep(Point {
            board_ns: 0,
            excess_ns: 0,
        });
        self.line.uncertainty_ns = BUCKET_NS as f64;
        StampOutcome::Mapped(Stamp {
            host_time_ns: receive_time_ns,
            board_elapsed_us: 0,
            since_last_us: 0,
        })
    }

    /// Keeps the pair if it has the least delay of its bucket.
    fn keep(&mut self, point: Point) {
        let skew = self.line.skew;
        let height =
            |point: &Point| point.excess_ns as f64 - skew * (point.board_ns % BUCKET_NS) as f64;
        if let Some(last) = self.points.last_mut()
            && last.board_ns / BUCKET_NS == point.board_ns / BUCKET_NS
        {
            if height(&point) < height(last) {
                *last = point;
                self.edge = self.middle_edge();
            }
            return;
        }
        let oldest_ns = point.board_ns - WINDOW_NS;
        self.points.retain(|kept| kept.board_ns >= oldest_ns);
        // One point for each bucket of the window: there is always room.
        let _ = self.points.push(point);
        self.edge = self.middle_edge();
    }

    fn fit(&mut self, newest_ns: i64) {
        let (Some(first), Some(last)) = (self.points.first(), self.points.last()) else {
            return;
        };
        let span_ns = last.board_ns - first.board_ns;
        let mut edge_ns = None;
        if span_ns >= SHORTEST_SKEW_SPAN_NS
            && let Some((left, right)) = self.edge
        {
            let length_ns = (right.board_ns - left.board_ns) as f64;
            self.line.skew =
                ((right.excess_ns - left.excess_ns) as f64 / length_ns).clamp(-MAX_SKEW, MAX_SKEW);
            edge_ns = Some(length_ns);
        }
        let skew = self.line.skew;
        let above_newest =
            |point: &Point| point.excess_ns as f64 - skew * (point.board_ns - newest_ns) as f64;
        let above_ns = self.points.iter().map(above_newest);
        let offset_ns = above_ns.clone().fold(f64::INFINITY, f64::min);
        let heights_ns: f64 = above_ns.map(|above_ns| above_ns - offset_ns).sum();
        let mean_height_ns = heights_ns / self.points.len() as f64;
        let age_ns = (newest_ns - first.board_ns) as f64;
        // The measured skew is the edge's, about the middle of the window.
        let skew_error_ns = match edge_ns {
            Some(length_ns) => (mean_height_ns / length_ns).min(UNKNOWN_SKEW) * age_ns / 2.0,
            None => UNKNOWN_SKEW * age_ns,
        };
        self.line = ExcessLine {
            at_ns: newest_ns,
            offset_ns,
            skew,
            uncertainty_ns: mean_height_ns + skew_error_ns,
        };
    }

    /// The edge of the lower convex hull that spans the mean board time.
    fn middle_edge(&self) -> Option<(Point, Point)> {
        let mut hull: Vec<Point, POINTS> = Vec::new();
        for &point in &self.points {
            while let [.., a, b] = hull.as_slice()
                && turns_right(a, b, &point)
            {
                hull.pop();
            }
            hull.push(point).ok()?;
        }
        let sum: i128 = self.points.iter().map(|p| i128::from(p.board_ns)).sum();
        let mean_ns = sum / i128::try_from(self.points.len()).ok()?;
        let mut edges = hull.array_windows().map(|[a, b]| (*a, *b));
        edges.find(|(_, b)| i128::from(b.board_ns) >= mean_ns)
    }
}

/// Whether `b` lies on or above the segment from `a` to `c`.
fn turns_right(a: &Point, b: &Point, c: &Point) -> bool {
    let cross = (b.board_ns - a.board_ns) as f64 * (c.excess_ns - a.excess_ns) as f64
        - (c.board_ns - a.board_ns) as f64 * (b.excess_ns - a.excess_ns) as f64;
    cross <= 0.0
}

fn nanoseconds(us: u64) -> i64 {
    i64::try_from(us.saturating_mul(1_000)).unwrap_or(i64::MAX)
}

fn signed_difference(a_ns: u64, b_ns: u64) -> i64 {
    i64::try_from(i128::from(a_ns) - i128::from(b_ns)).unwrap_or(i64::MAX)
}

fn host_time(first_host_ns: u64, board_ns: i64, line: &ExcessLine) -> u64 {
    let since_first_ns = board_ns.saturating_add(line.excess_at(board_ns) as i64);
    first_host_ns.saturating_add_signed(since_first_ns)
}
