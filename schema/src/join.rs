//! The join secret: all that a new worker needs to enrol at a coordinator on the local network, as one word.
//!
//! Whoever holds it may enrol. It is written `furrow-join-1.` with base64url of its JSON and a checksum behind it, so
//! that a torn or mistyped one is told from one that the coordinator refuses.

use std::fmt;
use std::str::FromStr;

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use serde::{Deserialize, Serialize};

/// What every join secret begins with; the number is the version of its form.
pub const MARK: &str = "furrow-join-1.";
/// A longer text is none.
const MAX_CHARS: usize = 16 << 10;
/// So many bytes of a hash stand behind the content.
const CHECKSUM_BYTES: usize = 4;

/// A join secret, read. Its `Debug` shows nothing that lets anyone in.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JoinSecret {
    /// The coordinator's id.
    pub coordinator: String,
    /// The namespace it serves.
    pub namespace: String,
    /// Where it listens, such as `quic/192.0.2.2:7447`; one of them is within the worker's reach.
    pub endpoints: Vec<String>,
    /// The certificate by which the coordinator is known (PEM).
    pub authority_pem: String,
    /// A certificate that lets its holder ask to be enrolled, and nothing else (PEM).
    pub certificate_pem: String,
    /// The secret itself: the certificate's private key (PEM), which signs the question.
    pub key_pem: String,
    /// When it ends [ms since 1970].
    pub until_ms: i64,
}

/// A text that is no join secret. The user looks where the text comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum JoinError {
    /// It does not begin as one. Nothing of it is repeated here: it may be another secret.
    #[error("this is no join secret: it does not begin with `{MARK}`")]
    NotOne,
    /// It is cut short, or a character is wrong.
    #[error("the join secret is damaged: copy all of it, to the last character")]
    Damaged,
}

impl fmt::Display for JoinSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut bytes = serde_json::to_vec(self).expect("texts and numbers are JSON");
        bytes.extend_from_slice(&checksum(&bytes));
        write!(f, "{MARK}{}", URL_SAFE_NO_PAD.encode(bytes))
    }
}

impl FromStr for JoinSecret {
    type Err = JoinError;

    /// White space around it does not count.
    fn from_str(text: &str) -> Result<Self, JoinError> {
        let encoded = text.trim().strip_prefix(MARK).ok_or(JoinError::NotOne)?;
        let bytes = Some(encoded).filter(|encoded| encoded.len() <= MAX_CHARS);
        let bytes = bytes.and_then(|encoded| URL_SAFE_NO_PAD.decode(encoded).ok()).ok_or(JoinError::Damaged)?;
        let (content, sum) = bytes.split_last_chunk::<CHECKSUM_BYTES>().ok_or(JoinError::Damaged)?;
        if *sum != checksum(content) {
            return Err(JoinError::Damaged);
        }
        serde_json::from_slice(content).map_err(|_| JoinError::Damaged)
    }
}

impl fmt::Debug for JoinSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("JoinSecret").field("coordinator", &self.coordinator).finish_non_exhaustive()
    }
}

fn checksum(content: &[u8]) -> [u8; CHECKSUM_BYTES] {
    *blake3::hash(content).as_bytes().first_chunk().expect("a hash is longer than a checksum")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn secret() -> JoinSecret {
        JoinSecret {
            coordinator: "c0ffee".to_owned(),
            namespace: "default".to_owned(),
            endpoints: vec!["quic/192.0.2.2:7447".to_owned()],
            authority_pem: "an authority".to_owned(),
            certificate_pem: "a certificate".to_owned(),
            key_pem: "nobody else knows this".to_owned(),
            until_ms: 1,
        }
    }

    #[test]
    fn a_secret_survives_being_written_and_read() {
        let text = secret().to_string();
        assert!(text.bytes().all(|byte| byte.is_ascii_graphic()), "it is one word");
        assert_eq!(format!("\n {text}\n").parse(), Ok(secret()));
    }

    #[test]
    fn a_torn_or_mistyped_secret_is_damaged_and_another_text_is_none() {
        let text = secret().to_string();
        for end in MARK.len()..text.len() {
            assert_eq!(text[..end].parse::<JoinSecret>(), Err(JoinError::Damaged), "cut at {end}");
        }
        let mistyped = text.replacen('e', "f", 2);
        assert!(mistyped.parse::<JoinSecret>().is_err());
        assert_eq!("let me in".parse::<JoinSecret>(), Err(JoinError::NotOne));
    }

    #[test]
    fn a_secret_is_not_shown_by_debug() {
        let shown = format!("{:?}", secret());
        assert!(shown.contains("c0ffee") && !shown.contains("nobody else"), "{shown}");
    }

    proptest! {
        #[test]
        fn arbitrary_texts_are_refused_without_a_panic(text in ".{0,200}") {
            prop_assert!(text.parse::<JoinSecret>().is_err());
            let marked = format!("{MARK}{text}");
            prop_assert!(marked.parse::<JoinSecret>().is_err());
        }
    }
}
