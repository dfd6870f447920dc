//! What to run: the flags that `run` and `submit` share.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::error::CliError;
use crate::plan::{CustomField, PlanSource, Request};

/// A plan and what is asked of it.
#[derive(Debug, clap::Args)]
pub(super) struct Selection {
    /// A plan's name (`furrow plans` lists them), or a path ending in .json
    plan: String,
    /// Run seeds 1 to N instead of the plan's number
    #[arg(long, value_name = "N")]
    seeds: Option<u64>,
    /// Keep only these levels of a factor; may be repeated
    #[arg(long, value_name = "FACTOR=LEVEL|LEVEL")]
    only: Vec<String>,
    /// Set a parameter of the scenario by its dotted path, to a JSON value or else a text; may be repeated
    #[arg(long, value_name = "PATH=VALUE")]
    set: Vec<String>,
    /// Add a factor: the values that a parameter takes; may be repeated
    #[arg(long, value_name = "PATH=A,B,C")]
    vary: Vec<String>,
    /// Your own field instead of the plan's fields: a JSON file
    #[arg(long, value_name = "FILE")]
    field: Option<PathBuf>,
}

impl Selection {
    /// The request that the flags spell out.
    ///
    /// # Errors
    /// Bad input: names the flag, the key and what is allowed.
    pub(super) fn request(&self) -> Result<Request, CliError> {
        Ok(Request {
            plan: PlanSource::from_argument(&self.plan),
            only: only(&self.only)?,
            set: pairs("--set", &self.set, literal)?,
            vary: pairs("--vary", &self.vary, literals)?,
            field: self.field.as_deref().map(custom_field).transpose()?,
            seeds: self.seeds,
        })
    }
}

fn custom_field(path: &Path) -> Result<CustomField, CliError> {
    CustomField::read(path).map_err(CliError::from)
}

/// The levels to keep; a factor named several times keeps all of them.
fn only(given: &[String]) -> Result<BTreeMap<String, Vec<String>>, CliError> {
    let mut map: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for text in given {
        let (factor, labels) = pair("--only", text)?;
        map.entry(factor).or_default().extend(labels.split('|').map(|label| label.trim().to_owned()));
    }
    Ok(map)
}

/// A value by path; a path may be given only once.
pub(super) fn pairs<T>(flag: &str, given: &[String], read: fn(&str) -> T) -> Result<BTreeMap<String, T>, CliError> {
    let mut map = BTreeMap::new();
    for text in given {
        let (path, value) = pair(flag, text)?;
        if map.insert(path.clone(), read(value)).is_some() {
            return Err(CliError::BadInput(format!("{flag} {path}: given more than once")));
        }
    }
    Ok(map)
}

/// Splits `text` at its first `=`.
fn pair<'a>(flag: &str, text: &'a str) -> Result<(String, &'a str), CliError> {
    text.split_once('=')
        .filter(|(key, value)| !key.trim().is_empty() && !value.is_empty())
        .map(|(key, value)| (key.trim().to_owned(), value))
        .ok_or_else(|| CliError::BadInput(format!("{flag} {text}: expected a name, `=` and a value")))
}

/// A JSON literal, or else the text itself.
pub(super) fn literal(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()))
}

/// Several literals: the inside of a JSON array, or else whatever stands between commas.
fn literals(text: &str) -> Vec<Value> {
    serde_json::from_str(&format!("[{text}]")).unwrap_or_else(|_| text.split(',').map(str::trim).map(literal).collect())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn owned(words: &[&str]) -> Vec<String> {
        words.iter().map(|word| (*word).to_owned()).collect()
    }

    #[test]
    fn values_are_json_or_else_text() {
        assert_eq!(literal("0.25"), json!(0.25));
        assert_eq!(literal("true"), json!(true));
        assert_eq!(literal("job"), json!("job"));
        assert_eq!(literal(r#"{"fixed":1}"#), json!({"fixed": 1}));
        assert_eq!(literals("1,2.5"), [json!(1), json!(2.5)]);
        assert_eq!(literals("fast,slow, 3"), [json!("fast"), json!("slow"), json!(3)]);
        assert_eq!(literals("[1,2],[3,4]"), [json!([1, 2]), json!([3, 4])]);
    }

    #[test]
    fn a_flag_without_a_value_or_given_twice_is_bad_input() {
        for bad in [&["a"][..], &["=1"], &["a="], &["a=1", "a=2"]] {
            let error = pairs("--set", &owned(bad), literal).unwrap_err();
            assert!(error.to_string().starts_with("--set"), "{error}");
            assert_eq!(error.exit_code(), 2);
        }
        let only = only(&owned(&["algorithm=rgop|rg", "field=crop-2", "algorithm=rg-ls"])).unwrap();
        assert_eq!(only["algorithm"], owned(&["rgop", "rg", "rg-ls"]));
        assert_eq!(only["field"], owned(&["crop-2"]));
    }

    #[test]
    fn a_value_may_hold_an_equals_sign() {
        assert_eq!(pairs("--set", &owned(&["a=b=c"]), literal).unwrap()["a"], json!("b=c"));
    }
}
