//! Where a plan comes from: by name, from a file, from a request's body.

use std::io::Read;
use std::path::{Path, PathBuf};

use furrow_sim::plan::{PatchLevel, Plan, PoolLevel, RangeLevel, builtin};
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::error::PlanError;
use super::factor::check_factors;

/// A file of a plan or a field holds at most this much [bytes].
const MAX_FILE_BYTES: u64 = 64 << 20;

/// Seeds of a sweep: 1 to this.
pub(super) const MAX_SEEDS: u64 = 1_000_000;

/// Where a plan comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum PlanSource {
    /// One that comes with Furrow.
    Named(String),
    /// The user's own file.
    File(PathBuf),
    /// The plan itself, as JSON.
    Inline(Value),
}

impl PlanSource {
    /// A command line's PLAN: a path when it ends in `.json`, a name otherwise.
    #[must_use]
    pub fn from_argument(text: &str) -> Self {
        if text.ends_with(".json") { Self::File(text.into()) } else { Self::Named(text.to_owned()) }
    }

    /// A body's `plan`: a name or an object. Never a path: a client must not read the server's files.
    ///
    /// # Errors
    /// When it is neither.
    pub fn from_json(value: Value) -> Result<Self, PlanError> {
        match value {
            Value::String(name) => Ok(Self::Named(name)),
            Value::Object(_) => Ok(Self::Inline(value)),
            _ => Err(PlanError::malformed("plan", "must be a plan's name or an object that is a plan")),
        }
    }

    /// The plan, checked.
    ///
    /// # Errors
    /// When there is none, or it is malformed; the message names the key.
    pub fn load(&self) -> Result<Plan, PlanError> {
        match self {
            Self::Named(name) => find(name),
            Self::File(path) => read(path),
            Self::Inline(value) => from_value(value.clone()),
        }
    }
}

/// The plan of this name among those that come with Furrow.
///
/// # Errors
/// Lists the names there are.
pub fn find(name: &str) -> Result<Plan, PlanError> {
    let (name, text) = builtin().iter().find(|(known, _)| *known == name).ok_or_else(|| PlanError::UnknownPlan {
        name: name.chars().take(200).collect(),
        known: builtin().iter().map(|(known, _)| (*known).to_owned()).collect(),
    })?;
    from_text(text, name)
}

/// All plans that come with Furrow, sorted by name.
///
/// # Errors
/// When one of them is malformed, which the tests of this crate rule out.
pub fn builtin_plans() -> Result<Vec<Plan>, PlanError> {
    builtin().iter().map(|(name, text)| from_text(text, name)).collect()
}

/// The plan in a file.
///
/// # Errors
/// Names the file, and the line and column or the key where it is not a plan.
pub fn read(path: &Path) -> Result<Plan, PlanError> {
    from_text(&read_text(path)?, &path.display().to_string())
}

/// The plan that `value` is.
///
/// # Errors
/// Names the key that is missing, unknown or wrong.
pub fn from_value(value: Value) -> Result<Plan, PlanError> {
    check_levels(&value)?;
    let plan = serde_json::from_value(value).map_err(|error| PlanError::malformed("plan", error.to_string()))?;
    checked(plan)
}

fn from_text(text: &str, file: &str) -> Result<Plan, PlanError> {
    let named = |error: PlanError| PlanError::File { file: file.to_owned(), reason: error.to_string() };
    let value: Value = parse(text, file)?;
    check_levels(&value).map_err(named)?;
    checked(parse(text, file)?).map_err(named)
}

fn parse<T: DeserializeOwned>(text: &str, file: &str) -> Result<T, PlanError> {
    serde_json::from_str(text).map_err(|error| PlanError::Json {
        file: file.to_owned(),
        line: error.line(),
        column: error.column(),
        reason: without_position(&error),
    })
}

/// The error's message without the position at its end.
fn without_position(error: &serde_json::Error) -> String {
    let text = error.to_string();
    text.split(" at line ").next().unwrap_or_default().to_owned()
}

fn read_text(path: &Path) -> Result<String, PlanError> {
    let refuse = |reason: String| PlanError::File { file: path.display().to_string(), reason };
    let mut text = String::new();
    let file = std::fs::File::open(path).map_err(|error| refuse(error.to_string()))?;
    file.take(MAX_FILE_BYTES + 1).read_to_string(&mut text).map_err(|error| refuse(error.to_string()))?;
    if text.len() as u64 > MAX_FILE_BYTES {
        return Err(refuse(format!("is larger than {} MiB", MAX_FILE_BYTES >> 20)));
    }
    Ok(text)
}

/// The JSON document in a file.
pub(super) fn read_json(path: &Path) -> Result<Value, PlanError> {
    parse(&read_text(path)?, &path.display().to_string())
}

/// Reads each level by the key that tells its form, so that an error names the key and not merely the form.
fn check_levels(plan: &Value) -> Result<(), PlanError> {
    let list = |value: &Value, key: &str| value.get(key).and_then(Value::as_array).cloned().unwrap_or_default();
    for (i, factor) in list(plan, "factors").iter().enumerate() {
        for (j, level) in list(factor, "levels").into_iter().enumerate() {
            check_level(level)
                .map_err(|error| PlanError::malformed(format!("factors[{i}].levels[{j}]"), error.to_string()))?;
        }
    }
    Ok(())
}

fn check_level(level: Value) -> Result<(), serde_json::Error> {
    if level.get("range").is_some() {
        serde_json::from_value::<RangeLevel>(level).map(drop)
    } else if level.get("pool").is_some() {
        serde_json::from_value::<PoolLevel>(level).map(drop)
    } else {
        serde_json::from_value::<PatchLevel>(level).map(drop)
    }
}

fn checked(plan: Plan) -> Result<Plan, PlanError> {
    let printable = |name: &str| !name.trim().is_empty() && name.len() <= 200 && !name.chars().any(char::is_control);
    if !printable(&plan.name) {
        return Err(PlanError::malformed("name", "must be 1 to 200 printable characters"));
    }
    if !plan.base.is_object() {
        return Err(PlanError::malformed("base", "must be an object: the scenario that the levels change"));
    }
    check_seeds(plan.seeds)?;
    check_factors(&plan.factors)?;
    Ok(plan)
}

/// Refuses a number of seeds that no sweep may have.
pub(super) fn check_seeds(seeds: u64) -> Result<u64, PlanError> {
    if (1..=MAX_SEEDS).contains(&seeds) { Ok(seeds) } else { Err(PlanError::Seeds { seeds }) }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn plan() -> Value {
        json!({
            "name": "mine", "title": "A plan.", "source": "here", "base": {"a": 1}, "seeds": 3,
            "factors": [{"name": "algorithm", "levels": [{"label": "x", "patch": {"a": 2}}]}]
        })
    }

    fn refusal(change: impl FnOnce(&mut Value)) -> String {
        let mut value = plan();
        change(&mut value);
        from_value(value).unwrap_err().to_string()
    }

    #[test]
    fn every_plan_that_comes_with_furrow_is_well_formed() {
        let plans = builtin_plans().unwrap();
        assert!(plans.iter().zip(builtin()).all(|(plan, (name, _))| plan.name == *name));
    }

    #[test]
    fn an_unknown_name_lists_the_names_there_are() {
        let error = find("no-such-plan").unwrap_err();
        assert!(error.to_string().starts_with("unknown plan `no-such-plan`: "));
        assert_eq!(error.allowed().len(), builtin().len());
    }

    #[test]
    fn a_malformed_plan_is_refused_by_the_key() {
        assert!(from_value(plan()).is_ok());
        assert!(refusal(|plan| plan["seed"] = json!(1)).contains("unknown field `seed`"));
        assert!(refusal(|plan| plan["seeds"] = json!(0)).contains("1 to 1000000"));
        assert!(refusal(|plan| plan["base"] = json!([])).starts_with("base: "));
        assert!(refusal(|plan| plan["name"] = json!("\u{1b}[2J")).starts_with("name: "));
        let level = refusal(|plan| plan["factors"][0]["levels"][0]["pach"] = json!({}));
        assert!(level.starts_with("factors[0].levels[0]: unknown field `pach`"), "{level}");
        let range = refusal(|plan| plan["factors"][0]["levels"][0] = json!({"label": "n-#", "range": [0, 1]}));
        assert!(range.contains("missing field `path`"), "{range}");
    }

    #[test]
    fn a_broken_file_is_named_with_line_and_column() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("mine.json");
        std::fs::write(&path, "{\n \"name\": \"a\",,\n}").unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("mine.json, line 2, column 14: "), "{error}");
        std::fs::write(&path, "{\n \"name\": \"a\",\n \"factors\": 3}").unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("mine.json, line 3, column 13: invalid type"), "{error}");
        std::fs::write(&path, plan().to_string()).unwrap();
        assert_eq!(read(&path).unwrap().name, "mine");
    }

    #[test]
    fn only_a_command_line_names_files() {
        assert_eq!(PlanSource::from_argument("a/b.json"), PlanSource::File("a/b.json".into()));
        assert_eq!(PlanSource::from_argument("a/b"), PlanSource::Named("a/b".into()));
        let from_body = PlanSource::from_json(json!("/etc/plan.json")).unwrap();
        assert_eq!(from_body, PlanSource::Named("/etc/plan.json".into()));
        assert!(PlanSource::from_json(json!(3)).is_err());
    }
}
