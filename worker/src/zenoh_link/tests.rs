//! The link over real Zenoh sessions, against a coordinator that answers by rote.

use furrow_schema::id::{Credential, EngineId, RequestId};
use furrow_schema::protocol::{KEY_PREFIX, Refusal, coordinator_key, work_key};
use serde_json::json;
use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinSet};
use zenoh::handlers::FifoChannelHandler;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};

use super::*;

/// Answers every claim with a retry time of 7 ms and everything else with a refusal.
struct Coordinator {
    session: Session,
    endpoint: String,
    namespace: String,
    _token: LivelinessToken,
    _queryable: Queryable<()>,
}

impl Coordinator {
    async fn serve(namespace: &str, id: &str, endpoint: &str) -> Self {
        let config = session::configure(&[
            ("mode", json!("peer")),
            ("listen/endpoints", json!([endpoint])),
            ("scouting/multicast/interface", json!("127.0.0.1")),
            ("scouting/multicast/autoconnect", json!({"peer": [], "router": [], "client": []})),
        ])
        .unwrap();
        let session = zenoh::open(config).await.unwrap();
        let token = session.liveliness().declare_token(coordinator_key(namespace, id)).await.unwrap();
        let questions = format!("{KEY_PREFIX}/{namespace}/{id}/*");
        let queryable = session.declare_queryable(questions).complete(true).callback(answer).await.unwrap();
        Self {
            session,
            endpoint: endpoint.to_owned(),
            namespace: namespace.to_owned(),
            _token: token,
            _queryable: queryable,
        }
    }

    fn config(&self) -> ConnectConfig {
        let endpoint = Some(self.endpoint.clone());
        // On a busy machine it takes a while to be found.
        let patience = Some(Duration::from_secs(30));
        ConnectConfig { endpoint, namespace: self.namespace.clone(), patience, ..ConnectConfig::default() }
    }

    async fn workers(&self) -> zenoh::pubsub::Subscriber<FifoChannelHandler<Sample>> {
        let workers = format!("{KEY_PREFIX}/{}/*/worker/*", self.namespace);
        self.session.liveliness().declare_subscriber(workers).history(true).await.unwrap()
    }
}

fn answer(query: Query) {
    let payload = if query.key_expr().ends_with("/claim") {
        serde_json::to_vec(&Reply::Ok(Leases { retry_after_ms: 7, ..Leases::default() }))
    } else if query.key_expr().ends_with("/hello") {
        serde_json::to_vec(&Reply::Ok(Welcome { lease_ms: 1, renew_every_ms: 1 }))
    } else if query.key_expr().ends_with("/renew") {
        Ok(b"neither JSON nor an answer".to_vec())
    } else {
        serde_json::to_vec(&Reply::<Recorded>::Refused(Refusal::BadCredential))
    };
    zenoh::Wait::wait(query.reply(query.key_expr(), payload.unwrap())).unwrap();
}

fn call<T>(body: T) -> Call<T> {
    Call { request: RequestId::random(), worker: WorkerId::random(), credential: Credential::random(), body }
}

fn claim() -> Call<Claim> {
    call(Claim { engine: EngineId([1; 32]), want: 1, known_scenarios: Vec::new(), first: false })
}

fn hello() -> Call<Hello> {
    call(Hello { name: "host".to_owned(), engine: EngineId([1; 32]), threads: 1 })
}

/// Tests run at the same time on one machine: each has its own namespace.
fn own_namespace() -> String {
    RequestId::random().as_str().to_owned()
}

/// An endpoint on a port that was free a moment ago: Zenoh does not tell which one it took.
fn own_endpoint() -> String {
    format!("tcp/{}", std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn questions_are_answered_refused_or_unreadable() {
    let coordinator = Coordinator::serve(&own_namespace(), "c1", &own_endpoint()).await;
    let link = ZenohLink::connect(coordinator.config()).await.unwrap();
    assert_eq!(link.coordinator(), "c1");
    assert!(matches!(link.claim(claim()).await, Ok(Reply::Ok(Leases { retry_after_ms: 7, .. }))));
    let report = call(Report { engine: EngineId([1; 32]), runs: Vec::new() });
    assert_eq!(link.result(report).await, Ok(Reply::Refused(Refusal::BadCredential)));
    assert!(matches!(link.renew(call(Renew { held: Vec::new() })).await, Err(LinkError::Unreadable(_))));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_is_found_by_scouting_among_others() {
    let _other = Coordinator::serve(&own_namespace(), "other", &own_endpoint()).await;
    let coordinator = Coordinator::serve(&own_namespace(), "wanted", &own_endpoint()).await;
    let link = ZenohLink::connect(ConnectConfig { endpoint: None, ..coordinator.config() }).await.unwrap();
    assert_eq!(link.coordinator(), "wanted");
    assert!(link.claim(claim()).await.is_ok());
}

#[tokio::test(flavor = "multi_thread")]
async fn two_coordinators_of_one_namespace_are_not_chosen_between() {
    let namespace = own_namespace();
    let first = Coordinator::serve(&namespace, "c1", &own_endpoint()).await;
    let second = Coordinator::serve(&namespace, "c2", &own_endpoint()).await;
    let scouting = ConnectConfig { endpoint: None, namespace, ..ConnectConfig::default() };
    match ZenohLink::connect(scouting).await.err() {
        Some(ConnectError::Ambiguous { endpoints }) => {
            assert!(endpoints.contains(&first.endpoint) && endpoints.contains(&second.endpoint));
        }
        other => panic!("expected to be asked to choose, got {other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_coordinator_the_search_ends_with_advice() {
    let nowhere = ConnectConfig {
        namespace: own_namespace(),
        patience: Some(Duration::from_millis(400)),
        ..ConnectConfig::default()
    };
    let closed_port = ConnectConfig { endpoint: Some("tcp/127.0.0.1:1".to_owned()), ..nowhere.clone() };
    for config in [nowhere, closed_port] {
        let message = ZenohLink::connect(config).await.err().unwrap().to_string();
        assert!(message.contains("furrow serve") && message.contains("--connect"), "{message}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn malformed_endpoints_and_namespaces_are_named() {
    for endpoint in
        ["", "nonsense", "tcp/", "tcp/127.0.0.1", "tcp/127.0.0.1:0", "tcp/:7447", "udp/127.0.0.1:1", "tcp/h:x"]
    {
        let config = ConnectConfig { endpoint: Some(endpoint.to_owned()), ..ConnectConfig::default() };
        match ZenohLink::connect(config).await.err() {
            Some(ConnectError::BadEndpoint { endpoint: named, .. }) => assert_eq!(named, endpoint),
            other => panic!("`{endpoint}` gave {other:?}"),
        }
    }
    for namespace in ["", "a/b", "*", "$*", "a b"] {
        let config = ConnectConfig { namespace: namespace.to_owned(), ..ConnectConfig::default() };
        assert_eq!(ZenohLink::connect(config).await.err(), Some(ConnectError::BadNamespace(namespace.to_owned())));
    }
}

/// Asks until there is an answer, or another coordinator.
async fn answer_in_the_end(link: &ZenohLink) -> Result<Reply<Leases>, LinkError> {
    let answered = async {
        loop {
            match link.claim(claim()).await {
                Err(LinkError::NoAnswer(_)) => tokio::task::yield_now().await,
                answer => return answer,
            }
        }
    };
    tokio::time::timeout(Duration::from_secs(10), answered).await.expect("the coordinator is back within 10 s")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_that_went_away_is_reached_again_at_its_endpoint() {
    let first = Coordinator::serve(&own_namespace(), "c1", &own_endpoint()).await;
    let (namespace, endpoint) = (first.namespace.clone(), first.endpoint.clone());
    let link = ZenohLink::connect(first.config()).await.unwrap();
    first.session.close().await.unwrap();
    assert!(matches!(link.claim(claim()).await, Err(LinkError::NoAnswer(_))));
    let _again = Coordinator::serve(&namespace, "c1", &endpoint).await;
    assert!(answer_in_the_end(&link).await.is_ok());
}

/// Leads its first visitor to one place and all later ones to others, a place each; the last goes on for ever.
async fn lead(mut places: Vec<String>) -> (String, AbortHandle) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
    let led = async move {
        let mut rides = JoinSet::new();
        while let Ok((mut visitor, _)) = listener.accept().await {
            let place = if places.len() > 1 { places.remove(0) } else { places[0].clone() };
            rides.spawn(async move {
                let mut there = TcpStream::connect(place.trim_start_matches("tcp/")).await.unwrap();
                copy_bidirectional(&mut visitor, &mut there).await
            });
        }
    };
    (endpoint, tokio::spawn(led).abort_handle())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_connects_again_but_hears_of_nobody_is_opened_anew() {
    let namespace = own_namespace();
    let first = Coordinator::serve(&namespace, "c1", &own_endpoint()).await;
    let deaf = Coordinator::serve(&own_namespace(), "deaf", &own_endpoint()).await;
    let again_at = own_endpoint();
    let (endpoint, door) = lead(vec![first.endpoint.clone(), deaf.endpoint.clone(), again_at.clone()]).await;
    let config = ConnectConfig { endpoint: Some(endpoint), ..first.config() };
    let mut link = ZenohLink::connect(config).await.unwrap();
    link.patient_for = Duration::ZERO;
    let _again = Coordinator::serve(&namespace, "c1", &again_at).await;
    first.session.close().await.unwrap();
    assert!(matches!(link.claim(claim()).await, Err(LinkError::NoAnswer(_))));
    assert!(answer_in_the_end(&link).await.is_ok());
    door.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn another_coordinator_at_the_same_endpoint_is_not_taken_for_the_old_one() {
    let first = Coordinator::serve(&own_namespace(), "c1", &own_endpoint()).await;
    let (namespace, endpoint) = (first.namespace.clone(), first.endpoint.clone());
    let link = ZenohLink::connect(first.config()).await.unwrap();
    first.session.close().await.unwrap();
    assert!(matches!(link.claim(claim()).await, Err(LinkError::NoAnswer(_))));
    let _other = Coordinator::serve(&namespace, "c2", &endpoint).await;
    assert_eq!(answer_in_the_end(&link).await, Err(LinkError::OtherCoordinator("c2".to_owned())));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_that_was_found_by_scouting_is_found_again_on_another_port() {
    let first = Coordinator::serve(&own_namespace(), "c1", &own_endpoint()).await;
    let namespace = first.namespace.clone();
    let link = ZenohLink::connect(ConnectConfig { endpoint: None, ..first.config() }).await.unwrap();
    let call = hello();
    let worker = call.worker.clone();
    link.hello(call).await.unwrap();
    first.session.close().await.unwrap();
    assert!(matches!(link.claim(claim()).await, Err(LinkError::NoAnswer(_))));

    let again = Coordinator::serve(&namespace, "c1", &own_endpoint()).await;
    let workers = again.workers().await;
    assert!(answer_in_the_end(&link).await.is_ok());
    let seen = workers.recv_async().await.unwrap();
    assert_eq!(seen.key_expr().as_str().rsplit('/').next(), Some(worker.as_str()), "it shows that it lives");
}

#[tokio::test(flavor = "multi_thread")]
async fn another_coordinator_is_taken_only_when_the_own_one_stays_away() {
    let first = Coordinator::serve(&own_namespace(), "c1", &own_endpoint()).await;
    let namespace = first.namespace.clone();
    let mut link = ZenohLink::connect(ConnectConfig { endpoint: None, ..first.config() }).await.unwrap();
    first.session.close().await.unwrap();
    let _other = Coordinator::serve(&namespace, "c2", &own_endpoint()).await;
    for _ in 0..2 {
        assert!(matches!(link.claim(claim()).await, Err(LinkError::NoAnswer(_))));
    }
    link.faithful_for = Duration::ZERO;
    assert_eq!(answer_in_the_end(&link).await, Err(LinkError::OtherCoordinator("c2".to_owned())));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_sees_a_worker_come_and_go() {
    let coordinator = Coordinator::serve(&own_namespace(), "c1", &own_endpoint()).await;
    let workers = coordinator.workers().await;
    let link = ZenohLink::connect(coordinator.config()).await.unwrap();
    let call = hello();
    let worker = call.worker.clone();
    link.hello(call).await.unwrap();
    let seen = workers.recv_async().await.unwrap();
    assert_eq!((seen.kind(), seen.key_expr().as_str().rsplit('/').next()), (SampleKind::Put, Some(worker.as_str())));
    link.close().await;
    assert_eq!(workers.recv_async().await.unwrap().kind(), SampleKind::Delete);
    assert_eq!(link.claim(claim()).await, Err(LinkError::Closed));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hint_of_the_coordinator_changes_what_an_idle_worker_waits_for() {
    let coordinator = Coordinator::serve(&own_namespace(), "c1", &own_endpoint()).await;
    let link = ZenohLink::connect(coordinator.config()).await.unwrap();
    let mut changes = link.changes().unwrap();
    link.hello(hello()).await.unwrap();
    let key = work_key(&coordinator.namespace, "c1");
    let hinted = async {
        // A worker's ear needs a moment to be known at the other end.
        let short = Duration::from_millis(100);
        while tokio::time::timeout(short, changes.changed()).await.is_err() {
            coordinator.session.put(&key, Vec::new()).await.unwrap();
        }
    };
    tokio::time::timeout(Duration::from_secs(10), hinted).await.expect("a hint is heard");
}
