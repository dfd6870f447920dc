//! Requests from end to end: from a plan's JSON to the scenarios of its cells.

use serde_json::{Value, json};

use super::{CustomField, Expansion, NotApplied, PlanError, PlanSource, Request, expand};

fn plan() -> Value {
    json!({
        "name": "mine", "title": "A plan.", "source": "a test", "seeds": 2,
        "base": {
            "field": {"kind": "guyonneau2022", "crop": 1, "seed": {"fixed": 1}},
            "robot": {"kind": "two-wheeled"},
            "sensors": {"kind": "two-planar-lidars"},
            "perception": {"kind": "rgop", "iterations": 10},
            "localization": {"kind": "row-filter"},
            "control": {"kind": "fuzzy"},
            "mission": {"kind": "row-by-row"},
            "observer": {"kind": "inter-rows"},
            "limits": {"kind": "simulated-time"}
        },
        "factors": [
            {"name": "algorithm", "levels": [
                {"label": "oracle", "patch": {"perception": {"kind": "oracle"}}},
                {"label": "rgop", "patch": {}}
            ]},
            {"name": "field", "levels": [
                {"label": "crop-#", "range": [1, 2], "path": "field.crop"},
                {"label": "any", "pool": [{"field": {"crop": 3}}, {"field": {"crop": 4}}]}
            ]}
        ]
    })
}

fn request() -> Request {
    Request::all_of(PlanSource::Inline(plan()))
}

fn scenario(expansion: &Expansion, cell: usize, index: usize) -> Value {
    serde_json::from_str(&expansion.cells[cell].scenarios[index]).unwrap()
}

#[test]
fn cells_are_the_product_of_the_levels_in_the_plans_order() {
    let expansion = expand(&request()).unwrap();
    let labels: Vec<[&str; 2]> =
        expansion.cells.iter().map(|cell| ["algorithm", "field"].map(|factor| cell.factors[factor].as_str())).collect();
    let expected = [
        ["oracle", "crop-1"],
        ["oracle", "crop-2"],
        ["oracle", "any"],
        ["rgop", "crop-1"],
        ["rgop", "crop-2"],
        ["rgop", "any"],
    ];
    assert_eq!(labels, expected);
    assert_eq!((expansion.seeds, expansion.jobs()), (2, 2 * 8));
    assert_eq!(scenario(&expansion, 4, 0)["field"]["crop"], json!(2));
    assert_eq!(scenario(&expansion, 5, 1)["field"]["crop"], json!(4));
    assert_eq!(scenario(&expansion, 0, 0)["perception"]["kind"], json!("oracle"));
    assert_eq!(scenario(&expansion, 0, 0)["perception"].get("iterations"), None);
}

#[test]
fn the_same_question_gives_the_same_scenarios() {
    let (a, b) = (expand(&request()).unwrap(), expand(&request()).unwrap());
    let texts = |expansion: &Expansion| expansion.cells.iter().map(|cell| cell.scenarios.clone()).collect::<Vec<_>>();
    assert_eq!(texts(&a), texts(&b));
}

#[test]
fn a_setting_applies_where_it_can_and_the_answer_says_where_not() {
    let mut request = request();
    request.set.insert("perception.iterations".into(), json!(20));
    let expansion = expand(&request).unwrap();
    assert_eq!(scenario(&expansion, 3, 0)["perception"]["iterations"], json!(20));
    let expected = NotApplied { path: "perception.iterations".into(), levels: vec!["algorithm=oracle".into()] };
    assert_eq!(expansion.not_applied, [expected]);

    request.only.insert("algorithm".into(), vec!["oracle".into()]);
    assert!(matches!(expand(&request), Err(PlanError::UnknownPath { part: "set", .. })));
}

#[test]
fn an_unknown_path_names_its_neighbours() {
    let mut request = request();
    request.set.insert("perception.iteratoins".into(), json!(20));
    let error = expand(&request).unwrap_err();
    assert_eq!(error.key(), "perception.iteratoins");
    assert_eq!(error.allowed()[0], "perception.iterations");
}

#[test]
fn a_varied_path_multiplies_the_cells() {
    let mut request = request();
    request.only.insert("algorithm".into(), vec!["rgop".into()]);
    request.vary.insert("perception.iterations".into(), vec![json!(5), json!(10)]);
    let expansion = expand(&request).unwrap();
    assert_eq!(expansion.factors, ["algorithm", "field", "iterations"]);
    assert_eq!(expansion.cells.len(), 6);
    assert_eq!(expansion.cells[0].factors["iterations"], "5");
    assert_eq!(scenario(&expansion, 0, 0)["perception"]["iterations"], json!(5));
    assert_eq!(scenario(&expansion, 1, 0)["perception"]["iterations"], json!(10));
}

#[test]
fn a_users_field_replaces_the_fields_of_the_plan() {
    let row = |y: f64| json!({"points_m": [[0.0, y], [10.0, y]]});
    let stem = |x: f64, row: usize| {
        let y = row as f64 - 0.5;
        json!({"x_m": x, "y_m": y, "radius_m": 0.02, "height_m": 1.0, "kind": "crop", "row": row})
    };
    let plants: Vec<Value> = (0..20).flat_map(|i| [0, 1].map(|row| stem(f64::from(i) * 0.5, row))).collect();
    let mut request = request();
    let field = json!({
        "name": "South End", "row_spacing_m": 1.0, "rows": [row(-0.5), row(0.5)], "plants": plants,
        "start": {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0}, "inter_rows": 1
    });
    request.field = Some(CustomField::from_json(field).unwrap());
    let expansion = expand(&request).unwrap();
    assert_eq!(expansion.cells.len(), 2);
    assert_eq!(expansion.cells[1].factors["field"], "south-end");
    assert_eq!(scenario(&expansion, 1, 0)["field"]["kind"], json!("custom"));
    assert_eq!(scenario(&expansion, 1, 0)["field"].get("crop"), None);
}

#[test]
fn what_was_asked_can_be_asked_again() {
    let mut request = request();
    request.only.insert("field".into(), vec!["crop-2".into()]);
    request.set.insert("perception.iterations".into(), json!(20));
    request.seeds = Some(7);
    let first = expand(&request).unwrap();
    let body = first.request.clone();
    assert_eq!((&body["seeds"], &body["only"]), (&json!(7), &json!({"field": ["crop-2"]})));

    let mut again = Request::all_of(PlanSource::from_json(body["plan"].clone()).unwrap());
    again.only = serde_json::from_value(body["only"].clone()).unwrap();
    again.set = serde_json::from_value(body["set"].clone()).unwrap();
    again.seeds = body["seeds"].as_u64();
    let second = expand(&again).unwrap();
    assert_eq!(second.request, body);
    assert_eq!(second.cells[0].scenarios, first.cells[0].scenarios);
}
