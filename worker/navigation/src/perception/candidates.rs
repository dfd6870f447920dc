//! Candidate lines over the points of one scan, each with the sums over its points.
//!
//! Guyonneau et al. (2022), sections 2.1 and 2.2: same lines are fused, and the fittest are kept. Coordinates are
//! kept apart, so that loops over many lines run in lanes.

use super::lanes::LARGEST;
use super::line::{Line, LineFit, same_line};
use super::ranking::Ranking;
use super::sampling::Fresh;

/// In [`Candidates::moved`]: the line is gone.
pub(super) const GONE: u32 = LARGEST;

/// Lines and the sums over their points.
#[derive(Debug, Default)]
pub(super) struct Candidates {
    pub(super) slopes: Vec<f64>,
    pub(super) intercepts_m: Vec<f64>,
    /// Sums over each line's points.
    pub(super) fits: Vec<LineFit>,
    /// Sum of orthogonal distances of each line's points \[m\], eq. 6, where it was measured.
    pub(super) energies: Vec<f64>,
    /// See [`Candidates::moved`].
    moved: Vec<u32>,
    /// Scratch of [`Candidates::fuse`]: where each line stood before.
    names: Vec<u32>,
    /// Lines as they were once they had been compared with all later ones.
    settled: Vec<Line>,
    /// Scratch of [`Candidates::keep_fittest`].
    kept: Vec<(Line, LineFit, f64)>,
}

impl Candidates {
    /// Takes over the lines of `other`, and not its scratch.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.slopes.clone_from(&other.slopes);
        self.intercepts_m.clone_from(&other.intercepts_m);
        self.fits.clone_from(&other.fits);
        self.energies.clone_from(&other.energies);
    }

    pub(super) fn len(&self) -> usize {
        self.slopes.len()
    }

    pub(super) fn line(&self, i: usize) -> Line {
        Line::new(self.slopes[i], self.intercepts_m[i])
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = Line> + '_ {
        (0..self.len()).map(|i| self.line(i))
    }

    /// After a change: where each line of before it stands now, [`GONE`] if it is no more.
    pub(super) fn moved(&self) -> &[u32] {
        &self.moved
    }

    pub(super) fn push(&mut self, line: Line, fit: LineFit) {
        self.slopes.push(line.slope);
        self.intercepts_m.push(line.intercept_m);
        self.fits.push(fit);
        self.energies.push(0.0);
    }

    pub(super) fn clear(&mut self) {
        self.truncate(0);
    }

    /// Keeps the lines and forgets their points.
    pub(super) fn detach(&mut self) {
        self.fits.fill(LineFit::default());
    }

    /// Fits line `i` to its points; it stays as it is where these do not determine a line.
    pub(super) fn refit(&mut self, i: usize) {
        if let Some(line) = self.fits[i].line() {
            self.slopes[i] = line.slope;
            self.intercepts_m[i] = line.intercept_m;
        }
    }

    /// Merges same lines: the one with fewer points into the other, ties into the earlier one.
    pub(super) fn fuse(&mut self) {
        self.names.clear();
        self.names.extend(0..self.len() as u32);
        self.moved.clone_from(&self.names);
        self.settled.clear();
        let mut i = 0;
        while i < self.len() {
            i = self.fuse_from(i);
        }
        self.follow_names();
    }

    /// Merges same lines and takes over the fresh ones that are new: these have no points, so they give way.
    pub(super) fn fuse_with(&mut self, fresh: &mut Fresh) {
        self.fuse();
        let (slopes, intercepts_m) = fresh.distinct_from(&self.settled);
        self.slopes.extend_from_slice(slopes);
        self.intercepts_m.extend_from_slice(intercepts_m);
        self.fits.resize(self.slopes.len(), LineFit::default());
        self.energies.resize(self.slopes.len(), 0.0);
    }

    /// Compares line `i` with all later ones; returns where to go on.
    ///
    /// When line `i` loses to a later one, the line before it is compared with the rest, one after the winner left
    /// out, as in the program behind the tables.
    fn fuse_from(&mut self, mut i: usize) -> usize {
        let mut j = i + 1;
        while j < self.len() {
            if !same_line(self.line(i), self.line(j)) {
                j += 1;
            } else if self.fits[i].points() >= self.fits[j].points() {
                self.absorb(i, j);
            } else {
                self.absorb(j, i);
                if i == 0 {
                    return 0;
                }
                i -= 1;
                j += 1;
            }
        }
        self.settled.push(self.line(i));
        i + 1
    }

    /// Moves the points of `loser` to `winner`, refits it if there are any, and removes `loser`.
    fn absorb(&mut self, winner: usize, loser: usize) {
        let points = self.fits[loser];
        if points.points() > 0.0 {
            self.fits[winner].merge(&points);
            self.refit(winner);
        }
        self.moved[self.names[loser] as usize] = self.names[winner];
        self.slopes.remove(loser);
        self.intercepts_m.remove(loser);
        self.fits.remove(loser);
        self.energies.remove(loser);
        self.names.remove(loser);
    }

    /// Turns "merged into the line called" into "stands at": a winner may have lost to another one later.
    fn follow_names(&mut self) {
        for i in 0..self.moved.len() {
            let mut name = self.moved[i] as usize;
            while self.moved[name] as usize != name {
                name = self.moved[name] as usize;
            }
            self.moved[i] = name as u32;
        }
        for name in &mut self.moved {
            *name = self.names.partition_point(|other| other < name) as u32;
        }
    }

    /// Removes the lines for which `keeps` is false; it sees all lines as they were.
    pub(super) fn retain(&mut self, keeps: impl Fn(&Self, usize) -> bool) {
        self.moved.clear();
        let mut kept = 0;
        for i in 0..self.len() {
            let stays = keeps(self, i);
            self.moved.push(if stays { kept } else { GONE });
            kept += u32::from(stays);
        }
        for i in 0..self.len() {
            if self.moved[i] != GONE {
                let to = self.moved[i] as usize;
                self.slopes[to] = self.slopes[i];
                self.intercepts_m[to] = self.intercepts_m[i];
                self.fits[to] = self.fits[i];
                self.energies[to] = self.energies[i];
            }
        }
        self.truncate(kept as usize);
    }

    fn truncate(&mut self, n: usize) {
        self.slopes.truncate(n);
        self.intercepts_m.truncate(n);
        self.fits.truncate(n);
        self.energies.truncate(n);
    }

    /// Keeps the fittest of the lines with more than `tiny` points, best first: a quarter, but at least `keep`.
    pub(super) fn keep_fittest(&mut self, ranking: &mut Ranking, keep: usize) {
        let order = ranking.rank(&self.slopes, &self.intercepts_m, &self.fits, &self.energies);
        let kept = (order.len() / 4).max(keep).min(order.len());
        self.moved.clear();
        self.moved.resize(self.slopes.len(), GONE);
        self.kept.clear();
        for (rank, (_, i)) in (0_u32..).zip(&order[..kept]) {
            let i = *i as usize;
            self.moved[i] = rank;
            self.kept.push((Line::new(self.slopes[i], self.intercepts_m[i]), self.fits[i], self.energies[i]));
        }
        self.truncate(kept);
        for (i, (line, fit, energy)) in self.kept.iter().enumerate() {
            self.slopes[i] = line.slope;
            self.intercepts_m[i] = line.intercept_m;
            self.fits[i] = *fit;
            self.energies[i] = *energy;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(lines: &[(f64, f64, u32)]) -> Candidates {
        let mut candidates = Candidates::default();
        for (slope, intercept, points) in lines {
            let mut fit = LineFit::default();
            (0..*points).map(f64::from).for_each(|x| fit.add(x, slope * x + intercept));
            candidates.push(Line::new(*slope, *intercept), fit);
        }
        candidates
    }

    fn intercepts(candidates: &Candidates) -> Vec<f64> {
        candidates.intercepts_m.iter().map(|b| (b * 1e9).round() / 1e9).collect()
    }

    #[test]
    fn same_lines_fuse_and_others_stay() {
        let mut candidates = lines(&[(0.0, 0.5, 0), (0.05, 0.6, 0), (0.0, -0.5, 0), (0.02, 0.4, 0)]);
        candidates.fuse();
        assert_eq!(intercepts(&candidates), [0.5, -0.5]);
        assert_eq!(candidates.moved(), [0, 0, 1, 0]);
    }

    #[test]
    fn the_line_with_more_points_wins_and_is_refitted_to_all() {
        let mut candidates = lines(&[(0.0, -3.0, 4), (0.0, 0.6, 2), (0.0, 0.5, 6)]);
        candidates.fuse();
        assert_eq!(candidates.moved(), [0, 1, 1]);
        assert_eq!(candidates.fits[1].points(), 8.0);
        assert!(candidates.intercepts_m[1] > 0.5 && candidates.intercepts_m[1] < 0.6);
    }

    #[test]
    fn a_line_merged_into_one_that_is_merged_later_is_followed() {
        let mut candidates = lines(&[(0.0, 0.5, 3), (0.0, 0.52, 2), (0.0, 0.6, 9)]);
        candidates.fuse();
        assert_eq!((candidates.moved(), candidates.len()), (&[0, 0, 0][..], 1));
    }

    #[test]
    fn lines_that_are_not_kept_are_gone() {
        let mut candidates = lines(&[(0.0, 0.5, 3), (0.0, -0.5, 5), (1.0, 2.0, 1), (1.0, 3.0, 7)]);
        candidates.retain(|lines, i| lines.fits[i].points() > 3.0);
        assert_eq!((candidates.moved(), intercepts(&candidates)), (&[GONE, 0, GONE, 1][..], vec![-0.5, 3.0]));
    }
}
