//! A user's own field: rows (straight or curved), plants, and where the robot starts, as a JSON file.

use furrow_navigation::parameters::{Parameter, ParameterError, Parameters};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{Field, Plant, PlantKind, Polyline, custom_schema};
use crate::Pose;

/// At most so many plants.
pub const MAX_PLANTS: usize = 100_000;
/// At most so many rows, and points in a row.
pub const MAX_ROWS: usize = 1_000;
/// Coordinates lie within this of the origin \[m\].
pub(super) const MAX_COORDINATE_M: f64 = 10_000.0;

/// The file's content.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CustomField {
    /// For people, and the label in tables.
    pub name: String,
    /// Distance between rows \[m\].
    pub row_spacing_m: f64,
    /// Rows, from the robot's right to its left; the robot starts between the first two.
    pub rows: Vec<CustomRow>,
    /// Stems.
    pub plants: Vec<Plant>,
    /// The robot at time 0.
    pub start: Start,
    /// How many inter-rows to drive through: fewer than there are rows.
    pub inter_rows: u32,
    /// Positions count into the squared error where x lies in this range \[m\]; none: 1 m inside the row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_range_x_m: Option<[f64; 2]>,
}

/// One row's centre line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CustomRow {
    /// Two points or more (x, y) \[m\], in the direction in which the robot drives first.
    pub points_m: Vec<[f64; 2]>,
}

/// A pose, as it stands in the file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// \[m\]
    pub x_m: f64,
    /// \[m\]
    pub y_m: f64,
    /// \[rad\], counter-clockwise from the x axis.
    pub heading_rad: f64,
}

impl CustomField {
    /// The field.
    #[must_use]
    pub fn build(&self) -> Field {
        let rows: Vec<_> = self.rows.iter().map(|row| Polyline::new(row.points_m.clone())).collect();
        Field {
            name: self.name.clone(),
            row_spacing_m: self.row_spacing_m,
            middles: Field::middles(&rows),
            rows,
            plants: self.plants.clone(),
            start: Pose { x_m: self.start.x_m, y_m: self.start.y_m, heading_rad: self.start.heading_rad },
            inter_rows: self.inter_rows,
            error_range_x_m: self.error_range_x_m,
            lane: None,
            nursery: None,
        }
    }

    fn check_rows(&self) -> Result<(), ParameterError> {
        within("rows", self.rows.len() as f64, 2.0, MAX_ROWS as f64, "rows")?;
        for (i, row) in self.rows.iter().enumerate() {
            let path = format!("rows[{i}].points_m");
            within(&path, row.points_m.len() as f64, 2.0, MAX_ROWS as f64, "points")?;
            for [x, y] in &row.points_m {
                coordinate(&path, *x)?;
                coordinate(&path, *y)?;
            }
            for pair in row.points_m.windows(2) {
                let length = libm::hypot(pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]);
                within(&path, length, 0.001, MAX_COORDINATE_M, "m between neighbouring points")?;
            }
        }
        self.check_middles()
    }

    /// The lines half-way between neighbouring rows must be lines, too.
    fn check_middles(&self) -> Result<(), ParameterError> {
        let rows: Vec<_> = self.rows.iter().map(|row| Polyline::new(row.points_m.clone())).collect();
        for (i, middle) in Field::middles(&rows).iter().enumerate() {
            let points = middle.points();
            let apart = |pair: &[[f64; 2]]| libm::hypot(pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]) > 1e-6;
            if points.len() < 2 || !points.windows(2).all(apart) {
                let reason = "this row and the one before run against each other; all must run the same way";
                return Err(ParameterError::new(format!("rows[{}].points_m", i + 1), reason));
            }
        }
        Ok(())
    }

    fn check_plants(&self) -> Result<(), ParameterError> {
        within("plants", self.plants.len() as f64, 0.0, MAX_PLANTS as f64, "plants")?;
        for (i, plant) in self.plants.iter().enumerate() {
            let path = |key: &str| format!("plants[{i}].{key}");
            coordinate(&path("x_m"), plant.x_m)?;
            coordinate(&path("y_m"), plant.y_m)?;
            within(&path("radius_m"), plant.radius_m, 0.0005, 2.0, "m")?;
            within(&path("height_m"), plant.height_m, 0.0, 10.0, "m")?;
            if plant.kind == PlantKind::Crop {
                within(&path("row"), f64::from(plant.row), 0.0, (self.rows.len() - 1) as f64, "")?;
            }
        }
        Ok(())
    }
}

impl Parameters for CustomField {
    const TABLE: &'static [Parameter] = &[];

    fn schema() -> (Map<String, Value>, Vec<&'static str>) {
        custom_schema::schema()
    }

    fn check(&self) -> Result<(), ParameterError> {
        within("name", self.name.chars().count() as f64, 1.0, 80.0, "characters")?;
        within("row_spacing_m", self.row_spacing_m, 0.1, 20.0, "m")?;
        self.check_rows()?;
        self.check_plants()?;
        coordinate("start.x_m", self.start.x_m)?;
        coordinate("start.y_m", self.start.y_m)?;
        within("start.heading_rad", self.start.heading_rad, -7.0, 7.0, "rad")?;
        within("inter_rows", f64::from(self.inter_rows), 1.0, (self.rows.len() - 1) as f64, "for this many rows")?;
        match self.error_range_x_m {
            Some([from, to]) if from >= to => {
                Err(ParameterError::new("error_range_x_m", format!("[{from}, {to}] must rise")))
            }
            _ => Ok(()),
        }
    }
}

fn coordinate(path: &str, value: f64) -> Result<(), ParameterError> {
    within(path, value, -MAX_COORDINATE_M, MAX_COORDINATE_M, "m")
}

fn within(path: &str, value: f64, min: f64, max: f64, unit: &str) -> Result<(), ParameterError> {
    if (min..=max).contains(&value) {
        return Ok(());
    }
    let reason = format!("{value} is out of range, allowed is {min} to {max} {unit}");
    Err(ParameterError::new(path, reason.trim_end()))
}

#[cfg(test)]
mod tests {
    use crate::field::FieldSpec;
    use furrow_navigation::parameters::Kinds;
    use serde_json::{Value, json};

    fn example() -> Value {
        json!({
            "kind": "custom", "name": "garden", "row_spacing_m": 1.0,
            "rows": [{"points_m": [[0.0, -0.5], [5.0, -0.5]]}, {"points_m": [[0.0, 0.5], [2.0, 0.6], [5.0, 0.5]]}],
            "plants": [
                {"x_m": 1.0, "y_m": -0.5, "radius_m": 0.02, "height_m": 1.0, "kind": "crop", "row": 0},
                {"x_m": 1.0, "y_m": 0.0, "radius_m": 0.02, "height_m": 1.0, "kind": "weed"}
            ],
            "start": {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0}, "inter_rows": 1
        })
    }

    fn refused(path: &str, value: Value) -> String {
        let mut field = example();
        *field.pointer_mut(path).unwrap() = value;
        FieldSpec::read(field).unwrap_err().to_string()
    }

    #[test]
    fn a_field_file_is_read_and_kept_as_it_is() {
        let spec = FieldSpec::read(example()).unwrap();
        let field = spec.build(1);
        assert_eq!((field.plants.len(), field.middles.len(), field.inter_rows), (2, 1, 1));
        assert_eq!(FieldSpec::read(serde_json::to_value(&spec).unwrap()).unwrap(), spec);
    }

    #[test]
    fn errors_name_the_key_and_the_range() {
        assert!(refused("/inter_rows", json!(2)).starts_with("inter_rows: 2 is out of range, allowed is 1 to 1"));
        assert!(refused("/plants/0/row", json!(7)).starts_with("plants[0].row"));
        assert!(refused("/plants/1/radius_m", json!(-1)).starts_with("plants[1].radius_m"));
        assert!(refused("/plants/1/kind", json!("tree")).contains("plants[1].kind"));
        assert!(refused("/rows", json!([])).starts_with("rows"));
        assert!(refused("/rows/0/points_m", json!([[0, 0], [0, 0]])).starts_with("rows[0].points_m"));
        let against = refused("/rows/1/points_m", json!([[5.0, 0.5], [0.0, 0.5]]));
        assert!(against.starts_with("rows[1].points_m"), "{against}");
        assert!(refused("/start/x_m", json!("here")).contains("start.x_m"));
    }
}
