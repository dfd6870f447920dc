use furrow_schema::id::{Credential, RequestId, WorkerId};
use furrow_schema::protocol::Hello;
use rcgen::{KeyPair, PKCS_ED25519, SigningKey};

use super::*;
use crate::store::hex;
use crate::testing::{Bench, ENGINE, sweep};
use crate::view::{AttemptEnd, WorkerChange};

const HOUR_MS: i64 = 60 * 60 * 1_000;
const DAY_MS: i64 = 24 * HOUR_MS;
const TERMS: SecretTerms = SecretTerms { valid_ms: HOUR_MS, uses: 3, workers_ms: None };

/// A gate whose authority is kept nowhere.
fn gate(bench: &Bench) -> Gate {
    let authority = Arc::new(Authority::draw(bench.coordinator.now_ms()));
    Gate::new(bench.coordinator.clone(), authority, "default".to_owned(), vec!["quic/127.0.0.1:1".to_owned()])
}

/// A machine with a key of its own that wants to work.
struct Machine {
    worker: WorkerId,
    credential: Credential,
    key: KeyPair,
}

impl Machine {
    fn new() -> Self {
        let key = KeyPair::generate_for(&PKCS_ED25519).unwrap();
        Self { worker: WorkerId::random(), credential: Credential::random(), key }
    }

    fn public_key(&self) -> PublicKey {
        PublicKey(self.key.public_key_raw().try_into().unwrap())
    }

    fn call<T>(&self, body: T) -> Call<T> {
        let (worker, credential) = (self.worker.clone(), self.credential.clone());
        Call { request: RequestId::random(), worker, credential, body }
    }

    fn enrol_call(&self, secret: &JoinSecret) -> Call<Enrol> {
        let join = KeyPair::from_pem(&secret.key_pem).unwrap();
        let statement = enrolment_statement(&secret.coordinator, &self.worker, self.public_key());
        let sign = |key: &KeyPair| hex(&key.sign(&statement).unwrap());
        self.call(Enrol {
            hello: Hello { name: "barn".to_owned(), engine: ENGINE, threads: 2 },
            public_key: self.public_key(),
            join: PublicKey(join.public_key_raw().try_into().unwrap()),
            signature: sign(&join),
            proof: sign(&self.key),
        })
    }

    async fn enrol(&mut self, gate: &Gate, secret: &JoinSecret) -> Result<Enrolled, Refusal> {
        let enrolled = gate.enrol(self.enrol_call(secret)).await.into_result()?;
        self.credential = enrolled.credential.clone();
        Ok(enrolled)
    }

    /// Whether it may claim.
    async fn may_work(&self, bench: &Bench) -> Result<(), Refusal> {
        let claim =
            furrow_schema::protocol::Claim { engine: ENGINE, want: 8, known_scenarios: Vec::new(), first: false };
        bench.coordinator.claim(self.call(claim)).await.into_result().map(drop)
    }
}

fn why(refused: Result<Enrolled, Refusal>) -> String {
    match refused {
        Err(Refusal::Enrolment { detail }) => detail,
        other => panic!("expected a refused enrolment, got {other:?}"),
    }
}

#[tokio::test]
async fn a_machine_with_a_join_secret_gets_a_credential_and_works() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    let secret = gate.new_secret(TERMS).await.unwrap();
    let mut machine = Machine::new();
    assert_eq!(machine.may_work(&bench).await, Err(Refusal::UnknownWorker));
    let drawn = machine.credential.clone();
    let enrolled = machine.enrol(&gate, &secret).await.unwrap();
    assert_eq!(machine.may_work(&bench).await, Ok(()));
    machine.credential = drawn;
    assert_eq!(machine.may_work(&bench).await, Err(Refusal::BadCredential), "its old one is worth nothing");

    let info = bench.coordinator.worker(&machine.worker).await.unwrap().unwrap();
    assert_eq!((info.name.as_str(), info.engine, info.threads), ("barn", ENGINE, 2));
    assert_eq!(info.certificate_until_ms, Some(enrolled.certificate.until_ms));
    assert_eq!(enrolled.certificate.until_ms, bench.coordinator.now_ms() + 30 * DAY_MS);
    assert!(info.enrolled_ms.is_some() && info.until_ms.is_none() && info.revoked_ms.is_none());
}

#[tokio::test]
async fn a_lost_answer_is_given_again_and_uses_nothing_up() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    let secret = gate.new_secret(SecretTerms { uses: 1, ..TERMS }).await.unwrap();
    let mut machine = Machine::new();
    let first = machine.enrol(&gate, &secret).await.unwrap();
    let again = machine.enrol(&gate, &secret).await.unwrap();
    assert_eq!((&first.credential, first.certificate.until_ms), (&again.credential, again.certificate.until_ms));
    assert!(why(Machine::new().enrol(&gate, &secret).await).contains("used up"));
}

#[tokio::test]
async fn an_expired_or_unknown_join_secret_lets_nobody_in() {
    let bench = Bench::new().await;
    let (gate, elsewhere) = (gate(&bench), Bench::new().await);
    let secret = gate.new_secret(TERMS).await.unwrap();
    let foreign = self::gate(&elsewhere).new_secret(TERMS).await.unwrap();
    let posing = JoinSecret { coordinator: secret.coordinator.clone(), ..foreign };
    assert!(why(Machine::new().enrol(&gate, &posing).await).contains("does not know this join secret"));
    bench.pass(HOUR_MS).await;
    assert!(why(Machine::new().enrol(&gate, &secret).await).contains("expired"));
    assert!(bench.coordinator.workers().await.unwrap().is_empty());
}

#[tokio::test]
async fn a_name_belongs_to_who_enrolled_under_it() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    let secret = gate.new_secret(TERMS).await.unwrap();
    let mut machine = Machine::new();
    machine.enrol(&gate, &secret).await.unwrap();
    let mut impostor = Machine { worker: machine.worker.clone(), ..Machine::new() };
    assert!(why(impostor.enrol(&gate, &secret).await).contains("another worker"));
    // It knows the name and the public key, and has a good join secret: but not the key.
    let mut stolen = impostor.enrol_call(&secret);
    stolen.body.public_key = machine.public_key();
    let statement = enrolment_statement(&secret.coordinator, &machine.worker, machine.public_key());
    stolen.body.signature = hex(&KeyPair::from_pem(&secret.key_pem).unwrap().sign(&statement).unwrap());
    stolen.body.proof = hex(&impostor.key.sign(&statement).unwrap());
    assert!(why(gate.enrol(stolen).await.into_result()).contains("proof"));
    let mut unsigned = Machine::new().enrol_call(&secret);
    unsigned.body.signature = unsigned.body.proof.clone();
    assert!(why(gate.enrol(unsigned).await.into_result()).contains("signature"));
    assert_eq!(machine.may_work(&bench).await, Ok(()));
}

#[tokio::test]
async fn a_worker_of_the_coordinators_own_machine_may_enrol_under_its_name_and_nobody_else() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    let secret = gate.new_secret(TERMS).await.unwrap();
    let local = bench.worker().await;
    let mut other = Machine { worker: local.id.clone(), ..Machine::new() };
    assert!(why(other.enrol(&gate, &secret).await).contains("another worker"));
    let mut same = Machine { worker: local.id.clone(), credential: local.credential.clone(), ..Machine::new() };
    same.enrol(&gate, &secret).await.unwrap();
    assert_eq!(same.may_work(&bench).await, Ok(()));
}

#[tokio::test]
async fn a_hello_takes_nobody_in() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    let stranger = Machine::new();
    let hello = stranger.call(Hello { name: "barn".to_owned(), engine: ENGINE, threads: 2 });
    let answer = gate.handle(Method::Hello, &serde_json::to_vec(&hello).unwrap()).await;
    let answer: Reply<furrow_schema::protocol::Welcome> = serde_json::from_slice(&answer).unwrap();
    assert_eq!(answer, Reply::Refused(Refusal::NotEnrolled));
    assert!(bench.coordinator.workers().await.unwrap().is_empty());
}

#[tokio::test]
async fn a_revoked_worker_loses_its_jobs_at_once_and_is_refused_everything() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    bench.submit(sweep(&["rgop"], 2)).await;
    let secret = gate.new_secret(TERMS).await.unwrap();
    let mut machine = Machine::new();
    machine.enrol(&gate, &secret).await.unwrap();
    machine.may_work(&bench).await.unwrap();
    assert_eq!(bench.coordinator.worker(&machine.worker).await.unwrap().unwrap().leased, 2);

    let revoked = bench.coordinator.change_worker(&machine.worker, WorkerChange::Revoke).await.unwrap().unwrap();
    assert_eq!((revoked.leased, revoked.revoked_ms), (0, Some(bench.coordinator.now_ms())));
    assert_eq!(machine.may_work(&bench).await, Err(Refusal::Revoked));
    assert_eq!(gate.refresh(machine.call(Refresh {})).await, Reply::Refused(Refusal::Revoked));
    assert_eq!(machine.enrol(&gate, &secret).await.unwrap_err(), Refusal::Revoked, "nor does it come in again");
    bench.clock.advance(4_000);
    let jobs = bench.worker().await.claim(2).await;
    assert!(jobs.len() == 2 && jobs.iter().all(|job| job.attempt == 2));
    let ended = bench.job(&jobs[0]).await.attempts.remove(0);
    assert_eq!((ended.end, ended.reason.as_deref()), (AttemptEnd::HandedBack, Some("the worker was revoked")));
    bench.assert_consistent().await;

    let nobody = bench.coordinator.change_worker(&WorkerId::random(), WorkerChange::Revoke).await.unwrap();
    assert_eq!(nobody, None);
}

#[tokio::test]
async fn a_worker_that_was_let_in_for_a_time_is_out_after_it() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    bench.submit(sweep(&["rgop"], 1)).await;
    let secret = gate.new_secret(SecretTerms { workers_ms: Some(10_000), ..TERMS }).await.unwrap();
    let mut machine = Machine::new();
    let enrolled = machine.enrol(&gate, &secret).await.unwrap();
    assert_eq!(enrolled.certificate.until_ms, bench.coordinator.now_ms() + 10_000, "its certificate ends with it");
    machine.may_work(&bench).await.unwrap();
    bench.pass(9_999).await;
    machine.may_work(&bench).await.unwrap();
    bench.pass(1).await;
    assert_eq!(machine.may_work(&bench).await, Err(Refusal::Expired));
    assert_eq!(bench.worker().await.claim(1).await[0].attempt, 2, "its lease did not have to run out");

    let longer = WorkerChange::Until(Some(bench.coordinator.now_ms() + 1));
    bench.coordinator.change_worker(&machine.worker, longer).await.unwrap().unwrap();
    assert_eq!(machine.may_work(&bench).await, Ok(()));
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_certificate_is_refreshed_for_the_key_that_was_enrolled() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    let secret = gate.new_secret(TERMS).await.unwrap();
    let mut machine = Machine::new();
    let first = machine.enrol(&gate, &secret).await.unwrap().certificate;
    bench.pass(20 * DAY_MS).await;
    let next = gate.refresh(machine.call(Refresh {})).await.into_result().unwrap();
    assert_eq!(next.until_ms, first.until_ms + 20 * DAY_MS);
    assert_ne!(next.pem, first.pem);
    let stranger = Machine { worker: machine.worker.clone(), ..Machine::new() };
    assert_eq!(gate.refresh(stranger.call(Refresh {})).await, Reply::Refused(Refusal::BadCredential));
    let local = bench.worker().await;
    assert_eq!(gate.refresh(local.call(Refresh {})).await, Reply::Refused(Refusal::NotEnrolled));
}

#[tokio::test]
async fn it_is_known_whether_there_ever_was_a_join_secret() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    assert!(!gate.had_secret().await.unwrap());
    gate.new_secret(TERMS).await.unwrap();
    bench.pass(HOUR_MS).await;
    assert!(gate.had_secret().await.unwrap());
}

#[tokio::test]
async fn garbage_is_refused() {
    let bench = Bench::new().await;
    let gate = gate(&bench);
    let secret = gate.new_secret(TERMS).await.unwrap();
    let mut question = serde_json::to_value(Machine::new().enrol_call(&secret)).unwrap();
    for (key, value) in [("signature", "\u{e9}".repeat(64)), ("proof", String::new()), ("public_key", "0".repeat(63))] {
        let good = question["body"][key].take();
        question["body"][key] = value.into();
        for method in [Method::Enrol, Method::Refresh] {
            let answer = gate.handle(method, question.to_string().as_bytes()).await;
            let answer: serde_json::Value = serde_json::from_slice(&answer).unwrap();
            let reason = answer["refused"]["reason"].as_str().unwrap();
            assert!(matches!(reason, "malformed" | "enrolment"), "{key}: {answer}");
        }
        question["body"][key] = good;
    }
    assert!(bench.coordinator.workers().await.unwrap().is_empty());
}

#[tokio::test]
async fn results_are_counted_by_worker_and_once() {
    let bench = Bench::new().await;
    bench.submit(sweep(&["rgop"], 3)).await;
    let worker = bench.worker().await;
    bench.clock.advance(10_000);
    for job in worker.claim(2).await {
        worker.ended(&job, crate::testing::done(1.0)).await;
        worker.ended(&job, crate::testing::done(1.0)).await;
    }
    let info = bench.coordinator.worker(&worker.id).await.unwrap().unwrap();
    assert_eq!(info.results, 2);
    assert!(info.rate_per_s.is_some_and(|rate| rate > 0.0));
}
