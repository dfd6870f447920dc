//! `furrow token`: who may use a server from beyond its machine. Works on the database's file, beside a server.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::Subcommand;
use furrow_coordinator::token::{NewToken, Scope, TokenBook, TokenInfo};
use serde_json::{Value, json};

use super::error::CliError;
use super::output;

const DAY_MS: i64 = 24 * 60 * 60 * 1_000;

/// Make, list and revoke the tokens by which a server is used from other machines
#[derive(Debug, clap::Args)]
pub(super) struct TokenArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Make a token and print it, this once
    Create(CreateArgs),
    /// List the tokens, without what opens anything
    List(ListArgs),
    /// Revoke a token; a server refuses it from then on
    Revoke(RevokeArgs),
}

/// Where the tokens are.
#[derive(Debug, clap::Args)]
struct Database {
    /// The server's database; the server may be running
    #[arg(long, value_name = "FILE")]
    db: PathBuf,
}

#[derive(Debug, clap::Args)]
struct CreateArgs {
    /// What to call it
    #[arg(long)]
    name: String,
    /// What it allows, of read, submit and admin; none includes another
    #[arg(long, value_name = "SCOPES", value_delimiter = ',', default_value = "read")]
    scope: Vec<Scope>,
    /// When it ends to be valid: 90d, 12h; never if not given
    #[arg(long, value_name = "TIME", value_parser = lifetime)]
    expires: Option<Duration>,
    #[command(flatten)]
    database: Database,
}

#[derive(Debug, clap::Args)]
struct ListArgs {
    #[command(flatten)]
    database: Database,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct RevokeArgs {
    /// Its name or number
    token: String,
    #[command(flatten)]
    database: Database,
}

/// Reads `90d`, `12h` or `30m`.
fn lifetime(text: &str) -> Result<Duration, String> {
    let wrong = || "expected a number of days, hours or minutes, such as 90d, 12h or 30m".to_owned();
    let (number, unit) = text.split_at_checked(text.len().saturating_sub(1)).ok_or_else(wrong)?;
    let seconds = match unit {
        "d" => 86_400,
        "h" => 3_600,
        "m" => 60,
        _ => return Err(wrong()),
    };
    let number: u32 = number.parse().map_err(|_| wrong())?;
    match number {
        0 => Err(wrong()),
        1..=36_500 => Ok(Duration::from_secs(u64::from(number) * seconds)),
        _ => Err("expected at most 36500".to_owned()),
    }
}

/// # Errors
/// Bad input: no such database, a name that is taken or none, or no such token.
pub(super) async fn run(args: TokenArgs) -> Result<(), CliError> {
    match args.what {
        What::Create(args) => create(args).await,
        What::List(args) => list(args).await,
        What::Revoke(args) => revoke(args).await,
    }
}

async fn create(args: CreateArgs) -> Result<(), CliError> {
    let mut book = open(&args.database.db).await?;
    let now_ms = now_ms();
    let end = |lifetime: Duration| now_ms + i64::try_from(lifetime.as_millis()).unwrap_or(i64::MAX - now_ms);
    let new = NewToken { name: args.name, scopes: args.scope, expires_ms: args.expires.map(end) };
    let secret = book.create(&new, now_ms).await?;
    book.close().await?;
    output::line(secret.reveal())
}

async fn list(args: ListArgs) -> Result<(), CliError> {
    let mut book = open(&args.database.db).await?;
    let tokens = book.list().await?;
    book.close().await?;
    if args.json {
        return output::json(&json!({"items": tokens.iter().map(shown).collect::<Vec<_>>()}));
    }
    let now_ms = now_ms();
    tokens.iter().try_for_each(|token| output::line(&sentence(token, now_ms)))
}

async fn revoke(args: RevokeArgs) -> Result<(), CliError> {
    let mut book = open(&args.database.db).await?;
    let revoked = book.revoke(&args.token, now_ms()).await?;
    book.close().await?;
    match revoked {
        Some(token) => output::line(&format!("token {} `{}` is revoked", token.id, token.name)),
        None => Err(CliError::BadInput(format!("there is no token `{}` that is not revoked", args.token))),
    }
}

async fn open(database: &Path) -> Result<TokenBook, CliError> {
    Ok(TokenBook::open(database).await?)
}

fn now_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_millis()).unwrap_or(i64::MAX)
}

fn shown(token: &TokenInfo) -> Value {
    let scopes: Vec<_> = token.scopes.iter().map(|scope| scope.word()).collect();
    json!({
        "id": token.id, "name": token.name, "scopes": scopes, "created_ms": token.created_ms,
        "expires_ms": token.expires_ms, "used_ms": token.used_ms, "revoked_ms": token.revoked_ms,
    })
}

fn sentence(token: &TokenInfo, now_ms: i64) -> String {
    let scopes: Vec<_> = token.scopes.iter().map(|scope| scope.word()).collect();
    let days = |ms: i64| ms.max(0) / DAY_MS;
    let state = match (token.revoked_ms, token.expires_ms) {
        (Some(_), _) => "revoked".to_owned(),
        (None, Some(expires)) if expires <= now_ms => "expired".to_owned(),
        (None, Some(expires)) => format!("valid for {} more days", days(expires - now_ms)),
        (None, None) => "valid".to_owned(),
    };
    let used = token.used_ms.map_or("never used".to_owned(), |at| match days(now_ms - at) {
        0 => "used today".to_owned(),
        n => format!("last used {n} days ago"),
    });
    format!("{} {}: {}; {state}; {used}", token.id, token.name, scopes.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lifetime_has_a_unit() {
        let read = |text: &str| lifetime(text).ok().map(|time| time.as_secs());
        assert_eq!((read("90d"), read("12h"), read("30m")), (Some(7_776_000), Some(43_200), Some(1_800)));
        for bad in ["", "d", "90", "-1d", "0d", "1.5h", "9999999d", "3w", "3é"] {
            assert_eq!(read(bad), None, "{bad}");
        }
    }

    #[test]
    fn a_token_is_told_in_a_line() {
        let token = TokenInfo {
            id: 3,
            name: "laptop".to_owned(),
            scopes: vec![Scope::Read, Scope::Submit],
            created_ms: 0,
            expires_ms: Some(3 * DAY_MS),
            used_ms: None,
            revoked_ms: None,
        };
        assert_eq!(sentence(&token, DAY_MS), "3 laptop: read,submit; valid for 2 more days; never used");
        let used = TokenInfo { used_ms: Some(0), ..token };
        assert_eq!(sentence(&used, 4 * DAY_MS), "3 laptop: read,submit; expired; last used 4 days ago");
    }
}
