//! Messages without a schema of Foxglove's: how the robot moves, and what came out. Both are JSON, so that they can be plotted.

use std::collections::BTreeMap;

use foxglove::Schema;
use serde::Serialize;
use serde_json::{Value, json};

use super::Run;
use super::file::JsonMessage;

/// How the robot moves.
#[derive(Debug, Serialize)]
pub(super) struct Motion {
    pub(super) time_s: f64,
    /// Along the heading, since the pose before; none where an operator put the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) speed_m_s: Option<f64>,
    /// Counter-clockwise, likewise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) yaw_rate_rad_s: Option<f64>,
    /// Positive to the left of the middle; none where there is no lane or inter-row.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) cross_track_m: Option<f64>,
}

impl JsonMessage for Motion {
    fn schema() -> Schema {
        let number = |text: &str| json!({"type": "number", "description": text});
        schema(
            "furrow.Motion",
            &json!({
                "time_s": number("simulated time"),
                "speed_m_s": number("along the heading, since the pose before; absent after the operator moved the robot"),
                "yaw_rate_rad_s": number("counter-clockwise, since the pose before"),
                "cross_track_m": number("to the left of the middle of the lane (of the LiDAR) or of the nearest inter-row \
                    (of the robot's centre); absent outside all of them"),
            }),
        )
    }
}

/// What came out of the run.
#[derive(Debug, Serialize)]
pub(super) struct Outcome {
    outcome: &'static str,
    digest: String,
    metrics: BTreeMap<&'static str, f64>,
    interventions: usize,
    damaged_plants: usize,
}

impl Outcome {
    pub(super) fn of(run: &Run<'_>) -> Self {
        Self {
            outcome: run.result.outcome.name(),
            digest: furrow_schema::id::Digest(run.result.digest).to_string(),
            metrics: run.result.metrics.clone(),
            interventions: run.result.interventions.len(),
            damaged_plants: run.result.damaged.len(),
        }
    }
}

impl JsonMessage for Outcome {
    fn schema() -> Schema {
        let whole = |text: &str| json!({"type": "integer", "description": text});
        schema(
            "furrow.Outcome",
            &json!({
                "outcome": {"type": "string", "description": "how the run ended"},
                "digest": {"type": "string", "description": "hash over trajectory, outcome and metrics"},
                "metrics": {"type": "object", "description": "value by metric, units in the names",
                    "additionalProperties": {"type": "number"}},
                "interventions": whole("how often an operator put the robot back"),
                "damaged_plants": whole("crop plants that were run over"),
            }),
        )
    }
}

fn schema(name: &str, properties: &Value) -> Schema {
    let text = json!({"title": name, "type": "object", "properties": properties}).to_string();
    Schema::new(name, "jsonschema", text.into_bytes())
}

/// Which run this is, for the file's metadata.
pub(super) fn metadata(run: &Run<'_>) -> BTreeMap<String, String> {
    let pairs = [
        ("job", run.job.to_string()),
        ("key", run.key.to_string()),
        ("seed", run.seed.to_string()),
        ("engine", crate::engine().to_string()),
        ("scenario", run.scenario_json.to_owned()),
        ("outcome", run.result.outcome.name().to_owned()),
        ("digest", furrow_schema::id::Digest(run.result.digest).to_string()),
        ("time", "simulated, from 0 at the start of the run".to_owned()),
        ("ranges", "32-bit floating point numbers; infinity is no return".to_owned()),
        ("points", "what lines were looked for in, rounded to 1/4096 m".to_owned()),
    ];
    pairs.map(|(key, value)| (key.to_owned(), value)).into()
}
