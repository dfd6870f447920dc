//! What the machine says of itself.

use std::fs;
use std::sync::OnceLock;

/// A processor's name is cut to this length; the coordinator takes 200.
const MAX_MODEL_BYTES: usize = 100;

/// The processor's name as the operating system gives it, `unknown` where it gives none.
pub(super) fn cpu_model() -> &'static str {
    static MODEL: OnceLock<String> = OnceLock::new();
    MODEL.get_or_init(|| {
        let text = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = parse_cpu_model(&text).unwrap_or("unknown");
        model[..model.floor_char_boundary(MAX_MODEL_BYTES)].to_owned()
    })
}

/// The one-minute load average; 0 where the operating system gives none.
pub(super) fn load() -> f64 {
    fs::read_to_string("/proc/loadavg").ok().and_then(|text| parse_load(&text)).unwrap_or(0.0)
}

/// x86 names the model, some ARM kernels the board.
fn parse_cpu_model(cpuinfo: &str) -> Option<&str> {
    ["model name", "Model", "Hardware"]
        .into_iter()
        .find_map(|wanted| {
            let values = cpuinfo.lines().filter_map(|line| line.split_once(':'));
            values
                .map(|(key, value)| (key.trim(), value.trim()))
                .find(|(key, value)| *key == wanted && !value.is_empty())
        })
        .map(|(_, value)| value)
}

fn parse_load(loadavg: &str) -> Option<f64> {
    loadavg.split_whitespace().next()?.parse().ok().filter(|load: &f64| load.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_s_name_is_read_on_x86_and_arm() {
        assert_eq!(parse_cpu_model("processor\t: 0\nmodel name\t: Some CPU @ 2 GHz\n"), Some("Some CPU @ 2 GHz"));
        assert_eq!(parse_cpu_model("processor : 0\nBogoMIPS : 1\nModel : Board 4 B\n"), Some("Board 4 B"));
        assert_eq!(parse_cpu_model("model name :\n"), None);
    }

    #[test]
    fn the_load_is_the_first_number() {
        assert_eq!(parse_load("1.25 0.80 0.60 2/345 6789\n"), Some(1.25));
        assert_eq!(parse_load("NaN 1 1"), None);
        assert_eq!(parse_load(""), None);
    }
}
