//! Lengths of time on the command line.

/// Reads `90s`, `30m`, `12h` or `7d`, as seconds.
pub(super) fn seconds(text: &str) -> Result<u64, String> {
    let wrong = || "expected a whole number and a unit: 90s, 30m, 12h or 7d".to_owned();
    let at = text.find(|c: char| !c.is_ascii_digit()).ok_or_else(wrong)?;
    let (number, unit) = text.split_at(at);
    let unit_s: u64 = match unit {
        "s" => 1,
        "m" => 60,
        "h" => 60 * 60,
        "d" => 24 * 60 * 60,
        _ => return Err(wrong()),
    };
    let number: u64 = number.parse().map_err(|_| wrong())?;
    // Longer than any use of it; in milliseconds it still fits.
    number.checked_mul(unit_s).filter(|seconds| (1..=1 << 40).contains(seconds)).ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_is_a_number_with_its_unit() {
        let read = ["90s", "30m", "12h", "7d"].map(seconds);
        assert_eq!(read, [90, 1_800, 43_200, 604_800].map(Ok));
        for bad in ["", "7", "d", "-1d", "1w", "1.5h", "0s", "99999999999999999999d", "1dd"] {
            assert!(seconds(bad).is_err(), "{bad}");
        }
    }
}
