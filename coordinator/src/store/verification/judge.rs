//! Whose digest is right, and who is wrong.

use std::collections::{BTreeMap, BTreeSet};

use furrow_schema::id::Digest;

use crate::view::VerificationState;

/// So many opinions are heard beside the result on record.
pub(crate) const MOST_OPINIONS: usize = 3;

/// One digest that a worker had for a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Opinion {
    /// The worker's row.
    pub(crate) worker: i64,
    pub(crate) digest: Digest,
    /// Whether the worker is barred: its opinion is kept, but has no weight.
    pub(crate) barred: bool,
}

/// What opinions come to.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Verdict {
    /// [`VerificationState::Waits`] if another opinion is needed.
    pub(crate) state: VerificationState,
    /// Workers to bar: outvoted by at least two others or by all that can be trusted, or at odds with themselves.
    pub(crate) wrong: BTreeSet<i64>,
}

/// Judges the result on record by the opinions that came after it, of which there is at least one.
///
/// A digest wins that more trusted workers have than any other: at least two, or one if nobody else can be trusted. A
/// worker that had two digests for one job is not trusted, and neither is one that was barred before.
pub(crate) fn judge(on_record: Opinion, later: &[Opinion]) -> Verdict {
    let all = || std::iter::once(&on_record).chain(later);
    let mut digests_by_worker: BTreeMap<i64, BTreeSet<Digest>> = BTreeMap::new();
    all().for_each(|opinion| _ = digests_by_worker.entry(opinion.worker).or_default().insert(opinion.digest));
    let torn = |worker: &i64| digests_by_worker[worker].len() > 1;
    if all().all(|opinion| opinion.digest == on_record.digest) {
        return Verdict { state: VerificationState::Agreed, wrong: BTreeSet::new() };
    }
    let mut voices: BTreeMap<Digest, BTreeSet<i64>> = BTreeMap::new();
    for opinion in all().filter(|opinion| !opinion.barred && !torn(&opinion.worker)) {
        voices.entry(opinion.digest).or_default().insert(opinion.worker);
    }
    let right = winner(&voices);
    let is_wrong = |opinion: &&Opinion| torn(&opinion.worker) || right.is_some_and(|right| opinion.digest != right);
    let wrong = all().filter(|opinion| !opinion.barred).filter(is_wrong).map(|opinion| opinion.worker).collect();
    let state = match right {
        Some(right) if right == on_record.digest => VerificationState::Upheld,
        Some(_) => VerificationState::Overruled,
        None if later.len() < MOST_OPINIONS => VerificationState::Waits,
        None => VerificationState::Undecided,
    };
    Verdict { state, wrong }
}

fn winner(voices: &BTreeMap<Digest, BTreeSet<i64>>) -> Option<Digest> {
    let mut by_weight: Vec<_> = voices.iter().map(|(digest, workers)| (workers.len(), *digest)).collect();
    by_weight.sort_unstable_by(|a, b| b.cmp(a));
    match by_weight.as_slice() {
        [(_, only)] => Some(*only),
        [(most, first), (next, _), ..] if most > next => Some(*first),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use VerificationState::{Agreed, Overruled, Undecided, Upheld, Waits};

    use super::*;

    fn says(worker: i64, digest: u8) -> Opinion {
        Opinion { worker, digest: Digest([digest; 32]), barred: false }
    }

    fn judged(opinions: &[(i64, u8)]) -> (VerificationState, Vec<i64>) {
        let opinions: Vec<_> = opinions.iter().map(|(worker, digest)| says(*worker, *digest)).collect();
        let verdict = judge(opinions[0], &opinions[1..]);
        (verdict.state, verdict.wrong.into_iter().collect())
    }

    #[test]
    fn equal_digests_agree_whoever_had_them() {
        assert_eq!(judged(&[(1, 7), (2, 7)]), (Agreed, vec![]));
        assert_eq!(judged(&[(1, 7), (1, 7)]), (Agreed, vec![]));
    }

    #[test]
    fn one_against_one_needs_a_third_who_outvotes_either() {
        assert_eq!(judged(&[(1, 7), (2, 8)]), (Waits, vec![]));
        assert_eq!(judged(&[(1, 7), (2, 8), (3, 7)]), (Upheld, vec![2]));
        assert_eq!(judged(&[(1, 7), (2, 8), (3, 8)]), (Overruled, vec![1]));
    }

    #[test]
    fn three_of_three_minds_need_a_fourth() {
        assert_eq!(judged(&[(1, 7), (2, 8), (3, 9)]), (Waits, vec![]));
        assert_eq!(judged(&[(1, 7), (2, 8), (3, 9), (4, 8)]), (Overruled, vec![1, 3]));
        assert_eq!(judged(&[(1, 7), (2, 8), (3, 9), (4, 6)]), (Undecided, vec![]));
    }

    #[test]
    fn a_worker_that_contradicts_itself_is_wrong_and_its_opponent_right() {
        assert_eq!(judged(&[(1, 7), (2, 8), (1, 9)]), (Overruled, vec![1]));
        assert_eq!(judged(&[(1, 7), (2, 8), (1, 8)]), (Overruled, vec![1]));
        assert_eq!(judged(&[(1, 7), (2, 8), (1, 7), (2, 9)]), (Upheld, vec![2]));
        assert_eq!(judged(&[(1, 7), (1, 8)]), (Waits, vec![1]), "somebody else has to say what is right");
    }

    #[test]
    fn two_that_insist_are_left_undecided() {
        assert_eq!(judged(&[(1, 7), (2, 8), (1, 7)]), (Waits, vec![]));
        assert_eq!(judged(&[(1, 7), (2, 8), (1, 7), (2, 8)]), (Undecided, vec![]));
    }

    #[test]
    fn the_opinion_of_a_barred_worker_has_no_weight() {
        let barred = Opinion { barred: true, ..says(1, 7) };
        let verdict = judge(barred, &[says(2, 8)]);
        assert_eq!(verdict, Verdict { state: Overruled, wrong: BTreeSet::new() });
        assert_eq!(judge(barred, &[says(2, 7)]).state, Agreed);
    }
}
