//! What its sweeps make of a job: whether it is queued, held or cancelled, and where it stands in the queue.
//!
//! Whatever a user does to sweeps (pause, resume, change a priority, cancel, retry, remove, submit one that shares
//! jobs), the rows of `sweep` change first; then their jobs are brought in line by the one rule of
//! [`Standing::fate`]. It may be applied to any job at any time, so it can be done in steps and done again.

use std::collections::HashMap;

use furrow_schema::id::JobId;
use furrow_schema::job::JobState;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::job::state_of;
use crate::store::tally::Tally;
use crate::store::transition::Changes;
use crate::store::{to_json, unsigned};
use crate::view::AttemptEnd;

/// Where each priority's queue has got to.
const VIRTUAL_TIMES: &str = "select priority, turn from virtual_time";

/// Where jobs without a result stand, whether a live sweep wants them, and the highest priority among those not paused.
const STANDINGS: &str = "select job.id, job.state, job.attempt, job.claim_id, job.priority, job.turn, job.held,
        max(sweep.state <> 'cancelled'),
        max(sweep.priority) filter (where sweep.state not in ('paused', 'cancelled'))
    from json_each(?1) as wanted cross join job on job.id = wanted.value
        cross join cell_job on cell_job.job_id = job.id
        cross join cell on cell.id = cell_job.cell_id cross join sweep on sweep.id = cell.sweep_id
    where job.state <> 'done' group by job.id";

/// Places in the queue: job, held, priority, turn.
const PLACE: &str = "update job set held = value ->> 1, priority = value ->> 2, turn = value ->> 3
    from json_each(?1) where job.id = value ->> 0";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[VIRTUAL_TIMES, STANDINGS, PLACE];

/// Places in the queues of all priorities: the jobs of a sweep stand one behind the other, from where a queue has got to.
#[derive(Debug)]
pub(crate) struct Turns {
    reached: HashMap<i64, i64>,
    /// How many jobs of the sweep stand before the next one.
    pub(crate) ahead: i64,
}

impl Turns {
    /// As the queues stand now, behind so many jobs of the same sweep.
    pub(crate) async fn load(conn: &mut SqliteConnection, ahead: i64) -> Result<Self, StoreError> {
        let rows: Vec<(i64, i64)> = sqlx::query_as(VIRTUAL_TIMES).fetch_all(conn).await?;
        Ok(Self { reached: rows.into_iter().collect(), ahead })
    }

    /// The turn of the next job in the queue of `priority`.
    pub(crate) fn take(&mut self, priority: i64) -> i64 {
        let turn = self.look(priority);
        self.ahead += 1;
        turn
    }

    /// The same for a job that does not wait, and so stands before no other.
    fn look(&self, priority: i64) -> i64 {
        self.reached.get(&priority).copied().unwrap_or(0) + self.ahead
    }
}

/// A job without a result, and what its sweeps want.
#[derive(Debug)]
struct Standing {
    job: JobId,
    state: JobState,
    /// The handing-out that lasts: attempt and claim.
    holding: Option<(u32, i64)>,
    place: Place,
    /// Whether a sweep wants it that is not cancelled.
    live: bool,
    /// The highest priority among the sweeps that want it and are neither paused nor cancelled.
    top: Option<i64>,
}

/// Where a job stands in the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Place {
    held: bool,
    priority: i64,
    turn: i64,
}

/// What becomes of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    /// Nothing.
    Stays,
    /// It is given up.
    Cancelled,
    /// It waits or runs.
    Placed,
    /// It waits again, from the start.
    Revived,
}

/// Brings `jobs` in line with the sweeps that want them; those that failed start anew if `retry`.
pub(crate) async fn settle(
    conn: &mut SqliteConnection,
    jobs: &[JobId],
    retry: bool,
    turns: &mut Turns,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<(), StoreError> {
    if jobs.is_empty() {
        return Ok(());
    }
    let mut standings = standings(conn, jobs).await?;
    let (mut changes, mut places) = (Changes::default(), Vec::new());
    for standing in jobs.iter().filter_map(|job| standings.remove(job)) {
        let fate = standing.fate(retry);
        match fate {
            Fate::Stays => continue,
            Fate::Cancelled => {
                standing.cancel(&mut changes);
                continue;
            }
            Fate::Placed => {}
            Fate::Revived => changes.revive(standing.job, standing.state),
        }
        let place = standing.new_place(fate, turns);
        if place != standing.place {
            places.push((standing.job, i64::from(place.held), place.priority, place.turn));
        }
    }
    changes.write(conn, engine_id, now_ms, tally).await?;
    if !places.is_empty() {
        sqlx::query(PLACE).bind(to_json(&places)).execute(conn).await?;
    }
    Ok(())
}

impl Standing {
    /// The rule.
    fn fate(&self, retry: bool) -> Fate {
        match (self.state, self.live) {
            (JobState::Queued | JobState::Leased, true) => Fate::Placed,
            (JobState::Queued | JobState::Leased, false) => Fate::Cancelled,
            (JobState::Cancelled, true) => Fate::Revived,
            (JobState::Failed, true) if retry => Fate::Revived,
            (JobState::Cancelled | JobState::Failed | JobState::Done, _) => Fate::Stays,
        }
    }

    /// Where it stands from now on: a job that keeps its priority may move up, one that joins a queue is placed in it.
    fn new_place(&self, fate: Fate, turns: &mut Turns) -> Place {
        let Some(priority) = self.top else { return Place { held: true, ..self.place } };
        let joined = if self.state == JobState::Leased { turns.look(priority) } else { turns.take(priority) };
        let stays = fate == Fate::Placed && !self.place.held && self.place.priority == priority;
        Place { held: false, priority, turn: if stays { joined.min(self.place.turn) } else { joined } }
    }

    fn cancel(&self, changes: &mut Changes<'_>) {
        if let Some((attempt, claim)) = self.holding {
            changes.archive(self.job, attempt, claim, AttemptEnd::Cancelled, None);
        }
        changes.cancel(self.job, self.state);
    }
}

async fn standings(conn: &mut SqliteConnection, jobs: &[JobId]) -> Result<HashMap<JobId, Standing>, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(STANDINGS).bind(to_json(&jobs)).fetch_all(conn).await?;
    rows.into_iter().map(|row| row.read().map(|standing| (standing.job, standing))).collect()
}

#[derive(sqlx::FromRow)]
struct Row(i64, String, i64, Option<i64>, i64, i64, bool, bool, Option<i64>);

impl Row {
    fn read(self) -> Result<Standing, StoreError> {
        let Self(job, state, attempt, claim, priority, turn, held, live, top) = self;
        let attempt = unsigned("an attempt", attempt)?;
        Ok(Standing {
            job: JobId(job),
            state: state_of(&state)?,
            holding: claim.map(|claim| (attempt, claim)),
            place: Place { held, priority, turn },
            live,
            top,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standing(state: JobState, live: bool) -> Standing {
        let place = Place { held: false, priority: 1, turn: 40 };
        Standing { job: JobId(1), state, holding: None, place, live, top: live.then_some(1) }
    }

    #[test]
    fn a_job_waits_or_runs_exactly_while_a_live_sweep_wants_it() {
        let fate = |state, live| standing(state, live).fate(false);
        assert_eq!(fate(JobState::Queued, true), Fate::Placed);
        assert_eq!(fate(JobState::Leased, false), Fate::Cancelled);
        assert_eq!(fate(JobState::Queued, false), Fate::Cancelled);
        assert_eq!(fate(JobState::Cancelled, true), Fate::Revived);
        assert_eq!(fate(JobState::Cancelled, false), Fate::Stays);
        assert_eq!(fate(JobState::Done, false), Fate::Stays);
    }

    #[test]
    fn a_failed_job_starts_anew_only_when_asked_for() {
        assert_eq!(standing(JobState::Failed, true).fate(false), Fate::Stays);
        assert_eq!(standing(JobState::Failed, true).fate(true), Fate::Revived);
        assert_eq!(standing(JobState::Failed, false).fate(true), Fate::Stays);
    }

    #[test]
    fn a_job_keeps_its_place_moves_up_or_joins_another_queue() {
        let behind = |ahead| Turns { reached: HashMap::from([(1, 20), (5, 100)]), ahead };
        let waits = standing(JobState::Queued, true);
        assert_eq!(waits.new_place(Fate::Placed, &mut behind(90)).turn, 40);
        assert_eq!(waits.new_place(Fate::Placed, &mut behind(3)).turn, 23);
        assert_eq!(waits.new_place(Fate::Revived, &mut behind(90)).turn, 110);
        let raised = Standing { top: Some(5), ..waits };
        assert_eq!(raised.new_place(Fate::Placed, &mut behind(7)), Place { held: false, priority: 5, turn: 107 });
        let mut turns = behind(7);
        let runs = Standing { state: JobState::Leased, ..raised };
        assert_eq!((runs.new_place(Fate::Placed, &mut turns).turn, turns.ahead), (107, 7), "it takes nobody's place");
        let held = Standing { top: None, ..runs };
        assert_eq!(held.new_place(Fate::Placed, &mut behind(7)), Place { held: true, ..held.place });
    }
}
