//! What the jobs of a schedule are like: most have a result, some panic first, or always, or kill their workers.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use furrow_schema::id::Digest;
use furrow_schema::job::{RunRecord, Timings};
use furrow_schema::sweep::{NewCell, NewSweep};

use super::ENGINE;
use super::world::World;

/// What a job may do instead of ending well.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Nature {
    Panics,
    Kills,
}

/// Labels are the first of these.
pub(super) const LABELS: [&str; 3] = ["rgop", "rg", "pearl"];

/// See the module.
pub(super) struct Jobs {
    /// How often jobs with this seed do so.
    times: BTreeMap<(Nature, u64), u64>,
    did: Mutex<BTreeMap<(Nature, String, u64), u64>>,
}

/// More often than anybody tries.
const ALWAYS: u64 = 1_000;

impl Jobs {
    pub(super) fn draw(world: &World) -> Self {
        let mut times = BTreeMap::new();
        for seed in 1..=world.size.seeds {
            match world.draw(0..20) {
                0 => times.insert((Nature::Panics, seed), ALWAYS),
                1 | 2 => times.insert((Nature::Panics, seed), world.draw(1..3)),
                3 if world.draw(0..4) == 0 => times.insert((Nature::Kills, seed), ALWAYS),
                4 => times.insert((Nature::Kills, seed), 1),
                _ => None,
            };
        }
        Self { times, did: Mutex::default() }
    }

    /// Whether this job does so now.
    pub(super) fn next(&self, nature: Nature, scenario: &str, seed: u64) -> bool {
        let times = self.times.get(&(nature, seed)).copied().unwrap_or(0);
        let mut did = self.did.lock().unwrap();
        let did = did.entry((nature, scenario.to_owned(), seed)).or_default();
        *did += 1;
        *did <= times
    }

    /// Whether jobs with this seed can have no result.
    pub(super) fn is_hopeless(&self, seed: u64) -> bool {
        [Nature::Panics, Nature::Kills].iter().any(|nature| self.times.get(&(*nature, seed)) == Some(&ALWAYS))
    }
}

/// What a user asks for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wish {
    /// So many of the labels, each with seeds 1 to `seeds`.
    pub(super) labels: usize,
    pub(super) seeds: u64,
    pub(super) priority: i64,
    /// Sweeps of the same generation share jobs.
    pub(super) generation: usize,
    pub(super) key: usize,
}

impl Wish {
    fn factors(&self, label: &str) -> BTreeMap<String, String> {
        let label = ("algorithm".to_owned(), label.to_owned());
        BTreeMap::from([label, ("generation".to_owned(), self.generation.to_string())])
    }

    /// Whether this job is one of it.
    pub(super) fn covers(&self, scenario_json: &str, seed: u64) -> bool {
        let labels = &LABELS[..self.labels];
        seed <= self.seeds && labels.iter().any(|label| scenario(&self.factors(label)) == scenario_json)
    }
}

/// The scenario of a cell.
pub(super) fn scenario(factors: &BTreeMap<String, String>) -> String {
    serde_json::to_string(factors).expect("texts are JSON")
}

pub(super) fn sweep(wish: Wish) -> NewSweep {
    let Wish { labels, seeds, priority, key, .. } = wish;
    let cell = |label: &&str| {
        let factors = wish.factors(label);
        NewCell { scenarios: vec![Arc::from(scenario(&factors))], factors }
    };
    NewSweep {
        name: "a sweep".to_owned(),
        plan: "test/plan".to_owned(),
        request_json: "{}".to_owned(),
        engine: ENGINE,
        priority,
        record: false,
        timing: false,
        seeds,
        factors: vec!["algorithm".to_owned(), "generation".to_owned()],
        cells: LABELS[..labels].iter().map(cell).collect(),
        idempotency_key: Some(key.to_string()),
    }
}

/// The value that follows from what a run is.
pub(super) fn value(scenario: &str, seed: u64) -> f64 {
    let text: u64 = scenario.bytes().fold(7, |sum, byte| sum.wrapping_mul(31).wrapping_add(u64::from(byte)));
    (text % 1_000) as f64 / 7.0 + seed as f64 / 3.0
}

/// What comes out of a run.
pub(super) fn record(scenario: &str, seed: u64) -> RunRecord {
    let value = value(scenario, seed);
    let mut digest = [0; 32];
    digest[..8].copy_from_slice(&value.to_le_bytes());
    RunRecord {
        digest: Digest(digest),
        outcome: "success".to_owned(),
        metrics: BTreeMap::from([("distance_m".to_owned(), value)]),
        timings: Timings::default(),
        trajectory: None,
    }
}
