//! The certificate and key of the service: the user's, or its own made at its first start.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rcgen::{CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, KeyPair, KeyUsagePurpose};
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};

/// A certificate or key cannot be used. The caller gives up and shows the text, which names the file.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct TlsError {
    path: PathBuf,
    reason: String,
}

impl TlsError {
    fn new(path: &Path, reason: impl ToString) -> Self {
        Self { path: path.to_owned(), reason: reason.to_string() }
    }
}

/// Where certificate and key are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Files {
    /// The certificate, and those that lead to an authority behind it (PEM).
    pub cert: PathBuf,
    /// Its private key (PEM), which not everybody on the machine may read.
    pub key: PathBuf,
}

/// What a service shows to its clients.
#[derive(Debug, Clone)]
pub struct Identity {
    /// For the service.
    pub config: Arc<ServerConfig>,
    /// SHA-256 of the certificate, as `openssl x509 -fingerprint -sha256` prints it.
    pub fingerprint: String,
}

/// Reads certificate and key.
///
/// # Errors
/// A file cannot be read, is no PEM, does not fit the other, or everybody may read the key.
pub fn load(files: &Files) -> Result<Identity, TlsError> {
    check_private(&files.key).map_err(|reason| TlsError::new(&files.key, reason))?;
    let wrong = |error: rustls::pki_types::pem::Error| TlsError::new(&files.cert, error);
    let chain: Vec<CertificateDer<'static>> =
        CertificateDer::pem_file_iter(&files.cert).map_err(wrong)?.collect::<Result<_, _>>().map_err(wrong)?;
    let Some(first) = chain.first() else { return Err(TlsError::new(&files.cert, "holds no certificate")) };
    let fingerprint = fingerprint(first);
    let key = PrivateKeyDer::from_pem_file(&files.key).map_err(|error| TlsError::new(&files.key, error))?;
    let builder = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let builder = builder.with_safe_default_protocol_versions().expect("the provider has the usual versions");
    let mut config = builder
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(|error| TlsError::new(&files.cert, error))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(Identity { config: Arc::new(config), fingerprint })
}

/// The service's own certificate beside its database, for the names of this machine and `names`; made if it is not there.
///
/// # Errors
/// It cannot be written, or one of `names` is none.
pub fn own(database: &Path, names: &[String]) -> Result<Files, TlsError> {
    let beside = |end: &str| {
        let mut name = database.as_os_str().to_owned();
        name.push(end);
        PathBuf::from(name)
    };
    let files = Files { cert: beside(".http-cert.pem"), key: beside(".http-key.pem") };
    if !(files.cert.is_file() && files.key.is_file()) {
        make(&files, names)?;
    }
    Ok(files)
}

fn make(files: &Files, names: &[String]) -> Result<(), TlsError> {
    let failed = |error: rcgen::Error| TlsError::new(&files.cert, error);
    let mut all = vec!["localhost".to_owned(), "127.0.0.1".to_owned(), "::1".to_owned()];
    all.extend(hostname::get().ok().and_then(|name| name.into_string().ok()));
    all.extend(names.iter().cloned());
    all.sort_unstable();
    all.dedup();
    tracing::info!(names = all.join(", "), file = %files.cert.display(), "made a certificate");
    let mut params = CertificateParams::new(all).map_err(failed)?;
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, "furrow");
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    let key = KeyPair::generate().map_err(failed)?;
    let cert = params.self_signed(&key).map_err(failed)?;
    write(&files.key, key.serialize_pem().as_bytes()).map_err(|error| TlsError::new(&files.key, error))?;
    write(&files.cert, cert.pem().as_bytes()).map_err(|error| TlsError::new(&files.cert, error))
}

/// Writes a file that only its owner may read, all of it or nothing.
fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}

/// Refuses a file with a secret that everybody on the machine may read.
///
/// # Errors
/// What is wrong with it, in words.
pub fn check_private(path: &Path) -> Result<(), String> {
    let metadata = fs::metadata(path).map_err(|error| error.to_string())?;
    if readable_by_others(&metadata) {
        return Err("everybody on this machine may read it: `chmod o= FILE`, or 600".to_owned());
    }
    Ok(())
}

#[cfg(unix)]
fn readable_by_others(metadata: &fs::Metadata) -> bool {
    use std::os::unix::fs::PermissionsExt;
    metadata.permissions().mode() & 0o007 != 0
}

#[cfg(not(unix))]
fn readable_by_others(_metadata: &fs::Metadata) -> bool {
    false
}

fn fingerprint(certificate: &CertificateDer<'_>) -> String {
    let digest = ::ring::digest::digest(&::ring::digest::SHA256, certificate);
    let pairs: Vec<_> = digest.as_ref().iter().map(|byte| format!("{byte:02X}")).collect();
    pairs.join(":")
}

/// Has this process encrypt with the one implementation that is compiled in, in clients too. May be called again.
pub fn provide() {
    // It fails if somebody did so before, who can only have chosen the same.
    let _ = ring::default_provider().install_default();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_own_certificate_is_made_once_and_its_key_is_private() {
        let folder = tempfile::tempdir().unwrap();
        let database = folder.path().join("furrow.db");
        let files = own(&database, &["furrow.example".to_owned(), "192.0.2.7".to_owned()]).unwrap();
        let first = load(&files).unwrap().fingerprint;
        assert_eq!(load(&own(&database, &[]).unwrap()).unwrap().fingerprint, first);
        assert_eq!((first.len(), first.split(':').count()), (95, 32));
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            assert_eq!(fs::metadata(&files.key).unwrap().permissions().mode() & 0o777, 0o600);
            fs::set_permissions(&files.key, fs::Permissions::from_mode(0o644)).unwrap();
            let error = load(&files).unwrap_err().to_string();
            assert!(error.contains("http-key.pem") && error.contains("everybody"), "{error}");
        }
    }

    #[test]
    fn what_is_no_certificate_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let files = own(&folder.path().join("furrow.db"), &[]).unwrap();
        for bad in ["", "nonsense", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"] {
            fs::write(&files.cert, bad).unwrap();
            let error = load(&files).unwrap_err().to_string();
            assert!(error.contains("http-cert.pem"), "{error}");
        }
        let missing = Files { cert: files.cert, key: folder.path().join("none.pem") };
        assert!(load(&missing).unwrap_err().to_string().contains("none.pem"));
    }
}
