use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::io;

use foxglove::Decode;
use foxglove::messages::{FrameTransform, FrameTransforms, LaserScan, PointCloud, SceneUpdate};
use furrow_schema::id::{JobId, JobKey};
use furrow_sim::{Detection, Pose, Probe, RunResult, Scan, Scenario};
use furrow_worker::replay::watch;
use mcap::{Message, MessageStream};
use serde_json::{Value, json};

use super::{RecordError, Run, record};

/// Six standard deviations of a range.
const NOISE_M: f64 = 0.06;
const SEED: u64 = 3;

fn among_rows(max_time_s: f64) -> Scenario {
    scenario(&json!({
        "field": {"kind": "guyonneau2022", "crop": 2, "seed": "job"}, "robot": {"kind": "two-wheeled"},
        "sensors": {"kind": "two-planar-lidars"}, "perception": {"kind": "rgop"},
        "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"}, "mission": {"kind": "row-by-row"},
        "observer": {"kind": "inter-rows"}, "limits": {"kind": "simulated-time", "max_time_s": max_time_s}
    }))
}

/// Stems on even ground; the robot sees the rows, and steers by `kp`.
fn in_a_lane(rate_hz: u32, kp: f64, max_time_s: f64) -> Scenario {
    scenario(&json!({
        "field": {"kind": "velasquez2022", "seed": "job", "leaf_factor": 0.0, "weed_factor": 0.0, "roughness_factor": 0.0},
        "robot": {"kind": "skid-steer"}, "sensors": {"kind": "one-planar-lidar", "rate_hz": rate_hz},
        "perception": {"kind": "oracle"}, "localization": {"kind": "view"},
        "control": {"kind": "lane-pd", "kp": kp, "kd": 0.0}, "mission": {"kind": "lane"},
        "observer": {"kind": "operator"}, "limits": {"kind": "simulated-time", "max_time_s": max_time_s}
    }))
}

fn scenario(value: &Value) -> Scenario {
    Scenario::from_value(value.clone()).unwrap()
}

/// What the LiDARs saw, in order.
#[derive(Default)]
struct Kept(Vec<Vec<f64>>);

impl Probe for Kept {
    fn scanned(&mut self, _world_from_lidar: Pose, scan: &Scan<'_>, _found: Detection<'_>) {
        self.0.push(scan.ranges_m.to_vec());
    }
}

fn kept(scenario: &Scenario) -> (RunResult, Kept) {
    let mut kept = Kept::default();
    (watch(scenario, SEED, &mut kept).unwrap(), kept)
}

fn written(scenario: &Scenario, result: &RunResult, out: impl io::Write) -> Result<(), RecordError> {
    let scenario_json = scenario.canonical_json();
    let key = JobKey([7; 32]);
    record(&Run { job: JobId(1), key, scenario_json: &scenario_json, scenario, seed: SEED, result }, out)
}

fn recording(scenario: &Scenario) -> Vec<u8> {
    let mut bytes = Vec::new();
    written(scenario, &kept(scenario).0, &mut bytes).unwrap();
    bytes
}

fn messages(bytes: &[u8]) -> Vec<Message<'_>> {
    MessageStream::new(bytes).unwrap().map(Result::unwrap).collect()
}

/// The messages on `topic`, with their times \[ns\].
fn on<T: Decode>(bytes: &[u8], topic: &str) -> Vec<(u64, T)> {
    let all = messages(bytes).into_iter().filter(|message| message.channel.topic == topic);
    all.map(|message| (message.log_time, T::decode(&*message.data).unwrap())).collect()
}

fn motions(bytes: &[u8]) -> Vec<Value> {
    let all = messages(bytes).into_iter().filter(|message| message.channel.topic == "/robot/motion");
    all.map(|message| serde_json::from_slice(&message.data).unwrap()).collect()
}

fn pose(transform: &FrameTransform) -> Pose {
    let (at, turn) = (transform.translation.unwrap(), transform.rotation.unwrap());
    Pose { x_m: at.x, y_m: at.y, heading_rad: 2.0 * f64::atan2(turn.z, turn.w) }
}

fn world([x, y]: [f64; 2], frame: Pose) -> [f64; 2] {
    let (sin, cos) = frame.heading_rad.sin_cos();
    [frame.x_m + cos * x - sin * y, frame.y_m + sin * x + cos * y]
}

/// Distance of each return from the surface of the nearest stem, by the file alone; `lidar` is `front` or `back`.
fn distances(bytes: &[u8], lidar: &str) -> Vec<f64> {
    let (_, fixed) = on::<FrameTransforms>(bytes, "/tf_static").remove(0);
    let frame = format!("lidar_{lidar}");
    let mount = pose(fixed.transforms.iter().find(|transform| transform.child_frame_id == frame).unwrap());
    let robots: BTreeMap<u64, Pose> =
        on(bytes, "/tf").iter().map(|(time, transform)| (*time, pose(transform))).collect();
    let (_, field) = on::<SceneUpdate>(bytes, "/field").remove(0);
    let stems: Vec<_> = field.entities.iter().flat_map(|entity| &entity.cylinders).collect();
    let mut distances = Vec::new();
    for (time, scan) in on::<LaserScan>(bytes, &format!("/lidar/{lidar}/scan")).iter().step_by(7) {
        let increment = (scan.end_angle - scan.start_angle) / (scan.ranges.len() - 1) as f64;
        for (i, range) in scan.ranges.iter().enumerate().filter(|(_, range)| range.is_finite()) {
            let (sin, cos) = (scan.start_angle + i as f64 * increment).sin_cos();
            let [x, y] = world(world([range * cos, range * sin], mount), robots[time]);
            let off = stems.iter().map(|stem| {
                let at = stem.pose.as_ref().unwrap().position.unwrap();
                (f64::hypot(x - at.x, y - at.y) - 0.5 * stem.size.unwrap().x).abs()
            });
            distances.push(off.fold(f64::INFINITY, f64::min));
        }
    }
    distances
}

#[test]
fn the_transforms_put_every_return_onto_a_stem_within_the_noise() {
    let lane = in_a_lane(40, 2.0, 3.0);
    for (scenario, lidar) in [(among_rows(5.0), "front"), (among_rows(20.0), "back"), (lane, "front")] {
        let distances = distances(&recording(&scenario), lidar);
        assert!(distances.len() > 1000, "{lidar}: {} returns", distances.len());
        let farthest = distances.iter().fold(0.0_f64, |a, b| a.max(*b));
        let rms = (distances.iter().map(|d| d * d).sum::<f64>() / distances.len() as f64).sqrt();
        assert!(farthest < NOISE_M && rms < 0.012, "{lidar}: up to {farthest} m, {rms} m");
    }
}

#[test]
fn all_scans_are_there_with_their_ranges_and_the_points_that_lines_were_found_in() {
    let scenario = among_rows(5.0);
    let (_, Kept(scans)) = kept(&scenario);
    let bytes = recording(&scenario);
    let lidars = ["front", "back"].map(|lidar| on::<LaserScan>(&bytes, &format!("/lidar/{lidar}/scan")));
    assert_eq!(scans.len(), lidars[0].len() + lidars[1].len());
    for (i, exact) in scans.iter().enumerate() {
        let (time, scan) = &lidars[i % 2][i / 2];
        assert_eq!(*time, (i as u64 / 2) * 25_000_000);
        assert_eq!((scan.start_angle, scan.ranges.len()), (-0.5 * PI, exact.len()));
        assert!(scan.ranges.iter().zip(exact).all(|(read, exact)| *read == f64::from(*exact as f32)));
    }
    let clouds = on::<PointCloud>(&bytes, "/lidar/front/points");
    let returns = |scan: &LaserScan| scan.ranges.iter().filter(|range| range.is_finite()).count();
    let points = |cloud: &PointCloud| cloud.data.len() / cloud.point_stride as usize;
    assert!(clouds.iter().zip(&lidars[0]).all(|((_, cloud), (_, scan))| (1..returns(scan)).contains(&points(cloud))));
}

#[test]
fn topics_have_schemas_and_messages_come_in_the_order_of_time() {
    let scenario = among_rows(5.0);
    let bytes = recording(&scenario);
    let mut topics: BTreeMap<String, (String, String, usize)> = BTreeMap::new();
    let mut before = 0;
    for message in messages(&bytes) {
        assert!(message.log_time >= before && message.log_time == message.publish_time);
        before = message.log_time;
        let schema = message.channel.schema.as_ref().unwrap();
        let encoding = format!("{} {}", message.channel.message_encoding, schema.encoding);
        let entry = (schema.name.clone(), encoding, 0);
        let (.., count) = topics.entry(message.channel.topic.clone()).or_insert(entry);
        assert_eq!(message.sequence as usize, *count);
        *count += 1;
    }
    let of = |topic: &str| {
        let (name, encoding, count) = &topics[topic];
        (name.as_str(), encoding.as_str(), *count)
    };
    let protobuf = "protobuf protobuf";
    for lidar in ["front", "back"] {
        assert_eq!(of(&format!("/lidar/{lidar}/scan")), ("foxglove.LaserScan", protobuf, 200));
        assert_eq!(of(&format!("/lidar/{lidar}/points")), ("foxglove.PointCloud", protobuf, 200));
        assert_eq!(of(&format!("/lidar/{lidar}/lines")), ("foxglove.SceneUpdate", protobuf, 200));
    }
    assert_eq!(of("/tf"), ("foxglove.FrameTransform", protobuf, 201));
    assert_eq!(of("/field"), ("foxglove.SceneUpdate", protobuf, 1));
    assert_eq!(of("/robot/motion"), ("furrow.Motion", "json jsonschema", 101));
    assert_eq!(of("/metrics"), ("furrow.Outcome", "json jsonschema", 1));
    let stats = mcap::Summary::read(&bytes).unwrap().unwrap().stats.unwrap();
    assert_eq!((stats.metadata_count, stats.message_end_time), (1, 5_000_000_000));
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let scenario = among_rows(5.0);
    assert_eq!(recording(&scenario), recording(&scenario));
}

#[test]
fn where_an_operator_moves_the_robot_there_is_a_mark_and_no_speed() {
    for rate_hz in [40, 5] {
        let scenario = in_a_lane(rate_hz, 0.0, 60.0);
        let result = kept(&scenario).0;
        assert!(!result.interventions.is_empty(), "{result:?}");
        let bytes = recording(&scenario);
        let marks = on::<SceneUpdate>(&bytes, "/interventions");
        assert_eq!(marks.last().unwrap().1.entities.len(), result.interventions.len());
        assert_eq!(marks[0].0, (result.interventions[0].time_s * 1e9).round() as u64);
        assert!(marks[0].1.entities[0].texts[0].text.starts_with(result.interventions[0].cause.name()));
        let motions = motions(&bytes);
        let speeds: Vec<f64> = motions.iter().filter_map(|motion| motion["speed_m_s"].as_f64()).collect();
        assert!(speeds.len() > motions.len() / 2 && speeds.iter().all(|speed| (-0.01..1.0).contains(speed)));
        assert!(motions.iter().all(|motion| motion["cross_track_m"].as_f64().unwrap().abs() < 1.0));
    }
}

/// Takes so many bytes and no more.
struct Full(usize);

impl io::Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 = self.0.checked_sub(bytes.len()).ok_or(io::ErrorKind::StorageFull)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_and_another_result_are_errors() {
    let scenario = among_rows(5.0);
    let mut result = kept(&scenario).0;
    for room in [0, 1_000, 100_000] {
        assert!(matches!(written(&scenario, &result, Full(room)), Err(RecordError::Write(_))), "{room}");
    }
    result.digest[0] ^= 1;
    assert!(matches!(written(&scenario, &result, io::sink()), Err(RecordError::OtherDigest)));
}
