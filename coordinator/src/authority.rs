//! The private authority of a coordinator on a local network: it signs the certificates by which coordinator,
//! workers and routers between them know each other.
//!
//! Its key is made once and kept beside the database, so that workers which enrolled come back after a restart. The
//! coordinator's own key lives no longer than its process. Every certificate says what its holder is, in the common
//! name, which Zenoh's access control reads, and in the extended usage: a worker's cannot be a coordinator's.
//! A router's can be both, towards either side.

use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use furrow_schema::id::{Credential, PublicKey, WorkerId};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose,
    PKCS_ED25519, PublicKeyData, SignatureAlgorithm, date_time_ymd,
};

/// The common name of a certificate that came with a join secret.
pub const JOIN: &str = "furrow-join";
/// The common name of a worker's certificate.
pub const WORKER: &str = "furrow-worker";
/// The common name of the certificate of a router between sites.
pub const ROUTER: &str = "furrow-router";
const COORDINATOR: &str = "furrow-coordinator";
const AUTHORITY: &str = "furrow authority";

/// Key and certificate, one behind the other.
const FILE: &str = "authority.pem";
/// Only its owner looks into the folder, and reads what is in it.
const FOLDER_MODE: u32 = 0o700;
const FILE_MODE: u32 = 0o600;
const OTHERS: u32 = 0o077;

const DAY_MS: i64 = 24 * 60 * 60 * 1_000;
/// The authority's certificate, and the coordinator's, hold for so long.
const AUTHORITY_DAYS: i64 = 20 * 365;
/// Clocks may differ by this much.
const SLACK_MS: i64 = DAY_MS;

/// Signs certificates.
pub struct Authority {
    key: KeyPair,
    certificate_pem: String,
}

/// A certificate with its private key, both as PEM.
#[derive(Clone, PartialEq, Eq)]
pub struct Signed {
    /// What the authority signed (PEM).
    pub certificate_pem: String,
    /// The private key that belongs to it (PEM).
    pub key_pem: String,
    pub(crate) public_key: PublicKey,
}

impl fmt::Debug for Signed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Signed(..)")
    }
}

/// Why there is no authority. The caller names the folder to the user and gives up.
#[derive(Debug, thiserror::Error)]
pub enum AuthorityError {
    /// The folder or its file cannot be made, read or written.
    #[error("the authority in `{}` cannot be used: {reason}", folder.display())]
    Folder {
        /// Where it is, or should be.
        folder: PathBuf,
        /// What stands in the way.
        reason: String,
    },
    /// Others than the owner may read the key. The user takes that right away, or removes the folder: then all workers
    /// have to join again.
    #[error("`{}` can be read by others: `chmod 600` it", file.display())]
    Open {
        /// The file with the key.
        file: PathBuf,
    },
}

impl Authority {
    /// The authority in `folder`, made if there is none.
    ///
    /// # Errors
    /// See [`AuthorityError`].
    pub fn open(folder: &Path, now_ms: i64) -> Result<Self, AuthorityError> {
        if let Some(there) = Self::find(folder)? {
            return Ok(there);
        }
        let new = Self::draw(now_ms);
        let made = DirBuilder::new().recursive(true).mode(FOLDER_MODE).create(folder);
        made.and_then(|()| new.keep(folder)).map_err(|error| refused(folder, &error))?;
        Ok(new)
    }

    /// The authority in `folder`, if there is one.
    ///
    /// # Errors
    /// See [`AuthorityError`].
    pub fn find(folder: &Path) -> Result<Option<Self>, AuthorityError> {
        let file = folder.join(FILE);
        let pem = match fs::read_to_string(&file) {
            Ok(pem) => pem,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(refused(folder, &error)),
        };
        let mode = fs::metadata(&file).map_err(|error| refused(folder, &error))?.permissions().mode();
        if mode & OTHERS != 0 {
            return Err(AuthorityError::Open { file });
        }
        Self::from_pem(&pem).map(Some).ok_or_else(|| refused(folder, &format_args!("`{FILE}` is damaged")))
    }

    /// A new one, kept nowhere.
    #[must_use]
    pub fn draw(now_ms: i64) -> Self {
        let key = draw_key();
        let mut params = params(AUTHORITY, now_ms, now_ms + AUTHORITY_DAYS * DAY_MS);
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        let certificate = params.self_signed(&key).expect("a certificate without variable parts can be signed");
        Self { certificate_pem: certificate.pem(), key }
    }

    /// The certificate by which the others know whom it vouches for (PEM).
    #[must_use]
    pub fn certificate_pem(&self) -> &str {
        &self.certificate_pem
    }

    fn from_pem(pem: &str) -> Option<Self> {
        let (key, certificate) = pem.split_at(pem.find("-----BEGIN CERTIFICATE")?);
        let key = KeyPair::from_pkcs8_pem_and_sign_algo(key, &PKCS_ED25519).ok()?;
        Some(Self { key, certificate_pem: certificate.to_owned() })
    }

    /// Writes all of it, or nothing.
    fn keep(&self, folder: &Path) -> io::Result<()> {
        let new = folder.join(format!("{FILE}.new"));
        let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(FILE_MODE).open(&new)?;
        file.write_all(self.key.serialize_pem().as_bytes())?;
        file.write_all(self.certificate_pem.as_bytes())?;
        file.sync_all()?;
        fs::rename(new, folder.join(FILE))?;
        File::open(folder)?.sync_all()
    }

    /// A fresh key and certificate for the coordinator under `names`: addresses, or names of hosts.
    ///
    /// # Errors
    /// The name that is neither.
    pub(crate) fn coordinator(&self, names: &[String], now_ms: i64) -> Result<Signed, String> {
        let of_coordinator = named(params(COORDINATOR, now_ms, now_ms + AUTHORITY_DAYS * DAY_MS), names)?;
        Ok(self.sign_new(&usable(of_coordinator, &[ExtendedKeyUsagePurpose::ServerAuth])))
    }

    /// A fresh key and certificate for a router that workers reach under `names`, and that is let in until `until_ms` \[ms since 1970\].
    ///
    /// # Errors
    /// The name that is neither an address nor the name of a host.
    pub fn router(&self, names: &[String], now_ms: i64, until_ms: i64) -> Result<Signed, String> {
        let both = [ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        Ok(self.sign_new(&usable(named(params(ROUTER, now_ms, until_ms), names)?, &both)))
    }

    /// A fresh key and certificate for a join secret.
    pub(crate) fn join(&self, now_ms: i64, until_ms: i64) -> Signed {
        // One that comes late shall be told why: the coordinator knows better when a secret ends.
        let of_secret = params(JOIN, now_ms, until_ms + DAY_MS);
        self.sign_new(&usable(of_secret, &[ExtendedKeyUsagePurpose::ClientAuth]))
    }

    /// A certificate for a worker's key (PEM).
    pub(crate) fn worker(&self, worker: &WorkerId, key: PublicKey, now_ms: i64, until_ms: i64) -> String {
        let mut of_worker = params(WORKER, now_ms, until_ms);
        of_worker.distinguished_name.push(DnType::OrganizationalUnitName, worker.as_str());
        self.sign(&usable(of_worker, &[ExtendedKeyUsagePurpose::ClientAuth]), &Ed25519(key))
    }

    /// What a worker with this key proves itself with: the same whenever it is asked for.
    pub(crate) fn credential(&self, worker: &WorkerId, key: PublicKey) -> Credential {
        let secret = blake3::derive_key("furrow 2026 credentials of workers", self.key.serialized_der());
        let hash = blake3::keyed_hash(&secret, &[worker.as_str().as_bytes(), &key.0].concat());
        Credential::try_from(hash.to_hex()[..32].to_owned()).expect("they are hexadecimal digits")
    }

    fn sign_new(&self, params: &CertificateParams) -> Signed {
        let key = draw_key();
        let public_key = PublicKey(key.public_key_raw().try_into().expect("Ed25519 keys have 32 bytes"));
        Signed { certificate_pem: self.sign(params, &key), key_pem: key.serialize_pem(), public_key }
    }

    fn sign(&self, of_holder: &CertificateParams, key: &impl PublicKeyData) -> String {
        let issuer = Issuer::new(params(AUTHORITY, 0, 0), &self.key);
        of_holder.signed_by(key, &issuer).expect("checked names and numbers can be signed").pem()
    }
}

impl fmt::Debug for Authority {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Authority(..)")
    }
}

/// Somebody else's public key.
struct Ed25519(PublicKey);

impl PublicKeyData for Ed25519 {
    fn der_bytes(&self) -> &[u8] {
        &self.0.0
    }

    fn algorithm(&self) -> &'static SignatureAlgorithm {
        &PKCS_ED25519
    }
}

fn refused(folder: &Path, reason: &dyn fmt::Display) -> AuthorityError {
    AuthorityError::Folder { folder: folder.to_owned(), reason: reason.to_string() }
}

fn draw_key() -> KeyPair {
    KeyPair::generate_for(&PKCS_ED25519).expect("the operating system gives random numbers")
}

fn params(common_name: &str, from_ms: i64, until_ms: i64) -> CertificateParams {
    let at = |ms: i64| date_time_ymd(1970, 1, 1) + Duration::from_millis(ms.max(0).unsigned_abs());
    let mut params = CertificateParams::default();
    params.not_before = at(from_ms - SLACK_MS);
    params.not_after = at(until_ms);
    // Positive, and another for every certificate.
    params.serial_number = Some((rand::random::<u128>() >> 1).to_be_bytes().to_vec().into());
    params.distinguished_name.remove(DnType::CommonName);
    params.distinguished_name.push(DnType::CommonName, common_name);
    params
}

fn named(mut params: CertificateParams, names: &[String]) -> Result<CertificateParams, String> {
    for name in names {
        let named = CertificateParams::new([name.clone()]).map_err(|_| name.clone())?;
        params.subject_alt_names.extend(named.subject_alt_names);
    }
    Ok(params)
}

fn usable(mut params: CertificateParams, usages: &[ExtendedKeyUsagePurpose]) -> CertificateParams {
    params.is_ca = IsCa::ExplicitNoCa;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = usages.to_vec();
    params.use_authority_key_identifier_extension = true;
    params
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW_MS: i64 = 1_800_000_000_000;

    fn mode(path: &Path) -> u32 {
        path.metadata().unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn an_authority_stays_the_same_and_is_its_owners_alone() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("furrow.db.lan");
        let first = Authority::open(&folder, NOW_MS).unwrap();
        let again = Authority::open(&folder, NOW_MS).unwrap();
        assert_eq!(first.certificate_pem(), again.certificate_pem());
        let (worker, key) = (WorkerId::random(), PublicKey([3; 32]));
        assert_eq!(first.credential(&worker, key), again.credential(&worker, key));
        assert_eq!((mode(&folder), mode(&folder.join(FILE))), (FOLDER_MODE, FILE_MODE));
        let files: Vec<_> = fs::read_dir(&folder).unwrap().map(|file| file.unwrap().file_name()).collect();
        assert_eq!(files, [FILE]);
    }

    #[test]
    fn a_key_that_others_may_read_or_that_is_damaged_is_refused_by_its_file() {
        let place = tempfile::tempdir().unwrap();
        Authority::open(place.path(), NOW_MS).unwrap();
        let file = place.path().join(FILE);
        fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).unwrap();
        let error = Authority::open(place.path(), NOW_MS).unwrap_err();
        assert!(matches!(&error, AuthorityError::Open { .. }), "{error}");
        fs::set_permissions(&file, fs::Permissions::from_mode(FILE_MODE)).unwrap();
        fs::write(&file, "-----BEGIN CERTIFICATE").unwrap();
        let error = Authority::open(place.path(), NOW_MS).unwrap_err().to_string();
        assert!(error.contains(FILE) && error.contains(place.path().to_str().unwrap()), "{error}");
    }

    #[test]
    fn credentials_differ_by_worker_by_key_and_by_authority() {
        let (one, other) = (Authority::draw(NOW_MS), Authority::draw(NOW_MS));
        let (worker, key) = (WorkerId::random(), PublicKey([3; 32]));
        let credential = one.credential(&worker, key);
        assert_ne!(credential, one.credential(&WorkerId::random(), key));
        assert_ne!(credential, one.credential(&worker, PublicKey([4; 32])));
        assert_ne!(credential, other.credential(&worker, key));
    }

    #[test]
    fn what_is_neither_address_nor_name_cannot_be_the_coordinators() {
        let authority = Authority::draw(NOW_MS);
        let names = ["192.0.2.2", "localhost", "barn.example"].map(str::to_owned);
        assert!(authority.coordinator(&names, NOW_MS).is_ok());
        assert_eq!(authority.coordinator(&["schön".to_owned()], NOW_MS).err(), Some("schön".to_owned()));
        assert_eq!(authority.router(&["schön".to_owned()], NOW_MS, NOW_MS).err(), Some("schön".to_owned()));
    }

    #[test]
    fn nothing_is_made_where_an_authority_is_only_looked_for() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("furrow.db.lan");
        assert!(Authority::find(&folder).unwrap().is_none() && !folder.exists());
        let made = Authority::open(&folder, NOW_MS).unwrap();
        assert_eq!(Authority::find(&folder).unwrap().unwrap().certificate_pem(), made.certificate_pem());
    }
}
