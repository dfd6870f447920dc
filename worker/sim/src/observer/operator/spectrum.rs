//! How often a robot swings about the middle: the frequency at which its cross-track error has the most power.

/// Samples per second.
const RATE_HZ: f64 = 20.0;
/// Frequencies that are tried \[Hz\]: below lies the wander of the rows, above no robot of this size swings.
const FROM_HZ: f64 = 0.05;
const TO_HZ: f64 = 2.0;
const STEP_HZ: f64 = 0.01;
/// Shorter stretches say nothing about the lowest frequency.
const SHORTEST: usize = 200;

/// The frequency with the most power in `samples`, taken together over stretches that begin at `starts` \[Hz\]; none if no
/// stretch is long enough.
pub(super) fn dominant_hz(samples: &[f64], starts: &[usize]) -> Option<f64> {
    let ends = starts.iter().skip(1).copied().chain([samples.len()]);
    let stretches: Vec<Vec<f64>> = starts
        .iter()
        .zip(ends)
        .map(|(start, end)| centred(&samples[*start..end]))
        .filter(|s| s.len() >= SHORTEST)
        .collect();
    if stretches.is_empty() {
        return None;
    }
    let steps = ((TO_HZ - FROM_HZ) / STEP_HZ).round() as u32;
    let tried = (0..=steps).map(|i| FROM_HZ + STEP_HZ * f64::from(i));
    let power = |hz: f64| stretches.iter().map(|stretch| power(stretch, hz)).sum::<f64>();
    tried.map(|hz| (hz, power(hz))).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(hz, _)| hz)
}

fn centred(samples: &[f64]) -> Vec<f64> {
    let mean = samples.iter().sum::<f64>() / samples.len().max(1) as f64;
    samples.iter().map(|sample| sample - mean).collect()
}

/// Power at one frequency, by a rotating phasor.
fn power(samples: &[f64], hz: f64) -> f64 {
    let (step_sin, step_cos) = libm::sincos(std::f64::consts::TAU * hz / RATE_HZ);
    let (mut sin, mut cos) = (0.0, 1.0);
    let (mut sum_sin, mut sum_cos) = (0.0, 0.0);
    for sample in samples {
        sum_sin += sample * sin;
        sum_cos += sample * cos;
        (sin, cos) = (sin * step_cos + cos * step_sin, cos * step_cos - sin * step_sin);
    }
    (sum_sin * sum_sin + sum_cos * sum_cos) / samples.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swing_of_three_seconds_is_found_among_slower_wander_and_over_breaks() {
        let at = |i: u32| {
            let t = f64::from(i) / RATE_HZ;
            0.3 + 0.1 * libm::sin(std::f64::consts::TAU * 0.33 * t) + 0.03 * libm::cos(std::f64::consts::TAU * 0.06 * t)
        };
        let samples: Vec<_> = (0..2_000).map(at).chain((500..1_500).map(at)).collect();
        let hz = dominant_hz(&samples, &[0, 2_000]).unwrap();
        assert!((hz - 0.33).abs() < 0.006, "{hz}");
    }

    #[test]
    fn short_stretches_say_nothing() {
        assert_eq!(dominant_hz(&[0.1; 300], &[0, 150]), None);
    }
}
