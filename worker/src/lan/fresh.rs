//! Staying in: the next certificate, before the present one ends.

use std::convert::Infallible;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use furrow_schema::id::RequestId;
use furrow_schema::protocol::{Call, Refresh, Reply};
use tokio::time::sleep;

use super::enrol::now_ms;
use super::{Certificates, Enrolment};
use crate::backoff::{Backoff, share};
use crate::spool::{Identity, Spool, SpoolError};
use crate::zenoh_link::ZenohLink;

/// The longest pause between two looks at the clock, which may be set meanwhile.
const LOOK_EVERY: Duration = Duration::from_secs(60 * 60);
/// Replaces the worker's certificate whenever half of its time is over, for ever. A worker that is not enrolled has
/// nothing to replace. A refusal changes nothing here: the worker's other questions meet it, too.
pub async fn keep_fresh(link: &ZenohLink, spool: &Mutex<Spool>) -> Infallible {
    let mut backoff = Backoff::new();
    loop {
        let Some(enrolment) = of(spool, link) else { return std::future::pending().await };
        let due = Duration::from_millis(left_ms(enrolment.certificate_ms, now_ms()));
        if !due.is_zero() {
            backoff = Backoff::new();
            sleep(due.min(LOOK_EVERY)).await;
        } else if let Err(trouble) = replace(link, spool, enrolment).await {
            tracing::debug!(trouble, "the worker's certificate is not replaced yet");
            sleep(backoff.pause(share())).await;
        }
    }
}

fn of(spool: &Mutex<Spool>, link: &ZenohLink) -> Option<Enrolment> {
    let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
    spool.enrolment().filter(|enrolment| enrolment.coordinator == link.coordinator()).cloned()
}

/// Until half of a certificate's time is over \[ms\].
fn left_ms([from_ms, until_ms]: [i64; 2], now_ms: i64) -> u64 {
    let half_ms = from_ms.saturating_add(until_ms.saturating_sub(from_ms) / 2);
    u64::try_from(half_ms.saturating_sub(now_ms)).unwrap_or(0)
}

async fn replace(link: &ZenohLink, spool: &Mutex<Spool>, before: Enrolment) -> Result<(), String> {
    let Identity { worker, credential } = identity(spool, &before);
    let call = Call { request: RequestId::random(), worker, credential, body: Refresh {} };
    let certificate = match link.refresh(&call).await.map_err(|error| error.to_string())? {
        Reply::Ok(certificate) => certificate,
        Reply::Refused(refusal) => return Err(refusal.to_string()),
    };
    let certificate_ms = [now_ms(), certificate.until_ms];
    if left_ms(certificate_ms, now_ms()) == 0 {
        return Err("the coordinator's clock is far behind".to_owned());
    }
    let enrolment = Enrolment { certificate_pem: certificate.pem, certificate_ms, ..before };
    let key_pem = keep(spool, enrolment.clone()).map_err(|error| error.to_string())?;
    link.go_on_with(Certificates::of_worker(&enrolment, &key_pem)).await;
    tracing::info!("the worker has a new certificate");
    Ok(())
}

fn identity(spool: &Mutex<Spool>, enrolment: &Enrolment) -> Identity {
    spool.lock().unwrap_or_else(PoisonError::into_inner).identity_at(&enrolment.coordinator)
}

fn keep(spool: &Mutex<Spool>, enrolment: Enrolment) -> Result<String, SpoolError> {
    let mut spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
    spool.keep_enrolment(enrolment)?;
    spool.key_pem()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_is_due_when_half_of_its_time_is_over() {
        assert_eq!(left_ms([1_000, 3_000], 1_000), 1_000);
        assert_eq!(left_ms([1_000, 3_000], 2_000), 0);
        assert_eq!(left_ms([1_000, 3_000], 9_000), 0);
        assert_eq!(left_ms([1_000, i64::MAX], 1_000), (i64::MAX as u64 - 1_000) / 2);
    }
}
