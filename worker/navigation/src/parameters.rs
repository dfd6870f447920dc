//! Parameters as data: one declaration gives the struct, its defaults, its ranges and its documentation.
//!
//! [`parameters!`](crate::parameters!) declares a part's parameters, [`kinds!`](crate::kinds!) the choice
//! between parts by the word `kind`, [`words!`](crate::words!) a parameter that is one of a few words.
//! Unknown keys, wrong types and values out of range are errors that name the key and what is allowed.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

/// One parameter, for checks, catalogues and schemas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Its key.
    pub name: &'static str,
    /// Meaning and source.
    pub doc: &'static str,
    /// Its unit; `1` for a pure number, empty for words and truth values.
    pub unit: &'static str,
    /// Smallest and largest allowed number; none where the type says it all.
    pub range: Option<[f64; 2]>,
    /// The allowed words, if it is a word.
    pub words: &'static [&'static str],
    /// JSON Schema of its type, without range, words and default.
    pub schema: &'static str,
}

/// How the sentence begins that says where a parameter's default comes from.
const SOURCES: [&str; 4] = ["Paper", "Program", "Data sheet", "Ours"];

impl Parameter {
    /// What it means, without its source.
    #[must_use]
    pub fn about(&self) -> &'static str {
        self.parts().0
    }

    /// Where its default comes from; empty where its documentation does not say.
    #[must_use]
    pub fn source(&self) -> &'static str {
        self.parts().1
    }

    fn parts(&self) -> (&'static str, &'static str) {
        let doc = self.doc.trim();
        let starts = SOURCES.iter().filter_map(|word| doc.find(&format!(". {word}")));
        starts.min().map_or((doc, ""), |at| (&doc[..=at], doc[at + 1..].trim_start()))
    }

    /// JSON Schema of its values.
    #[must_use]
    pub fn value_schema(&self, default: Option<&Value>) -> Value {
        let mut schema: Map<String, Value> = serde_json::from_str(self.schema).expect("a type's schema is JSON");
        schema.insert("description".into(), json!(self.doc.trim()));
        if !self.words.is_empty() {
            schema.insert("enum".into(), json!(self.words));
        }
        if let Some([min, max]) = self.range {
            schema.extend([("minimum".into(), number(min)), ("maximum".into(), number(max))]);
        }
        if !self.unit.is_empty() {
            schema.insert("unit".into(), json!(self.unit));
        }
        if let Some(default) = default {
            schema.insert("default".into(), default.clone());
        }
        Value::Object(schema)
    }
}

/// A bound as a person would write it: 1, not 1.0.
fn number(value: f64) -> Value {
    if value.fract() == 0.0 && value.abs() < 1e15 { json!(value as i64) } else { json!(value) }
}

/// A key that is unknown, missing, of the wrong type or out of range.
///
/// The caller refuses the input and shows this.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{path}: {reason}")]
pub struct ParameterError {
    /// Dotted path of the key.
    pub path: String,
    /// What is wrong, and what is allowed.
    pub reason: String,
}

impl ParameterError {
    /// An error at `path`.
    pub fn new(path: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { path: path.into(), reason: reason.into() }
    }

    /// The same error seen from the part that holds this one under `key`.
    #[must_use]
    pub fn under(self, key: &str) -> Self {
        let path = if self.path.is_empty() { key.to_owned() } else { format!("{key}.{}", self.path) };
        Self { path, ..self }
    }
}

/// The parameters of one part.
pub trait Parameters: Serialize + DeserializeOwned {
    /// Every parameter, in the order of declaration.
    const TABLE: &'static [Parameter];

    /// Checks what a type cannot say.
    ///
    /// # Errors
    /// The first value out of its range.
    fn check(&self) -> Result<(), ParameterError> {
        let value = serde_json::to_value(self).expect("parameters are plain data with text keys");
        Self::TABLE.iter().try_for_each(|parameter| check_range(parameter, value.get(parameter.name)))
    }

    /// JSON Schema of each key, and which keys must be there.
    fn schema() -> (Map<String, Value>, Vec<&'static str>) {
        let defaults = Self::read(Map::new()).ok().and_then(|values| serde_json::to_value(values).ok());
        let default = |name| defaults.as_ref().and_then(|values| values.get(name));
        let keys = Self::TABLE.iter().map(|one| (one.name.to_owned(), one.value_schema(default(one.name))));
        (keys.collect(), Vec::new())
    }

    /// Reads parameters from a JSON object, filling in defaults.
    ///
    /// # Errors
    /// Names the unknown key, the wrong type or the value out of range.
    fn read(object: Map<String, Value>) -> Result<Self, ParameterError> {
        let parameters: Self = serde_path_to_error::deserialize(Value::Object(object)).map_err(|error| {
            let path = error.path().to_string();
            ParameterError::new(if path == "." { String::new() } else { path }, error.inner().to_string())
        })?;
        parameters.check().map(|()| parameters)
    }
}

fn check_range(parameter: &Parameter, value: Option<&Value>) -> Result<(), ParameterError> {
    let (Some([min, max]), Some(number)) = (parameter.range, value.and_then(Value::as_f64)) else { return Ok(()) };
    if (min..=max).contains(&number) {
        return Ok(());
    }
    let unit = if matches!(parameter.unit, "" | "1") { String::new() } else { format!(" {}", parameter.unit) };
    Err(ParameterError::new(parameter.name, format!("{number} is out of range, allowed is {min} to {max}{unit}")))
}

/// One part that a word `kind` chooses, for catalogues.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The word.
    pub kind: &'static str,
    /// What it is.
    pub about: &'static str,
    /// Its parameters; empty where the schema alone describes them.
    pub parameters: &'static [Parameter],
    /// JSON Schema of the whole object, `kind` included.
    pub schema: Value,
}

impl Choice {
    /// The part `kind` with the parameters `P`.
    #[must_use]
    pub fn of<P: Parameters>(kind: &'static str, about: &'static str) -> Self {
        let (mut properties, mut required) = P::schema();
        properties.insert("kind".into(), json!({"const": kind}));
        required.insert(0, "kind");
        let schema = json!({
            "type": "object", "description": about.trim(), "properties": properties, "required": required,
            "additionalProperties": false,
        });
        Self { kind, about: about.trim(), parameters: P::TABLE, schema }
    }

    /// The default of parameter `name`; none where it must be given.
    #[must_use]
    pub fn default_of(&self, name: &str) -> Option<&Value> {
        self.schema["properties"][name].get("default")
    }
}

/// A choice between parts by the word `kind`.
pub trait Kinds: Sized {
    /// The words.
    fn kinds() -> Vec<&'static str>;

    /// The parts they choose, in the same order.
    fn choices() -> Vec<Choice>;

    /// The parameters of the part that `kind` chooses.
    fn table(kind: &str) -> Option<&'static [Parameter]>;

    /// Reads the part that `kind` chooses from its parameters.
    ///
    /// # Errors
    /// Names the unknown kind, or the parameter at fault.
    fn read_kind(kind: &str, parameters: Map<String, Value>) -> Result<Self, ParameterError>;

    /// Reads a JSON object with `kind` and parameters.
    ///
    /// # Errors
    /// Names the key at fault and what is allowed.
    fn read(value: Value) -> Result<Self, ParameterError> {
        let Value::Object(mut object) = value else {
            return Err(ParameterError::new("", "must be an object with `kind` and its parameters"));
        };
        match object.remove("kind") {
            Some(Value::String(kind)) => Self::read_kind(&kind, object),
            _ => Err(ParameterError::new("kind", format!("must be one of {}", list(&Self::kinds())))),
        }
    }
}

/// Words in backquotes, separated by commas.
#[must_use]
pub fn list(words: &[&str]) -> String {
    words.iter().map(|word| format!("`{word}`")).collect::<Vec<_>>().join(", ")
}

/// The type of a parameter.
pub trait ParameterType {
    /// The allowed words, if it is a word.
    const WORDS: &'static [&'static str] = &[];
    /// JSON Schema of the type.
    const SCHEMA: &'static str;
}
impl ParameterType for f64 {
    const SCHEMA: &'static str = r#"{"type":"number"}"#;
}
impl ParameterType for u32 {
    const SCHEMA: &'static str = r#"{"type":"integer","minimum":0,"maximum":4294967295}"#;
}
impl ParameterType for u64 {
    const SCHEMA: &'static str = r#"{"type":"integer","minimum":0}"#;
}
impl ParameterType for bool {
    const SCHEMA: &'static str = r#"{"type":"boolean"}"#;
}

/// Declares a parameter struct with defaults, units, ranges and documentation.
///
/// `key: type = default, "unit", [min, max];` with the range left out where the type says it all.
#[macro_export]
macro_rules! parameters {
    ($(#[doc = $about:literal])* pub struct $name:ident {
        $($(#[doc = $doc:literal])+ pub $key:ident: $type:ty = $default:expr, $unit:literal $(, [$min:expr, $max:expr])?;)*
    }) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name {
            $($(#[doc = $doc])+ #[doc = concat!(" Unit: ", $unit, ".")] pub $key: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($key: $default,)* }
            }
        }

        impl $crate::parameters::Parameters for $name {
            const TABLE: &'static [$crate::parameters::Parameter] = &[
                $($crate::parameters::Parameter {
                    name: stringify!($key),
                    doc: concat!($($doc),+),
                    unit: $unit,
                    range: $crate::parameters!(@range $($min, $max)?),
                    words: <$type as $crate::parameters::ParameterType>::WORDS,
                    schema: <$type as $crate::parameters::ParameterType>::SCHEMA,
                },)*
            ];
        }
    };
    (@range) => { None };
    (@range $min:expr, $max:expr) => { Some([$min as f64, $max as f64]) };
}

/// Declares a serde-tagged choice of parts: `Variant(Parameters) = "word",`.
#[macro_export]
macro_rules! kinds {
    ($(#[doc = $about:literal])* pub enum $name:ident {
        $($(#[doc = $doc:literal])+ $variant:ident($params:ty) = $word:literal,)+
    }) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize)]
        #[serde(tag = "kind")]
        pub enum $name {
            $($(#[doc = $doc])+ #[serde(rename = $word)] $variant($params),)+
        }

        impl $crate::parameters::Kinds for $name {
            fn kinds() -> Vec<&'static str> {
                vec![$($word),+]
            }

            fn choices() -> Vec<$crate::parameters::Choice> {
                vec![$($crate::parameters::Choice::of::<$params>($word, concat!($($doc),+)),)+]
            }

            fn table(kind: &str) -> Option<&'static [$crate::parameters::Parameter]> {
                match kind {
                    $($word => Some(<$params as $crate::parameters::Parameters>::TABLE),)+
                    _ => None,
                }
            }

            fn read_kind(
                kind: &str,
                parameters: serde_json::Map<String, serde_json::Value>,
            ) -> Result<Self, $crate::parameters::ParameterError> {
                match kind {
                    $($word => <$params as $crate::parameters::Parameters>::read(parameters).map(Self::$variant),)+
                    _ => Err($crate::parameters::ParameterError::new(
                        "kind",
                        format!("`{kind}` is unknown, allowed is {}", $crate::parameters::list(&Self::kinds())),
                    )),
                }
            }
        }
    };
}

/// Declares a parameter that is one of a few words: `Variant = "word",`; the first is the default.
#[macro_export]
macro_rules! words {
    ($(#[doc = $about:literal])* pub enum $name:ident {
        $(#[doc = $first_doc:literal])+ $first:ident = $first_word:literal,
        $($(#[doc = $doc:literal])+ $variant:ident = $word:literal,)*
    }) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $(#[doc = $first_doc])+ #[default] #[serde(rename = $first_word)] $first,
            $($(#[doc = $doc])+ #[serde(rename = $word)] $variant,)*
        }

        impl $crate::parameters::ParameterType for $name {
            const WORDS: &'static [&'static str] = &[$first_word, $($word),*];
            const SCHEMA: &'static str = r#"{"type":"string"}"#;
        }
    };
}

parameters! {
    /// No parameters: a part that has none still refuses unknown keys.
    pub struct NoParams {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    words! {
        /// Colours.
        pub enum Colour {
            /// Red.
            Red = "red",
            /// Blue.
            Blue = "dark-blue",
        }
    }

    parameters! {
        /// For the tests.
        pub struct Example {
            /// A length. Paper: 0.2.
            pub length_m: f64 = 0.2, "m", [0.0, 5.0];
            /// A count.
            pub count: u32 = 3, "1", [1, 10];
            /// A colour.
            pub colour: Colour = Colour::Red, "";
        }
    }

    kinds! {
        /// For the tests.
        pub enum Part {
            /// Has parameters.
            Example(Example) = "example",
            /// Has none.
            Nothing(NoParams) = "nothing",
        }
    }

    fn message(value: Value) -> String {
        Part::read(value).unwrap_err().to_string()
    }

    #[test]
    fn defaults_are_filled_in_and_written_out() {
        let choice = Part::read(json!({"kind": "example", "count": 4})).unwrap();
        let written = json!({"kind": "example", "length_m": 0.2, "count": 4, "colour": "red"});
        assert_eq!(serde_json::to_value(&choice).unwrap(), written);
        assert_eq!(Part::read(written).unwrap(), choice);
    }

    #[test]
    fn errors_name_the_key_and_what_is_allowed() {
        assert_eq!(
            message(json!({"kind": "example", "length_m": 9})),
            "length_m: 9 is out of range, allowed is 0 to 5 m"
        );
        assert_eq!(message(json!({"kind": "example", "count": 0})), "count: 0 is out of range, allowed is 1 to 10");
        assert!(message(json!({"kind": "example", "colour": "green"})).contains("`red` or `dark-blue`"));
        assert!(message(json!({"kind": "example", "size": 1})).contains("size"));
        assert_eq!(message(json!({"kind": "other"})), "kind: `other` is unknown, allowed is `example`, `nothing`");
        assert!(message(json!([])).contains("object"));
    }

    #[test]
    fn a_schema_says_type_range_unit_and_default() {
        let choices = Part::choices();
        let [example, nothing] = &choices[..] else { panic!("{choices:?}") };
        let properties = &example.schema["properties"];
        let length = json!({"type": "number", "description": "A length. Paper: 0.2.", "minimum": 0, "maximum": 5,
            "unit": "m", "default": 0.2});
        assert_eq!(properties["length_m"], length);
        assert_eq!(properties["count"]["type"], "integer");
        assert_eq!(properties["colour"]["enum"], json!(["red", "dark-blue"]));
        assert_eq!(properties["kind"], json!({"const": "example"}));
        assert_eq!(example.schema["required"], json!(["kind"]));
        assert_eq!(example.default_of("count"), Some(&json!(3)));
        assert_eq!((nothing.kind, nothing.about), ("nothing", "Has none."));
    }

    #[test]
    fn a_parameter_says_where_its_default_comes_from() {
        let [length, count, ..] = Example::TABLE else { panic!("{:?}", Example::TABLE) };
        assert_eq!((length.about(), length.source()), ("A length.", "Paper: 0.2."));
        assert_eq!((count.about(), count.source()), ("A count.", ""));
    }

    #[test]
    fn a_part_without_parameters_refuses_unknown_keys() {
        assert!(message(json!({"kind": "nothing", "size": 1})).contains("size"));
    }
}
