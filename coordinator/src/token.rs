//! Tokens: who may use the service from beyond its own machine, and for what.
//!
//! A token is 256 random bits behind a mark. It is shown once; the database keeps its hash. [`TokenBook`] writes them
//! from another process while a coordinator serves the same file; the coordinator looks a token up whenever it is sent.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use rand::RngExt;
use sqlx::{Connection, SqliteConnection};

use crate::error::StoreError;
use crate::store;

/// What every token begins with: it is found where it should not be, in a log or a repository.
pub const TOKEN_PREFIX: &str = "furrow_";

/// A token's name is at most this long \[characters\].
const NAME_CHARS: usize = 64;
const SECRET_BYTES: usize = 32;

/// What a token allows. None includes another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Scope {
    /// To see sweeps, jobs, tables and metrics.
    Read,
    /// To submit, pause, cancel and retry sweeps.
    Submit,
    /// To remove results, to shut workers out, and everything else that changes the service.
    Admin,
}

impl Scope {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Read, Self::Submit, Self::Admin];

    /// Its name on the command line and in the database.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Submit => "submit",
            Self::Admin => "admin",
        }
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl FromStr for Scope {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|scope| scope.word() == word);
        known.ok_or_else(|| "a scope is read, submit or admin".to_owned())
    }
}

/// A token in the clear. It prints itself on purpose only: by [`Secret::reveal`].
#[derive(Clone)]
pub struct Secret(String);

impl Secret {
    /// A new one.
    #[must_use]
    pub fn random() -> Self {
        let bytes: [u8; SECRET_BYTES] = rand::rng().random();
        Self(format!("{TOKEN_PREFIX}{}", URL_SAFE_NO_PAD.encode(bytes)))
    }

    /// What a client sent, if it has the form of a token.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let digits = text.strip_prefix(TOKEN_PREFIX)?;
        let bytes = URL_SAFE_NO_PAD.decode(digits).ok()?;
        (bytes.len() == SECRET_BYTES).then(|| Self(text.to_owned()))
    }

    /// The token itself.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    pub(crate) fn hash(&self) -> blake3::Hash {
        blake3::hash(self.0.as_bytes())
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

/// A token that is to be made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewToken {
    /// What people call it; no other token that is not revoked may have the name.
    pub name: String,
    /// What it allows; at least one.
    pub scopes: Vec<Scope>,
    /// When it stops to be valid [ms since 1970]; never if not given.
    pub expires_ms: Option<i64>,
}

/// What is known of a token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenInfo {
    /// Its number.
    pub id: i64,
    /// What people call it.
    pub name: String,
    /// What it allows.
    pub scopes: Vec<Scope>,
    /// When it was made [ms since 1970].
    pub created_ms: i64,
    /// When it stops to be valid [ms since 1970].
    pub expires_ms: Option<i64>,
    /// When it was last used, to the minute [ms since 1970].
    pub used_ms: Option<i64>,
    /// When it was revoked [ms since 1970].
    pub revoked_ms: Option<i64>,
}

impl TokenInfo {
    /// Whether it opens anything at `now_ms`.
    #[must_use]
    pub fn is_valid(&self, now_ms: i64) -> bool {
        self.revoked_ms.is_none() && self.expires_ms.is_none_or(|expires| now_ms < expires)
    }

    /// Whether it allows `scope`.
    #[must_use]
    pub fn allows(&self, scope: Scope) -> bool {
        self.scopes.contains(&scope)
    }
}

/// The tokens in a database file, which a coordinator may be serving at the same time.
///
/// Each change is one short transaction, for which the coordinator's writer waits, and the other way round.
#[derive(Debug)]
pub struct TokenBook {
    conn: SqliteConnection,
}

impl TokenBook {
    /// Opens the tokens in the file at `path`, which must be there.
    ///
    /// # Errors
    /// [`StoreError::Open`], [`StoreError::NotOurs`] and [`StoreError::Newer`] name the file and why it cannot be used.
    pub async fn open(path: &Path) -> Result<Self, StoreError> {
        Ok(Self { conn: store::open_beside(path).await? })
    }

    /// Makes a token; it is not kept and cannot be shown again.
    ///
    /// # Errors
    /// [`StoreError::Invalid`]: a bad name, one that is taken, no scope, or an expiry that has passed.
    pub async fn create(&mut self, new: &NewToken, now_ms: i64) -> Result<Secret, StoreError> {
        check(new, now_ms)?;
        let secret = Secret::random();
        store::token::add(&mut self.conn, new, &secret.hash(), now_ms).await?;
        Ok(secret)
    }

    /// All tokens, those revoked too, by number.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn list(&mut self) -> Result<Vec<TokenInfo>, StoreError> {
        store::token::list(&mut self.conn).await
    }

    /// Revokes the token of that name or number; none if there is no such token that is not revoked yet.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn revoke(&mut self, name_or_id: &str, now_ms: i64) -> Result<Option<TokenInfo>, StoreError> {
        store::token::revoke(&mut self.conn, name_or_id, now_ms).await
    }

    /// Closes the file.
    ///
    /// # Errors
    /// [`StoreError::Database`]; what was changed is on disk all the same.
    pub async fn close(self) -> Result<(), StoreError> {
        Ok(self.conn.close().await?)
    }
}

fn check(new: &NewToken, now_ms: i64) -> Result<(), StoreError> {
    let NewToken { name, scopes, expires_ms } = new;
    let ordinary = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.' | '@');
    let refuse = |text: String| Err(StoreError::Invalid(text));
    if name.is_empty() || name.len() > NAME_CHARS || !name.chars().all(ordinary) {
        return refuse(format!("a token's name is 1 to {NAME_CHARS} of the characters a-z A-Z 0-9 - _ . @"));
    }
    if name.bytes().all(|b| b.is_ascii_digit()) {
        return refuse("a token's name must not be a number: those are the tokens' own".to_owned());
    }
    if scopes.is_empty() {
        return refuse("a token needs a scope: read, submit or admin".to_owned());
    }
    if expires_ms.is_some_and(|expires| expires <= now_ms) {
        return refuse("a token must not expire before it is made".to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::store::Store;
    use crate::testing::Bench;

    const NOW: i64 = 1_700_000_000_000;

    fn new(name: &str) -> NewToken {
        NewToken { name: name.to_owned(), scopes: vec![Scope::Read, Scope::Submit], expires_ms: None }
    }

    /// A coordinator on a file, and the tokens beside it.
    async fn served() -> (tempfile::TempDir, Bench, TokenBook) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let bench = Bench::over(Store::open(&path).await.unwrap());
        let book = TokenBook::open(&path).await.unwrap();
        (folder, bench, book)
    }

    #[tokio::test]
    async fn a_token_opens_until_it_is_revoked() {
        let (_folder, bench, mut book) = served().await;
        let secret = book.create(&new("laptop"), NOW).await.unwrap();
        let found = bench.coordinator.token(&secret).await.unwrap().unwrap();
        assert_eq!(
            (found.name.as_str(), found.allows(Scope::Submit), found.allows(Scope::Admin)),
            ("laptop", true, false)
        );
        assert!(bench.coordinator.token(&Secret::random()).await.unwrap().is_none());
        assert_eq!(book.revoke("laptop", NOW).await.unwrap().unwrap().id, found.id);
        assert!(bench.coordinator.token(&secret).await.unwrap().is_none());
        assert!(book.revoke("laptop", NOW).await.unwrap().is_none(), "it is revoked already");
        bench.coordinator.shutdown().await;
    }

    #[tokio::test]
    async fn a_token_expires_at_its_time() {
        let (_folder, bench, mut book) = served().await;
        let token = NewToken { expires_ms: Some(NOW + 1_000), ..new("short") };
        let secret = book.create(&token, NOW).await.unwrap();
        assert!(bench.coordinator.token(&secret).await.unwrap().is_some());
        bench.clock.advance(1_000);
        assert!(bench.coordinator.token(&secret).await.unwrap().is_none());
        bench.coordinator.shutdown().await;
    }

    #[tokio::test]
    async fn the_file_holds_no_token_and_a_name_is_free_after_it_is_revoked() {
        let (folder, bench, mut book) = served().await;
        let secret = book.create(&new("laptop"), NOW).await.unwrap();
        assert!(matches!(book.create(&new("laptop"), NOW).await, Err(StoreError::Invalid(_))));
        book.revoke("1", NOW).await.unwrap().unwrap();
        book.create(&new("laptop"), NOW).await.unwrap();
        let revoked: Vec<_> = book.list().await.unwrap().iter().map(|token| token.revoked_ms).collect();
        assert_eq!(revoked, [Some(NOW), None]);
        book.close().await.unwrap();
        bench.coordinator.shutdown().await;
        let digits = secret.reveal().strip_prefix(TOKEN_PREFIX).unwrap().as_bytes();
        let bytes = std::fs::read(folder.path().join("furrow.db")).unwrap();
        assert!(!bytes.windows(digits.len()).any(|window| window == digits));
        assert_eq!(format!("{secret:?}"), "Secret(..)");
    }

    #[tokio::test]
    async fn use_is_noted() {
        let (_folder, bench, mut book) = served().await;
        let secret = book.create(&new("laptop"), NOW).await.unwrap();
        let token = bench.coordinator.token(&secret).await.unwrap().unwrap();
        bench.coordinator.note_use(&token).await.unwrap();
        assert_eq!(book.list().await.unwrap()[0].used_ms, Some(NOW));
        bench.coordinator.shutdown().await;
    }

    #[tokio::test]
    async fn a_bad_token_is_refused() {
        let (_folder, bench, mut book) = served().await;
        for name in ["", "a b", "17", "tür", &"x".repeat(65)] {
            assert!(matches!(book.create(&new(name), NOW).await, Err(StoreError::Invalid(_))), "{name}");
        }
        for bad in [NewToken { scopes: vec![], ..new("x") }, NewToken { expires_ms: Some(NOW), ..new("x") }] {
            assert!(matches!(book.create(&bad, NOW).await, Err(StoreError::Invalid(_))), "{bad:?}");
        }
        assert!(book.list().await.unwrap().is_empty());
        bench.coordinator.shutdown().await;
    }

    #[tokio::test]
    async fn a_file_that_is_not_there_is_not_made() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none.db");
        assert!(matches!(TokenBook::open(&path).await, Err(StoreError::Open { .. })));
        assert!(!path.exists());
    }

    proptest! {
        #[test]
        fn any_text_is_a_token_or_none(text in prop_oneof![".{0,80}", "furrow_[A-Za-z0-9_-]{40,46}", "furrow_.{43}"]) {
            if let Some(secret) = Secret::parse(&text) {
                prop_assert_eq!(secret.reveal(), text.as_str());
                prop_assert_eq!(text.len(), TOKEN_PREFIX.len() + 43);
            }
        }
    }

    #[test]
    fn a_token_is_read_as_it_was_made() {
        let (one, other) = (Secret::random(), Secret::random());
        assert_ne!(one.reveal(), other.reveal());
        assert_eq!(Secret::parse(one.reveal()).unwrap().hash(), one.hash());
    }
}
