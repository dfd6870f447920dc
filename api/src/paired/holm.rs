//! Holm's correction of several p values (Holm 1979).

/// The corrected values, in the order of `p`: the chance of any false one among those called true stays below the level.
pub(crate) fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let mut corrected = vec![1.0; p.len()];
    let mut largest: f64 = 0.0;
    for (rank, index) in order.into_iter().enumerate() {
        largest = largest.max((p.len() - rank) as f64 * p[index]).min(1.0);
        corrected[index] = largest;
    }
    corrected
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_values_are_those_of_statsmodels() {
        // multipletests(p, method="holm"), statsmodels 0.15.0.
        let found = holm(&[0.01, 0.04, 0.03, 0.005, 0.5]);
        let expected = [0.04, 0.09, 0.09, 0.025, 0.5];
        assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-15), "{found:?}");
        assert_eq!(holm(&[]), Vec::<f64>::new());
        assert_eq!(holm(&[0.2]), [0.2]);
    }

    proptest! {
        #[test]
        fn it_keeps_the_order_and_lowers_nothing(p in proptest::collection::vec(0.0..=1.0_f64, 0..30)) {
            let corrected = holm(&p);
            for (i, own) in p.iter().enumerate() {
                prop_assert!(*own <= corrected[i] && corrected[i] <= 1.0);
                prop_assert!(corrected[i] <= (p.len() as f64 * own).min(1.0), "no stricter than Bonferroni");
                for (j, other) in p.iter().enumerate() {
                    prop_assert!(own > other || corrected[i] <= corrected[j]);
                }
            }
        }
    }
}
