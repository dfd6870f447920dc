//! The files in deploy/: what they say is what the program, its metrics and its routes know.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use furrow_schema::join::JoinSecret;
use furrow_schema::protocol::{Leases, Method, Reply};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::machine::{Machine, ask, connect, secret_in, serve_lan};
use crate::plan::{directory, path, plan};
use crate::process::{Running, finished};
use crate::server::Server;
use crate::strangers::a_spy_learns_nothing;

/// A worker that was killed behind a router: 4 s are usual, and this machine may be busy.
const MISSED_WITHIN: Duration = Duration::from_secs(15);

fn deploy() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy")
}

fn read(name: &str) -> String {
    std::fs::read_to_string(deploy().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Every document of a YAML file.
fn yaml(name: &str) -> Vec<Value> {
    let document = |document: serde_yaml::Deserializer<'_>| {
        let mut value = serde_yaml::Value::deserialize(document).unwrap_or_else(|error| panic!("{name}: {error}"));
        value.apply_merge().unwrap();
        serde_json::to_value(value).unwrap()
    };
    serde_yaml::Deserializer::from_str(&read(name)).map(document).collect()
}

/// Every text in a document, wherever it stands.
fn texts(value: &Value) -> Vec<&str> {
    match value {
        Value::String(text) => vec![text],
        Value::Array(items) => items.iter().flat_map(texts).collect(),
        Value::Object(object) => object.values().flat_map(texts).collect(),
        _ => Vec::new(),
    }
}

/// The command lines of `furrow` in all files: the subcommand and its options.
fn commands() -> Vec<(String, Vec<String>)> {
    let mut commands = Vec::new();
    let files = [
        "furrow-coordinator.service",
        "furrow-worker.service",
        "furrow-worker@.service",
        "furrow-coordinator-lan.conf",
        "slurm/furrow-workers.sbatch",
        "README.md",
    ];
    for file in files {
        let text = read(file).replace("\\\n", " ");
        for line in text.lines().filter(|line| !line.trim_start().starts_with('#')) {
            for after in line.split("furrow ").skip(1) {
                commands.extend(command(after.split_whitespace()));
            }
        }
    }
    let args =
        |value: &Value| value.as_array().map(|args| args.iter().map(|arg| arg.as_str().unwrap().to_owned()).collect());
    let mut listed: Vec<Vec<String>> = Vec::new();
    for document in yaml("kubernetes/coordinator.yaml").iter().chain(&yaml("kubernetes/workers.yaml")) {
        let containers = document["spec"]["template"]["spec"]["containers"].as_array();
        listed.extend(containers.into_iter().flatten().filter_map(|container| args(&container["args"])));
    }
    let compose = yaml("container/compose.yaml").remove(0);
    listed.extend(compose["services"].as_object().unwrap().values().filter_map(|service| args(&service["command"])));
    assert_eq!(listed.len(), 4, "two in Kubernetes, two in compose");
    commands.extend(listed.iter().flat_map(|words| command(words.iter().map(String::as_str))));
    commands
}

/// The subcommand that `words` begin with, and the options behind it; none if they are no command.
fn command<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<(String, Vec<String>)> {
    let known = ["serve", "work", "token", "router", "status", "submit", "watch"];
    let mut name = words.next().filter(|word| known.contains(word))?.to_owned();
    let words: Vec<_> = words.take_while(|word| !matches!(*word, "|" | ">" | "&&")).collect();
    if name == "token" {
        name = format!("token {}", words.first()?);
    }
    let option =
        |word: &&str| word.trim_matches('`').split('=').next().filter(|word| word.starts_with("--")).map(str::to_owned);
    Some((name, words.iter().filter_map(option).collect()))
}

#[tokio::test]
async fn every_option_in_the_files_is_known_to_the_program() {
    let mut helps = BTreeMap::new();
    let commands = commands();
    for (name, options) in &commands {
        if !helps.contains_key(name) {
            let args: Vec<_> = name.split(' ').chain(["--help"]).collect();
            let help = finished(&args).await;
            assert_eq!(help.code, Some(0), "furrow {name}: {help:?}");
            helps.insert(name.clone(), help.stdout);
        }
        let known: BTreeSet<_> = helps[name].split(|c: char| c.is_whitespace() || ",[]".contains(c)).collect();
        for option in options {
            assert!(known.contains(option.as_str()), "`furrow {name}` has no {option}");
        }
    }
    let of = |name: &str| commands.iter().filter(|(command, _)| command == name).count();
    assert!(of("serve") >= 4 && of("work") >= 5 && of("token create") >= 1, "{commands:?}");
}

/// The names in an expression that could be metrics of ours.
fn metrics_in(expression: &str) -> BTreeSet<String> {
    let word = |c: char| !(c.is_ascii_alphanumeric() || c == '_' || c == ':');
    let ours = |name: &&str| name.starts_with("furrow_") || name.starts_with("process_");
    expression.split(word).filter(ours).map(str::to_owned).collect()
}

#[tokio::test]
async fn every_metric_of_board_and_alerts_is_on_the_page() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    server.json("/v1/sweeps").await;
    let page = server.text("/metrics").await;
    let samples: BTreeSet<_> = page
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| line.split(['{', ' ']).next().unwrap().to_owned())
        .collect();

    let board: Value = serde_json::from_str(&read("grafana/furrow.json")).unwrap();
    let panels = board["panels"].as_array().unwrap();
    let expressions =
        panels.iter().flat_map(|panel| panel["targets"].as_array().unwrap()).map(|target| &target["expr"]);
    let on_board: BTreeSet<_> = expressions.flat_map(|expression| metrics_in(expression.as_str().unwrap())).collect();
    let alerts = yaml("prometheus/alerts.yml").remove(0);
    let rules = alerts["groups"][0]["rules"].as_array().unwrap();
    let in_alerts: BTreeSet<_> = rules.iter().flat_map(|rule| metrics_in(rule["expr"].as_str().unwrap())).collect();
    assert!(on_board.len() >= 10 && in_alerts.len() >= 6, "{on_board:?} {in_alerts:?}");
    for metric in on_board.union(&in_alerts) {
        assert!(samples.contains(metric), "{metric} is not in {samples:?}");
    }
    assert!(
        rules.iter().all(|rule| rule["annotations"]["summary"].is_string() && rule["labels"]["severity"].is_string())
    );
    let scrape = yaml("prometheus/prometheus.yml").remove(0);
    assert_eq!(scrape["scrape_configs"][0]["job_name"], "furrow");
}

/// The labels by which `selector` selects must all be on `labels`.
fn selects(selector: &Value, labels: &Value) -> bool {
    selector.as_object().is_some_and(|wanted| wanted.iter().all(|(key, value)| labels[key] == *value))
}

#[tokio::test]
async fn the_manifests_fit_together() {
    let kustomization = yaml("kubernetes/kustomization.yaml").remove(0);
    let files: Vec<_> =
        kustomization["resources"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    let documents: Vec<Value> = files.iter().flat_map(|name| yaml(&format!("kubernetes/{name}"))).collect();
    let of_kind = |kind: &str| documents.iter().filter(|document| document["kind"] == kind).collect::<Vec<_>>();
    let pods: Vec<_> = [of_kind("StatefulSet"), of_kind("Deployment")].concat();
    assert_eq!(pods.len(), 2);
    for owner in &pods {
        let (spec, template) = (&owner["spec"], &owner["spec"]["template"]);
        assert!(selects(&spec["selector"]["matchLabels"], &template["metadata"]["labels"]), "{owner}");
        let pod = &template["spec"];
        assert_eq!(pod["securityContext"]["runAsNonRoot"], true);
        assert_eq!(pod["automountServiceAccountToken"], false);
        let container = &pod["containers"][0];
        assert_eq!(container["securityContext"]["readOnlyRootFilesystem"], true);
        assert_eq!(container["securityContext"]["allowPrivilegeEscalation"], false);
        let claimed =
            spec["volumeClaimTemplates"].as_array().into_iter().flatten().map(|claim| &claim["metadata"]["name"]);
        let volumes: Vec<_> =
            pod["volumes"].as_array().unwrap().iter().map(|volume| &volume["name"]).chain(claimed).collect();
        for mount in container["volumeMounts"].as_array().unwrap() {
            assert!(volumes.contains(&&mount["name"]), "{mount} has no volume");
        }
    }
    let service = of_kind("Service").remove(0);
    let coordinator = &of_kind("StatefulSet").remove(0)["spec"]["template"];
    assert!(selects(&service["spec"]["selector"], &coordinator["metadata"]["labels"]));
    let ports = coordinator["spec"]["containers"][0]["ports"].as_array().unwrap();
    let named = |name: &Value| ports.iter().any(|port| port["name"] == *name);
    assert!(service["spec"]["ports"].as_array().unwrap().iter().all(|port| named(&port["targetPort"])));
    assert_eq!(of_kind("NetworkPolicy").len(), 3);
    let scaled = &of_kind("HorizontalPodAutoscaler").remove(0)["spec"]["scaleTargetRef"];
    assert_eq!((&scaled["kind"], &scaled["name"]), (&pods[1]["kind"], &pods[1]["metadata"]["name"]));
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    for probe in ["startupProbe", "livenessProbe", "readinessProbe"] {
        let probe = &coordinator["spec"]["containers"][0][probe]["httpGet"];
        assert!(named(&probe["port"]), "{probe}");
        server.json(probe["path"].as_str().unwrap()).await;
    }
}

#[test]
fn the_compose_file_fits_together() {
    let compose = yaml("container/compose.yaml").remove(0);
    for (name, service) in compose["services"].as_object().unwrap() {
        assert_eq!((&service["read_only"], &service["user"]), (&Value::Bool(true), &"65532:65532".into()), "{name}");
        for secret in service["secrets"].as_array().into_iter().flatten() {
            assert!(compose["secrets"].get(secret.as_str().unwrap()).is_some(), "{name}: {secret}");
        }
        for network in service["networks"].as_array().unwrap() {
            assert!(compose["networks"].get(network.as_str().unwrap()).is_some(), "{name}: {network}");
        }
    }
    let build = &compose["services"]["coordinator"]["build"];
    let context = deploy().join("container").join(build["context"].as_str().unwrap());
    assert!(context.join("Cargo.lock").is_file() && context.join(build["dockerfile"].as_str().unwrap()).is_file());
    let image = read("container/Dockerfile");
    assert!(image.contains("\nUSER 65532:65532\n") && image.contains("--locked"));
}

#[test]
fn the_router_s_configuration_is_zenoh_s() {
    let config = zenoh::Config::from_json5(&read("zenoh/router.json5")).unwrap();
    let text = |key: &str| config.get_json(key).unwrap();
    assert_eq!(text("mode"), "\"router\"");
    assert_eq!(text("transport/link/tls/enable_mtls"), "true");
    assert_eq!(text("access_control/default_permission"), "\"deny\"");
}

/// A coordinator and the router of `deploy/` before it, on this machine; what workers join with, and where they reach the router.
async fn behind_a_router(directory: &tempfile::TempDir) -> (Server, zenoh::Session, String, String) {
    let (db, made) = (path(directory, "served.db"), path(directory, "router"));
    let (server, secret) = serve_lan(&db).await;
    let finished = finished(&["router", "--name", "127.0.0.1", "--to", &made, "--db", &db]).await;
    assert_eq!(finished.code, Some(0), "{finished:?}");
    let free = std::net::UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let listen = format!("quic/{free}");
    let text = read("zenoh/router.json5").replace("/etc/zenohd/furrow", &made);
    let text = text.replace("quic/0.0.0.0:7447", &listen).replace("quic/coordinator.example:7447", &server.endpoint);
    let router = zenoh::open(zenoh::Config::from_json5(&text).unwrap()).await.unwrap();
    (server, router, secret, listen)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_behind_the_router_enrols_works_and_is_missed() {
    let directory = directory();
    let (server, router, secret, listen) = behind_a_router(&directory).await;
    let work = ["work", "--join", &secret, "--connect", &listen, "--threads", "1", "--spool", &server.spool];
    let mut worker = Running::start(&work);
    let sweep = server.submit(&json!({"plan": plan(1.0, 1)})).await;
    let done = server.done(sweep).await;
    assert_eq!((done["done"].as_u64(), done["failed"].as_u64()), (Some(4), Some(0)), "{}", worker.log());

    let long = server.submit(&json!({"plan": plan(600.0, 2)})).await;
    server.until(&format!("/v1/sweeps/{long}"), |sweep| (sweep["leased"].as_u64()? > 0).then_some(())).await;
    worker.child.kill().await.unwrap();
    let killed = Instant::now();
    let free = |sweep: &Value| (sweep["leased"].as_u64()? == 0).then_some(());
    server.until(&format!("/v1/sweeps/{long}"), free).await;
    assert!(killed.elapsed() < MISSED_WITHIN, "sooner than its lease of 30 s: {:?}", killed.elapsed());
    router.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_router_keeps_out_whom_the_coordinator_would() {
    let directory = directory();
    let (server, router, secret, listen) = behind_a_router(&directory).await;
    let (secret, (_elsewhere, foreign)) = (secret_in(&secret), serve_lan(&path(&directory, "elsewhere.db")).await);
    let (authority, foreign) = (&secret.authority_pem, secret_in(&foreign));
    let here = JoinSecret { endpoints: vec![listen.clone()], ..secret.clone() };
    let machine = Machine::enrol(&here, &directory.path().join("spool")).await;
    let answer = machine.ask::<Leases>(Method::Claim, &machine.claim(1)).await;
    assert!(matches!(answer, Some(Reply::Ok(_))), "{answer:?}");
    a_spy_learns_nothing(&directory, &server, &here).await;

    let stranger = (foreign.certificate_pem.as_str(), foreign.key_pem.as_str());
    let own = (secret.certificate_pem.as_str(), secret.key_pem.as_str());
    let newcomer = async {
        let session = connect(&listen, authority, Some(own)).await.unwrap();
        ask::<Leases>(&session, &machine.key(Method::Claim), &machine.claim(1)).await
    };
    let (nobody, stranger, newcomer) =
        tokio::join!(connect(&listen, authority, None), connect(&listen, authority, Some(stranger)), newcomer);
    nobody.expect_err("without a certificate");
    stranger.expect_err("with another authority's");
    assert_eq!(newcomer, None, "a join secret opens one question");
    router.close().await.unwrap();
}

#[test]
fn no_file_holds_a_secret() {
    for file in ["container/compose.yaml", "kubernetes/workers.yaml", "kubernetes/coordinator.yaml"] {
        for document in yaml(file) {
            assert_ne!(document["kind"], "Secret", "{file}");
            assert!(texts(&document).iter().all(|text| !text.contains("furrow_")), "{file}");
        }
    }
}
