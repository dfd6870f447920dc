//! `furrow` processes: run to their end, or kept going and killed at the latest when the test ends.

use std::fs::{self, File};
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use serde_json::Value;
use tempfile::TempPath;
use tokio::process::{Child, Command};
use tokio::time::timeout;

/// A command that takes longer than this hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// What a finished command left.
#[derive(Debug)]
pub(crate) struct Finished {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// The program, in the directory above this test's own.
fn program() -> PathBuf {
    let test = std::env::current_exe().expect("a process knows its file");
    let profile = test.ancestors().nth(2).expect("tests lie in target/<profile>/deps");
    let program = profile.join(format!("furrow{}", std::env::consts::EXE_SUFFIX));
    let shown = program.display();
    assert!(program.is_file(), "{shown} is missing: run `cargo build` first, in the profile of the tests");
    program
}

/// `furrow` with these arguments, in a network namespace if one is named, without standard input, killed when dropped.
fn furrow(namespace: Option<&str>, args: &[&str]) -> Command {
    let mut command = Command::new(if namespace.is_some() { PathBuf::from("ip") } else { program() });
    if let Some(namespace) = namespace {
        command.args(["netns", "exec", namespace]).arg(program());
    }
    command
        .args(args)
        .env_remove("FURROW_LOG")
        .env_remove("FURROW_JOIN")
        .env_remove("FURROW_TOKEN")
        .env_remove("FURROW_CA")
        .env_remove("RUST_BACKTRACE")
        .stdin(Stdio::null())
        .kill_on_drop(true);
    // The user's own state is left alone.
    command.env("XDG_STATE_HOME", env!("CARGO_TARGET_TMPDIR"));
    command
}

/// A process that goes on. When dropped it is killed; its log is shown if the test failed, and must be free of panics.
pub(crate) struct Running {
    pub(crate) child: Child,
    log: TempPath,
}

impl Running {
    /// Starts `furrow` with these arguments; its standard output is piped.
    pub(crate) fn start(args: &[&str]) -> Self {
        Self::start_in(args, &[])
    }

    /// The same in this environment.
    pub(crate) fn start_in(args: &[&str], environment: &[(&str, &str)]) -> Self {
        let mut command = furrow(None, args);
        command.envs(environment.iter().copied());
        Self::spawn(command)
    }

    /// The same in a network namespace.
    pub(crate) fn start_in_namespace(namespace: &str, args: &[&str]) -> Self {
        Self::spawn(furrow(Some(namespace), args))
    }

    fn spawn(mut command: Command) -> Self {
        let (file, log): (File, TempPath) = tempfile::NamedTempFile::new().unwrap().into_parts();
        let child = command.stdout(Stdio::piped()).stderr(file).spawn().expect("furrow can be started");
        Self { child, log }
    }

    /// Sends the process a signal: `STOP`, `CONT`, ..
    pub(crate) async fn signal(&self, name: &str) {
        let pid = self.child.id().expect("the process still runs").to_string();
        let sent = Command::new("sh").args(["-c", "kill -\"$1\" \"$0\"", &pid, name]).status().await.unwrap();
        assert!(sent.success());
    }

    /// What it has logged so far.
    pub(crate) fn log(&self) -> String {
        fs::read_to_string(&self.log).unwrap()
    }

    /// Waits until the process ends by itself; its exit code.
    pub(crate) async fn ended(&mut self) -> Option<i32> {
        let ended = timeout(PATIENCE, self.child.wait()).await;
        ended.unwrap_or_else(|_| panic!("the process does not end")).unwrap().code()
    }

    /// Waits until the process ends by itself; its exit code and its log.
    pub(crate) async fn ends(&mut self, within: Duration) -> (Option<i32>, String) {
        let ended = timeout(within, self.child.wait()).await;
        let status = ended.unwrap_or_else(|_| panic!("the process goes on for {within:?}")).unwrap();
        (status.code(), fs::read_to_string(&self.log).unwrap_or_default())
    }

    /// Asks the process to end, as a service manager does, and waits until it has.
    pub(crate) async fn terminate(&mut self, within: Duration) -> ExitStatus {
        self.signal("TERM").await;
        let ended = timeout(within, self.child.wait()).await;
        ended.unwrap_or_else(|_| panic!("the process goes on {within:?} after SIGTERM")).unwrap()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let log = fs::read_to_string(&self.log).unwrap_or_default();
        if std::thread::panicking() {
            eprintln!("--- log of a process:\n{log}");
        } else {
            assert!(!log.contains("panicked at"), "{log}");
        }
    }
}

/// Runs `furrow` to its end.
pub(crate) async fn finished(args: &[&str]) -> Finished {
    finished_with(args, &[]).await
}

/// The same, in an environment with these variables, too.
pub(crate) async fn finished_with(args: &[&str], env: &[(&str, &str)]) -> Finished {
    output_of(args, furrow(None, args).envs(env.iter().copied())).await
}

/// The same in a network namespace.
pub(crate) async fn finished_in(namespace: &str, args: &[&str]) -> Finished {
    output_of(args, &mut furrow(Some(namespace), args)).await
}

async fn output_of(args: &[&str], command: &mut Command) -> Finished {
    let output = timeout(PATIENCE, command.output()).await;
    let output = output.unwrap_or_else(|_| panic!("furrow {args:?} hangs")).expect("furrow can be started");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("furrow writes UTF-8");
    let finished = Finished { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) };
    assert!(!finished.stderr.contains("panicked at"), "{finished:?}");
    finished
}

/// Runs `furrow` to its good end, and reads the one JSON object that it prints.
pub(crate) async fn json(args: &[&str]) -> Value {
    let finished = finished(args).await;
    assert_eq!(finished.code, Some(0), "{finished:?}");
    serde_json::from_str(&finished.stdout).unwrap_or_else(|error| panic!("{error}: {finished:?}"))
}
