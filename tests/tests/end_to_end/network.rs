//! A coordinator and a worker on two machines: two network namespaces with a cable between them, which is cut.

use std::process::Command;
use std::time::Duration;

use tempfile::TempDir;
use tokio::time::{interval, timeout};

use crate::kills::LOST_OR_DOUBLED;
use crate::plan::{directory, file, path, plan};
use crate::process::{Running, finished_in};
use crate::survival::{BACK_WITHIN_MS, finished_runs, now_ms, number};

/// Skips these tests where namespaces cannot be made; without it they fail there.
const SKIP: &str = "FURROW_TESTS_SKIP_NETNS";
/// The coordinator's address and the worker's.
const ADDRESSES: [&str; 2] = ["10.213.7.1", "10.213.7.2"];
const ENDPOINT: &str = "quic/10.213.7.1:7447";
const HTTP: &str = "127.0.0.1:8080";
const WITHIN: Duration = Duration::from_secs(60);

/// Two namespaces and the cable between them. They go when dropped.
struct Cable {
    ends: [String; 2],
}

fn ip(command: &str) -> Result<(), String> {
    let output = Command::new("ip").args(command.split(' ')).output().map_err(|error| error.to_string())?;
    let error = String::from_utf8_lossy(&output.stderr).trim().to_owned();
    if output.status.success() { Ok(()) } else { Err(format!("ip {command}: {error}")) }
}

impl Cable {
    fn lay() -> Result<Self, String> {
        let id = std::process::id();
        let cable = Self { ends: [format!("furrow-{id}-a"), format!("furrow-{id}-b")] };
        let [a, b] = &cable.ends;
        ip(&format!("netns add {a}"))?;
        ip(&format!("netns add {b}"))?;
        ip(&format!("-n {a} link add cable type veth peer name cable netns {b}"))?;
        for (end, address) in cable.ends.iter().zip(ADDRESSES) {
            ip(&format!("-n {end} addr add {address}/24 dev cable"))?;
            ip(&format!("-n {end} link set lo up"))?;
            ip(&format!("-n {end} link set cable up"))?;
        }
        Ok(cable)
    }

    fn cut(&self) {
        ip(&format!("-n {} link set cable down", self.ends[0])).unwrap();
    }

    fn mend(&self) {
        ip(&format!("-n {} link set cable up", self.ends[0])).unwrap();
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        for end in &self.ends {
            let _ = ip(&format!("netns del {end}"));
        }
    }
}

/// The cable, or none where the user said that there can be none.
fn cable() -> Option<Cable> {
    if std::env::var_os(SKIP).is_some_and(|value| value == "1") {
        eprintln!("{SKIP}=1: a cut cable is not tested");
        return None;
    }
    let cable = Cable::lay();
    Some(cable.unwrap_or_else(|error| {
        panic!("no network namespaces: {error}. Needs root and iproute2; {SKIP}=1 leaves these tests out")
    }))
}

/// Waits until the query gives a number that is good.
async fn until(db: &str, query: &str, good: impl Fn(i64) -> bool) {
    let mut looks = interval(Duration::from_millis(50));
    let search = async {
        while !good(number(db, query).await) {
            looks.tick().await;
        }
    };
    timeout(WITHIN, search).await.unwrap_or_else(|_| panic!("{query} never became good"));
}

/// Serves the network; workers get in with the file `secret`.
async fn serve(cable: &Cable, directory: &TempDir, db: &str, secret: &str) -> Running {
    let listen = ["--http", HTTP, "--lan", "--zenoh", ENDPOINT, "--join-out", secret];
    let args = [&["serve", "--db", db, "--threads", "0", "--verify", "0"], &listen[..]].concat();
    let server = Running::start_in_namespace(&cable.ends[0], &args);
    let plan = file(directory, "plan.json", &plan(60.0, 10));
    let (url, mut looks) = (format!("http://{HTTP}"), interval(Duration::from_millis(100)));
    let submit = async {
        while finished_in(&cable.ends[0], &["submit", &plan, "--url", &url]).await.code != Some(0) {
            looks.tick().await;
        }
    };
    timeout(WITHIN, submit).await.expect("the server takes a sweep");
    server
}

#[tokio::test]
async fn a_worker_goes_on_while_its_cable_is_cut_and_is_back_within_ten_seconds() {
    let Some(cable) = cable() else { return };
    let directory = directory();
    let (db, spool) = (path(&directory, "served.db"), directory.path().join("spool"));
    let secret = path(&directory, "secret");
    let _server = serve(&cable, &directory, &db, &secret).await;
    let args = ["work", "--threads", "1", "--spool", spool.to_str().unwrap(), "--join", &secret];
    let _worker = Running::start_in_namespace(&cable.ends[1], &args);
    until(&db, "select count(*) from result", |done| done >= 2).await;

    cable.cut();
    finished_runs(&spool.join("1").join("runs"), 1).await;
    let before = number(&db, "select count(*) from result").await;
    cable.mend();
    let mended_ms = now_ms();
    until(&db, "select count(*) from result", |done| done > before).await;
    let back_ms = now_ms() - mended_ms;
    eprintln!("a result came {back_ms} ms after the cable was mended");
    assert!(back_ms < BACK_WITHIN_MS);
    until(&db, "select count(*) from job where state <> 'done'", |open| open == 0).await;
    assert_eq!(number(&db, LOST_OR_DOUBLED).await, 0);
    assert_eq!(number(&db, "select count(*) from job where attempt > 1").await, 0, "no lease ran out");
}
