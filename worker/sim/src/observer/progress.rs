//! Which inter-row the robot is in, and which it should be in.

use crate::Pose;
use crate::field::{Field, OnLine, Polyline};

/// So far inside its ends the robot is in an inter-row \[m\], or a quarter of its length if that is less.
const INSIDE_M: f64 = 1.0;

/// Progress through the inter-rows, even ones driven from start to end, odd ones back.
pub(super) struct Progress {
    middles: Vec<Polyline>,
    half_spacing_m: f64,
    inter_rows: usize,
    completed: usize,
    entered: bool,
    wrong: bool,
}

impl Progress {
    pub(super) fn new(field: &Field) -> Self {
        Self {
            middles: field.middles.clone(),
            half_spacing_m: 0.5 * field.row_spacing_m,
            inter_rows: (field.inter_rows as usize).min(field.middles.len()),
            completed: 0,
            entered: false,
            wrong: false,
        }
    }

    pub(super) const fn rows_completed(&self) -> u32 {
        self.completed as u32
    }

    pub(super) const fn is_complete(&self) -> bool {
        self.completed == self.inter_rows
    }

    /// Whether the robot is in an inter-row that it should not be in.
    pub(super) const fn in_wrong_row(&self) -> bool {
        self.wrong
    }

    /// Takes in the true pose; where the robot is relative to the middle of the inter-row it should be in.
    pub(super) fn observe(&mut self, pose: Pose) -> Option<OnLine> {
        let expected = self.completed;
        self.wrong = (0..self.middles.len()).any(|i| i != expected && self.is_in(i, pose).1);
        if self.is_complete() {
            return None;
        }
        let (on_middle, inside) = self.is_in(expected, pose);
        self.entered |= inside;
        let forward = expected.is_multiple_of(2);
        let past_end = if forward { on_middle.along_m >= on_middle.length_m } else { on_middle.along_m <= 0.0 };
        if self.entered && past_end && on_middle.across_m.abs() < self.half_spacing_m {
            self.completed += 1;
            self.entered = false;
        }
        Some(on_middle)
    }

    fn is_in(&self, inter_row: usize, pose: Pose) -> (OnLine, bool) {
        let on_middle = self.middles[inter_row].project(pose.x_m, pose.y_m);
        let margin_m = INSIDE_M.min(0.25 * on_middle.length_m);
        (on_middle, on_middle.is_inside(margin_m) && on_middle.across_m.abs() < self.half_spacing_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::guyonneau2022::{Guyonneau2022Params, build};

    fn progress() -> Progress {
        Progress::new(&build(&Guyonneau2022Params { crop: 2, ..Default::default() }, 1))
    }

    fn drive(progress: &mut Progress, path: &[(f64, f64)]) {
        for (x_m, y_m) in path {
            progress.observe(Pose { x_m: *x_m, y_m: *y_m, heading_rad: 0.0 });
        }
    }

    #[test]
    fn inter_rows_are_completed_to_and_fro() {
        let mut progress = progress();
        drive(&mut progress, &[(0.0, 0.0), (5.0, 0.1), (9.5, 0.0)]);
        assert_eq!(progress.rows_completed(), 0);
        drive(&mut progress, &[(10.1, 0.0), (11.0, 0.0), (10.2, 1.0), (5.0, 1.0), (-0.1, 1.1)]);
        assert_eq!(progress.rows_completed(), 2);
        assert!(!progress.in_wrong_row());
    }

    #[test]
    fn leaving_a_row_in_the_middle_or_entering_it_twice_is_the_wrong_row() {
        let mut early = progress();
        drive(&mut early, &[(5.0, 0.0), (5.0, 0.8)]);
        assert!(early.in_wrong_row());
        let mut twice = progress();
        drive(&mut twice, &[(5.0, 0.0), (10.1, 0.0), (8.0, 0.0)]);
        assert!(twice.in_wrong_row());
    }
}
