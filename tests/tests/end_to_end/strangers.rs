//! Strangers on the local network: without a certificate, with one from elsewhere, under another's name, over another
//! protocol, with a join secret that is worth nothing any more, or let in and after more than their own.

use std::fs;
use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use furrow_schema::id::Credential;
use furrow_schema::job::{RunRecord, Timings};
use furrow_schema::join::JoinSecret;
use furrow_schema::protocol::{
    Call, HeldJob, KEY_PREFIX, LeasedJob, Leases, Method, Recorded, Refusal, Renew, Renewed, Reply, Report, RunEnd,
    RunReport, Welcome,
};
use serde_json::{Value, json};
use tempfile::TempDir;
use zenoh::Wait;

use crate::machine::{
    Machine, ask, base64, connect, connect_with, hello, new_secret, open, refused, secret_in, serve_lan, serve_lan_at,
};
use crate::plan::{directory, path, plan};
use crate::process;
use crate::server::Server;

async fn lan(directory: &TempDir) -> (Server, String) {
    serve_lan(&path(directory, "served.db")).await
}

fn place(directory: &TempDir, name: &str) -> std::path::PathBuf {
    directory.path().join(name)
}

fn is_enrolment(refusal: &Refusal, word: &str) {
    assert!(matches!(refusal, Refusal::Enrolment { detail } if detail.contains(word)), "{refusal}");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_certificate_there_is_no_connection() {
    let directory = directory();
    let (server, secret) = lan(&directory).await;
    let secret = secret_in(&secret);
    let own = (secret.certificate_pem.as_str(), secret.key_pem.as_str());
    connect(&server.endpoint, &secret.authority_pem, Some(own)).await.expect("with the secret's certificate there is");
    connect(&server.endpoint, &secret.authority_pem, None).await.expect_err("without any there is none");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_certificate_from_elsewhere_lets_nobody_in() {
    let directory = directory();
    let (server, secret) = lan(&directory).await;
    let (_elsewhere, foreign) = serve_lan(&path(&directory, "elsewhere.db")).await;
    let (secret, foreign) = (secret_in(&secret), secret_in(&foreign));
    let stranger = (foreign.certificate_pem.as_str(), foreign.key_pem.as_str());
    connect(&server.endpoint, &secret.authority_pem, Some(stranger)).await.expect_err("it is another authority's");
    assert_eq!(server.json("/v1/workers").await["items"], json!([]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_does_not_go_to_a_coordinator_of_another_authority() {
    let directory = directory();
    let (mut server, secret) = lan(&directory).await;
    let machine = Machine::enrol(&secret_in(&secret), &place(&directory, "spool")).await;
    server.process.child.kill().await.unwrap();
    let (impostor, _) = serve_lan_at(&path(&directory, "impostor.db"), &server.endpoint).await;
    assert_eq!(impostor.endpoint, server.endpoint);
    let own = (machine.enrolment.certificate_pem.as_str(), machine.key_pem.as_str());
    connect(&server.endpoint, &machine.enrolment.authority_pem, Some(own))
        .await
        .expect_err("it is not its coordinator");
    assert_eq!(
        machine.ask::<Leases>(Method::Claim, &machine.claim(1)).await,
        None,
        "nor is the old connection taken up"
    );
    assert_eq!(impostor.json("/v1/workers").await["items"], json!([]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_workers_certificate_makes_no_coordinator() {
    let directory = directory();
    let (_server, secret) = lan(&directory).await;
    let machine = Machine::enrol(&secret_in(&secret), &place(&directory, "spool")).await;
    let free = std::net::UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let endpoint = format!("quic/{free}");
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("listen/endpoints", json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
        ("transport/link/tls/root_ca_certificate_base64", json!(base64(&machine.enrolment.authority_pem))),
        ("transport/link/tls/listen_certificate_base64", json!(base64(&machine.enrolment.certificate_pem))),
        ("transport/link/tls/listen_private_key_base64", json!(base64(&machine.key_pem))),
        ("transport/link/tls/enable_mtls", json!(true)),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    let _impostor = zenoh::open(config).await.unwrap();
    let own = (machine.enrolment.certificate_pem.as_str(), machine.key_pem.as_str());
    let authority = &machine.enrolment.authority_pem;
    connect(&endpoint, authority, Some(own)).await.expect_err("its name is not the endpoint's");
    let any_name = vec![("transport/link/tls/verify_name_on_connect", json!(false))];
    connect_with(&endpoint, authority, Some(own), any_name).await.expect_err("nor is it for a server under any name");
}

#[tokio::test(flavor = "multi_thread")]
async fn another_workers_name_is_worth_nothing_without_its_credential() {
    let directory = directory();
    let (server, secret) = lan(&directory).await;
    let secret = secret_in(&secret);
    let honest = Machine::enrol(&secret, &place(&directory, "honest")).await;
    let thief = Machine::enrol(&secret, &place(&directory, "thief")).await;
    let mut claim = thief.claim(1);
    claim.worker = honest.identity.worker.clone();
    assert_eq!(thief.ask::<Leases>(Method::Claim, &claim).await, Some(Reply::Refused(Refusal::BadCredential)));
    let greeting = Call { worker: honest.identity.worker.clone(), ..thief.call(hello()) };
    assert_eq!(thief.ask::<Welcome>(Method::Hello, &greeting).await, Some(Reply::Refused(Refusal::BadCredential)));

    // It enrols under the other's name, as far as it knows it.
    let posing = place(&directory, "posing");
    fs::create_dir_all(posing.join("1")).unwrap();
    let identity = json!({"worker": honest.identity.worker, "credential": Credential::random()});
    fs::write(posing.join("1").join("identity.json"), identity.to_string()).unwrap();
    is_enrolment(&refused(&secret, &posing).await, "another worker goes by this name");
    let answer = honest.ask::<Leases>(Method::Claim, &honest.claim(1)).await;
    assert!(matches!(answer, Some(Reply::Ok(_))), "the honest one is still in: {answer:?}");
    assert_eq!(server.json("/v1/workers").await["items"].as_array().unwrap().len(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hello_lets_nobody_in_and_a_join_secrets_certificate_opens_one_question() {
    let directory = directory();
    let (server, secret) = lan(&directory).await;
    let secret = secret_in(&secret);
    let machine = Machine::enrol(&secret, &place(&directory, "spool")).await;
    let stranger = Call { worker: furrow_schema::id::WorkerId::random(), ..machine.call(hello()) };
    assert_eq!(machine.ask::<Welcome>(Method::Hello, &stranger).await, Some(Reply::Refused(Refusal::NotEnrolled)));

    let own = (secret.certificate_pem.as_str(), secret.key_pem.as_str());
    let newcomer = connect(&server.endpoint, &secret.authority_pem, Some(own)).await.unwrap();
    for method in Method::OF_WORK {
        let question = json!(machine.claim(1));
        assert_eq!(ask::<Value>(&newcomer, &machine.key(method), &question).await, None, "{method:?}");
    }
    let answer: Option<Reply<Value>> = ask(&newcomer, &machine.key(Method::Enrol), &json!({})).await;
    assert!(matches!(answer, Some(Reply::Refused(Refusal::Malformed { .. }))), "{answer:?}");
}

/// The ports on which a process listens over TCP.
fn tcp_ports(pid: u32) -> Vec<u16> {
    let sockets: Vec<String> = fs::read_dir(format!("/proc/{pid}/fd"))
        .unwrap()
        .filter_map(|fd| fs::read_link(fd.unwrap().path()).ok()?.to_str().map(str::to_owned))
        .collect();
    let lines = ["tcp", "tcp6"].map(|table| fs::read_to_string(format!("/proc/{pid}/net/{table}")).unwrap_or_default());
    let listening = lines.iter().flat_map(|table| table.lines().skip(1)).filter_map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let is_own = sockets.contains(&format!("socket:[{}]", words[9]));
        (words[3] == "0A" && is_own).then(|| u16::from_str_radix(words[1].rsplit(':').next().unwrap(), 16).unwrap())
    });
    listening.collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_answered_over_plain_tcp() {
    let directory = directory();
    let (server, _) = lan(&directory).await;
    let address = server.endpoint.strip_prefix("quic/").unwrap();
    assert!(TcpStream::connect(address).is_err(), "nobody listens there");
    open(&format!("tcp/{address}"), Vec::new()).await.expect_err("nor does Zenoh find anybody");
    let http: u16 = server.url.rsplit(':').next().unwrap().parse().unwrap();
    assert_eq!(tcp_ports(server.process.child.id().unwrap()), [http], "HTTP is all that there is over TCP");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_join_secret_that_is_used_up_or_over_lets_nobody_in() {
    let directory = directory();
    let (server, _) = lan(&directory).await;
    let secret = new_secret(&server, &["--uses", "1", "--valid", "2s"]).await;
    let first = Machine::enrol(&secret, &place(&directory, "first")).await;
    let second = place(&directory, "second");
    is_enrolment(&refused(&secret, &second).await, "used up");
    let over = async {
        loop {
            match refused(&secret, &second).await {
                Refusal::Enrolment { detail } if detail.contains("used up") => {}
                other => return other,
            }
        }
    };
    is_enrolment(&tokio::time::timeout(Duration::from_secs(20), over).await.unwrap(), "expired");
    let answer = first.ask::<Leases>(Method::Claim, &first.claim(1)).await;
    assert!(matches!(answer, Some(Reply::Ok(_))), "who came in with it stays in: {answer:?}");

    let text = second.join("secret");
    fs::write(&text, secret.to_string()).unwrap();
    let args = ["work", "--join", text.to_str().unwrap(), "--spool", second.to_str().unwrap()];
    let told = process::finished(&args).await;
    assert!(told.code == Some(2) && told.stderr.contains("expired"), "{told:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_join_secret_on_the_command_line_or_none_at_all_is_refused() {
    let directory = directory();
    let (server, secret) = lan(&directory).await;
    let typed = fs::read_to_string(&secret).unwrap();
    let spool = path(&directory, "spool");
    let refused = process::finished(&["work", "--join", typed.trim(), "--spool", &spool]).await;
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert!(refused.stderr.contains("--join") && !refused.stderr.contains(typed.trim()), "{refused:?}");
    let without = process::finished(&["work", "--connect", &server.endpoint, "--spool", &spool]).await;
    assert!(without.code == Some(2) && without.stderr.contains("--join"), "{without:?}");
    let torn = path(&directory, "torn");
    fs::write(&torn, &typed[..typed.len() / 2]).unwrap();
    let refused = process::finished(&["work", "--join", &torn, "--spool", &spool]).await;
    assert!(refused.code == Some(2) && refused.stderr.contains("damaged"), "{refused:?}");
    assert_eq!(server.json("/v1/workers").await["items"], json!([]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_worker_is_refused_every_question() {
    let directory = directory();
    let (server, secret) = lan(&directory).await;
    let secret = secret_in(&secret);
    let machine = Machine::enrol(&secret, &place(&directory, "spool")).await;
    let worker = format!("/v1/workers/{}", machine.identity.worker);
    server.change(reqwest::Method::DELETE, &worker, None).await;
    for (method, body) in [
        (Method::Hello, json!(machine.call(hello()))),
        (Method::Claim, json!(machine.claim(1))),
        (Method::Result, json!(machine.call(report(&[])))),
        (Method::Renew, json!(machine.call(Renew { held: Vec::new() }))),
        (Method::Refresh, json!(machine.call(json!({})))),
    ] {
        let answer: Option<Reply<Value>> = machine.ask(method, &body).await;
        assert_eq!(answer, Some(Reply::Refused(Refusal::Revoked)), "{method:?}");
    }
}

fn report(runs: &[(i64, u32, RunEnd)]) -> Report {
    let run = |(job, attempt, ended): &(i64, u32, RunEnd)| RunReport {
        job: furrow_schema::id::JobId(*job),
        attempt: *attempt,
        ended: ended.clone(),
    };
    Report { engine: furrow_api::engine(), runs: runs.iter().map(run).collect() }
}

fn done(digest: u8) -> RunEnd {
    RunEnd::Done(RunRecord {
        digest: furrow_schema::id::Digest([digest; 32]),
        outcome: "success".to_owned(),
        metrics: std::collections::BTreeMap::from([("success".to_owned(), 1.0)]),
        timings: Timings::default(),
        trajectory: None,
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn nobody_reports_renews_or_hands_back_what_another_holds() {
    let directory = directory();
    let (server, secret) = lan(&directory).await;
    let secret = secret_in(&secret);
    let holder = Machine::enrol(&secret, &place(&directory, "holder")).await;
    let other = Machine::enrol(&secret, &place(&directory, "other")).await;
    server.submit(&json!({"plan": plan(1.0, 1)})).await;
    let leases: Reply<Leases> = holder.ask(Method::Claim, &holder.claim(1)).await.unwrap();
    let LeasedJob { job, attempt, .. } = leases.into_result().unwrap().jobs.remove(0);

    let panicked = RunEnd::Panicked { message: "of another".to_owned() };
    for ended in [done(1), RunEnd::HandedBack, panicked] {
        let answer: Reply<Recorded> =
            other.ask(Method::Result, &other.call(report(&[(job.0, attempt, ended)]))).await.unwrap();
        assert_eq!(answer, Reply::Ok(Recorded { recorded: vec![], ignored: vec![job] }));
    }
    let renew = |machine: &Machine| machine.call(Renew { held: vec![HeldJob { job, attempt, running: true }] });
    let lost = Some(Reply::Ok(Renewed { lost: vec![job] }));
    assert_eq!(other.ask(Method::Renew, &renew(&other)).await, lost);
    assert_eq!(holder.ask(Method::Renew, &renew(&holder)).await, Some(Reply::Ok(Renewed { lost: vec![] })));
    let recorded: Reply<Recorded> =
        holder.ask(Method::Result, &holder.call(report(&[(job.0, attempt, done(2))]))).await.unwrap();
    assert_eq!(recorded, Reply::Ok(Recorded { recorded: vec![job], ignored: vec![] }));
    let stored = server.json(&format!("/v1/jobs/{job}")).await;
    assert_eq!((&stored["digest"], &stored["incidents"]), (&json!("02".repeat(32)), &json!([])));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_hears_and_answers_nothing_that_is_not_for_it() {
    let directory = directory();
    let (server, secret) = lan(&directory).await;
    a_spy_learns_nothing(&directory, &server, &secret_in(&secret)).await;
}

/// Of two workers that enrol with `secret`, one tries to be the coordinator, and to hear what is said to it and of others.
pub(crate) async fn a_spy_learns_nothing(directory: &TempDir, server: &Server, secret: &JoinSecret) {
    let (honest, spy) = (
        Machine::enrol(secret, &place(directory, "honest")).await,
        Machine::enrol(secret, &place(directory, "spy")).await,
    );
    let (heard, hears) = std::sync::mpsc::channel();
    let own = format!("{KEY_PREFIX}/{}/{}", secret.namespace, secret.coordinator);
    let keys =
        [format!("{own}/claim"), format!("{own}/*"), format!("{own}/**"), "furrow/**".to_owned(), "**".to_owned()];
    let mut declared = Vec::new();
    for key in &keys {
        let heard = heard.clone();
        let answer = move |query: zenoh::query::Query| {
            let _ = heard.send(query.key_expr().to_string());
            let _ = query.reply(query.key_expr(), "trust me").wait();
        };
        declared.push(spy.session.declare_queryable(key.clone()).complete(true).callback(answer).await.unwrap());
    }
    let mut watches = Vec::new();
    for key in &keys {
        let heard = heard.clone();
        let note = move |sample: zenoh::sample::Sample| _ = heard.send(sample.key_expr().to_string());
        watches.push(spy.session.declare_subscriber(key.clone()).callback(note.clone()).await.unwrap());
        let alive = spy.session.liveliness().declare_subscriber(key.clone()).history(true).callback(note);
        watches.push(alive.await.unwrap());
    }
    all_has_arrived(&spy).await;

    let token = format!("{own}/worker/{}", honest.identity.worker);
    let _life = honest.session.liveliness().declare_token(token).await.unwrap();
    server.submit(&json!({"plan": plan(1.0, 1)})).await;
    for _ in 0..3 {
        let answer = honest.ask::<Leases>(Method::Claim, &honest.claim(1)).await;
        assert!(matches!(answer, Some(Reply::Ok(_))), "{answer:?}");
    }
    honest.session.put(format!("{own}/claim"), "to everybody").await.unwrap();
    all_has_arrived(&honest).await;
    all_has_arrived(&spy).await;
    let of_others: Vec<_> = hears.try_iter().filter(|key| *key != spy.key(Method::Renew)).collect();
    assert_eq!(of_others, [""; 0], "the spy heard something");

    drop((declared, watches));
    let tokens = spy.session.liveliness().get(format!("{own}/worker/*")).await.unwrap();
    assert!(tokens.recv_async().await.is_err(), "it does not learn who else works");
    assert!(ask::<Value>(&spy.session, "furrow/**", &json!({})).await.is_none(), "patterns reach nobody");
}

/// Waits until the coordinator has answered what this machine asks now. A connection keeps the order: what either side
/// sent before has arrived, too.
async fn all_has_arrived(machine: &Machine) {
    let answered = async { while !is_answered(machine).await {} };
    tokio::time::timeout(Duration::from_secs(20), answered).await.expect("the coordinator answers");
}

/// Whether the coordinator answered. It does not where a new connection has not learnt of it yet.
async fn is_answered(machine: &Machine) -> bool {
    let renew = serde_json::to_vec(&machine.call(Renew { held: Vec::new() })).unwrap();
    let all = machine.session.get(machine.key(Method::Renew)).payload(renew).target(zenoh::query::QueryTarget::All);
    let replies = all.consolidation(zenoh::query::ConsolidationMode::None).await.unwrap();
    while let Ok(reply) = replies.recv_async().await {
        let answer = reply.result().map(|sample| sample.payload().to_bytes().into_owned());
        if let Ok(Ok(Reply::Ok(Renewed { .. }))) = answer.map(|answer| serde_json::from_slice(&answer)) {
            return true;
        }
    }
    false
}

#[tokio::test(flavor = "multi_thread")]
async fn an_authority_that_others_may_read_is_not_used() {
    use std::os::unix::fs::PermissionsExt;
    let directory = directory();
    let db = path(&directory, "served.db");
    let (server, _) = serve_lan(&db).await;
    drop(server);
    let file = format!("{db}.lan/authority.pem");
    fs::set_permissions(Path::new(&file), fs::Permissions::from_mode(0o644)).unwrap();
    let refused = process::finished(&["serve", "--db", &db, "--http", "127.0.0.1:0", "--lan"]).await;
    assert!(refused.code == Some(2) && refused.stderr.contains(&file), "{refused:?}");
}
