//! Whole numbers in a body, also written as `2.0`: JSON does not tell the two apart, and not every client does.

use serde::de::{Deserialize, Deserializer, Error};
use serde_json::Number;

/// A whole number within the range of `T`.
pub(super) fn whole<'de, D: Deserializer<'de>, T: TryFrom<i128>>(deserializer: D) -> Result<T, D::Error> {
    read(&Number::deserialize(deserializer)?)
}

/// The same, or null.
pub(super) fn whole_or_null<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
where
    D: Deserializer<'de>,
    T: TryFrom<i128>,
{
    Option::<Number>::deserialize(deserializer)?.as_ref().map(read).transpose()
}

fn read<T: TryFrom<i128>, E: Error>(number: &Number) -> Result<T, E> {
    let whole = number.as_i128().or_else(|| number.as_f64().and_then(exact));
    let whole = whole.ok_or_else(|| E::custom(format!("`{number}` is no whole number")))?;
    T::try_from(whole).map_err(|_| E::custom(format!("`{number}` is out of range")))
}

/// The number itself, if it is whole. Beyond 2^53 nobody can tell which one was meant.
#[expect(clippy::cast_possible_truncation, reason = "it has no fraction and is in range")]
fn exact(number: f64) -> Option<i128> {
    (number.fract() == 0.0 && number.abs() < 2_f64.powi(53)).then_some(number as i128)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    struct Body {
        #[serde(deserialize_with = "whole")]
        seeds: u64,
        #[serde(default, deserialize_with = "whole_or_null")]
        until_ms: Option<i64>,
    }

    fn body(text: &str) -> Result<(u64, Option<i64>), String> {
        serde_json::from_str::<Body>(text).map(|body| (body.seeds, body.until_ms)).map_err(|error| error.to_string())
    }

    #[test]
    fn a_whole_number_may_be_written_with_a_point() {
        assert_eq!(body(r#"{"seeds": 3}"#), Ok((3, None)));
        assert_eq!(body(r#"{"seeds": 3.0, "until_ms": -2e3}"#), Ok((3, Some(-2_000))));
        assert_eq!(body(r#"{"seeds": 18446744073709551615, "until_ms": null}"#), Ok((u64::MAX, None)));
        assert_eq!(body(r#"{"seeds": 0, "until_ms": -9223372036854775808}"#), Ok((0, Some(i64::MIN))));
    }

    #[test]
    fn what_is_no_whole_number_in_range_is_refused() {
        for (number, word) in [("1.5", "no whole"), ("-1", "range"), ("1e300", "no whole"), ("\"3\"", "string")] {
            let error = body(&format!(r#"{{"seeds": {number}}}"#)).unwrap_err();
            assert!(error.contains(word), "{error}");
        }
        assert!(body(r#"{"seeds": 1, "until_ms": 9223372036854775808}"#).unwrap_err().contains("range"));
        assert!(body(r#"{"seeds": 1, "until_ms": -9223372036854775809}"#).unwrap_err().contains("no whole"));
    }
}
