//! Proportional and derivative control with a filtered derivative.
//!
//! Velasquez et al. (2022), sections 3.4 and 5.1. The derivative is one by time, whatever the rate of the loop, and
//! goes through a first-order low pass (ours: the paper names none).

/// The controller.
#[derive(Debug, Clone)]
pub struct Pd {
    kp: f64,
    kd: f64,
    filter_s: f64,
    last_error: Option<f64>,
    /// The error's filtered rate \[1/s\].
    rate: f64,
}

impl Pd {
    /// Gains `kp` and `kd` \[s\]; the derivative's filter has the time constant `filter_s` \[s\].
    #[must_use]
    pub const fn new(kp: f64, kd: f64, filter_s: f64) -> Self {
        Self { kp, kd, filter_s, last_error: None, rate: 0.0 }
    }

    /// The control for `error`, `dt_s` \[s\] after the last one.
    ///
    /// The first error has no rate; an error that is not finite changes nothing and counts as the last one.
    pub fn control(&mut self, error: f64, dt_s: f64) -> f64 {
        let before = self.last_error.unwrap_or(error);
        let error = if error.is_finite() { error } else { self.last_error.unwrap_or(0.0) };
        if before.is_finite() && dt_s > 0.0 && dt_s.is_finite() {
            // Backward Euler of filter_s rate' + rate = error'.
            self.rate = (self.filter_s * self.rate + error - before) / (self.filter_s + dt_s);
        }
        self.last_error = Some(error);
        self.kp * error + self.kd * self.rate
    }

    /// Forgets all earlier errors.
    pub const fn restart(&mut self) {
        self.last_error = None;
        self.rate = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATES_HZ: [f64; 3] = [40.0, 10.0, 5.0];

    /// What the derivative part says after `seconds` of an error that grows by 0.3 a second.
    fn on_a_ramp(rate_hz: f64, seconds: f64) -> f64 {
        let mut pd = Pd::new(0.0, 1.5, 0.1);
        let steps = (seconds * rate_hz).round() as u32;
        (0..=steps).map(|i| pd.control(0.3 * f64::from(i) / rate_hz, 1.0 / rate_hz)).last().unwrap()
    }

    #[test]
    fn the_derivative_of_a_ramp_is_its_slope_at_any_rate() {
        for rate_hz in RATES_HZ {
            assert!((on_a_ramp(rate_hz, 5.0) - 1.5 * 0.3).abs() < 1e-9, "{rate_hz}");
        }
    }

    #[test]
    fn the_filter_takes_its_time_constant() {
        // Two thirds after 0.1 s in continuous time; backward Euler at 1 kHz is close to that.
        let share = on_a_ramp(1000.0, 0.1) / (1.5 * 0.3);
        assert!((share - (1.0 - (-1.0_f64).exp())).abs() < 0.01, "{share}");
    }

    #[test]
    fn a_step_kicks_by_its_height_over_the_filters_time_and_decays() {
        let mut pd = Pd::new(0.7, 1.5, 0.1);
        pd.control(0.0, 0.025);
        assert!((pd.control(0.1, 0.025) - (0.07 + 1.5 * 0.1 / 0.125)).abs() < 1e-12);
        let settled = (0..200).map(|_| pd.control(0.1, 0.025)).last().unwrap();
        assert!((settled - 0.07).abs() < 1e-9);
    }

    #[test]
    fn the_first_error_and_the_first_after_a_restart_have_no_rate() {
        let mut pd = Pd::new(1.0, 1.0, 0.1);
        assert_eq!(pd.control(0.4, 0.1), 0.4);
        pd.control(0.9, 0.1);
        pd.restart();
        assert_eq!(pd.control(0.4, 0.1), 0.4);
    }

    #[test]
    fn what_is_not_finite_counts_as_the_last_error() {
        let mut pd = Pd::new(1.0, 1.0, 0.1);
        assert_eq!(pd.control(f64::NAN, 0.1), 0.0);
        assert_eq!(pd.control(0.2, f64::NAN), 0.2);
        assert_eq!(pd.control(f64::INFINITY, 0.0), 0.2);
    }
}
