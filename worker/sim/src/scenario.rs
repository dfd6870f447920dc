//! What a run is made of.

use furrow_navigation::control::ControlSpec;
use furrow_navigation::localization::LocalizationSpec;
use furrow_navigation::parameters::{Kinds, Parameter, ParameterError, list};
use serde::Serialize;
use serde_json::{Map, Value};

use crate::field::FieldSpec;
use crate::lidar::SensorsSpec;
use crate::mission::MissionSpec;
use crate::observer::{LimitsSpec, ObserverSpec};
use crate::perception::{PerceptionSpec, SimulatedPerception};
use crate::robot::RobotSpec;

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
        let blind = matches!(self.perception, PerceptionSpec::Simulated(SimulatedPerception::None(_)));
        if blind && matches!(self.mission, MissionSpec::RowByRow(_)) {
            let reason =
                "`none` finds no lines, but the mission `row-by-row` follows them; allowed with `heading-hold`";
            return Err(ScenarioError::new("perception.kind", reason));
        }
        if !matches!(self.localization, LocalizationSpec::RowFilter(_)) {
            return Err(ScenarioError::new("localization.kind", "must be `row-filter` for missions among rows"));
        }
        if !matches!(self.control, ControlSpec::Fuzzy(_)) {
            return Err(ScenarioError::new("control.kind", "must be `fuzzy` for missions among rows"));
        }
        let SensorsSpec::TwoPlanarLidars(sensors) = &self.sensors;
        if sensors.range_min_m >= sensors.range_max_m {
            let reason = format!("{} must be below sensors.range_max_m, {}", sensors.range_min_m, sensors.range_max_m);
            return Err(ScenarioError::new("sensors.range_min_m", reason));
        }
        Ok(())
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

/// The parameters of every kind of every part, for catalogues: (part, kind, parameters).
#[must_use]
pub fn catalogue() -> Vec<(&'static str, &'static str, &'static [Parameter])> {
    let mut rows = Vec::new();
    list_part::<FieldSpec>("field", &mut rows);
    list_part::<RobotSpec>("robot", &mut rows);
    list_part::<SensorsSpec>("sensors", &mut rows);
    list_part::<PerceptionSpec>("perception", &mut rows);
    list_part::<LocalizationSpec>("localization", &mut rows);
    list_part::<ControlSpec>("control", &mut rows);
    list_part::<MissionSpec>("mission", &mut rows);
    list_part::<ObserverSpec>("observer", &mut rows);
    list_part::<LimitsSpec>("limits", &mut rows);
    rows
}

fn list_part<T: Kinds>(part: &'static str, rows: &mut Vec<(&'static str, &'static str, &'static [Parameter])>) {
    rows.extend(T::kinds().into_iter().map(|kind| (part, kind, T::table(kind).unwrap_or_default())));
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

    fn refused(path: &str, value: Value) -> String {
        let mut scenario = base();
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
    fn every_part_stands_in_the_catalogue() {
        for name in PARTS {
            assert!(catalogue().iter().any(|(part, _, _)| *part == name));
        }
    }
}
