//! A sweep on a local network, over QUIC: joining, coming back, leaving.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use furrow_schema::protocol::Reply;
use furrow_worker::lan::{Enrolment, keep_fresh};
use furrow_worker::{ConnectConfig, Link, ZenohLink};
use serde_json::{Value, json};

use crate::machine::{Machine, secret_in, serve_lan, serve_lan_at};
use crate::plan::{directory, file, path, plan};
use crate::process::{self, Running};
use crate::server::Server;

/// A worker leaves this soon.
const LEAVES_WITHIN: Duration = Duration::from_secs(10);

/// A worker process that joins with this file, or is in already.
pub(crate) fn worker(server: &Server, secret: Option<&str>) -> Running {
    let mut args = vec!["work", "--threads", "1", "--spool", &server.spool];
    args.extend(secret.iter().flat_map(|file| ["--join", file]));
    Running::start(&args)
}

fn live(workers: &Value) -> Vec<String> {
    let live = workers["items"].as_array().unwrap().iter().filter(|worker| worker["state"] == "live");
    live.map(|worker| worker["id"].as_str().unwrap().to_owned()).collect()
}

#[tokio::test]
async fn a_sweep_over_the_network_gives_the_bits_of_one_process_and_outlives_both_sides() {
    let directory = directory();
    let plan_of_it = plan(20.0, 3);
    let (plan_file, undisturbed) = (file(&directory, "plan.json", &plan_of_it), path(&directory, "undisturbed.db"));
    process::json(&["run", &plan_file, "--db", &undisturbed, "--threads", "2", "--json"]).await;
    let digests = Server::start(&undisturbed, 0).await.digests(1).await;

    let db = path(&directory, "served.db");
    let (mut server, secret) = serve_lan(&db).await;
    let mut workers = [worker(&server, Some(&secret)), worker(&server, Some(&secret))];
    server.until("/v1/workers", |workers| (live(workers).len() == 2).then_some(())).await;
    let sweep = server.submit(&json!({"plan": plan_of_it})).await;
    server.done(sweep).await;
    assert_eq!(server.digests(sweep).await, digests);
    let listed = server.json("/v1/workers").await;
    for worker in listed["items"].as_array().unwrap() {
        assert_eq!(worker["enrolled_by"], "join-secret", "{worker}");
        assert!(worker["certificate_until_ms"].is_i64() && worker["revoked_ms"].is_null(), "{worker}");
    }
    let results = listed["items"].as_array().unwrap().iter().map(|worker| worker["results"].as_u64().unwrap());
    assert_eq!(results.sum::<u64>(), 12);

    for worker in &mut workers {
        assert_eq!(worker.terminate(LEAVES_WITHIN).await.code(), Some(0));
    }
    std::fs::remove_file(&secret).unwrap();
    let _workers = [worker(&server, None), worker(&server, None)];
    let more = server.submit(&json!({"plan": plan(20.0, 4)})).await;
    server.done(more).await;
    assert_eq!(live(&server.json("/v1/workers").await).len(), 2, "they are the same two");

    server.process.child.kill().await.unwrap();
    let (server, _) = serve_lan_at(&db, &server.endpoint).await;
    let last = server.submit(&json!({"plan": plan(20.0, 5)})).await;
    let done = server.done(last).await;
    assert_eq!((done["done"].as_u64(), done["failed"].as_u64()), (Some(20), Some(0)));
    assert_eq!(server.json("/v1/workers").await["items"].as_array().unwrap().len(), 2);
    assert!(!Path::new(&secret).exists(), "a later start draws no secret by itself");
}

#[tokio::test]
async fn a_revoked_worker_ends_says_why_and_does_not_come_back() {
    let directory = directory();
    let (server, secret) = serve_lan(&path(&directory, "served.db")).await;
    let mut leaving = worker(&server, Some(&secret));
    let sweep = server.submit(&json!({"plan": plan(60.0, 6)})).await;
    let holds = |workers: &Value| {
        let worker = &workers["items"][0];
        (worker["leased"].as_u64()? > 0).then(|| worker["id"].as_str().unwrap().to_owned())
    };
    let id = server.until("/v1/workers", holds).await;
    let revoked = process::json(&["workers", "revoke", &id, "--url", &server.url, "--json"]).await;
    assert_eq!((&revoked["state"], &revoked["leased"]), (&json!("revoked"), &json!(0)));
    assert_eq!(leaving.ended().await, Some(2));
    assert!(leaving.log().contains("this worker was revoked"), "{}", leaving.log());

    let spool = ["--spool", server.spool.as_str()];
    for joining in [&["work", "--join", &secret][..], &["work"]] {
        let again = process::finished(&[joining, &spool[..]].concat()).await;
        assert!(again.code == Some(2) && again.stderr.contains("revoked"), "{again:?}");
    }
    let elsewhere = path(&directory, "another-spool");
    let _fresh = Running::start(&["work", "--join", &secret, "--threads", "1", "--spool", &elsewhere]);
    assert_eq!(server.done(sweep).await["failed"], 0);
    let listed = process::finished(&["workers", "--url", &server.url]).await;
    assert!(listed.stdout.contains("revoked") && listed.stdout.contains("live"), "{listed:?}");
}

#[tokio::test]
async fn a_worker_whose_time_is_over_ends_and_may_be_let_in_again() {
    let directory = directory();
    let (server, secret) = serve_lan(&path(&directory, "served.db")).await;
    let mut first = worker(&server, Some(&secret));
    let id = server.until("/v1/workers", |workers| live(workers).pop()).await;
    let expire = |time| ["workers", "expire", &id, "--url", &server.url, "--json", time].map(str::to_owned);
    server.change(reqwest::Method::PATCH, &format!("/v1/workers/{id}"), Some(&json!({"until_ms": 1}))).await;
    assert_eq!(first.ended().await, Some(2));
    assert!(first.log().contains("for a time that is over"), "{}", first.log());

    let never = expire("--never");
    let back = process::json(&never.each_ref().map(String::as_str)).await;
    assert_eq!(back["until_ms"], Value::Null);
    let _again = worker(&server, None);
    let sweep = server.submit(&json!({"plan": plan(2.0, 1)})).await;
    assert_eq!(server.done(sweep).await["done"], 4);
}

/// A worker's way to its coordinator, as the worker of `machine`'s folder has it.
async fn link(machine: &Machine, enrolment: &Enrolment) -> ZenohLink {
    ZenohLink::connect(ConnectConfig::enrolled(enrolment, &machine.key_pem)).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_whose_first_address_is_dead_gets_in_by_the_next() {
    let directory = directory();
    let (_server, secret) = serve_lan(&path(&directory, "served.db")).await;
    let mut secret = secret_in(&secret);
    secret.endpoints.insert(0, "quic/127.0.0.1:1".to_owned());
    let spool = crate::machine::enrol(&secret, directory.path()).await.unwrap();
    let (enrolment, key_pem) = {
        let spool = spool.lock().unwrap();
        (spool.enrolment().unwrap().clone(), spool.key_pem().unwrap())
    };
    assert_eq!(enrolment.endpoints.len(), 2);
    let link = ZenohLink::connect(ConnectConfig::enrolled(&enrolment, &key_pem)).await.unwrap();
    assert_eq!(link.coordinator(), secret.coordinator);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_certificate_that_ends_is_replaced_while_the_worker_works() {
    let directory = directory();
    let (_server, secret) = serve_lan(&path(&directory, "served.db")).await;
    let machine = Machine::enrol(&secret_in(&secret), directory.path()).await;
    let ending = Enrolment { certificate_ms: [0, 1], ..machine.enrolment.clone() };
    let link = link(&machine, &ending).await;
    machine.spool.lock().unwrap().keep_enrolment(ending.clone()).unwrap();
    let replaced = async {
        let mut looks = tokio::time::interval(Duration::from_millis(5));
        loop {
            looks.tick().await;
            let now = machine.spool.lock().unwrap().enrolment().unwrap().clone();
            if now.certificate_ms != ending.certificate_ms {
                return now;
            }
        }
    };
    let fresh = tokio::select! {
        fresh = replaced => fresh,
        () = tokio::time::sleep(Duration::from_secs(60)) => panic!("it is not replaced"),
        never = keep_fresh(&link, &machine.spool) => match never {},
    };
    assert_ne!(fresh.certificate_pem, ending.certificate_pem);
    assert!(fresh.certificate_ms[1] >= machine.enrolment.certificate_ms[1], "{fresh:?}");
    assert_eq!(fresh.credential, ending.credential);
    for link in [link, self::link(&machine, &fresh).await] {
        let answer = link.claim(machine.claim(1)).await;
        assert!(matches!(answer, Ok(Reply::Ok(_))), "{answer:?}");
    }
}

#[tokio::test]
async fn without_lan_nothing_but_this_machine_is_served_and_with_it_nothing_but_quic() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let serve = |more: &[&'static str]| [&["serve", "--db", "DB", "--http", "127.0.0.1:0"], more].concat();
    for (more, words) in [
        (&["--zenoh", "tcp/0.0.0.0:0"][..], ["--zenoh", "--lan"]),
        (&["--zenoh", "quic/127.0.0.1:0"], ["--zenoh", "--lan"]),
        (&["--lan", "--zenoh", "tcp/127.0.0.1:0"], ["--zenoh", "quic/HOST:PORT"]),
        (&["--lan", "--zenoh", "tls/127.0.0.1:0"], ["--zenoh", "quic/HOST:PORT"]),
        (&["--lan", "--zenoh", "quic/127.0.0.1:0", "--lan-name", "sch\u{f6}n"], ["--zenoh", "sch\u{f6}n"]),
        (&["--lan-name", "barn"], ["--lan", "required"]),
    ] {
        let args: Vec<_> = serve(more).into_iter().map(|arg| if arg == "DB" { db.as_str() } else { arg }).collect();
        let refused = process::finished(&args).await;
        assert_eq!(refused.code, Some(2), "{more:?}: {refused:?}");
        assert!(words.iter().all(|word| refused.stderr.contains(word)), "{more:?}: {refused:?}");
    }
    let server = Server::start(&path(&directory, "local.db"), 0).await;
    let none = process::finished(&["join", "--url", &server.url]).await;
    assert!(none.code == Some(2) && none.stderr.contains("furrow serve --lan"), "{none:?}");
}

/// Everything in `folder` that others than its owner can read.
fn open_to_others(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        if entry.metadata().unwrap().permissions().mode() & 0o077 != 0 {
            found.push(entry.path().display().to_string());
        } else if entry.file_type().unwrap().is_dir() {
            found.extend(open_to_others(&entry.path()));
        }
    }
    found
}

/// The lines of a text in the middle of a key or certificate.
fn inner_lines(pem: &str) -> impl Iterator<Item = &str> {
    pem.lines().filter(|line| !line.starts_with("-----"))
}

#[tokio::test]
async fn no_secret_is_logged_or_left_open_though_everything_is_logged() {
    let directory = directory();
    let (db, spool) = (path(&directory, "served.db"), path(&directory, "spool"));
    let trace = [("FURROW_LOG", "trace"), ("RUST_LOG", "trace")];
    let server = Server::start_with(&db, &["--lan", "--zenoh", "quic/127.0.0.1:0"], &trace).await;
    assert!(server.said[0].contains("not shown again"), "{:?}", server.said);
    let secret = server.said[1].clone();
    let environment = [&trace[..], &[("FURROW_JOIN", secret.as_str())]].concat();
    let mut worker = Running::start_in(&["work", "--threads", "1", "--spool", &spool], &environment);
    let sweep = server.submit(&json!({"plan": plan(2.0, 1)})).await;
    server.done(sweep).await;
    worker.terminate(LEAVES_WITHIN).await;
    let logs = [server.process.log(), worker.log()];
    assert!(logs.iter().all(|log| log.contains("TRACE") && log.contains("quic/127.0.0.1")), "all is logged");

    let read: furrow_schema::join::JoinSecret = secret.parse().unwrap();
    let own = Path::new(&spool).join("1");
    let text = |name: &str| std::fs::read_to_string(own.join(name)).unwrap();
    let (enrolment, identity): (Value, Value) =
        (serde_json::from_str(&text("enrolment.json")).unwrap(), serde_json::from_str(&text("identity.json")).unwrap());
    let authority = std::fs::read_to_string(format!("{db}.lan/authority.pem")).unwrap();
    let key = text("key.pem");
    let mut secrets =
        vec![secret.as_str(), enrolment["credential"].as_str().unwrap(), identity["credential"].as_str().unwrap()];
    secrets.extend(inner_lines(&read.key_pem).chain(inner_lines(&key)));
    secrets.extend(inner_lines(authority.split("-----END").next().unwrap()));
    let encoded = crate::machine::base64(&key);
    secrets.push(&encoded);
    for secret in secrets {
        assert!(secret.len() >= 20, "{secret}");
        for log in &logs {
            let line = log.lines().find(|line| line.contains(secret));
            assert_eq!(line, None, "a secret is logged");
        }
    }
    assert_eq!(open_to_others(Path::new(&spool)), [""; 0]);
    assert_eq!(open_to_others(Path::new(&format!("{db}.lan"))), [""; 0]);
}
