use std::collections::BTreeMap;
use std::io;

use foxglove::messages::{FrameTransform, FrameTransforms, LaserScan, PointCloud, SceneUpdate};
use foxglove::{Decode, Encode};
use furrow_schema::id::{JobId, JobKey};
use furrow_sim::field::Field;
use furrow_sim::{Detection, Pose, Probe, RunResult, Scan, Scenario};
use furrow_worker::replay::watch;
use serde_json::{Value, json};

use super::{RecordError, Run, record};

/// Six standard deviations of a range.
const NOISE_M: f64 = 0.06;

/// A scenario of a few seconds.
fn scenario(plan: &str, set: &[(&str, Value)]) -> Scenario {
    let mut value = furrow_sim::plan::read(plan).base;
    for (pointer, to) in set {
        *value.pointer_mut(pointer).unwrap() = to.clone();
    }
    Scenario::from_value(value).unwrap()
}
