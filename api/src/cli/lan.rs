//! `furrow serve --lan`: what a server on a local network is told, and what it tells.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use furrow_coordinator::zenoh_service::LocalNetwork;
use furrow_coordinator::{Authority, Config, Gate};

use super::error::CliError;
use super::{join, output};
use crate::http::workers::NewJoinSecret;

/// Where the authority of the database `db` is kept.
pub(super) fn folder_of(db: &Path) -> PathBuf {
    let mut folder = OsString::from(db);
    folder.push(".lan");
    folder.into()
}

#[derive(Debug, clap::Args)]
pub(super) struct LanArgs {
    /// Serve workers on the local network: encrypted, and only those that enrolled with a join secret, of which the first
    /// is printed at the first start
    #[arg(long)]
    lan: bool,
    /// A further name or address under which workers reach this machine; may be given several times
    #[arg(long, value_name = "HOST", requires = "lan")]
    lan_name: Vec<String>,
    /// Write the first join secret to a new file that only its owner reads, instead of printing it
    #[arg(long, value_name = "FILE", requires = "lan")]
    join_out: Option<PathBuf>,
}

impl LanArgs {
    /// Where workers connect if nothing is said.
    pub(super) fn default_endpoint(&self) -> &'static str {
        if self.lan { "quic/0.0.0.0:7447" } else { "tcp/127.0.0.1:0" }
    }

    /// The network that is served, with the authority that is kept beside the database `db`; none without `--lan`.
    ///
    /// # Errors
    /// Bad input: the authority cannot be made or read.
    pub(super) fn network(&self, db: &Path, config: &Config) -> Result<Option<LocalNetwork>, CliError> {
        if !self.lan {
            return Ok(None);
        }
        let authority = Authority::open(&folder_of(db), config.clock.now_ms());
        let authority = Arc::new(authority.map_err(CliError::bad_input("--lan"))?);
        Ok(Some(LocalNetwork { authority, names: self.lan_name.clone() }))
    }

    /// Tells the first join secret, if there never was one; otherwise how to get another.
    ///
    /// # Errors
    /// The file cannot be written, or is there already; the database failed.
    pub(super) async fn tell_first_secret(&self, gate: &Gate) -> Result<(), CliError> {
        if gate.had_secret().await? {
            let _ = output::line("new workers join with a secret from `furrow join`");
            return Ok(());
        }
        let terms = NewJoinSecret::default().terms().expect("the default terms are good");
        let Some(path) = &self.join_out else {
            let secret = gate.new_secret(terms).await?;
            let text = format!("new workers join with this secret, within a day; it is not shown again:\n{secret}");
            let _ = output::line(&text);
            return Ok(());
        };
        // A file that cannot be made is found out before there is a secret to lose.
        let file = join::new_file("--join-out", path)?;
        join::write(path, file, &gate.new_secret(terms).await?.to_string())
    }
}
