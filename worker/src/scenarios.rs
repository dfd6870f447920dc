//! The scenarios a worker holds, so that their texts are sent to it once.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use furrow_schema::id::ScenarioId;
use furrow_schema::protocol::{MAX_KNOWN_SCENARIOS, ScenarioText};

/// Texts of all held scenarios together take at most this many bytes.
const MAX_BYTES: usize = 64 << 20;

/// A scenario as it was sent, read when it is first run.
#[derive(Debug)]
pub(crate) struct HeldScenario<S> {
    json: String,
    read: OnceLock<Result<S, String>>,
}

impl<S> HeldScenario<S> {
    fn new(json: String) -> Self {
        Self { json, read: OnceLock::new() }
    }

    /// The scenario, or what is wrong with it.
    pub(crate) fn read_by(&self, read: impl FnOnce(&str) -> Result<S, String>) -> Result<&S, &str> {
        self.read.get_or_init(|| read(&self.json)).as_ref().map_err(String::as_str)
    }
}

/// The scenarios at hand; those used longest ago are forgotten first.
#[derive(Debug)]
pub(crate) struct Scenarios<S> {
    held: HashMap<ScenarioId, (u64, Arc<HeldScenario<S>>)>,
    uses: u64,
    bytes: usize,
}

impl<S> Scenarios<S> {
    pub(crate) fn new() -> Self {
        Self { held: HashMap::new(), uses: 0, bytes: 0 }
    }

    /// The scenarios to name in a claim, in order.
    pub(crate) fn known(&self) -> Vec<ScenarioId> {
        let mut known: Vec<ScenarioId> = self.held.keys().copied().collect();
        known.sort_unstable();
        known
    }

    /// Takes in the scenarios that came with an answer.
    pub(crate) fn learn(&mut self, texts: Vec<ScenarioText>) {
        for ScenarioText { id, json } in texts {
            self.uses += 1;
            self.bytes += json.len();
            if let Some((_, old)) = self.held.insert(id, (self.uses, Arc::new(HeldScenario::new(json)))) {
                self.bytes -= old.json.len();
            }
        }
    }

    /// One scenario, if it is at hand.
    pub(crate) fn get(&mut self, id: ScenarioId) -> Option<Arc<HeldScenario<S>>> {
        self.uses += 1;
        let (used, scenario) = self.held.get_mut(&id)?;
        *used = self.uses;
        Some(Arc::clone(scenario))
    }

    /// Keeps within the limits. Called when no claim is on its way, since that names what is held.
    pub(crate) fn forget_surplus(&mut self) {
        self.shrink_to(MAX_KNOWN_SCENARIOS, MAX_BYTES);
    }

    fn shrink_to(&mut self, max_scenarios: usize, max_bytes: usize) {
        while self.held.len() > max_scenarios || self.bytes > max_bytes {
            let Some(oldest) = self.held.iter().min_by_key(|(_, (used, _))| *used).map(|(id, _)| *id) else { return };
            if let Some((_, scenario)) = self.held.remove(&oldest) {
                self.bytes -= scenario.json.len();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(id: i64) -> ScenarioText {
        ScenarioText { id: ScenarioId(id), json: "{}".to_owned() }
    }

    #[test]
    fn the_scenario_used_longest_ago_is_forgotten_first() {
        let mut scenarios = Scenarios::<()>::new();
        scenarios.learn(vec![text(1), text(2), text(3)]);
        scenarios.get(ScenarioId(1));
        scenarios.shrink_to(2, 100);
        assert_eq!(scenarios.known(), [ScenarioId(1), ScenarioId(3)]);
        scenarios.shrink_to(2, 3);
        assert_eq!(scenarios.known(), [ScenarioId(1)]);
    }

    #[test]
    fn a_scenario_sent_twice_counts_once() {
        let mut scenarios = Scenarios::<()>::new();
        scenarios.learn(vec![text(1), text(1)]);
        assert_eq!((scenarios.known().len(), scenarios.bytes), (1, 2));
    }

    #[test]
    fn a_scenario_is_read_once() {
        let held = HeldScenario::new("7".to_owned());
        assert_eq!(held.read_by(|json| json.parse::<u8>().map_err(|error| error.to_string())), Ok(&7));
        assert_eq!(held.read_by(|_| Err("read again".to_owned())), Ok(&7));
    }
}
