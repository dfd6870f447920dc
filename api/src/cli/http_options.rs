//! How `furrow serve` meets its users: for this machine only, encrypted, or behind a proxy.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use super::error::CliError;
use crate::http::access::{Access, DEFAULT_RATE};
use crate::http::tls::{self, Files};

/// Where users connect, and how.
#[derive(Debug, clap::Args)]
pub(super) struct HttpOptions {
    /// Where users connect: an address of this machine; port 0 takes a free one. Any but a loopback address is served
    /// encrypted, to those who send a token (`furrow token create`)
    #[arg(long = "http", value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    pub(super) address: SocketAddr,
    /// The certificate for users, with its chain (PEM). Without it one is made and kept beside the database
    #[arg(long = "http-cert", value_name = "FILE", requires = "key", conflicts_with = "plain")]
    cert: Option<PathBuf>,
    /// Its private key (PEM), which not everybody on this machine may read
    #[arg(long = "http-key", value_name = "FILE", requires = "cert")]
    key: Option<PathBuf>,
    /// A further name or address of this server, for the certificate that is made
    #[arg(long = "http-name", value_name = "NAME", conflicts_with_all = ["plain", "cert"])]
    names: Vec<String>,
    /// Do not encrypt: a reverse proxy in front does, and says in X-Forwarded-For who asks. Tokens are needed
    #[arg(long = "http-plain")]
    plain: bool,
    /// Requests per second of one address or token
    #[arg(long = "http-rate", value_name = "N", default_value_t = DEFAULT_RATE, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    rate_per_s: u32,
}

/// How a service meets its users, and what to tell them of it.
pub(super) struct Front {
    pub(super) access: Access,
    /// The certificate's file and its fingerprint.
    pub(super) certificate: Option<(PathBuf, String)>,
}

impl HttpOptions {
    /// Reads the certificate, or makes one beside `database`.
    ///
    /// # Errors
    /// Bad input: certificate or key cannot be used.
    pub(super) fn front(&self, database: &Path) -> Result<Front, CliError> {
        let beyond = !self.address.ip().to_canonical().is_loopback();
        let files = match (&self.cert, &self.key) {
            (Some(cert), Some(key)) => Some(Files { cert: cert.clone(), key: key.clone() }),
            _ if beyond && !self.plain => Some(tls::own(database, &self.own_names()).map_err(refuse)?),
            _ => None,
        };
        let identity = files.as_ref().map(tls::load).transpose().map_err(refuse)?;
        let access = Access {
            tokens: beyond || self.plain,
            proxied: self.plain,
            rate_per_s: self.rate_per_s,
            tls: identity.as_ref().map(|identity| identity.config.clone()),
        };
        let certificate = files.zip(identity).map(|(files, identity)| (files.cert, identity.fingerprint));
        Ok(Front { access, certificate })
    }

    fn own_names(&self) -> Vec<String> {
        let address = Some(self.address.ip()).filter(|address| !address.is_unspecified());
        self.names.iter().cloned().chain(address.map(|address| address.to_string())).collect()
    }
}

fn refuse(error: tls::TlsError) -> CliError {
    CliError::BadInput(error.to_string())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        options: HttpOptions,
    }

    fn front(line: &str, folder: &Path) -> Front {
        let args = ["serve"].into_iter().chain(line.split_whitespace());
        Line::try_parse_from(args).unwrap().options.front(&folder.join("furrow.db")).unwrap()
    }

    #[test]
    fn beyond_this_machine_tokens_are_needed_and_never_sent_in_the_clear_unless_told() {
        let folder = tempfile::tempdir().unwrap();
        for (line, tokens, encrypted) in [
            ("", false, false),
            ("--http [::1]:0", false, false),
            ("--http 0.0.0.0:0", true, true),
            ("--http [::]:0 --http-name furrow.example", true, true),
            ("--http 192.0.2.1:8080", true, true),
            ("--http 192.0.2.1:8080 --http-plain", true, false),
            ("--http-plain", true, false),
        ] {
            let Front { access, certificate } = front(line, folder.path());
            let seen = (access.tokens, access.tls.is_some(), certificate.is_some());
            assert_eq!(seen, (tokens, encrypted, encrypted), "{line}");
        }
    }

    #[test]
    fn options_that_do_not_go_together_are_refused() {
        for line in ["--http-cert a", "--http-key a", "--http-plain --http-cert a --http-key b", "--http-rate 0"] {
            let args = ["serve"].into_iter().chain(line.split_whitespace());
            assert!(Line::try_parse_from(args).is_err(), "{line}");
        }
    }
}
