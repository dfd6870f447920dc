//! The sum of any number of doubles without rounding: the same bits in any order.
//!
//! Every finite double is a whole number of 2^-1074, so a sum of them is one too: a two's complement integer
//! wide enough for the largest double and 2^140 of them. Adding integers is associative; only reading the
//! sum as a double rounds, once, to the nearest (ties to even).

/// 64-bit words: 2,098 bits hold any double, the rest is for the sign and for carries.
const WORDS: usize = 35;
/// Bits of a double's significand, the hidden one counted.
const SIGNIFICAND_BITS: usize = 53;
const FRACTION_MASK: u64 = (1 << 52) - 1;

/// An exact sum of doubles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExactSum {
    /// Two's complement, least significant word first, in units of 2^-1074.
    words: [u64; WORDS],
}

impl Default for ExactSum {
    fn default() -> Self {
        Self { words: [0; WORDS] }
    }
}

impl ExactSum {
    /// Adds `value`, which must be finite: anything else is no number and is left out.
    pub fn add(&mut self, value: f64) {
        debug_assert!(value.is_finite(), "sums are of finite values");
        if !value.is_finite() {
            return;
        }
        let bits = value.to_bits();
        let exponent = ((bits >> 52) & 0x7ff) as usize;
        let fraction = bits & FRACTION_MASK;
        let (significand, shift) = if exponent == 0 { (fraction, 0) } else { (fraction | 1 << 52, exponent - 1) };
        let wide = u128::from(significand) << (shift % 64);
        let (low, high) = (wide as u64, (wide >> 64) as u64);
        self.add_words(shift / 64, low, high, value.is_sign_negative());
    }

    /// Adds all that `other` holds.
    pub fn merge(&mut self, other: &Self) {
        let mut carry = false;
        for (word, more) in self.words.iter_mut().zip(other.words) {
            let (sum, over_a) = word.overflowing_add(more);
            let (sum, over_b) = sum.overflowing_add(u64::from(carry));
            *word = sum;
            carry = over_a || over_b;
        }
    }

    /// The sum as the nearest double; infinite when it is beyond all of them.
    #[must_use]
    pub fn value(&self) -> f64 {
        let negative = self.is_negative();
        let magnitude = if negative { self.negated() } else { self.clone() };
        let value = magnitude.nearest();
        if negative { -value } else { value }
    }

    /// The sum as two doubles whose own sum is within 2^-106 of it: the nearest, and the nearest to the rest.
    #[must_use]
    pub fn value_and_rest(&self) -> (f64, f64) {
        let value = self.value();
        if !value.is_finite() {
            return (value, 0.0);
        }
        let mut rest = self.clone();
        rest.add(-value);
        (value, rest.value())
    }

    /// The words that differ from the sign, behind the number of the first: 9 to 40 bytes for usual values.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let sign = if self.is_negative() { u64::MAX } else { 0 };
        let Some(first) = self.words.iter().position(|word| *word != 0) else { return Vec::new() };
        let mut end = WORDS;
        while end > first + 1 && self.words[end - 1] == sign && (self.words[end - 2] >> 63) == (sign >> 63) {
            end -= 1;
        }
        let words = self.words[first..end].iter().flat_map(|word| word.to_le_bytes());
        std::iter::once(first as u8).chain(words).collect()
    }

    /// What [`Self::to_bytes`] wrote; none if these are not such bytes.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mut sum = Self::default();
        let Some((first, rest)) = bytes.split_first() else { return Some(sum) };
        let (words, odd) = rest.as_chunks::<8>();
        let first = usize::from(*first);
        if !odd.is_empty() || words.is_empty() || first + words.len() > WORDS {
            return None;
        }
        for (to, from) in sum.words[first..].iter_mut().zip(words) {
            *to = u64::from_le_bytes(*from);
        }
        let end = first + words.len();
        let sign = if sum.words[end - 1] >> 63 == 1 { u64::MAX } else { 0 };
        sum.words[end..].fill(sign);
        Some(sum)
    }

    fn is_negative(&self) -> bool {
        self.words[WORDS - 1] >> 63 == 1
    }

    fn negated(&self) -> Self {
        let mut words = self.words.map(|word| !word);
        for word in &mut words {
            let (sum, over) = word.overflowing_add(1);
            *word = sum;
            if !over {
                break;
            }
        }
        Self { words }
    }

    fn add_words(&mut self, at: usize, low: u64, high: u64, subtract: bool) {
        let step = if subtract { u64::overflowing_sub } else { u64::overflowing_add };
        let mut carry = false;
        for (i, word) in self.words[at..].iter_mut().enumerate() {
            let addend = [low, high].get(i).copied().unwrap_or(0);
            if i >= 2 && !carry {
                break;
            }
            let (sum, over_a) = step(*word, addend);
            let (sum, over_b) = step(sum, u64::from(carry));
            *word = sum;
            carry = over_a || over_b;
        }
    }

    /// The nearest double of a sum that is not negative.
    fn nearest(&self) -> f64 {
        let Some(top_word) = self.words.iter().rposition(|word| *word != 0) else { return 0.0 };
        let bits = 64 * (top_word + 1) - self.words[top_word].leading_zeros() as usize;
        if bits <= SIGNIFICAND_BITS {
            return f64::from_bits(self.words[0]);
        }
        let dropped = bits - SIGNIFICAND_BITS;
        let kept = self.bits_from(dropped) & ((1 << SIGNIFICAND_BITS) - 1);
        let half = self.bits_from(dropped - 1) & 1 == 1;
        let round_up = half && (kept & 1 == 1 || self.any_below(dropped - 1));
        let exponent = dropped as u64 + 1;
        // The hidden bit adds one to the exponent's field; so does a significand that rounds up to the next power.
        let rounded = ((exponent - 1) << 52) + kept + u64::from(round_up);
        if rounded >= 0x7ff << 52 { f64::INFINITY } else { f64::from_bits(rounded) }
    }

    /// The 64 bits from bit `from` up.
    fn bits_from(&self, from: usize) -> u64 {
        let (word, shift) = (from / 64, from % 64);
        let high = self.words.get(word + 1).copied().unwrap_or(0);
        ((u128::from(high) << 64 | u128::from(self.words[word])) >> shift) as u64
    }

    fn any_below(&self, bit: usize) -> bool {
        let (word, shift) = (bit / 64, bit % 64);
        self.words[..word].iter().any(|w| *w != 0) || self.words[word] & ((1 << shift) - 1) != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sum(values: &[f64]) -> ExactSum {
        let mut sum = ExactSum::default();
        values.iter().for_each(|value| sum.add(*value));
        sum
    }

    #[test]
    fn what_a_running_sum_loses_is_kept() {
        assert_eq!(sum(&[1e100, 1.0, -1e100]).value(), 1.0);
        assert_eq!(sum(&[0.1; 10]).value(), 1.0);
        assert_eq!(sum(&[f64::MAX, f64::MAX, -f64::MAX]).value(), f64::MAX);
        assert_eq!(sum(&[5e-324, 5e-324, -5e-324]).value(), 5e-324);
        assert_eq!(sum(&[]).value().to_bits(), 0.0_f64.to_bits());
    }

    #[test]
    fn a_tie_goes_to_the_even_neighbour_and_a_trace_breaks_it() {
        let ulp = f64::EPSILON;
        assert_eq!(sum(&[1.0, ulp / 2.0]).value(), 1.0);
        assert_eq!(sum(&[1.0 + ulp, ulp / 2.0]).value(), 1.0 + 2.0 * ulp);
        assert_eq!(sum(&[1.0, ulp / 2.0, 5e-324]).value(), 1.0 + ulp);
        assert_eq!(sum(&[2.0 - ulp, ulp / 2.0]).value(), 2.0);
    }

    #[test]
    fn a_sum_beyond_all_doubles_is_infinite() {
        assert_eq!(sum(&[f64::MAX, f64::MAX]).value(), f64::INFINITY);
        assert_eq!(sum(&[-f64::MAX, -f64::MAX]).value(), f64::NEG_INFINITY);
    }

    #[test]
    fn the_rest_is_what_the_nearest_double_leaves() {
        assert_eq!(sum(&[1e30, 1.0]).value_and_rest(), (1e30, 1.0));
    }

    #[test]
    fn foreign_bytes_are_no_sum() {
        assert_eq!(ExactSum::from_bytes(&[0, 1]), None);
        assert_eq!(ExactSum::from_bytes(&[40, 1, 0, 0, 0, 0, 0, 0, 0]), None);
        assert_eq!(ExactSum::from_bytes(&[3]), None);
    }

    fn any_finite() -> impl Strategy<Value = f64> {
        any::<u64>().prop_map(f64::from_bits).prop_filter("finite", |value| value.is_finite())
    }

    fn values_and_a_permutation() -> impl Strategy<Value = (Vec<f64>, Vec<f64>)> {
        proptest::collection::vec(prop_oneof![any_finite(), -1e6..1e6_f64], 0..40)
            .prop_flat_map(|values| (Just(values.clone()), Just(values).prop_shuffle()))
    }

    proptest! {
        #[test]
        fn the_order_does_not_matter((values, shuffled) in values_and_a_permutation(), cut in 0usize..40) {
            let straight = sum(&values);
            let (left, right) = shuffled.split_at(cut.min(shuffled.len()));
            let mut merged = sum(left);
            merged.merge(&sum(right));
            prop_assert_eq!(&straight, &merged);
            prop_assert_eq!(straight.to_bytes(), merged.to_bytes());
        }

        #[test]
        fn bytes_hold_all_of_it(values in proptest::collection::vec(any_finite(), 0..10)) {
            let sum = sum(&values);
            prop_assert_eq!(ExactSum::from_bytes(&sum.to_bytes()), Some(sum));
        }

        #[test]
        fn one_value_is_itself_and_two_are_rounded_once(a in any_finite(), b in any_finite()) {
            prop_assert_eq!(sum(&[a]).value(), a);
            prop_assert_eq!(sum(&[a, b]).value(), a + b);
        }

        #[test]
        fn whole_numbers_agree_with_integers(values in proptest::collection::vec(-(1i64 << 50)..(1 << 50), 0..50)) {
            let floats: Vec<f64> = values.iter().map(|v| *v as f64).collect();
            let whole: i128 = values.iter().map(|v| i128::from(*v)).sum();
            prop_assert_eq!(sum(&floats).value(), whole as f64);
        }
    }
}
