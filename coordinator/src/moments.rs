//! Number, minimum, maximum, sum and sum of squares of one metric over the runs of a cell.
//!
//! All of it is exact or a choice among the values, so it depends on the set of values alone and not on the
//! order in which they came. The standard deviation is taken from both exact sums with twice a double's
//! digits, so that a large mean does not drown a small spread.

use crate::exact_sum::ExactSum;

/// A metric's magnitude is at most this, so that no square is infinite.
pub const METRIC_LIMIT: f64 = 1e100;

/// Moments of a set of values.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Moments {
    n: u64,
    min: f64,
    max: f64,
    sum: ExactSum,
    squares: ExactSum,
}

impl Moments {
    /// Takes `value` in; it is finite and within [`METRIC_LIMIT`].
    pub fn add(&mut self, value: f64) {
        if self.n == 0 || value.total_cmp(&self.min).is_lt() {
            self.min = value;
        }
        if self.n == 0 || value.total_cmp(&self.max).is_gt() {
            self.max = value;
        }
        self.n += 1;
        self.sum.add(value);
        let square = value * value;
        self.squares.add(square);
        self.squares.add(value.mul_add(value, -square));
    }

    /// Takes in all that `other` holds.
    pub fn merge(&mut self, other: &Self) {
        if other.n == 0 {
            return;
        }
        if self.n == 0 {
            self.clone_from(other);
            return;
        }
        self.n += other.n;
        self.min = if other.min.total_cmp(&self.min).is_lt() { other.min } else { self.min };
        self.max = if other.max.total_cmp(&self.max).is_gt() { other.max } else { self.max };
        self.sum.merge(&other.sum);
        self.squares.merge(&other.squares);
    }

    /// How many values there are.
    #[must_use]
    pub const fn n(&self) -> u64 {
        self.n
    }

    /// The smallest value.
    #[must_use]
    pub fn min(&self) -> Option<f64> {
        (self.n > 0).then_some(self.min)
    }

    /// The largest value.
    #[must_use]
    pub fn max(&self) -> Option<f64> {
        (self.n > 0).then_some(self.max)
    }

    /// The exact sum, rounded once.
    #[must_use]
    pub fn sum(&self) -> f64 {
        self.sum.value()
    }

    /// The exact sum of the squares, rounded once.
    #[must_use]
    pub fn sum_of_squares(&self) -> f64 {
        self.squares.value()
    }

    /// The arithmetic mean; none without values.
    #[must_use]
    pub fn mean(&self) -> Option<f64> {
        (self.n > 0).then(|| self.sum() / self.n as f64)
    }

    /// The sample standard deviation (n - 1); none for fewer than two values.
    #[must_use]
    pub fn std(&self) -> Option<f64> {
        if self.n < 2 {
            return None;
        }
        let n = self.n as f64;
        let sum = self.sum.value_and_rest();
        let spread = Pair::product(n, self.squares.value_and_rest()).minus(Pair::square(sum));
        Some((spread.value().max(0.0) / (n * (n - 1.0))).sqrt())
    }

    /// One value for the database: n, minimum, maximum, then both sums, the first behind its length.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let sum = self.sum.to_bytes();
        let mut bytes = Vec::with_capacity(64);
        bytes.extend_from_slice(&self.n.to_le_bytes());
        bytes.extend_from_slice(&self.min.to_le_bytes());
        bytes.extend_from_slice(&self.max.to_le_bytes());
        bytes.extend_from_slice(&(sum.len() as u16).to_le_bytes());
        bytes.extend_from_slice(&sum);
        bytes.extend_from_slice(&self.squares.to_bytes());
        bytes
    }

    /// What [`Self::to_bytes`] wrote; none if these are not such bytes.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (n, rest) = bytes.split_first_chunk::<8>()?;
        let (min, rest) = rest.split_first_chunk::<8>()?;
        let (max, rest) = rest.split_first_chunk::<8>()?;
        let (length, rest) = rest.split_first_chunk::<2>()?;
        let (sum, squares) = rest.split_at_checked(usize::from(u16::from_le_bytes(*length)))?;
        Some(Self {
            n: u64::from_le_bytes(*n),
            min: f64::from_le_bytes(*min),
            max: f64::from_le_bytes(*max),
            sum: ExactSum::from_bytes(sum)?,
            squares: ExactSum::from_bytes(squares)?,
        })
    }
}

/// A number as the unevaluated sum of a double and a smaller one.
#[derive(Clone, Copy)]
struct Pair(f64, f64);

impl Pair {
    fn of_sum(a: f64, b: f64) -> Self {
        let sum = a + b;
        let part = sum - a;
        Self(sum, (a - (sum - part)) + (b - part))
    }

    fn product(factor: f64, (high, low): (f64, f64)) -> Self {
        let product = factor * high;
        Self::of_sum(product, factor.mul_add(high, -product) + factor * low)
    }

    fn square((high, low): (f64, f64)) -> Self {
        let square = high * high;
        Self::of_sum(square, high.mul_add(high, -square) + 2.0 * high * low)
    }

    fn minus(self, other: Self) -> Self {
        let difference = Self::of_sum(self.0, -other.0);
        Self::of_sum(difference.0, difference.1 + (self.1 - other.1))
    }

    fn value(self) -> f64 {
        self.0 + self.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn moments(values: &[f64]) -> Moments {
        let mut moments = Moments::default();
        values.iter().for_each(|value| moments.add(*value));
        moments
    }

    #[test]
    fn textbook_values_come_out() {
        let m = moments(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]);
        assert_eq!((m.n(), m.sum(), m.sum_of_squares()), (8, 40.0, 232.0));
        assert_eq!((m.min(), m.max(), m.mean()), (Some(2.0), Some(9.0), Some(5.0)));
        assert_eq!(m.std(), Some((32.0_f64 / 7.0).sqrt()));
    }

    #[test]
    fn none_and_one_have_no_spread() {
        assert_eq!((moments(&[]).mean(), moments(&[]).min(), moments(&[]).std()), (None, None, None));
        assert_eq!((moments(&[3.0]).mean(), moments(&[3.0]).std()), (Some(3.0), None));
    }

    #[test]
    fn a_large_mean_does_not_drown_a_small_spread() {
        let m = moments(&[1e15, 1e15 + 1.0, 1e15 + 2.0]);
        assert_eq!(m.std(), Some(1.0));
    }

    #[test]
    fn equal_values_have_no_spread_at_all() {
        assert_eq!(moments(&[0.1; 1000]).std(), Some(0.0));
    }

    proptest! {
        #[test]
        fn the_order_of_arrival_leaves_no_trace(
            (values, shuffled) in proptest::collection::vec(-1e100..1e100_f64, 0..30)
                .prop_flat_map(|v| (Just(v.clone()), Just(v).prop_shuffle())),
            cut in 0usize..30,
        ) {
            let (left, right) = shuffled.split_at(cut.min(shuffled.len()));
            let mut merged = moments(left);
            merged.merge(&moments(right));
            prop_assert_eq!(moments(&values).to_bytes(), merged.to_bytes());
        }

        #[test]
        fn bytes_hold_all_of_it(values in proptest::collection::vec(-1e3..1e3_f64, 0..20)) {
            let m = moments(&values);
            prop_assert_eq!(Moments::from_bytes(&m.to_bytes()), Some(m));
        }

        #[test]
        fn arbitrary_bytes_are_refused_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let _ = Moments::from_bytes(&bytes).map(|m| (m.sum(), m.std()));
        }

        #[test]
        fn the_spread_agrees_with_two_passes(values in proptest::collection::vec(-1e3..1e3_f64, 2..50)) {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
            let two_pass = (squares / (values.len() - 1) as f64).sqrt();
            let std = moments(&values).std().unwrap();
            prop_assert!((std - two_pass).abs() <= 1e-9 * (1.0 + two_pass), "{std} {two_pass}");
        }
    }
}
