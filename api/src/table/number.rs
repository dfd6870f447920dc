//! Numbers as text.

/// A number for people: `decimals` digits behind the point, none from 10,000 on; no sign on zero.
pub(crate) fn short(value: f64, decimals: u8) -> String {
    let decimals = if value.abs() >= 10_000.0 { 0 } else { usize::from(decimals) };
    let text = if value.abs() >= 1e15 { format!("{value:.3e}") } else { format!("{value:.decimals$}") };
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|byte| matches!(byte, b'0' | b'.')) => digits.to_owned(),
        _ => text,
    }
}

/// A count as a mark above the line, such as that of a footnote.
pub(crate) fn superscript(count: usize) -> String {
    let raised = |digit: u8| SUPERSCRIPTS[usize::from(digit - b'0')];
    count.to_string().bytes().map(raised).collect()
}

/// The digits 0 to 9 above the line.
pub(super) const SUPERSCRIPTS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];

/// A number for programs: the shortest text that reads back as the same bits, with a point.
pub(crate) fn exact(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-5..1e16).contains(&magnitude) { value.to_string() } else { format!("{value:e}") }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn people_see_few_digits() {
        assert_eq!(short(65.24, 1), "65.2");
        assert_eq!(short(18957.4, 1), "18957");
        assert_eq!(short(-0.001, 2), "0.00");
        assert_eq!(short(-0.01, 2), "-0.01");
        assert_eq!(short(1e99, 1), "1.000e99");
    }

    #[test]
    fn a_mark_stands_above_the_line() {
        assert_eq!(superscript(12), "¹²");
    }

    proptest! {
        #[test]
        fn programs_read_back_the_same_bits(value in any::<f64>().prop_filter("finite", |value| value.is_finite())) {
            prop_assert_eq!(exact(value).parse::<f64>().map(f64::to_bits), Ok(value.to_bits()));
        }
    }
}
