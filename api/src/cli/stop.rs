//! Stopping on request: the first signal asks politely, the second ends the process.

use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio_util::sync::CancellationToken;

use super::error::CliError;
use super::output;

/// A token that is cancelled by the first SIGINT or SIGTERM. The second ends the process at once, with 130.
///
/// # Errors
/// The signals cannot be listened for.
pub(super) fn on_signals() -> Result<CancellationToken, CliError> {
    let listen = |kind| signal(kind).map_err(CliError::failed("cannot listen for signals"));
    let (mut interrupt, mut terminate) = (listen(SignalKind::interrupt())?, listen(SignalKind::terminate())?);
    let token = CancellationToken::new();
    let stop = token.clone();
    tokio::spawn(async move {
        either(&mut interrupt, &mut terminate).await;
        output::note("furrow: stopping; once more to end at once");
        stop.cancel();
        either(&mut interrupt, &mut terminate).await;
        std::process::exit(130);
    });
    Ok(token)
}

async fn either(interrupt: &mut Signal, terminate: &mut Signal) {
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
}
