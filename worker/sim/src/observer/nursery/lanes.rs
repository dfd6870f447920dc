//! Which lanes of a nursery a robot has driven through, and whether in their order.

use furrow_navigation::localization::PlantingMap;

use crate::Pose;

/// So far inside its ends a robot is in a lane \[m\], or a quarter of its length if that is less (ours).
const ENTERED_M: f64 = 0.5;

/// What a robot must not do: Vintu (2018), section 4.1.1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Violation {
    /// It entered a lane out of order.
    OutOfOrder,
    /// Its centre crossed a row.
    Crossed,
    /// It entered a lane again.
    Again,
}

/// Progress through the lanes.
#[derive(Debug, Clone)]
pub(super) struct Lanes {
    map: PlantingMap,
    /// From which to which x each lane was driven \[m\].
    driven: Vec<Option<[f64; 2]>>,
    /// The lane that the robot is in.
    active: Option<u32>,
    /// The lane that comes next.
    next: u32,
    /// Lane by y alone, and x \[m\], of the last sample.
    last: Option<(i64, f64)>,
}

impl Lanes {
    pub(super) fn new(map: PlantingMap) -> Self {
        Self { map, driven: vec![None; map.lanes() as usize], active: None, next: 0, last: None }
    }

    /// Takes in a pose; what the robot did wrong since the last one.
    pub(super) fn observe(&mut self, pose: Pose) -> Option<Violation> {
        let length_m = self.map.row_length_m();
        let lane = self.lane_at(pose.y_m);
        let x_m = pose.x_m.clamp(0.0, length_m);
        let inside = (0.0..=length_m).contains(&pose.x_m);
        let last = self.last.replace((lane, x_m));
        if last.is_some_and(|(before, _)| before != lane) && inside && self.is_at_a_row(last, lane) {
            return Some(Violation::Crossed);
        }
        if !inside {
            self.leave(x_m);
            return None;
        }
        let number = u32::try_from(lane).ok().filter(|lane| *lane < self.map.lanes())?;
        if self.active.is_none() && self.has_entered(pose.x_m) {
            let visited = number < self.next;
            if number != self.next {
                return Some(if visited { Violation::Again } else { Violation::OutOfOrder });
            }
            self.active = Some(number);
            self.next = number + 1;
        }
        self.cover(number, x_m, last);
        None
    }

    /// The lane by y alone; below 0 or beyond the last one outside of the field.
    fn lane_at(&self, y_m: f64) -> i64 {
        (y_m * self.map.towards_next() / self.map.row_distance_m).round() as i64
    }

    /// Whether there is a row between two neighbouring lanes.
    fn is_at_a_row(&self, last: Option<(i64, f64)>, lane: i64) -> bool {
        let row = last.map_or(lane, |(before, _)| before.max(lane));
        (0..i64::from(self.map.rows)).contains(&row)
    }

    fn has_entered(&self, x_m: f64) -> bool {
        let length_m = self.map.row_length_m();
        let margin_m = ENTERED_M.min(0.25 * length_m);
        (margin_m..=length_m - margin_m).contains(&x_m)
    }

    /// The robot is beyond an end of the rows.
    fn leave(&mut self, x_m: f64) {
        if let Some(lane) = self.active.take() {
            self.extend(lane, x_m);
        }
    }

    /// Counts what the robot drove of the lane it is in, or is about to enter.
    fn cover(&mut self, lane: u32, x_m: f64, last: Option<(i64, f64)>) {
        if self.active == Some(lane) || (self.active.is_none() && lane == self.next) {
            if let Some((before, last_x_m)) = last
                && before == i64::from(lane)
            {
                self.extend(lane, last_x_m);
            }
            self.extend(lane, x_m);
        }
    }

    fn extend(&mut self, lane: u32, x_m: f64) {
        let driven = self.driven[lane as usize].get_or_insert([x_m; 2]);
        *driven = [driven[0].min(x_m), driven[1].max(x_m)];
    }

    /// The lane that the robot is in.
    pub(super) const fn active(&self) -> Option<u32> {
        self.active
    }

    /// Lanes driven from end to end.
    pub(super) fn whole(&self) -> u32 {
        let length_m = self.map.row_length_m();
        self.driven.iter().flatten().map(|[from, to]| u32::from(to - from >= length_m)).sum()
    }

    /// Whether all lanes were driven from end to end.
    pub(super) fn is_complete(&self) -> bool {
        self.whole() == self.map.lanes()
    }

    /// Share of the lanes' length that was driven \[%\]; none without lanes of any length.
    pub(super) fn covered_percent(&self) -> Option<f64> {
        let all_m = self.map.row_length_m() * f64::from(self.map.lanes());
        // Not `sum`, which is -0 of nothing.
        let driven_m = self.driven.iter().flatten().fold(0.0, |sum, [from, to]| sum + (to - from));
        let percent = if self.is_complete() { 100.0 } else { 100.0 * driven_m / all_m };
        (all_m > 0.0).then_some(percent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lanes(lanes_to_the_left: bool) -> Lanes {
        let map = PlantingMap {
            row_distance_m: 1.5,
            planting_distance_m: 1.0,
            rows: 4,
            plants_per_row: 11,
            lanes_to_the_left,
        };
        Lanes::new(map)
    }

    /// Drives along corners in steps of 4 cm; y counts lanes.
    fn drive(lanes: &mut Lanes, corners: &[(f64, f64)]) -> Option<Violation> {
        let side = lanes.map.towards_next() * 1.5;
        corners.windows(2).find_map(|pair| {
            let [(x0, l0), (x1, l1)] = [pair[0], pair[1]];
            let steps = (libm::hypot(x1 - x0, 1.5 * (l1 - l0)) / 0.04).ceil();
            (0..=steps as u32).find_map(|i| {
                let t = f64::from(i) / steps;
                lanes.observe(Pose { x_m: x0 + t * (x1 - x0), y_m: side * (l0 + t * (l1 - l0)), heading_rad: 0.0 })
            })
        })
    }

    #[test]
    fn a_complete_run_covers_exactly_everything_from_either_corner() {
        for left in [true, false] {
            let mut lanes = lanes(left);
            let path = [
                (-1.0, 0.0),
                (11.0, 0.1),
                (12.0, 0.5),
                (11.0, 1.0),
                (-1.0, 1.0),
                (-1.0, 2.0),
                (10.5, 2.0),
                (11.0, 2.0),
            ];
            assert_eq!(drive(&mut lanes, &path), None);
            assert_eq!((lanes.whole(), lanes.is_complete(), lanes.covered_percent()), (3, true, Some(100.0)));
        }
    }

    #[test]
    fn part_of_a_lane_counts_pro_rata() {
        let mut lanes = lanes(true);
        assert_eq!(drive(&mut lanes, &[(-1.0, 0.0), (5.0, 0.0)]), None);
        assert!((lanes.covered_percent().unwrap() - 100.0 * 5.0 / 30.0).abs() < 1e-9);
        assert_eq!((lanes.whole(), lanes.active()), (0, Some(0)));
    }

    #[test]
    fn what_must_not_be_done_is_told_apart() {
        let start = (-1.0, 0.0);
        let after_the_first = [start, (11.0, 0.0)];
        assert_eq!(drive(&mut lanes(true), &[start, (5.0, 0.0), (5.0, 1.0)]), Some(Violation::Crossed));
        assert_eq!(drive(&mut lanes(false), &[start, (5.0, 0.0), (5.0, -1.0)]), Some(Violation::Crossed));
        let again = [&after_the_first[..], &[(5.0, 0.0)]].concat();
        assert_eq!(drive(&mut lanes(true), &again), Some(Violation::Again));
        let skipped = [&after_the_first[..], &[(11.0, 2.0), (5.0, 2.0)]].concat();
        assert_eq!(drive(&mut lanes(true), &skipped), Some(Violation::OutOfOrder));
        let at_first = [start, (-1.0, 1.0), (5.0, 1.0)];
        assert_eq!(drive(&mut lanes(true), &at_first), Some(Violation::OutOfOrder));
    }

    #[test]
    fn outside_of_the_field_nothing_is_crossed() {
        let mut lanes = lanes(true);
        assert_eq!(drive(&mut lanes, &[(-1.0, 0.0), (-1.0, 5.0), (11.0, 5.0), (11.0, -3.0)]), None);
        assert_eq!(lanes.covered_percent(), Some(0.0));
    }
}
