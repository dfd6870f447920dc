//! What a scenario can be made of.

use furrow_sim::Scenario;
use serde_json::{Value, json};

use super::Service;

async fn items(path: &str) -> Vec<Value> {
    let answer = Service::start().await.get(path).await;
    assert_eq!(answer.status, 200, "{}", answer.body);
    answer.json()["items"].as_array().unwrap().clone()
}

#[tokio::test]
async fn fields_and_algorithms_are_listed_with_every_parameter() {
    let fields = items("/v1/fields").await;
    let kinds: Vec<&str> = fields.iter().map(|field| field["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["guyonneau2022", "velasquez2022", "vintu2018", "custom"]);

    let algorithms = items("/v1/algorithms").await;
    let rgop = algorithms.iter().find(|choice| choice["kind"] == "rgop").unwrap();
    assert_eq!(
        (&rgop["part"], algorithms.iter().any(|choice| choice["part"] == "field")),
        (&json!("perception"), false)
    );
    let attach = rgop["parameters"].as_array().unwrap().iter();
    let attach = attach.clone().find(|one| one["path"] == "perception.attach_distance_m").unwrap();
    let expected = json!({"path": "perception.attach_distance_m", "unit": "m", "default": 0.2, "range": [0.001, 10.0],
        "about": "A point belongs to its nearest line if closer than this.", "source": "Program: 0.2.", "words": []});
    assert_eq!(*attach, expected);
}

#[tokio::test]
async fn the_schema_of_a_part_says_what_the_part_is_unless_set() {
    let scenario = Scenario::from_value(super::plan()["base"].clone()).unwrap().to_value();
    for choice in [items("/v1/fields").await, items("/v1/algorithms").await].concat() {
        let part = &scenario[choice["part"].as_str().unwrap()];
        if choice["kind"] != part["kind"] {
            continue;
        }
        let properties = choice["schema"]["properties"].as_object().unwrap();
        assert!(properties.keys().eq(part.as_object().unwrap().keys()), "{choice}");
        let defaults = properties.iter().filter_map(|(name, schema)| Some((name, schema.get("default")?)));
        for (name, default) in defaults {
            assert_eq!(*default, part[name], "{}.{name}", choice["kind"]);
        }
    }
}

#[tokio::test]
async fn the_schema_of_a_field_of_ones_own_lists_the_keys_of_the_file() {
    let fields = items("/v1/fields").await;
    let custom = &fields.iter().find(|field| field["kind"] == "custom").unwrap()["schema"];
    let example: Value = serde_json::from_str(include_str!("../../../../docs/curved-rows.json")).unwrap();
    for key in example.as_object().unwrap().keys() {
        assert!(custom["properties"].get(key).is_some(), "{key}");
    }
    let required = custom["required"].as_array().unwrap();
    assert!(required.iter().all(|key| *key == "kind" || example.get(key.as_str().unwrap()).is_some()));
    let plant = &custom["properties"]["plants"]["items"]["properties"];
    assert_eq!((&plant["radius_m"]["maximum"], &plant["kind"]["enum"]), (&json!(2.0), &json!(["crop", "weed"])));
}
