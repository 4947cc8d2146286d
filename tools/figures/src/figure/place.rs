//! Where on the page there is room for a label.

/// From one point to another, in mm.
pub(super) type Segment = [[f64; 2]; 2];

/// A rectangle for a text, perhaps turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Slot {
    pub(super) centre: [f64; 2],
    /// Half its width and height, in mm.
    pub(super) half: [f64; 2],
    /// From the x axis to its width, on the page, in rad.
    pub(super) angle: f64,
}

impl Slot {
    fn grown(self, by: f64) -> Self {
        Self {
            half: self.half.map(|half| half + by),
            ..self
        }
    }

    /// A point along and across the slot from its centre, on the page.
    fn point(&self, along: f64, across: f64) -> [f64; 2] {
        let (sin, cos) = self.angle.sin_cos();
        [
            self.centre[0] + along * cos - across * sin,
            self.centre[1] + along * sin + across * cos,
        ]
    }

    pub(super) fn corners(&self) -> [[f64; 2]; 4] {
        let [half, height] = self.half;
        [
            self.point(-half, -height),
            self.point(half, -height),
            self.point(half, height),
            self.point(-half, height),
        ]
    }

    /// Which part of a segment is within, from 0 at its start to 1 at its end.
    pub(super) fn within(&self, [from, to]: Segment) -> Option<[f64; 2]> {
        let (sin, cos) = self.angle.sin_cos();
        let own = |point: [f64; 2]| {
            let (x, y) = (point[0] - self.centre[0], point[1] - self.centre[1]);
            [x * cos + y * sin, y * cos - x * sin]
        };
        let (from, to) = (own(from), own(to));
        let [mut enter, mut leave] = [0.0_f64, 1.0_f64];
        for ((from, to), half) in from.into_iter().zip(to).zip(self.half) {
            let (ahead, step) = (half - from, to - from);
            let behind = -half - from;
            if step == 0.0 {
                if ahead < 0.0 || behind > 0.0 {
                    return None;
                }
                continue;
            }
            let (one, other) = (behind / step, ahead / step);
            enter = enter.max(one.min(other));
            leave = leave.min(one.max(other));
        }
        (enter < leave).then_some([enter, leave])
    }
}

/// What a label must not lie on, and what it had better not.
#[derive(Default)]
pub(super) struct Obstacles {
    hard: Vec<Segment>,
    soft: Vec<Segment>,
}

/// Free around a label, in mm.
pub(super) const RIM: f64 = 0.35;

impl Obstacles {
    /// A line that must stay free.
    pub(super) fn line(&mut self, points: &[[f64; 2]]) {
        self.hard.extend(segments(points));
    }

    /// A line that may be interrupted.
    pub(super) fn faint_line(&mut self, points: &[[f64; 2]]) {
        self.soft.extend(segments(points));
    }

    /// A label that has its place.
    pub(super) fn label(&mut self, slot: &Slot) {
        let [a, b, c, d] = slot.corners();
        // With the diagonals, so that a smaller one within meets something.
        self.line(&[a, b, c, d, a, c, b, d]);
    }

    /// Whether nothing that must stay free is beneath it.
    pub(super) fn is_free(&self, slot: &Slot) -> bool {
        let slot = slot.grown(RIM);
        !self.hard.iter().any(|line| slot.within(*line).is_some())
    }

    /// How much of what had better stay free is beneath it, in mm.
    pub(super) fn beneath(&self, slot: &Slot) -> f64 {
        let slot = slot.grown(RIM);
        let lengths = self.soft.iter().filter_map(|line| {
            let [enter, leave] = slot.within(*line)?;
            Some((leave - enter) * length(*line))
        });
        lengths.sum()
    }

    /// How often a segment crosses what must stay free, but for its first bit.
    pub(super) fn crossings(&self, [from, to]: Segment) -> usize {
        let whole = length([from, to]);
        if whole <= 1.0 {
            return 0;
        }
        let towards = |index: usize| from[index] + (to[index] - from[index]) / whole;
        let rest = [[towards(0), towards(1)], to];
        let crossed = self.hard.iter().filter(|line| cross(rest, **line));
        crossed.count()
    }
}

pub(super) fn segments(points: &[[f64; 2]]) -> impl Iterator<Item = Segment> + '_ {
    points.array_windows().copied()
}

/// The place at a part of the way from one point to another.
pub(super) fn between([from, to]: Segment, part: f64) -> [f64; 2] {
    [0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis]))
}

pub(super) fn length([from, to]: Segment) -> f64 {
    (to[0] - from[0]).hypot(to[1] - from[1])
}

fn cross([a, b]: Segment, [c, d]: Segment) -> bool {
    let side = |from: [f64; 2], to: [f64; 2], point: [f64; 2]| {
        (to[0] - from[0]) * (point[1] - from[1]) - (to[1] - from[1]) * (point[0] - from[0])
    };
    (side(a, b, c) > 0.0) != (side(a, b, d) > 0.0) && (side(c, d, a) > 0.0) != (side(c, d, b) > 0.0)
}

/// The pieces of a line outside all slots.
pub(super) fn interrupted(points: &[[f64; 2]], slots: &[Slot]) -> Vec<Vec<[f64; 2]>> {
    let mut pieces = Vec::new();
    let mut piece: Vec<[f64; 2]> = Vec::new();
    for segment in segments(points) {
        let taken = slots.iter().filter_map(|slot| slot.within(segment));
        let mut taken: Vec<[f64; 2]> = taken.collect();
        taken.sort_by(|one, other| one[0].total_cmp(&other[0]));
        let at = |part: f64| between(segment, part);
        let mut free_from = 0.0;
        for [enter, leave] in taken {
            if enter > free_from {
                extend(&mut piece, at(free_from), at(enter));
            }
            if !piece.is_empty() {
                pieces.push(std::mem::take(&mut piece));
            }
            free_from = leave.max(free_from);
        }
        if free_from < 1.0 {
            extend(&mut piece, at(free_from), segment[1]);
        }
    }
    if !piece.is_empty() {
        pieces.push(piece);
    }
    pieces
}

fn extend(piece: &mut Vec<[f64; 2]>, from: [f64; 2], to: [f64; 2]) {
    if piece.is_empty() {
        piece.push(from);
    }
    piece.push(to);
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOT: Slot = Slot {
        centre: [10.0, 5.0],
        half: [2.0, 1.0],
        angle: 0.0,
    };

    #[test]
    fn a_line_through_a_slot_is_cut_at_its_edges() {
        let pieces = interrupted(&[[0.0, 5.0], [20.0, 5.0], [20.0, 9.0]], &[SLOT]);
        assert_eq!(
            pieces,
            [
                vec![[0.0, 5.0], [8.0, 5.0]],
                vec![[12.0, 5.0], [20.0, 5.0], [20.0, 9.0]]
            ]
        );
        let turned = Slot {
            angle: std::f64::consts::FRAC_PI_2,
            ..SLOT
        };
        let [enter, leave] = turned.within([[0.0, 5.0], [20.0, 5.0]]).unwrap();
        assert!((enter - 0.45).abs() < 1e-12 && (leave - 0.55).abs() < 1e-12);
        assert!(SLOT.within([[0.0, 7.0], [20.0, 7.0]]).is_none());
    }

    #[test]
    fn a_label_is_not_put_on_a_line_nor_on_or_in_another_label() {
        let mut obstacles = Obstacles::default();
        assert!(obstacles.is_free(&SLOT));
        obstacles.faint_line(&[[0.0, 5.0], [20.0, 5.0]]);
        assert!(obstacles.is_free(&SLOT));
        assert!((obstacles.beneath(&SLOT) - 2.0 * (2.0 + RIM)).abs() < 1e-9);
        obstacles.label(&Slot {
            half: [6.0, 4.0],
            ..SLOT
        });
        assert!(!obstacles.is_free(&SLOT), "within a larger one");
        let beside = Slot {
            centre: [18.9, 5.0],
            ..SLOT
        };
        assert!(obstacles.is_free(&beside));
        obstacles.line(&[[19.0, 0.0], [19.0, 20.0]]);
        assert!(!obstacles.is_free(&beside));
    }

    #[test]
    fn a_leader_may_begin_at_a_line_but_is_counted_when_it_crosses_one() {
        let mut obstacles = Obstacles::default();
        obstacles.line(&[[0.0, 0.0], [10.0, 0.0]]);
        assert_eq!(obstacles.crossings([[5.0, 0.0], [5.0, 8.0]]), 0);
        assert_eq!(obstacles.crossings([[5.0, -4.0], [5.0, 4.0]]), 1);
    }
}
