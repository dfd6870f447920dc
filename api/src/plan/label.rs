//! The form of factor names and labels.

/// Whether `name` is snake_case: a letter, then letters, digits and single underscores, at most 64 characters.
pub(super) fn is_factor_name(name: &str) -> bool {
    name.len() <= 64
        && name.starts_with(|c: char| c.is_ascii_lowercase())
        && name.split('_').all(|word| !word.is_empty() && word.bytes().all(is_plain))
}

/// Whether `label` is kebab-case: words of lower-case letters and digits joined by single `-`, or by `.` as in
/// a decimal number, at most 128 characters.
pub(super) fn is_label(label: &str) -> bool {
    label.len() <= 128 && label.split(['-', '.']).all(|word| !word.is_empty() && word.bytes().all(is_plain))
}

fn is_plain(byte: u8) -> bool {
    byte.is_ascii_lowercase() || byte.is_ascii_digit()
}

/// `text` as a label: lower case, all else between words a single `-`. None when no word is left.
pub(super) fn kebab(text: &str) -> Option<String> {
    let lower = text.to_lowercase();
    let words: Vec<&str> = lower.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty()).collect();
    Some(words.join("-")).filter(|label| is_label(label))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_kebab_case() {
        for good in ["rgop", "crop-2", "pl-ekf-lgg", "nursery-042", "0.05", "1e-7"] {
            assert!(is_label(good), "{good}");
        }
        for bad in ["", "Crop", "crop_2", "-crop", "crop-", "a--b", "a b", "=1+1", "a.", "\u{1b}[31m"] {
            assert!(!is_label(bad), "{bad}");
        }
    }

    #[test]
    fn factor_names_are_snake_case() {
        for good in ["algorithm", "lidar_hz", "x2"] {
            assert!(is_factor_name(good), "{good}");
        }
        for bad in ["", "Field", "_x", "x_", "a__b", "lidar-hz", "2x", "a b"] {
            assert!(!is_factor_name(bad), "{bad}");
        }
    }

    #[test]
    fn any_name_with_a_letter_or_a_digit_becomes_a_label() {
        assert_eq!(kebab("Crop_1 (published)").as_deref(), Some("crop-1-published"));
        assert_eq!(kebab("crop-1-published").as_deref(), Some("crop-1-published"));
        assert_eq!(kebab("--"), None);
    }
}
