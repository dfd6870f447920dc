//! `furrow router`: what lets a Zenoh router stand between a coordinator and workers that cannot reach it.

use std::fs::Permissions;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use furrow_coordinator::{Authority, Clock};

use super::error::CliError;
use super::time::seconds;
use super::{join, lan, output};

/// No certificate lasts longer than about its authority's.
const LONGEST: Duration = Duration::from_secs(20 * 365 * 24 * 60 * 60);

/// Make the certificate by which a Zenoh router passes on what workers of another site say
#[derive(Debug, clap::Args)]
pub(super) struct RouterArgs {
    /// A name or address under which workers reach the router; may be given several times
    #[arg(long = "name", value_name = "HOST", required = true)]
    names: Vec<String>,
    /// How long the router is let in, such as 90d; 20 years at the most
    #[arg(long, value_name = "TIME", value_parser = lifetime, default_value = "365d")]
    expires: Duration,
    /// A new folder for ca.pem, router.pem and router-key.pem, which only its owner reads
    #[arg(long, value_name = "DIR")]
    to: PathBuf,
    /// The database that `furrow serve --lan` serves; the server may be running
    #[arg(long, value_name = "FILE")]
    db: PathBuf,
}

fn lifetime(text: &str) -> Result<Duration, String> {
    let asked = Duration::from_secs(seconds(text)?);
    if asked > LONGEST { Err("at most 7300d".to_owned()) } else { Ok(asked) }
}

/// # Errors
/// Bad input: there is no authority beside the database, a name is none, or the folder is there already. A disk that fails.
pub(super) fn run(args: &RouterArgs) -> Result<(), CliError> {
    let folder = lan::folder_of(&args.db);
    let authority = Authority::find(&folder).map_err(CliError::bad_input("--db"))?.ok_or_else(|| {
        let db = args.db.display();
        CliError::BadInput(format!(
            "--db {db}: no local network was served from it; `furrow serve --lan` makes {}",
            folder.display()
        ))
    })?;
    let now_ms = Clock::system().now_ms();
    let signed = authority.router(&args.names, now_ms, now_ms + args.expires.as_millis() as i64);
    let signed = signed.map_err(|name| {
        CliError::BadInput(format!("--name {name}: it is neither an address nor the name of a host"))
    })?;
    let files = [
        ("ca.pem", authority.certificate_pem()),
        ("router.pem", &signed.certificate_pem),
        ("router-key.pem", &signed.key_pem),
    ];
    write_all(&args.to, &files)?;
    output::line(&format!(
        "{} is for the router alone: whoever has its key reads and says what workers do, and can be the coordinator for them",
        args.to.display()
    ))
}

/// Makes `folder` with these files, or nothing.
fn write_all(folder: &Path, files: &[(&str, &str)]) -> Result<(), CliError> {
    let cannot = || format!("cannot make {}", folder.display());
    if folder.exists() {
        return Err(CliError::BadInput(format!("--to {}: is there already", folder.display())));
    }
    let place = folder.parent().filter(|place| !place.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let beside = tempfile::Builder::new().permissions(Permissions::from_mode(0o700)).tempdir_in(place);
    let beside = beside.map_err(CliError::bad_input(format_args!("--to {}", folder.display())))?;
    for (name, text) in files {
        let mut file = join::new_file("--to", &beside.path().join(name))?;
        file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(CliError::failed(cannot()))?;
    }
    std::fs::rename(beside.path(), folder).map_err(CliError::failed(cannot()))?;
    // It has its name; what is dropped is not there any more.
    let _ = beside.keep();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(db: &Path, to: &Path, names: &[&str]) -> RouterArgs {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        RouterArgs { names, expires: Duration::from_secs(60), to: to.to_owned(), db: db.to_owned() }
    }

    #[test]
    fn what_a_router_needs_is_its_owners_alone_and_is_not_written_over() {
        let place = tempfile::tempdir().unwrap();
        let (db, to) = (place.path().join("x.db"), place.path().join("router"));
        let authority = Authority::open(&lan::folder_of(&db), 0).unwrap();
        run(&args(&db, &to, &["router.example", "192.0.2.7"])).unwrap();
        assert_eq!(std::fs::read_to_string(to.join("ca.pem")).unwrap(), authority.certificate_pem());
        assert!(std::fs::read_to_string(to.join("router-key.pem")).unwrap().contains("PRIVATE KEY"));
        let mode = |path: &Path| path.metadata().unwrap().permissions().mode() & 0o077;
        assert_eq!((mode(&to), mode(&to.join("router-key.pem"))), (0, 0));
        let again = run(&args(&db, &to, &["router.example"])).unwrap_err();
        assert!(again.exit_code() == 2 && again.to_string().contains("--to"), "{again}");
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 2, "nothing else is left there");
    }

    #[test]
    fn what_is_wrong_is_named_and_nothing_is_made() {
        let place = tempfile::tempdir().unwrap();
        let (db, to) = (place.path().join("x.db"), place.path().join("router"));
        let without = run(&args(&db, &to, &["router.example"])).unwrap_err();
        assert!(without.exit_code() == 2 && without.to_string().contains("serve --lan"), "{without}");
        Authority::open(&lan::folder_of(&db), 0).unwrap();
        let unnamed = run(&args(&db, &to, &["sch\u{f6}n"])).unwrap_err();
        assert!(unnamed.exit_code() == 2 && unnamed.to_string().contains("--name sch\u{f6}n"), "{unnamed}");
        let nowhere = run(&args(&db, &place.path().join("a/b"), &["router.example"])).unwrap_err();
        assert!(nowhere.exit_code() == 2 && nowhere.to_string().contains("--to"), "{nowhere}");
        assert!(!to.exists());
        assert!(lifetime("7301d").is_err() && lifetime("7300d").is_ok());
    }
}
