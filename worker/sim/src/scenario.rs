//! What a run is made of.

use furrow_navigation::control::ControlSpec;
use furrow_navigation::localization::LocalizationSpec as OnBoard;
use furrow_navigation::parameters::{Choice, Kinds, ParameterError, list};
use serde::Serialize;
use serde_json::{Map, Value};

use crate::field::FieldSpec;
use crate::lidar::SensorsSpec;
use crate::localization::{InMap, LocalizationSpec};
use crate::mission::MissionSpec;
use crate::observer::{LimitsSpec, ObserverSpec};
use crate::perception::{LanePerception, PerceptionSpec, SimulatedPerception};
use crate::robot::RobotSpec;
use crate::run::STEPS_PER_S;

/// What a run is made of, checked and with all defaults filled in.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scenario {
    /// The world.
    pub field: FieldSpec,
    /// The vehicle.
    pub robot: RobotSpec,
    /// What it senses with.
    pub sensors: SensorsSpec,
    /// From scans to lines.
    pub perception: PerceptionSpec,
    /// From lines to rows around the robot.
    pub localization: LocalizationSpec,
    /// From rows to wheel commands.
    pub control: ControlSpec,
    /// Which row, and when the next one.
    pub mission: MissionSpec,
    /// Who watches.
    pub observer: ObserverSpec,
    /// When a run is given up.
    pub limits: LimitsSpec,
}

/// A scenario that cannot be run. The caller refuses it: the message names the path and what is allowed there.
pub type ScenarioError = ParameterError;

/// The parts, in the order of the loop.
pub const PARTS: [&str; 9] =
    ["field", "robot", "sensors", "perception", "localization", "control", "mission", "observer", "limits"];

impl Scenario {
    /// Reads, fills in and checks a scenario.
    ///
    /// # Errors
    /// Names the unknown, missing or out-of-range key.
    pub fn from_value(value: Value) -> Result<Self, ScenarioError> {
        let Value::Object(mut parts) = value else {
            return Err(ScenarioError::new("scenario", format!("must be an object of {}", list(&PARTS))));
        };
        if let Some(unknown) = parts.keys().find(|key| !PARTS.contains(&key.as_str())) {
            return Err(ScenarioError::new(unknown, format!("is unknown, allowed is {}", list(&PARTS))));
        }
        let scenario = Self {
            field: part(&mut parts, "field")?,
            robot: part(&mut parts, "robot")?,
            sensors: part(&mut parts, "sensors")?,
            perception: part(&mut parts, "perception")?,
            localization: part(&mut parts, "localization")?,
            control: part(&mut parts, "control")?,
            mission: part(&mut parts, "mission")?,
            observer: part(&mut parts, "observer")?,
            limits: part(&mut parts, "limits")?,
        };
        scenario.check().map(|()| scenario)
    }

    /// Checks what one part cannot say alone.
    fn check(&self) -> Result<(), ScenarioError> {
        match &self.mission {
            MissionSpec::Lane(_) => self.check_lane(),
            MissionSpec::RowByRow(_) | MissionSpec::HeadingHold(_) => self.check_rows(),
            MissionSpec::Nursery(_) => self.check_nursery(),
        }
    }

    /// The parts of a mission among rows.
    fn check_rows(&self) -> Result<(), ScenarioError> {
        let blind = matches!(self.perception, PerceptionSpec::Simulated(SimulatedPerception::None(_)));
        if blind && matches!(self.mission, MissionSpec::RowByRow(_)) {
            let reason =
                "`none` finds no lines, but the mission `row-by-row` follows them; allowed with `heading-hold`";
            return Err(ScenarioError::new("perception.kind", reason));
        }
        let fits = "for the missions `row-by-row` and `heading-hold`";
        fit(self.field.among_rows(), "field.kind", "`guyonneau2022` or `custom`", fits)?;
        fit(matches!(self.robot, RobotSpec::TwoWheeled(_)), "robot.kind", "`two-wheeled`", fits)?;
        let finds_rows = matches!(self.perception, PerceptionSpec::Simulated(_) | PerceptionSpec::LineFinder(_));
        fit(finds_rows, "perception.kind", "`oracle`, `none` or a line finder", fits)?;
        let filters = matches!(self.localization, LocalizationSpec::OnBoard(OnBoard::RowFilter(_)));
        fit(filters, "localization.kind", "`row-filter`", fits)?;
        fit(matches!(self.control, ControlSpec::Fuzzy(_)), "control.kind", "`fuzzy`", fits)?;
        fit(matches!(self.observer, ObserverSpec::InterRows(_)), "observer.kind", "`inter-rows`", fits)?;
        let SensorsSpec::TwoPlanarLidars(sensors) = &self.sensors else {
            return fit(false, "sensors.kind", "`two-planar-lidars`", fits);
        };
        check_ranges(sensors.range_min_m, sensors.range_max_m)
    }

    /// The parts of a mission along a lane.
    fn check_lane(&self) -> Result<(), ScenarioError> {
        let fits = "for the mission `lane`";
        fit(matches!(self.field, FieldSpec::Velasquez2022(_)), "field.kind", "`velasquez2022`", fits)?;
        fit(matches!(self.robot, RobotSpec::SkidSteer(_)), "robot.kind", "`skid-steer`", fits)?;
        let sees = LanePerception::new(&self.perception, 1.0).is_some();
        fit(sees, "perception.kind", "`oracle` or a lane finder", fits)?;
        let places = self.localization.lane_estimator(1.0).is_some();
        fit(places, "localization.kind", "`view` or a filter of lanes", fits)?;
        fit(matches!(self.control, ControlSpec::LanePd(_)), "control.kind", "`lane-pd`", fits)?;
        fit(matches!(self.observer, ObserverSpec::Operator(_)), "observer.kind", "`operator`", fits)?;
        let SensorsSpec::OnePlanarLidar(sensors) = &self.sensors else {
            return fit(false, "sensors.kind", "`one-planar-lidar`", fits);
        };
        let reason = format!("{} does not divide the LiDAR's 40 scans a second", sensors.rate_hz);
        if !STEPS_PER_S.is_multiple_of(sensors.rate_hz) {
            return Err(ScenarioError::new("sensors.rate_hz", reason));
        }
        check_ranges(sensors.range_min_m, sensors.range_max_m)
    }

    /// The parts of a mission in a nursery.
    fn check_nursery(&self) -> Result<(), ScenarioError> {
        let fits = "for the mission `nursery`";
        fit(matches!(self.field, FieldSpec::Vintu2018(_)), "field.kind", "`vintu2018`", fits)?;
        let drives = matches!(self.robot, RobotSpec::Tracked(_) | RobotSpec::SkidSteer(_));
        fit(drives, "robot.kind", "`tracked` or `skid-steer`", fits)?;
        let sees = matches!(
            self.perception,
            PerceptionSpec::RowDetector(_) | PerceptionSpec::Simulated(SimulatedPerception::Oracle(_))
        );
        fit(sees, "perception.kind", "`oracle` or a row detector", fits)?;
        fit(InMap::places(&self.localization), "localization.kind", "`none`, `pose-graph` or `oracle`", fits)?;
        fit(self.control.mid_line().is_some(), "control.kind", "`pid` or `io-linearization`", fits)?;
        fit(matches!(self.observer, ObserverSpec::Nursery(_)), "observer.kind", "`nursery`", fits)?;
        let SensorsSpec::Fx10(sensors) = &self.sensors else {
            return fit(false, "sensors.kind", "`fx10`", fits);
        };
        check_ranges(sensors.range_min_m, sensors.range_max_m)
    }

    /// The resolved scenario as JSON, all defaults present.
    #[must_use]
    pub fn to_value(&self) -> Value {
        serde_json::to_value(self).expect("a scenario is plain data with text keys")
    }

    /// The resolved scenario as canonical JSON: all defaults present, keys sorted, no white space.
    #[must_use]
    pub fn canonical_json(&self) -> String {
        let mut text = String::new();
        write_sorted(&self.to_value(), &mut text);
        text
    }
}

/// Refuses a part that does not fit the mission.
fn fit(fits: bool, path: &str, allowed: &str, mission: &str) -> Result<(), ScenarioError> {
    if fits { Ok(()) } else { Err(ScenarioError::new(path, format!("must be {allowed} {mission}"))) }
}

fn check_ranges(min_m: f64, max_m: f64) -> Result<(), ScenarioError> {
    if min_m < max_m {
        return Ok(());
    }
    let reason = format!("{min_m} must be below sensors.range_max_m, {max_m}");
    Err(ScenarioError::new("sensors.range_min_m", reason))
}

fn part<T: Kinds>(parts: &mut Map<String, Value>, name: &str) -> Result<T, ScenarioError> {
    let value = parts.remove(name).ok_or_else(|| {
        let reason = format!("is missing, its `kind` must be one of {}", list(&T::kinds()));
        ScenarioError::new(name, reason)
    })?;
    T::read(value).map_err(|error| error.under(name))
}

/// Writes JSON with sorted keys, whatever order the map type keeps.
fn write_sorted(value: &Value, text: &mut String) {
    match value {
        Value::Object(map) => {
            let mut entries: Vec<_> = map.iter().collect();
            entries.sort_by_key(|(key, _)| *key);
            text.push('{');
            for (i, (key, value)) in entries.into_iter().enumerate() {
                text.push_str(if i > 0 { "," } else { "" });
                text.push_str(&Value::String(key.clone()).to_string());
                text.push(':');
                write_sorted(value, text);
            }
            text.push('}');
        }
        Value::Array(items) => {
            text.push('[');
            for (i, item) in items.iter().enumerate() {
                text.push_str(if i > 0 { "," } else { "" });
                write_sorted(item, text);
            }
            text.push(']');
        }
        scalar => text.push_str(&scalar.to_string()),
    }
}

/// What every part can be, for catalogues: (part, its choices), in the order of the loop.
#[must_use]
pub fn catalogue() -> [(&'static str, Vec<Choice>); 9] {
    [
        ("field", FieldSpec::choices()),
        ("robot", RobotSpec::choices()),
        ("sensors", SensorsSpec::choices()),
        ("perception", PerceptionSpec::choices()),
        ("localization", LocalizationSpec::choices()),
        ("control", ControlSpec::choices()),
        ("mission", MissionSpec::choices()),
        ("observer", ObserverSpec::choices()),
        ("limits", LimitsSpec::choices()),
    ]
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use serde_json::json;

    /// The scenario of the plans, every part with its defaults.
    pub(crate) fn base() -> Value {
        json!({
            "field": {"kind": "guyonneau2022"}, "robot": {"kind": "two-wheeled"},
            "sensors": {"kind": "two-planar-lidars"}, "perception": {"kind": "rgop"},
            "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"},
            "mission": {"kind": "row-by-row"}, "observer": {"kind": "inter-rows"},
            "limits": {"kind": "simulated-time"}
        })
    }

    /// The system of Velasquez et al. (2022), every part with its defaults.
    pub(crate) fn lane() -> Value {
        json!({
            "field": {"kind": "velasquez2022"}, "robot": {"kind": "skid-steer"},
            "sensors": {"kind": "one-planar-lidar"}, "perception": {"kind": "pl"},
            "localization": {"kind": "ekf"}, "control": {"kind": "lane-pd"},
            "mission": {"kind": "lane"}, "observer": {"kind": "operator"},
            "limits": {"kind": "simulated-time"}
        })
    }

    /// The system of Vintu (2018), every part with its defaults.
    pub(crate) fn nursery() -> Value {
        json!({
            "field": {"kind": "vintu2018"}, "robot": {"kind": "tracked"},
            "sensors": {"kind": "fx10"}, "perception": {"kind": "map-lines"},
            "localization": {"kind": "pose-graph"}, "control": {"kind": "pid"},
            "mission": {"kind": "nursery"}, "observer": {"kind": "nursery"},
            "limits": {"kind": "simulated-time"}
        })
    }

    fn refused(path: &str, value: Value) -> String {
        refused_in(base(), path, value)
    }

    fn refused_in(mut scenario: Value, path: &str, value: Value) -> String {
        let (parent, key) = path.rsplit_once('/').unwrap();
        scenario.pointer_mut(parent).unwrap()[key] = value;
        Scenario::from_value(scenario).unwrap_err().to_string()
    }

    #[test]
    fn a_resolved_scenario_reads_back_as_itself() {
        let scenario = Scenario::from_value(base()).unwrap();
        let text = scenario.canonical_json();
        assert!(text.contains(r#""perception":{"attach_distance_m":0.2,"#), "{text}");
        let again = Scenario::from_value(serde_json::from_str(&text).unwrap()).unwrap();
        assert_eq!((&again, again.canonical_json()), (&scenario, text));
    }

    #[test]
    fn errors_name_path_and_range() {
        assert!(refused("/perception/iterations", json!(0)).starts_with("perception.iterations: 0 is out of range"));
        assert!(refused("/perception/speed", json!(0)).contains("perception.speed"));
        assert!(refused("/perception/iterations", json!(1.5)).starts_with("perception.iterations: invalid type"));
        assert!(refused("/robot", json!(3)).starts_with("robot: must be an object"));
        assert!(refused("/weather", json!({})).starts_with("weather: is unknown"));
        assert!(refused("/field/kind", json!("moon")).starts_with("field.kind: `moon` is unknown"));
        assert!(refused("/perception", json!({"kind": "none"})).starts_with("perception.kind: `none`"));
        assert!(refused("/perception", json!({"kind": "oracle", "eyes": 2})).contains("perception.eyes"));
        assert!(refused("/field/seed", json!({"fixed": -1})).starts_with("field.seed"));
    }

    #[test]
    fn parts_of_rows_lanes_and_nurseries_do_not_mix() {
        Scenario::from_value(lane()).unwrap();
        Scenario::from_value(nursery()).unwrap();
        for part in ["field", "robot", "sensors", "perception", "localization", "control", "observer"] {
            for (scenario, other) in [(base(), lane()), (lane(), base()), (base(), nursery()), (nursery(), lane())] {
                if part == "robot" && other[part] == json!({"kind": "skid-steer"}) && scenario == nursery() {
                    continue; // A Jackal is one.
                }
                let message = refused_in(scenario, &format!("/{part}"), other[part].clone());
                assert!(message.starts_with(&format!("{part}.kind: must be `")), "{message}");
            }
        }
        let message = refused_in(lane(), "/perception", json!({"kind": "none"}));
        assert_eq!(message, "perception.kind: must be `oracle` or a lane finder for the mission `lane`");
        assert!(refused_in(lane(), "/sensors/rate_hz", json!(7)).starts_with("sensors.rate_hz: 7 does not divide"));
    }

    #[test]
    fn every_part_stands_in_the_catalogue() {
        assert_eq!(catalogue().map(|(part, _)| part), PARTS);
        assert!(catalogue().iter().all(|(_, choices)| !choices.is_empty()));
    }

    #[test]
    fn every_parameter_says_what_it_means_and_where_its_default_comes_from() {
        for (part, choices) in catalogue() {
            for choice in choices {
                let unclear = choice.parameters.iter().filter(|one| one.about().is_empty() || one.source().is_empty());
                let unclear: Vec<_> = unclear.map(|one| one.name).collect();
                assert!(unclear.is_empty(), "{part}.{}: {unclear:?}", choice.kind);
            }
        }
    }
}
