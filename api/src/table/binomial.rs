//! Hits in a number of trials: their tail, and the exact interval of the chance behind them.

use statrs::function::beta::beta_reg;

/// The chance of at most `k` hits in `n` trials with chance `p` each.
pub(crate) fn at_most(k: u64, n: u64, p: f64) -> f64 {
    if k >= n { 1.0 } else { beta_reg((n - k) as f64, (k + 1) as f64, 1.0 - p) }
}

/// The exact interval of the chance after `hits` in `n` trials (Clopper and Pearson 1934): it misses with a chance of at
/// most `error`, whatever that chance is. Without trials it is 0 to 1.
pub(crate) fn clopper_pearson_interval(hits: u64, n: u64, error: f64) -> [f64; 2] {
    let hits = hits.min(n);
    let low = if hits == 0 { 0.0 } else { 1.0 - chance_of_tail(n - hits, n, error / 2.0) };
    let high = if hits == n { 1.0 } else { chance_of_tail(hits, n, error / 2.0) };
    [low, high]
}

/// The chance p at which `at_most(k, n, p)` is `tail`.
fn chance_of_tail(k: u64, n: u64, tail: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..200 {
        let middle = f64::midpoint(low, high);
        if at_most(k, n, middle) > tail {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_intervals_are_those_of_scipy() {
        // binomtest(k, n).proportion_ci(confidence_level=1 - error, method="exact"), scipy 1.17.1.
        for (hits, n, error, low, high) in [
            (9, 10, 0.05, 0.554_983_883, 0.997_471_421),
            (20, 20, 0.05, 0.831_566_529, 1.0),
            (0, 20, 0.05, 0.0, 0.168_433_471),
            (30, 42, 0.01, 0.506_210_655, 0.872_603_320),
        ] {
            let [a, b] = clopper_pearson_interval(hits, n, error);
            assert!((a - low).abs() < 1e-9 && (b - high).abs() < 1e-9, "{hits} of {n}: [{a}, {b}]");
        }
    }
}
