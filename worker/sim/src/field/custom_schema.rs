//! JSON Schema of a user's own field.

use serde_json::{Map, Value, json};

use super::custom::{MAX_COORDINATE_M, MAX_PLANTS, MAX_ROWS};

/// The file's keys, and those that must be there.
///
/// What a schema cannot say is checked when the file is read: fewer inter-rows than rows, rows that run the same way.
pub(super) fn schema() -> (Map<String, Value>, Vec<&'static str>) {
    let keys = [
        (
            "name",
            json!({"type": "string", "minLength": 1, "maxLength": 80, "description": "For people, and the label in tables."}),
        ),
        ("row_spacing_m", number("m", [0.1, 20.0], "Distance between rows.")),
        (
            "rows",
            json!({"type": "array", "minItems": 2, "maxItems": MAX_ROWS, "items": row(),
            "description": "From the robot's right to its left; the robot starts between the first two."}),
        ),
        ("plants", json!({"type": "array", "maxItems": MAX_PLANTS, "items": plant(), "description": "Upright stems."})),
        ("start", start()),
        (
            "inter_rows",
            json!({"type": "integer", "minimum": 1, "maximum": MAX_ROWS - 1,
            "description": "How many inter-rows to drive through: fewer than there are rows."}),
        ),
        (
            "error_range_x_m",
            json!({"type": "array", "minItems": 2, "maxItems": 2, "items": {"type": "number"}, "unit": "m",
            "description": "[from, to]: the squared error counts where x lies in it; otherwise 1 m and more inside the row."}),
        ),
    ];
    let required = vec!["name", "row_spacing_m", "rows", "plants", "start", "inter_rows"];
    (keys.map(|(key, schema)| (key.to_owned(), schema)).into_iter().collect(), required)
}

fn row() -> Value {
    let point = json!({"type": "array", "minItems": 2, "maxItems": 2, "items": coordinate("")});
    let points = json!({"type": "array", "minItems": 2, "maxItems": MAX_ROWS, "items": point, "unit": "m",
        "description": "The centre line, (x, y), in the direction in which the robot drives first."});
    object(&json!({"points_m": points}), &["points_m"])
}

fn plant() -> Value {
    let keys = json!({
        "x_m": coordinate("Centre."), "y_m": coordinate("Centre."),
        "radius_m": number("m", [0.0005, 2.0], "Radius of the stem."),
        "height_m": number("m", [0.0, 10.0], "Height of the stem."),
        "kind": {"enum": ["crop", "weed"], "description": "To be kept or not; LiDARs see both."},
        "row": {"type": "integer", "minimum": 0, "maximum": MAX_ROWS - 1, "default": 0,
            "description": "Its row, counted from 0; not read for weeds."},
    });
    object(&keys, &["x_m", "y_m", "radius_m", "height_m", "kind"])
}

fn start() -> Value {
    let keys = json!({
        "x_m": coordinate("At time 0."), "y_m": coordinate("At time 0."),
        "heading_rad": number("rad", [-7.0, 7.0], "Counter-clockwise from the x axis."),
    });
    object(&keys, &["x_m", "y_m", "heading_rad"])
}

fn coordinate(about: &str) -> Value {
    number("m", [-MAX_COORDINATE_M, MAX_COORDINATE_M], about)
}

fn number(unit: &str, [min, max]: [f64; 2], about: &str) -> Value {
    json!({"type": "number", "minimum": min, "maximum": max, "unit": unit, "description": about})
}

fn object(properties: &Value, required: &[&str]) -> Value {
    json!({"type": "object", "properties": properties, "required": required, "additionalProperties": false})
}
