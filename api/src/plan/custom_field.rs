//! A user's own field: a JSON document that takes the place of a plan's fields.

use std::path::Path;

use serde_json::{Map, Value};

use super::error::PlanError;
use super::label::kebab;
use super::source::read_json;

/// A user's own field and the label it goes by.
#[derive(Debug, Clone, PartialEq)]
pub struct CustomField {
    /// Kebab-case: the file's name without `.json`, or the document's `name`.
    pub label: String,
    /// The document.
    content: Map<String, Value>,
}

impl CustomField {
    /// Reads a field file; its label is the file's name.
    ///
    /// # Errors
    /// Names the file, and line and column where it is not JSON.
    pub fn read(path: &Path) -> Result<Self, PlanError> {
        let file = path.display().to_string();
        let refuse = |reason: &str| PlanError::File { file: file.clone(), reason: reason.to_owned() };
        let stem = path.file_stem().and_then(|stem| stem.to_str()).and_then(kebab);
        let label =
            stem.ok_or_else(|| refuse("the file's name must hold a letter or a digit: it becomes the label"))?;
        let Value::Object(content) = read_json(path)? else { return Err(refuse("a field must be a JSON object")) };
        Self::new(label, content).map_err(|error| refuse(&error.to_string()))
    }

    /// Takes a field from a request's body; its label is the document's `name`.
    ///
    /// # Errors
    /// Names the key that is missing or wrong.
    pub fn from_json(value: Value) -> Result<Self, PlanError> {
        let Value::Object(content) = value else {
            return Err(PlanError::malformed("field", "must be an object: a field with `name`, `rows`, `plants`, .."));
        };
        let label = content.get("name").and_then(Value::as_str).and_then(kebab).ok_or_else(|| {
            PlanError::malformed("field.name", "must be a text with a letter or a digit: it becomes the label")
        })?;
        Self::new(label, content)
    }

    fn new(label: String, mut content: Map<String, Value>) -> Result<Self, PlanError> {
        match content.remove("kind") {
            None => Ok(Self { label, content }),
            Some(Value::String(kind)) if kind == "custom" => Ok(Self { label, content }),
            Some(other) => Err(PlanError::malformed("field.kind", format!("is {other}: allowed is only \"custom\""))),
        }
    }

    /// The scenario's part `field`: the document with `"kind": "custom"`.
    pub(super) fn scenario_part(&self) -> Value {
        let mut part = self.content.clone();
        part.insert("kind".to_owned(), Value::from("custom"));
        Value::Object(part)
    }

    /// The field as a request's body holds it: its `name` is the label.
    #[must_use]
    pub fn request_part(&self) -> Value {
        let mut part = self.content.clone();
        part.insert("name".to_owned(), Value::from(self.label.clone()));
        Value::Object(part)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_file_gives_its_name_and_a_body_its_own() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("My Field_2.json");
        std::fs::write(&path, r#"{"name": "other", "rows": []}"#).unwrap();
        let field = CustomField::read(&path).unwrap();
        assert_eq!(field.label, "my-field-2");
        assert_eq!(field.scenario_part(), json!({"kind": "custom", "name": "other", "rows": []}));

        let field = CustomField::from_json(json!({"name": "South end", "rows": []})).unwrap();
        assert_eq!(field.label, "south-end");
    }

    #[test]
    fn what_is_no_field_is_refused_by_name() {
        for (bad, word) in [
            (json!([]), "field: must be an object"),
            (json!({"rows": []}), "field.name"),
            (json!({"name": 3}), "field.name"),
            (json!({"name": "?"}), "field.name"),
            (json!({"name": "a", "kind": "crop"}), "field.kind"),
        ] {
            let error = CustomField::from_json(bad).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }

    #[test]
    fn a_broken_file_is_named_with_line_and_column() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("field.json");
        std::fs::write(&path, "{\n  \"name\": \n}").unwrap();
        let error = CustomField::read(&path).unwrap_err().to_string();
        assert!(error.contains("field.json, line 3, column 1"), "{error}");
        let absent = CustomField::read(&directory.path().join("none.json")).unwrap_err().to_string();
        assert!(absent.contains("none.json"), "{absent}");
    }
}
